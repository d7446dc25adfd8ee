"""`sparsefit study`: check, plan, run, read, compare and merge studies."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import FORCE, JSON, RESULTS, Option, Verbs, declare, number, verb, whole
from sparsefit.cli.terminal import (
    Progress,
    check_folder,
    check_output,
    coloured,
    duration,
    emit,
    rows_of,
    terminal_width,
)
from sparsefit.errors import InputError, non_negative, one_line, told_with

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit.study.runner import RunStatus, RunSummary
    from sparsefit.study.study import Study

EXAMPLE = """\
  sparsefit study check studies/NAME.toml
  sparsefit study run studies/NAME.toml --processes 4
  sparsefit study show studies/NAME.toml
"""
COMPARE = """\
  sparsefit study compare results-0.3/table2 results/table2
  sparsefit study compare old/table2 studies/table2.toml --fail-on worse -o changes
"""
MERGE = """\
  sparsefit study run studies/table2.toml --only lasso          # on one machine
  sparsefit study run studies/table2.toml --only stlsq          # on another
  sparsefit study merge studies/table2.toml copied/table2
"""
STOPPED = "stopped; run the same command again to continue"
STOPPED_FRESH = "stopped; run the same command without --fresh to continue"
STOPPING = "finishing the fits at hand; Ctrl-C again to stop at once"
STOPPED_WRITING = "stopped while writing the report; run the same command again to continue"
SUFFIXES = (".html", ".svg", ".png")
REPEATED = {"action": "append", "default": []}
RUN = (
    Option("--processes", "default: one per processor of this machine", "N", whole),
    Option("--fresh", "start over, and drop the cases that are there", read=None),
    Option("--retry-failed", "compute cases again that ended as error, timeout or crashed",
           read=None),
    Option("--stale", "compute cases again that other code than this has computed", read=None),
    Option("--executor", "where cases run: processes of this machine (default), or workers of "
           "dask (an extra)", extra={"choices": ("processes", "dask"), "default": "processes"}),
    Option("--scheduler", "of dask, tcp://host:8786 say; default: a cluster of N processes on "
           "this machine", "ADDRESS"),
    Option("--only", "compute no case but those of this back-end, label, protocol, problem or "
           "solver (* for any letters) or case id; repeat it for more", "NAME", extra=REPEATED),
)  # fmt: skip
SHOW = (
    Option("--table", "one table, or more if repeated; default: those of the study", "NAME",
           extra=REPEATED),
    Option("--case", "run this one case again in this process, draw it, and print its numbers "
           "beside the stored ones; ids stand in cases.parquet, in `errors` and in report.html",
           "CASE_ID"),
    Option("-o --output", "picture of the case, .html, .svg or .png; default: "
           "case-CASE_ID.html in the results folder of the study", "FILE"),
    FORCE,
)  # fmt: skip
COMPARED = (
    Option("--tolerance", "a number that changed by less is the same; default: 1e-6 of itself",
           "SHARE", number(), {"default": 1e-6}),
    Option("--fail-on", "exit code 1 when anything changed (default), when it became worse, or "
           "never: changed, worse, never",
           extra={"choices": ("changed", "worse", "never"), "default": "changed"}),
    Option("-o --output", "write tables and a picture there", "FOLDER"),
)  # fmt: skip
KEEP_FIRST = Option(
    "--keep-first", "where parts differ in a case keep the row that is there, or the first part's",
    read=None,
)  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb and its actions."""
    summary = "check, plan, run and read a study"
    parser = verb(verbs, "study", _help, summary=summary, example=EXAMPLE)
    actions = parser.add_subparsers(metavar="ACTION", title="actions", dest="action")
    for run, summary, options in (
        (check, "check a study file, and say on one line what it plans", ()),
        (plan, "count what a study will do and write", ()),
        (run_study, "run a study, or go on with one that was stopped", RUN),
        (status, "tell how far a study is, also while it runs", ()),
        (errors, "list the cases that are not ok, grouped by reason", ()),
        (show, "print the tables of a study, also unfinished; or run one case again", SHOW),
        (report, "write tables, figures and report again from the stored cases", ()),
    ):
        name = run.__name__.removesuffix("_study")
        example = f"  sparsefit study {name} studies/NAME.toml\n"
        action = verb(actions, name, run, summary=summary, example=example)
        action.add_argument("study", metavar="STUDY", help="study file, .toml")
        declare(action, (RESULTS, *options, *([] if run is report else [JSON])))
    _add_compare(actions)
    _add_merge(actions)


def _add_compare(actions: Verbs) -> None:
    summary = "hold two runs of a study against each other, case by case"
    action = verb(actions, "compare", compare, summary=summary, example=COMPARE)
    for name in ("first", "second"):
        words = f"the {name} run: a results folder, or a study file whose results are there"
        action.add_argument(name, metavar=name.upper(), help=words)
    declare(action, (RESULTS, *COMPARED, JSON))


def _add_merge(actions: Verbs) -> None:
    summary = "bring parts of a study together that were run in several places"
    action = verb(actions, "merge", merge, summary=summary, example=MERGE)
    action.add_argument("study", metavar="STUDY", help="study file, .toml")
    action.add_argument("parts", metavar="FOLDER", nargs="+", help="results folder of a part")
    declare(action, (RESULTS, KEEP_FIRST, JSON))


def _help(args: argparse.Namespace) -> int:
    args.parser.print_help()
    return 0


def read_study(args: argparse.Namespace) -> Study:
    """The study of a file, with its results where the command line says."""
    from sparsefit.study.study import Study

    return Study.from_file(args.study, results=args.results)


def _checked(args: argparse.Namespace) -> Study:
    """The study of a file whose outputs and rule of selection are known, before any work."""
    from sparsefit.study.choice import check_rule
    from sparsefit.study.page import check_outputs

    study = read_study(args)
    with told_with(args.study):
        check_outputs(study)
        with told_with("[select]"):
            check_rule(study)
    return study


def check(args: argparse.Namespace) -> int:
    """Exit 0 if the study file is valid; solvers that are missing here are named."""
    study = _checked(args)
    cases = len(study.plan())
    record = {"study": study.name, "cases": cases, "hash": study.hash, "missing": study.missing}
    kind = "" if study.kind == "flights" else f" of {study.kind}"
    heading = f"{args.study}: ok, study {study.name}{kind} plans {cases} cases"
    missing = [f"  missing: {name}: {reason}" for name, reason in study.missing.items()]
    emit(record, lambda: [heading, *missing], as_json=args.json)
    return 0


def plan(args: argparse.Namespace) -> int:
    """Count what will be computed."""
    study = read_study(args)
    record = study.counts()
    pairs = [("study", study.name), ("question", study.question), *record["rows"]]
    written = {key: value for key, value in record.items() if key != "rows"}
    emit({"study": study.name, **written}, lambda: rows_of(pairs), as_json=args.json)
    return 0


def run_study(args: argparse.Namespace) -> int:
    """Run to the end; write and print what came out."""
    from sparsefit.study import page

    args.stopped = STOPPED_FRESH if args.fresh else STOPPED
    study = _checked(args)
    progress = Progress()
    try:
        summary = study.run(
            processes=args.processes,
            progress=progress,
            fresh=args.fresh,
            retry_failed=args.retry_failed,
            stale=args.stale,
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
    record, lines = _run_record(study, summary), [_done(summary)]
    if summary.finished:
        written = page.write(study)
        cases = study.cases
        headline = page.headline(study, cases)
        record |= {"headline": headline, "written": [str(path) for path in written]}
        if not args.json:
            shown = page.show(study, cases, width=terminal_width())
            lines = [shown.rstrip("\n"), "", *lines]
            lines.append(f"written to {summary.folder}; start with {written[-1]}")
    else:
        lines.append(
            f"{summary.done} of {summary.planned} cases are there: run without --only for the "
            "rest, and the report"
        )
    emit(record, lambda: lines, as_json=args.json)
    return 0


def _notes(summary: RunSummary) -> Iterator[str]:
    """What happened to rows of an earlier run, a line each."""
    if summary.dropped:
        yield f"{summary.dropped} cases that the study no longer plans are left out"
    if summary.damaged:
        yield f"{summary.damaged} damaged rows were passed over, and their cases computed again"
    if summary.stale:
        yield _stale(summary.stale)


def _stale(stale: int) -> str:
    rows = "1 case was" if stale == 1 else f"{stale} cases were"
    return f"{rows} computed by other code than this; study run --stale renews"


def _run_record(study: Study, summary: RunSummary) -> dict[str, Any]:
    names = ["done", "resumed", "computed", "stale", "dropped", "seconds", "solver_seconds"]
    return {
        "study": study.name,
        "folder": str(summary.folder),
        "cases": summary.planned,
        "statuses": dict(summary.statuses),
        **{name: getattr(summary, name) for name in names},
    }


def _done(summary: RunSummary) -> str:
    """What was done, in a line: cases by status, time, and the share of it in solvers."""
    counted = _by_status(summary.statuses)
    if not summary.computed:
        there = "all" if summary.finished else f"{summary.done} of"
        return f"nothing to run: {there} {summary.planned} cases were there ({counted})"
    before = f", {summary.resumed} of them from before" if summary.resumed else ""
    spent = duration(summary.processes * summary.seconds)
    together = f" on {summary.processes} processes" if summary.processes > 1 else ""
    took = f"in {duration(summary.seconds)}{together}"
    share = f"solvers took {duration(summary.solver_seconds)} of {spent}"
    return f"{summary.done} cases{before} ({counted}) {took}; {share}"


def _by_status(statuses: Mapping[str, int]) -> str:
    """`93 ok, 2 unidentifiable`, in the order of the vocabulary."""
    from sparsefit.study.columns import STATUSES

    order = [name for name in STATUSES if statuses.get(name)]
    return ", ".join(f"{statuses[name]} {coloured(name)}" for name in order) or "none"


def status(args: argparse.Namespace) -> int:
    """Count planned and finished cases, by status."""
    study = read_study(args)
    found = study.status()
    record = {key: getattr(found, key) for key in ("planned", "done", "finished", "stale")}
    record |= {"statuses": dict(found.statuses), "versions": dict(found.versions)}
    state = "finished" if found.finished else "not finished" if found.done else "not begun"
    counted = f"{found.done} of {found.planned} cases ({_by_status(found.statuses)})"
    lines = [f"{study.name}: {state}, {counted} in {found.folder}"]
    lines += [_stale(found.stale)] if found.stale else []
    emit({"study": study.name, "folder": str(found.folder), **record}, lambda: lines,
         as_json=args.json)  # fmt: skip
    return 0


def errors(args: argparse.Namespace) -> int:
    """List cases that are not ok, by candidate, status and reason; numbers in a reason may vary."""
    study, found, cases = _stored(args)
    groups = _grouped(cases[cases["status"] != "ok"])
    total = sum(group["cases"] for group in groups)
    state = "" if found.finished else f" (not finished: {found.done} of {found.planned} so far)"
    heading = f"{study.name}: {total} of {found.done} cases are not ok{state}"

    def lines() -> Iterator[str]:
        yield heading
        for group in groups:
            count = f"{group['cases']} x {coloured(group['status'], one_line(group['status']))}"
            yield f"\n{count}, {one_line(group['label'])}"
            yield f"  {one_line(group['reason']) or 'no reason given'}"
            yield f"  first case: {group['first_case']}"

    record = {"study": study.name, "done": found.done, "groups": groups}
    emit(record, lines, as_json=args.json)
    return 0


def _grouped(cases: pd.DataFrame) -> list[dict[str, Any]]:
    pattern = cases["reason"].str.replace(r"[-+]?\d[\d.,e+-]*", "#", regex=True)
    keys = [cases["title"], cases["status"], pattern]
    groups = [
        {
            "cases": len(rows),
            "status": str(rows["status"].iloc[0]),
            "label": str(rows["title"].iloc[0]),
            "reason": str(rows["reason"].iloc[0]),
            "first_case": str(rows["case_id"].iloc[0]),
        }
        for _, rows in cases.groupby(keys, sort=False, dropna=False)
    ]
    return sorted(groups, key=lambda group: -group["cases"])


def show(args: argparse.Namespace) -> int:
    """Print the tables of the study, or those asked for; or run one case again and draw it."""
    if args.case is not None:
        return _show_case(args)
    from sparsefit.study import page, tables

    study, _, cases = _stored(args)
    if not args.table and not args.json:
        print(page.show(study, cases, width=terminal_width()), end="")
        return 0
    made = tables.tables(study, cases, tuple(args.table))
    records = {name: table.record() for name, table in made.items()}
    width = terminal_width()
    emit(records, lambda: (table.to_text(width) for table in made.values()), as_json=args.json)
    return 0


def _show_case(args: argparse.Namespace) -> int:
    """Run one case again, write its picture, and print its numbers beside the stored ones."""
    from sparsefit.study import case_page

    study = read_study(args)
    file: Path | None = None
    if args.output is not None and Path(args.output).suffix.lower() not in SUFFIXES:
        words = f"{args.output} must end in {', '.join(SUFFIXES)}: no other is drawn"
        raise InputError(f"--output: {words}")
    if study.kind == "flights":
        default = study.folder / f"case-{args.case}.html"
        file = default if args.output is None else Path(args.output)
        if args.output is not None:
            check_output(args.output, force=args.force)
    elif args.output is not None:
        raise InputError("--output: there is no flight to draw in a study of solvers")
    table = case_page.write_case(study, args.case, file)
    record = {"case": args.case, "picture": None if file is None else str(file), **table.record()}
    written = [] if file is None else [f"written to {file}"]
    emit(record, lambda: [table.to_text(terminal_width()), *written], as_json=args.json)
    return 0


def report(args: argparse.Namespace) -> int:
    """Write tables, figures and report anew; the cases stay as they are."""
    from sparsefit.study import page

    study = read_study(args)
    found = study.status()
    if not found.finished:
        raise unfinished(args.study, found)
    if found.stale:
        print(_stale(found.stale), file=sys.stderr)
    written = page.write(study)
    print("\n".join([page.headline(study, study.cases), *map(str, written)]).lstrip("\n"))
    return 0


def compare(args: argparse.Namespace) -> int:
    """Show what changed; exit 1 where that is more than was asked for."""
    from sparsefit.study import compare as comparing

    tolerance = non_negative("--tolerance", args.tolerance)
    folder = None if args.output is None else check_folder(args.output, own="comparison.md")
    names = (args.first, args.second)
    first, second = (_cases(name, args.results) for name in names)
    both = comparing.compare(first, second, names, tolerance)
    written = comparing.write_comparison(both, folder) if folder else []
    record = both.record() | {"written": [str(path) for path in written]}

    def lines() -> Iterator[str]:
        for table in both.tables.values():
            if len(table.frame):
                yield table.to_text(terminal_width())
        yield both.sentence
        yield from (f"written: {path}" for path in written[-1:])

    emit(record, lines, as_json=args.json)
    if args.fail_on == "worse":
        return int(both.worse)
    return int(both.differs and args.fail_on == "changed")


def _cases(name: str, results: str | None) -> pd.DataFrame:
    """The rows of a results folder, or of a study file by its results."""
    from sparsefit.study.export import read_cases
    from sparsefit.study.study import Study

    return read_cases(name) if Path(name).is_dir() else Study.from_file(name, results=results).cases


def merge(args: argparse.Namespace) -> int:
    """Take what the parts hold; exit 0 also where cases are still missing, which is said."""
    from sparsefit.study import page

    study = _checked(args)
    merged = study.merge(args.parts, keep_first=args.keep_first)
    if merged.finished:
        page.write(study)

    def lines() -> Iterator[str]:
        for part in merged.parts:
            counts = ((part.alike, "alike"), (part.other, "different and left out"))
            beside = "".join(f", {count} {words}" for count, words in counts if count)
            yield f"{part.folder}: {part.taken} of its {part.rows} rows were new{beside}"
        missing = merged.planned - merged.done
        rest = f"{missing} left to run: sparsefit study run {args.study}"
        state = "finished" if merged.finished else rest
        yield f"{merged.folder}: {merged.done} of {merged.planned} cases, {state}"

    parts = [{**dataclasses.asdict(part), "folder": str(part.folder)} for part in merged.parts]
    counted = {"planned": merged.planned, "done": merged.done, "parts": parts}
    record = {"study": study.name, "folder": str(merged.folder), **counted}
    emit(record, lines, as_json=args.json)
    return 0


def _stored(args: argparse.Namespace) -> tuple[Study, RunStatus, pd.DataFrame]:
    """The study, its state and its rows. Raises InputError where there is none yet."""
    study = read_study(args)
    found = study.status()
    if not found.done:
        raise unfinished(args.study, found)
    return study, found, study.cases


def unfinished(name: str, found: RunStatus) -> InputError:
    """The refusal of what needs more cases of a study file than there are; returned, not raised."""
    there = f"{found.done} of {found.planned} cases are there; run them first"
    return InputError(f"{found.folder}: {there}: sparsefit study run {name}")
