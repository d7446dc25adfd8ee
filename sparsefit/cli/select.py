"""`sparsefit select`: from a finished study to one estimator."""

from __future__ import annotations

import argparse
import json
from typing import TYPE_CHECKING

from sparsefit.cli.output import (
    print_json,
    refuse_existing,
    table_record,
    terminal_width,
)
from sparsefit.cli.parser import Verbs, add_results, number, verb

if TYPE_CHECKING:
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.study.evidence.candidates import Candidate
    from sparsefit.study.evidence.selection import Selection
    from sparsefit.study.spec.design import Cell
    from sparsefit.study.spec.study import Study

EXAMPLE = """\
  sparsefit select studies/NAME.toml
  sparsefit select studies/NAME.toml --max-failure-rate 0.02 --max-seconds 0.5
  sparsefit estimate flight.csv --estimator estimator.json
"""


def add(verbs: Verbs) -> None:
    """Declare the verb."""
    parser = verb(
        verbs,
        "select",
        run,
        summary="choose one estimator from a finished study, and write it and the evidence",
        example=EXAMPLE,
    )
    parser.add_argument("study", metavar="STUDY", help="study file, .toml, with a [split]")
    add_results(parser)
    parser.add_argument(
        "--criterion",
        metavar="NAME",
        help="mean- or median-absolute-percentage-error- followed by timescale, length_scale or "
        "mean_velocity; default: mean-absolute-percentage-error-timescale",
    )
    parser.add_argument(
        "--max-failure-rate",
        type=number(),
        metavar="SHARE",
        help="largest share of cases without an estimate, 0 to 1",
    )
    parser.add_argument(
        "--max-seconds", type=number("s"), metavar="S", help="largest median time of a case"
    )
    parser.add_argument(
        "-o",
        "--output",
        default="estimator.json",
        metavar="FILE",
        help="estimator to write; default: estimator.json",
    )
    parser.add_argument("--force", action="store_true", help="overwrite FILE")
    parser.add_argument("--json", action="store_true", help="print JSON")


def run(args: argparse.Namespace) -> int:
    """Choose, write, and show the evidence."""
    refuse_existing(args.output, force=args.force)
    from sparsefit.study.evidence.selection import CRITERIA, select
    from sparsefit.study.report.pages import write_table
    from sparsefit.study.run import runner
    from sparsefit.study.run.store import read_cases
    from sparsefit.study.spec.study import Study
    from sparsefit.whole_file import write_whole

    study = Study.load(args.study)
    folder = runner.status(study, args.results).folder  # refuses the results of another study
    chosen = select(
        study,
        read_cases(folder),
        criterion=args.criterion or CRITERIA[0],
        max_failure_rate=args.max_failure_rate,
        max_seconds=args.max_seconds,
    )
    write_whole(args.output, estimator_of(study, chosen).to_json())
    write_table(study, folder, "selection", chosen.table)
    if args.json:
        print_json(_record(chosen, args.output))
    else:
        print("\n".join(_lines(chosen, args.output)))
    return 0


def estimator_of(study: Study, chosen: Selection) -> Estimator:
    """The estimator that the chosen cases used."""
    return study.estimator(next(cell for cell in study.cells if _is(cell, chosen.winner)))


def _is(cell: Cell, winner: Candidate) -> bool:
    from sparsefit.study.spec.document import canonical_json

    fixed = (cell.protocol, cell.backend, cell.label, cell.canonical_settings)
    if fixed != tuple(map(winner.of, ("protocol", "backend", "label", "settings"))):
        return False
    # A column of levels that are not all numbers holds them as text.
    return all(
        value in (cell.levels[key], canonical_json(cell.levels[key]))
        for key, value in winner.factors.items()
    )


def _record(chosen: Selection, output: str) -> dict[str, object]:
    from sparsefit.codec import finite_or_none

    winner = chosen.winner
    scores = ("validate", "evaluate", "failure_rate", "seconds")
    return {
        "study": chosen.study,
        "criterion": chosen.criterion,
        "protocol": winner.of("protocol"),
        "backend": winner.of("backend"),
        "settings": json.loads(winner.of("settings")),
        "factors": dict(winner.factors),
        **{name: finite_or_none(getattr(winner, name)) for name in scores},
        "candidates": chosen.candidates,
        "eligible": chosen.eligible,
        "output": output,
        "table": table_record(chosen.table),
    }


def _lines(chosen: Selection, output: str) -> list[str]:
    from sparsefit.study.report.render import to_text

    winner = chosen.winner
    return [
        to_text(chosen.table, width=terminal_width()),
        f"{output}: {winner.of('backend')}, {chosen.criterion} {winner.evaluate:.3g} % on flights "
        "that had no part in the choice",
        f"use it: sparsefit estimate FLIGHT --estimator {output}",
    ]
