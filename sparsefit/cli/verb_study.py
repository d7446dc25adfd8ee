"""`sparsefit study`: check, plan, run, read, compare and merge studies."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from sparsefit.cli import terminal
from sparsefit.cli.options import PAIRS, RESULTS, Option, Verbs, print_help, verb
from sparsefit.cli.terminal import Reply, terminal_width
from sparsefit.errors import InputError, non_negative, told_with

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit.study.study import Study

ABOUT = """Check, plan, run and read a study.

example:
  sparsefit study check studies/NAME.toml
  sparsefit study run studies/NAME.toml --processes 4
  sparsefit study show studies/NAME.toml
"""
STUDY = Option("study", "study file, .toml", "STUDY")
COUNTS = ("done", "resumed", "computed", "stale", "dropped", "processes", "seconds")
STALE = "computed by another version of the code; study run --stale renews"
RUN = (
    Option("--processes", "default: one per processor of this machine", "N", int),
    Option("--fresh", "start over, and drop all stored cases", read=None),
    Option("--retry-failed", "compute again the cases that ended as error, timeout or crashed",
           read=None),
    Option("--stale", "compute again the cases of other versions of the code", read=None),
    Option("--scheduler", "of dask (an extra), tcp://host:8786 say, whose workers compute in place "
           "of processes of this machine", "ADDRESS"),
    Option("--only", "compute only the cases of this back-end, label, protocol, problem or "
           "solver (* for any letters) or case id; may be repeated", "NAME", **PAIRS),
)  # fmt: skip
TABLES = Option("--table", "table to print, may be repeated; default: those of the study", "NAME",
                **PAIRS)  # fmt: skip
COMPARED = (
    *(Option(name, f"the {name} run: a results folder, or a study file with results",
             name.upper()) for name in ("first", "second")),
    RESULTS,
    Option("--tolerance", "relative change of a number that counts; default: 1e-6",
           "SHARE", float),
)  # fmt: skip
PARTS = Option("parts", "results folder of a part", "FOLDER", nargs="+")


def add(verbs: Verbs) -> None:
    """Declare the verb and its actions."""
    parser = verb(verbs, "study", print_help, about=ABOUT)
    actions = parser.add_subparsers(metavar="ACTION", title="actions", dest="action")
    for run in (check, plan, run_study, status, errors, show, report, compare, merge):
        more = {run_study: RUN, show: (TABLES,), compare: COMPARED, merge: (PARTS,)}
        of_study = () if run is compare else (STUDY, RESULTS)
        options = (*of_study, *more.get(run, ()))
        verb(actions, run.__name__.removesuffix("_study"), run, options)


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
        check_rule(study)
        study.planned.check()
        if study.definition.select.on_board:
            with told_with("[select]"):
                _ = study.refusals  # none can fly
    return study


def check(args: argparse.Namespace) -> Reply:
    """Check a study file, and count its cases."""
    study = _checked(args)
    counts = {"kind": study.definition.kind, "cases": study.planned.size, "hash": study.hash}
    return Reply({"study": study.name, "status": "ok", **counts, "missing": study.missing})


def plan(args: argparse.Namespace) -> Reply:
    """Count the units, conditions, candidates and cases of a study."""
    study = read_study(args)
    return Reply({"study": study.name, "question": study.question, **study.counts()})


def run_study(args: argparse.Namespace) -> Reply:
    """Run a study, or continue one that was stopped."""
    from sparsefit.study import page

    again = "without --fresh to continue" if args.fresh else "again to continue"
    args.stopped = f"stopped; run the same command {again}"
    study = _checked(args)
    names = ("processes", "fresh", "retry_failed", "stale", "only", "scheduler")
    with terminal.Progress() as progress:
        summary = study.run(progress=progress, **{name: getattr(args, name) for name in names})
    _warn(summary.dropped, "no longer planned by the study, and left out")
    _warn(summary.damaged, "damaged, and computed again")
    _warn(summary.stale, STALE)
    args.stopped = "stopped while writing the report; run the same command again to continue"
    record = {"study": study.name, "folder": str(summary.folder), "cases": summary.planned,
              **{name: getattr(summary, name) for name in COUNTS},
              "statuses": dict(summary.statuses)}  # fmt: skip
    if not summary.finished:
        return Reply(record | {"rest": "run without --only for the rest, and the report"})
    written, cases = list(map(str, page.write(study))), study.cases
    record |= {"report": written[-1]}
    shown = "" if args.json else page.show(study, cases, width=terminal_width(), tables_shown=1)
    more = f"all tables: sparsefit study show {args.study}"
    lines = [shown, *terminal.rows(terminal.entries(record)), more]
    return Reply(record | {"headline": page.headline(study, cases), "written": written}, lines)


def _warn(count: int, words: str) -> None:
    """Print on stderr what happened to a number of cases, if any."""
    if count:
        print(f"{count} case{'s' * (count > 1)} {words}", file=sys.stderr)


def status(args: argparse.Namespace) -> Reply:
    """Print the progress of a study, also while it runs."""
    study = read_study(args)
    state = study.status()
    _warn(state.stale, STALE)
    unwritten = state.done == state.planned and not state.finished
    _warn(state.done * unwritten, "there, but not yet in cases.parquet; study run writes it")
    record = {"study": study.name, "folder": str(state.folder), "planned": state.planned}
    record |= {"done": state.done, "finished": state.finished, "stale": state.stale}
    return Reply(record | {"statuses": dict(state.statuses), "versions": dict(state.versions)})


def errors(args: argparse.Namespace) -> Reply:
    """List the cases that are not ok, grouped by candidate, status and reason."""
    from sparsefit.study import tables

    study = read_study(args)
    groups = tables.failures(study.cases).reset_index()
    counts = {"done": len(study.cases), "planned": study.planned.size}
    counts |= {"not_ok": int(groups["cases"].sum())}
    keys = {"cases": "cases", "status": "status", "title": "label", "reason of it": "reason",
            "first case": "first_case"}  # fmt: skip
    found = groups[[*keys]].rename(columns=keys).to_dict("records")
    return Reply({"study": study.name, **counts, "groups": found})


def show(args: argparse.Namespace) -> Reply:
    """Print the tables of a study, also unfinished."""
    from sparsefit.study import page, tables

    study = read_study(args)
    cases, width = study.cases, terminal_width()
    if not args.table and not args.json:
        return Reply({}, [page.show(study, cases, width=width).rstrip("\n")])
    made = tables.tables(study, cases, tuple(args.table))
    texts = (table.to_text(width) for table in made.values())
    return Reply({name: table.record() for name, table in made.items()}, texts)


def report(args: argparse.Namespace) -> Reply:
    """Write tables, figures and report again from the stored cases."""
    from sparsefit.study import page

    study = read_study(args)
    state = study.status()
    if state.done < state.planned:
        there = f"{state.done} of {state.planned} cases are there; run them first"
        raise InputError(f"{state.folder}: {there}: sparsefit study run {args.study}")
    _warn(state.stale, STALE)
    written, headline = list(map(str, page.write(study))), page.headline(study, study.cases)
    said = {"headline": headline, "files": len(written), "report": written[-1]}
    return Reply({**said, "written": written}, terminal.rows(terminal.entries(said)))


def compare(args: argparse.Namespace) -> Reply:
    """Compare two runs of a study case by case; exit code 1 if any case differs.

    example:
      sparsefit study compare results-0.3/table2 results/table2
      sparsefit study compare old/table2 studies/table2.toml
    """
    from sparsefit.study import compare as comparing
    from sparsefit.study.store import read_cases
    from sparsefit.study.study import Study
    from sparsefit.study.table import Table

    def cases(name: str) -> pd.DataFrame:
        is_folder = Path(name).is_dir()
        return read_cases(name) if is_folder else Study.from_file(name, args.results).cases

    limit = comparing.TOLERANCE if args.tolerance is None else args.tolerance
    limit, names = non_negative("--tolerance", limit), (args.first, args.second)
    both = comparing.compare(cases(args.first), cases(args.second), names, limit)
    lines = [Table.of(both.changes).to_text(terminal_width())] if len(both.changes) else []
    return Reply(both.record(), [*lines, both.sentence], int(both.differs))


def merge(args: argparse.Namespace) -> Reply:
    """Merge parts of a study that were run in several places.

    example:
      sparsefit study run studies/table2.toml --only lasso          # on one machine
      sparsefit study run studies/table2.toml --only stlsq          # on another
      sparsefit study merge studies/table2.toml copied/table2
    """
    from sparsefit.study import page

    study = _checked(args)
    merged = study.merge(args.parts)
    now = study.status()
    if now.finished:
        page.write(study)
    record = {"study": study.name, "folder": str(now.folder), "planned": now.planned}
    parts = [{**part._asdict(), "folder": str(part.folder)} for part in merged]
    return Reply(record | {"done": now.done, "finished": now.finished, "parts": parts})
