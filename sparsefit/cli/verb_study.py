"""`sparsefit study`: check, plan, run, read, compare and merge studies."""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.cli.options import (
    FORCE,
    JSON,
    RESULTS,
    Option,
    Verbs,
    declare,
    number,
    print_help,
    verb,
    whole,
)
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

    from sparsefit.study.runner import RunSummary
    from sparsefit.study.study import Study

EXAMPLE = """\
  sparsefit study check studies/NAME.toml
  sparsefit study run studies/NAME.toml --processes 4
  sparsefit study show studies/NAME.toml
"""
COMPARE = """\
  sparsefit study compare results-0.3/table2 results/table2
  sparsefit study compare old/table2 studies/table2.toml -o changes
"""
MERGE = """\
  sparsefit study run studies/table2.toml --only lasso          # on one machine
  sparsefit study run studies/table2.toml --only stlsq          # on another
  sparsefit study merge studies/table2.toml copied/table2
"""
STUDY = Option("study", "study file, .toml", "STUDY")
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
    *(Option(name, f"the {name} run: a results folder, or a study file whose results are there",
             name.upper()) for name in ("first", "second")),
    RESULTS,
    Option("--tolerance", "a number that changed by less is the same; default: 1e-6 of itself",
           "SHARE", number(), {"default": 1e-6}),
    Option("-o --output", "write tables and a picture there", "FOLDER"),
)  # fmt: skip
MERGED = (
    STUDY,
    Option("parts", "results folder of a part", "FOLDER", extra={"nargs": "+"}),
    RESULTS,
)  # fmt: skip
SECTION = Option("section", "flights, library, run, select ...; default: all of them", "SECTION",
                 extra={"nargs": "?"})  # fmt: skip


def add(verbs: Verbs) -> None:
    """Declare the verb and its actions."""
    summary = "check, plan, run and read a study"
    parser = verb(verbs, "study", print_help, summary=summary, example=EXAMPLE)
    actions = parser.add_subparsers(metavar="ACTION", title="actions", dest="action")
    own = "  sparsefit study {} studies/NAME.toml\n"
    of_study = (STUDY, RESULTS)
    for name, run, summary, options, example in (
        ("check", check, "check a study file, and say on one line what it plans", of_study, own),
        ("plan", plan, "count what a study will do and write", of_study, own),
        ("run", run_study, "run a study, or go on with one that was stopped", (*of_study, *RUN),
         own),
        ("status", status, "tell how far a study is, also while it runs", of_study, own),
        ("errors", errors, "list the cases that are not ok, grouped by reason", of_study, own),
        ("show", show, "print the tables of a study, also unfinished; or run one case again",
         (*of_study, *SHOW), own),
        ("report", report, "write tables, figures and report again from the stored cases",
         of_study, own),
        ("compare", compare, "hold two runs of a study against each other, case by case", COMPARED,
         COMPARE),
        ("merge", merge, "bring parts of a study together that were run in several places",
         MERGED, MERGE),
        ("keys", keys, "list the keys of a study file, with their units, ranges and defaults",
         (SECTION,), "  sparsefit study keys flights\n"),
    ):  # fmt: skip
        action = verb(actions, name, run, summary=summary, example=example.format(name))
        declare(action, (*options, *([] if name == "report" else [JSON])))


def read_study(args: argparse.Namespace) -> Study:
    """The study of a file, with its results where the command line says."""
    from sparsefit.study.study import Study

    return Study.from_file(args.study, results=args.results)


def _checked(args: argparse.Namespace) -> Study:
    """The study of a file whose outputs and rule of selection are known, before any work."""
    from sparsefit.study.page import check_outputs
    from sparsefit.study.selection import check_rule

    study = read_study(args)
    with told_with(args.study):
        check_outputs(study)
        with told_with("[select]"):
            check_rule(study)
            if study.definition.selection.on_board:
                _ = study.refusals  # none can fly
    return study


def check(args: argparse.Namespace) -> int:
    """Exit 0 if the study file is valid; solvers that are missing here are named."""
    study = _checked(args)
    cases = study.planned.size
    record = {"study": study.name, "cases": cases, "hash": study.hash, "missing": study.missing}
    kind = "" if study.kind == "flights" else f" of {study.kind}"
    heading = f"{args.study}: ok, study {study.name}{kind} plans {cases} cases"
    missing = [  # most reasons begin with the solver's name
        f"  missing: {reason if reason.startswith(name) else f'{name}: {reason}'}"
        for name, reason in study.missing.items()
    ]
    return emit(record, [heading, *missing], as_json=args.json)


def plan(args: argparse.Namespace) -> int:
    """Count what will be computed."""
    study = read_study(args)
    record = {"study": study.name, "question": study.question, **study.counts()}
    rows: list[tuple[str, str]] = []
    for name, value in record.items():
        if isinstance(value, dict):
            rows += ((f"{name.rstrip('s')} {key}", str(item)) for key, item in value.items())
        elif isinstance(value, list):
            words = f"{len(value)}: {'; '.join(value)}" if value else "none"
            rows.append((name, one_line(words, terminal_width())))
        else:
            rows.append((name, str(value)))
    return emit(record, rows_of(rows), as_json=args.json)


def keys(args: argparse.Namespace) -> int:
    """List the keys of one section, or of all."""
    from sparsefit.study.definition import keys_of
    from sparsefit.study.keys import OWN

    record = {name: keys_of(name) for name in ([args.section] if args.section else OWN)}
    parts = ("\n".join([f"[{name}]", *rows_of(words.items())]) for name, words in record.items())
    return emit(record, ["\n\n".join(parts)], as_json=args.json)


def run_study(args: argparse.Namespace) -> int:
    """Run to the end; write and print what came out."""
    from sparsefit.study import page

    again = "without --fresh to continue" if args.fresh else "again to continue"
    args.stopped = f"stopped; run the same command {again}"
    study = _checked(args)
    names = ("processes", "fresh", "retry_failed", "stale", "only", "executor", "scheduler")
    with Progress() as progress:
        summary = study.run(progress=progress, **{name: getattr(args, name) for name in names})
    rows = {
        f"{summary.dropped} cases that the study no longer plans are left out": summary.dropped,
        f"{summary.damaged} rows were damaged, and their cases computed again": summary.damaged,
        _stale(summary.stale): summary.stale,
    }
    for note in (note for note, count in rows.items() if count):
        print(note, file=sys.stderr)
    args.stopped = "stopped while writing the report; run the same command again to continue"
    record = {
        "study": study.name,
        "folder": str(summary.folder),
        "cases": summary.planned,
        "statuses": dict(summary.statuses),
        **{name: getattr(summary, name) for name in
           ("done", "resumed", "computed", "stale", "dropped", "seconds")},
    }  # fmt: skip
    lines = [_done(summary)]
    if summary.finished:
        written, cases = page.write(study), study.cases
        record |= {"headline": page.headline(study, cases), "written": list(map(str, written))}
        shown = "" if args.json else page.show(study, cases, width=terminal_width())
        lines = [shown.rstrip("\n"), "", *lines]
        lines.append(f"written to {summary.folder}; start with {written[-1]}")
    else:
        rest = "run without --only for the rest, and the report"
        lines.append(f"{summary.done} of {summary.planned} cases are there: {rest}")
    return emit(record, lines, as_json=args.json)


def _stale(stale: int) -> str:
    rows = "1 case was" if stale == 1 else f"{stale} cases were"
    return f"{rows} computed by other code than this; study run --stale renews"


def _done(summary: RunSummary) -> str:
    """The outcome of a run in a line: cases by status, and the time."""
    counted = _by_status(summary.statuses)
    if not summary.computed:
        there = "all" if summary.finished else f"{summary.done} of"
        return f"nothing to run: {there} {summary.planned} cases were there ({counted})"
    before = f", {summary.resumed} of them from before" if summary.resumed else ""
    together = f" on {summary.processes} processes" if summary.processes > 1 else ""
    return f"{summary.done} cases{before} ({counted}) in {duration(summary.seconds)}{together}"


def _by_status(statuses: Mapping[str, int]) -> str:
    """`93 ok, 2 unidentifiable`, in the order of the vocabulary."""
    from sparsefit.study.columns import STATUSES

    order = [name for name in STATUSES if statuses.get(name)]
    return ", ".join(f"{statuses[name]} {coloured(name)}" for name in order) or "none"


def status(args: argparse.Namespace) -> int:
    """Count planned and finished cases, by status."""
    study = read_study(args)
    state = study.status()
    record = {"study": study.name, "folder": str(state.folder), "planned": state.planned}
    record |= {"done": state.done, "finished": state.finished, "stale": state.stale}
    record |= {"statuses": dict(state.statuses), "versions": dict(state.versions)}
    words = "finished" if state.finished else "not finished" if state.done else "not begun"
    counted = f"{state.done} of {state.planned} cases ({_by_status(state.statuses)})"
    lines = [f"{study.name}: {words}, {counted} in {state.folder}"]
    return emit(record, lines + [_stale(state.stale)] * bool(state.stale), as_json=args.json)


def errors(args: argparse.Namespace) -> int:
    """List cases that are not ok, by candidate, status and reason; numbers in a reason may vary."""
    study, state = stored(args, whole=False)
    cases = study.cases
    cases = cases[cases["status"] != "ok"]
    pattern = cases["reason"].str.replace(r"[-+]?\d[\d.,e+-]*", "#", regex=True)
    names = {"status": "status", "label": "title", "reason": "reason", "first_case": "case_id"}
    groups: list[dict[str, Any]] = [
        {"cases": len(rows), **{key: str(rows[name].iloc[0]) for key, name in names.items()}}
        for _, rows in cases.groupby([cases["title"], cases["status"], pattern], sort=False,
                                     dropna=False)
    ]  # fmt: skip
    groups.sort(key=lambda group: -group["cases"])
    so_far = "" if state.finished else f" (not finished: {state.done} of {state.planned} so far)"
    lines = [f"{study.name}: {len(cases)} of {state.done} cases are not ok{so_far}"]
    for group in groups:
        status, label, reason, case = (one_line(str(group[name])) for name in names)
        lines += [f"\n{group['cases']} x {coloured(status)}, {label}"]
        lines += [f"  {reason or 'no reason given'}", f"  first case: {case}"]
    record = {"study": study.name, "done": state.done, "groups": groups}
    return emit(record, lines, as_json=args.json)


def show(args: argparse.Namespace) -> int:
    """Print the tables of the study, or those asked for; or run one case again and draw it."""
    if args.case is not None:
        return _show_case(args)
    from sparsefit.study import page, tables

    study, _ = stored(args, whole=False)
    cases, width = study.cases, terminal_width()
    if not args.table and not args.json:
        print(page.show(study, cases, width=width), end="")
        return 0
    made = tables.tables(study, cases, tuple(args.table))
    texts = (table.to_text(width) for table in made.values())
    return emit({name: table.record() for name, table in made.items()}, texts, as_json=args.json)


def _show_case(args: argparse.Namespace) -> int:
    """Run one case again, write its picture, and print its numbers beside the stored ones."""
    from sparsefit.study import case_page

    study, flown = read_study(args), None
    if study.kind == "flights":
        flown = Path(args.output or study.folder / f"case-{args.case}.html")
    if args.output is not None:
        if flown is None:
            raise InputError("--output: there is no flight to draw in a study of solvers")
        check_output(args.output, force=args.force, endings=(".html", ".svg", ".png"))
    table = case_page.write_case(study, args.case, flown)
    record = {"case": args.case, "picture": flown and str(flown), **table.record()}
    written = [f"written to {flown}"] if flown else []
    return emit(record, [table.to_text(terminal_width()), *written], as_json=args.json)


def report(args: argparse.Namespace) -> int:
    """Write tables, figures and report anew; the cases stay as they are."""
    from sparsefit.study import page

    study, state = stored(args, whole=True)
    if state.stale:
        print(_stale(state.stale), file=sys.stderr)
    written = page.write(study)
    print("\n".join([page.headline(study, study.cases), *map(str, written)]).lstrip("\n"))
    return 0


def compare(args: argparse.Namespace) -> int:
    """Show what changed; exit 1 where anything did."""
    from sparsefit.study import compare as comparing
    from sparsefit.study.export import read_cases
    from sparsefit.study.study import Study

    def cases(name: str) -> pd.DataFrame:
        if Path(name).is_dir():
            return read_cases(name)
        return Study.from_file(name, results=args.results).cases

    tolerance = non_negative("--tolerance", args.tolerance)
    folder = None if args.output is None else check_folder(args.output, own="comparison.md")
    names = (args.first, args.second)
    first, second = map(cases, names)
    both = comparing.compare(first, second, names, tolerance)
    written = list(map(str, comparing.write_comparison(both, folder) if folder else []))
    tables = (table for table in both.tables.values() if len(table.frame))
    lines = [*(table.to_text(terminal_width()) for table in tables), both.sentence]
    lines += [f"written: {path}" for path in written[-1:]]
    emit(both.record() | {"written": written}, lines, as_json=args.json)
    return int(both.differs)


def merge(args: argparse.Namespace) -> int:
    """Take what the parts hold; exit 0 also where cases are still missing, which is said."""
    from sparsefit.study import page

    study = _checked(args)
    merged = study.merge(args.parts)
    now = study.status()
    if now.finished:
        page.write(study)
    lines = [f"{part.folder}: {part.taken} of its {part.rows} rows were new" for part in merged]
    rest = f"{now.planned - now.done} left to run: sparsefit study run {args.study}"
    state = "finished" if now.finished else rest
    lines.append(f"{now.folder}: {now.done} of {now.planned} cases, {state}")
    parts = [{**dataclasses.asdict(part), "folder": str(part.folder)} for part in merged]
    counted = {"planned": now.planned, "done": now.done, "parts": parts}
    record = {"study": study.name, "folder": str(now.folder), **counted}
    return emit(record, lines, as_json=args.json)


def stored(args: argparse.Namespace, *, whole: bool) -> tuple[Study, RunSummary]:
    """The study and its state; whole: all of its cases are needed, else some.

    Raises:
        InputError: with the command that runs those that are not there.
    """
    study = read_study(args)
    state = study.status()  # refuses the results of another study
    if not (state.finished if whole else state.done):
        there = f"{state.done} of {state.planned} cases are there; run them first"
        raise InputError(f"{state.folder}: {there}: sparsefit study run {args.study}")
    return study, state
