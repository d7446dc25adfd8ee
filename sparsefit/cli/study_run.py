"""`sparsefit study run`: run, show how far it is, and leave the report behind."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

from sparsefit.cli.output import duration, print_json, terminal_width
from sparsefit.cli.parser import Parser, whole
from sparsefit.cli.progress import Bar, Lines

if TYPE_CHECKING:
    from sparsefit.study.runner import RunSummary
    from sparsefit.study.spec import Study

STOPPED = "stopped; run the same command again to continue"
STOPPED_FRESH = "stopped; run the same command without --fresh to continue"
STOPPED_WRITING = "stopped while writing the report; run the same command again to continue"


def add_options(parser: Parser) -> None:
    """Declare what only `run` has."""
    parser.set_defaults(stopped=STOPPED)
    parser.add_argument(
        "--processes", type=whole, metavar="N", help="default: one per processor of this machine"
    )
    parser.add_argument(
        "--fresh", action="store_true", help="start over, and drop the cases that are there"
    )


def run(args: argparse.Namespace) -> int:
    """Run to the end; write and print what came out."""
    from sparsefit.study import runner
    from sparsefit.study.spec import Study

    study = Study.load(args.study)
    if args.fresh:
        args.stopped = STOPPED_FRESH
    progress = Bar() if sys.stderr.isatty() else Lines()
    try:
        summary = runner.run(
            study, args.results, processes=args.processes, progress=progress, fresh=args.fresh
        )
    finally:
        progress.close()
    args.stopped = STOPPED_WRITING
    return _finish(args, study, summary)


def _finish(args: argparse.Namespace, study: Study, summary: RunSummary) -> int:
    from sparsefit.study.report import write_report

    written = write_report(study, summary.folder)
    if args.json:
        print_json(
            {
                "study": study.name,
                "folder": str(summary.folder),
                "cases": summary.planned,
                "resumed": summary.resumed,
                "statuses": dict(summary.statuses),
                "seconds": summary.seconds,
                "written": [str(path) for path in written],
            }
        )
        return 0
    print(_main_table(study, summary))
    print(_what_was_done(summary))
    print(f"cases, manifest, tables, figures and report: {summary.folder}")
    return 0


def _main_table(study: Study, summary: RunSummary) -> str:
    from sparsefit.study.render import to_text
    from sparsefit.study.store import read_cases
    from sparsefit.study.tables import TABLES, tables_for

    cases = read_cases(summary.folder)
    first = (*study.tables, *tables_for(cases))[0]
    return to_text(TABLES[first](study, cases), width=terminal_width())


def _what_was_done(summary: RunSummary) -> str:
    counted = by_status(summary.statuses)
    if summary.nothing_to_do:
        return f"nothing to run: all {summary.planned} cases were there ({counted})"
    before = f", {summary.resumed} of them from before" if summary.resumed else ""
    return f"{summary.planned} cases{before} ({counted}) in {duration(summary.seconds)}"


def by_status(statuses: Mapping[str, int]) -> str:
    """`93 ok, 2 unidentifiable`, in the order of the vocabulary."""
    from sparsefit.study.summary import STATUSES

    order = [name for name in STATUSES if name in statuses]
    return ", ".join(f"{statuses[name]} {name}" for name in order) or "none"
