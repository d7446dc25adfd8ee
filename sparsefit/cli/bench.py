"""`sparsefit bench`: time to a certified gap, for our solvers and every public peer installed."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from sparsefit.cli.output import refuse_existing
from sparsefit.cli.parser import Verbs, verb, whole

EXAMPLE = """\
  sparsefit bench --quick --results trial
  sparsefit bench --problems short-clean long-noisy --repeats 5
  sparsefit bench --force        # everything, about 15 minutes; peers: pip install sparsefit[peers]
"""


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "bench",
        run,
        summary="time 30-point penalty paths to a duality gap, ours against public peers",
        example=EXAMPLE,
    )
    parser.add_argument("--problems", nargs="+", metavar="NAME", help="default: all six flights")
    parser.add_argument("--contenders", nargs="+", metavar="NAME", help="default: all")
    parser.add_argument(
        "--repeats", type=whole, default=3, metavar="N", help="runs of each, alternating; default 3"
    )
    parser.add_argument(
        "--results", default="results", metavar="FOLDER", help="results go to FOLDER/solvers"
    )
    parser.add_argument(
        "--quick", action="store_true", help="one small problem, to see that everything works"
    )
    parser.add_argument(
        "--force", action="store_true", help="overwrite the benchmark that FOLDER/solvers holds"
    )


def run(args: argparse.Namespace) -> int:
    """Measure, write, and say where."""
    from sparsefit import bench
    from sparsefit.bench import contenders, problems

    problems.chosen(tuple(args.problems) if args.problems else None)  # refuses unknown names
    contenders.chosen(args.contenders, quick=args.quick)
    folder = Path(args.results) / bench.FOLDER
    refuse_existing(str(folder), force=args.force)
    folder.mkdir(parents=True, exist_ok=True)  # before minutes of work, not after
    result = bench.run(
        problems=args.problems,
        contenders=args.contenders,
        repeats=args.repeats,
        quick=args.quick,
        progress=lambda line: print(line, file=sys.stderr),
    )
    folder = bench.write(result, args.results)
    print(f"written to {folder}; start with {folder / 'README.md'}")
    return 0
