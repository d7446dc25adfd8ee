"""`sparsefit export`: an estimator as C99 for the processor on board."""

from __future__ import annotations

import argparse
from pathlib import Path

from sparsefit.cli.estimator_file import read_estimator
from sparsefit.cli.options import Verbs, verb
from sparsefit.cli.terminal import check_folder
from sparsefit.errors import one_line

COSTS = ("RAM ", "flas", "stac", "work", "    ")
EXAMPLE = """\
  sparsefit export estimator.json --c flow
  sparsefit export estimator.json --c flow --float --flight flight.csv
  cmake -S flow -B flow/build && cmake --build flow/build && ctest --test-dir flow/build
"""


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "export",
        run,
        summary="write an estimator as C99: no heap, bounded work, with a test that replays a "
        "flight",
        example=EXAMPLE,
    )
    parser.add_argument(
        "estimator", metavar="ESTIMATOR", help="estimator file, .json, as sparsefit select writes"
    )
    parser.add_argument("--c", required=True, metavar="DIR", dest="folder", help="folder to write")
    real = parser.add_mutually_exclusive_group()
    real.add_argument(
        "--double",
        action="store_const",
        const="double",
        dest="real",
        help="numbers of 8 bytes (default)",
    )
    real.add_argument(
        "--float", action="store_const", const="float", dest="real", help="numbers of 4 bytes"
    )
    parser.add_argument(
        "--flight", metavar="FILE", help="recorded flight of the test; default: a simulated one"
    )
    parser.add_argument(
        "--compiler", metavar="CC", help="that measures the flash; default: cc, where there is one"
    )
    parser.add_argument("--force", action="store_true", help="write into DIR though it has files")


def run(args: argparse.Namespace) -> int:
    """Write the C, and say what it takes."""
    from sparsefit.logs import read_flight
    from sparsefit.onboard.c_source import package
    from sparsefit.whole_file import write_whole

    folder = check_folder(args.folder, force=args.force)
    estimator = read_estimator(args.estimator)
    flight = None if args.flight is None else read_flight(args.flight)
    content = package(
        estimator,
        args.real or "double",
        flight,
        source=Path(args.estimator).name,
        compiler=args.compiler,
    )
    for path, file in content.items():
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        write_whole(folder / path, file)
    grid = estimator.library.grid
    print(f"{one_line(args.folder)}: sf_flow.h, sf_flow.c, CMakeLists.txt, README.md, test/")
    print(f"       {grid.lower:g} to {grid.upper:g} m, {args.real or 'double'}")
    readme = content["README.md"].decode()
    print("\n".join(line[4:] for line in readme.splitlines() if line[4:8] in COSTS))
    return 0
