"""`sparsefit study run`: run, show how far it is, and leave the report behind."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from sparsefit.cli.output import duration, print_json, terminal_width
from sparsefit.cli.parser import Parser, whole
from sparsefit.cli.progress import Bar, Lines

if TYPE_CHECKING:
    from sparsefit.study.run.summary import RunSummary
    from sparsefit.study.spec.identity import AnyStudy

STOPPED = "stopped; run the same command again to continue"
STOPPED_FRESH = "stopped; run the same command without --fresh to continue"
STOPPING = "finishing the fits at hand; Ctrl-C again to stop at once"
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
    parser.add_argument(
        "--retry-failed",
        action="store_true",
        help="compute cases again that ended as error, timeout or crashed",
    )
    parser.add_argument(
        "--stale",
        action="store_true",
        help="compute cases again that other code than this has computed",
    )
    parser.add_argument(
        "--executor",
        choices=("processes", "dask"),
        default="processes",
        help="where cases run: processes of this machine (default), or workers of dask (an extra)",
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of dask, tcp://host:8786 say; default: a cluster of N processes on this machine",
    )
    parser.add_argument(
        "--only",
        action="append",
        default=[],
        metavar="NAME",
        help="compute no case but those of this back-end, label, protocol (* for any letters) or "
        "case id; of a study of solvers of this problem, objective or solver, and what takes turns "
        "with it; repeat it for more",
    )


def run(args: argparse.Namespace) -> int:
    """Run to the end; write and print what came out."""
    from sparsefit.study.report.kind_pages import pages_of
    from sparsefit.study.run import runner
    from sparsefit.study.spec.load import load_study

    study = load_study(args.study)
    pages_of(study).check()
    if args.fresh:
        args.stopped = STOPPED_FRESH
    progress = Bar() if sys.stderr.isatty() else Lines()
    try:
        summary = runner.run(
            study,
            args.results,
            processes=args.processes,
            progress=progress,
            fresh=args.fresh,
            retry_failed=args.retry_failed,
            renew_stale=args.stale,
            only=args.only,
            executor=args.executor,
            scheduler=args.scheduler,
            stopping=lambda: print(f"\n{STOPPING}", file=sys.stderr),
        )
    finally:
        progress.close()
    for note in _notes(summary):
        print(note, file=sys.stderr)
    args.stopped = STOPPED_WRITING
    return _finish(args, study, summary) if summary.finished else _unfinished(args, study, summary)


def _notes(summary: RunSummary) -> Iterator[str]:
    """What happened to rows that were there before, a line each."""
    if summary.dropped:
        yield (
            f"{summary.dropped} cases that the study no longer plans are left out, and kept in "
            f"{summary.folder / 'unplanned.jsonl'} in case it plans them again"
        )
    if summary.damaged:
        yield f"{summary.damaged} damaged rows were passed over, and their cases computed again"
    if summary.stale:
        yield stale_note(summary.stale)


def stale_note(stale: int) -> str:
    """That some rows are older than the code, and what to do about it."""
    from sparsefit.study.run.version import version_of

    rows = "1 case was" if stale == 1 else f"{stale} cases were"
    return f"{rows} computed by other code than this ({version_of('')}); study run --stale renews"


def _unfinished(args: argparse.Namespace, study: AnyStudy, summary: RunSummary) -> int:
    """What `--only` left: rows, but no report yet."""
    if args.json:
        print_json(_record(study, summary))
        return 0
    print(_what_was_done(summary))
    print(
        f"{summary.done} of {summary.planned} cases are there: run without --only for the rest, "
        "and the report"
    )
    return 0


def _finish(args: argparse.Namespace, study: AnyStudy, summary: RunSummary) -> int:
    from sparsefit.study.report.kind_pages import pages_of
    from sparsefit.study.run.store import read_cases

    pages, cases = pages_of(study), read_cases(summary.folder)
    written = pages.write(args.results, cases)
    answers = pages.sentences(cases)
    if args.json:
        said = {"answers": answers, "written": [str(path) for path in written]}
        print_json({**_record(study, summary), **said})
        return 0
    table = pages.main_table(cases, width=terminal_width())
    print("".join(f"{sentence}\n\n" for sentence in answers) + table)
    print(_what_was_done(summary))
    print(f"written to {summary.folder}; start with {written[-1]}")
    return 0


def _record(study: AnyStudy, summary: RunSummary) -> dict[str, Any]:
    return {
        "study": study.name,
        "folder": str(summary.folder),
        "cases": summary.planned,
        "done": summary.done,
        "resumed": summary.resumed,
        "computed": summary.computed,
        "stale": summary.stale,
        "dropped": summary.dropped,
        "statuses": dict(summary.statuses),
        "seconds": summary.seconds,
        "solver_seconds": summary.solver_seconds,
    }


def _what_was_done(summary: RunSummary) -> str:
    counted = by_status(summary.statuses)
    if summary.nothing_to_do:
        there = "all" if summary.finished else f"{summary.done} of"
        return f"nothing to run: {there} {summary.planned} cases were there ({counted})"
    before = f", {summary.resumed} of them from before" if summary.resumed else ""
    spent = summary.processes * summary.seconds
    share = f"solvers took {duration(summary.solver_seconds)} of {duration(spent)}"
    together = f" on {summary.processes} processes" if summary.processes > 1 else ""
    took = f"in {duration(summary.seconds)}{together}; {share}"
    return f"{summary.done} cases{before} ({counted}) {took}"


def by_status(statuses: Mapping[str, int]) -> str:
    """`93 ok, 2 unidentifiable`, in the order of the vocabulary."""
    from sparsefit.study.evidence.cases import STATUSES

    order = [name for name in STATUSES if name in statuses]
    return ", ".join(f"{statuses[name]} {name}" for name in order) or "none"
