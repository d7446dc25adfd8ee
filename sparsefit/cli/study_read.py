"""`sparsefit study status, errors, show, report`: read what a study answered."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sparsefit.cli import study_case
from sparsefit.cli.output import print_json, table_record, terminal_width
from sparsefit.cli.parser import Parser, Run
from sparsefit.cli.study_case import show_case
from sparsefit.cli.study_run import by_status, stale_note
from sparsefit.errors import InputError, one_line

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit.study.run.summary import RunStatus
    from sparsefit.study.spec.identity import AnyStudy


@dataclass(frozen=True, eq=False)
class Stored:
    """A study and the cases that are there, finished or not."""

    study: AnyStudy
    status: RunStatus
    cases: pd.DataFrame


def add_options(show: Parser) -> None:
    """Declare what only `show` has."""
    show.add_argument(
        "--table",
        action="append",
        metavar="NAME",
        help="one table, or more if repeated; default: those of the study",
    )
    study_case.add_options(show)


def status(args: argparse.Namespace) -> int:
    """Planned, done, and by status."""
    from sparsefit.study.run import runner
    from sparsefit.study.spec.load import load_study

    study = load_study(args.study)
    found = runner.status(study, args.results)
    if args.json:
        record = {"folder": str(found.folder), "planned": found.planned, "done": found.done}
        counted = {
            "finished": found.finished,
            "statuses": dict(found.statuses),
            "stale": found.stale,
            "versions": dict(found.versions),
        }
        print_json({"study": study.name, **record, **counted})
        return 0
    state = "finished" if found.finished else "not finished" if found.done else "not begun"
    print(
        f"{study.name}: {state}, {found.done} of {found.planned} cases "
        f"({by_status(found.statuses)}) in {found.folder}"
    )
    if found.stale:
        print(stale_note(found.stale))
    return 0


def errors(args: argparse.Namespace) -> int:
    """Cases that are not ok, by back-end, status and reason; numbers in a reason may differ."""
    stored = _stored(args)
    groups = _grouped(stored.study, stored.cases[stored.cases["status"] != "ok"])
    if args.json:
        print_json({"study": stored.study.name, "done": stored.status.done, "groups": groups})
        return 0
    total = sum(group["cases"] for group in groups)
    print(f"{stored.study.name}: {total} of {stored.status.done} cases are not ok" + _note(stored))
    for group in groups:
        print(
            f"\n{group['cases']} x {one_line(group['status'])}, {group['label']}\n"
            f"  {one_line(group['reason']) or 'no reason given'}\n"
            f"  first case: {group['first_case']}"
        )
    return 0


def _grouped(study: AnyStudy, cases: pd.DataFrame) -> list[dict[str, Any]]:
    from sparsefit.study.evidence.sentence import numberless
    from sparsefit.study.report.kind_pages import pages_of

    groups: dict[tuple[str, str, str], dict[str, Any]] = {}
    columns = (cases[name].tolist() for name in ("case_id", "status", "reason"))
    who = pages_of(study).who(cases)
    for label, case_id, status, reason in zip(who, *columns, strict=True):
        key = (label, status, numberless(reason))
        first = {"cases": 0, "status": status, "label": label, "reason": reason}
        groups.setdefault(key, {**first, "first_case": case_id})["cases"] += 1
    return sorted(groups.values(), key=lambda group: -group["cases"])


def show(args: argparse.Namespace) -> int:
    """The tables of the study, or those asked for; or one case, run again and drawn."""
    if args.case is not None:
        return show_case(args)
    from sparsefit.study.report.kind_pages import pages_of
    from sparsefit.study.report.render import to_text
    from sparsefit.study.spec.load import load_study

    names = tuple(args.table or ())
    pages = pages_of(load_study(args.study))
    pages.check_tables(names)
    stored = _stored(args)
    cases, width = stored.cases, terminal_width()
    if not names and not args.json:
        print(pages.show(cases, width=width), end="")
        return 0
    tables = pages.tables(cases, names)
    if args.json:
        print_json({name: table_record(table) for name, table in tables.items()})
    else:
        print("\n".join(to_text(table, width=width) for table in tables.values()), end="")
    return 0


def report(args: argparse.Namespace) -> int:
    """Tables, figures and report anew; the cases stay as they are."""
    from sparsefit.study.report.kind_pages import pages_of
    from sparsefit.study.run import runner
    from sparsefit.study.run.store import read_cases
    from sparsefit.study.spec.load import load_study

    study = load_study(args.study)
    found = runner.status(study, args.results)
    if not found.finished:
        raise unfinished(args.study, found)
    if found.stale:
        print(stale_note(found.stale), file=sys.stderr)
    cases = read_cases(found.folder)
    pages = pages_of(study)
    written = pages.write(args.results, cases)
    print("\n".join([*pages.sentences(cases), *map(str, written)]))
    return 0


RUNS: dict[str, Run] = {"status": status, "errors": errors, "show": show, "report": report}


def _stored(args: argparse.Namespace) -> Stored:
    """The cases of a finished study, or those that a run has left or is making."""
    from sparsefit.study.run import runner
    from sparsefit.study.run.held import cases_of
    from sparsefit.study.spec.load import load_study

    study = load_study(args.study)
    found = runner.status(study, args.results)
    if not found.done:
        raise unfinished(args.study, found)
    return Stored(study, found, cases_of(study, found.folder))


def unfinished(study: str, found: RunStatus) -> InputError:
    """Return (not raise) the refusal of what needs more cases of a study file than there are."""
    there = f"{found.done} of {found.planned} cases are there; run them first"
    if found.done == found.planned:
        there = f"all {found.done} cases are there, and are yet to be put in order"
    return InputError(f"{found.folder}: {there}: sparsefit study run {study}")


def _note(stored: Stored) -> str:
    if stored.status.finished:
        return ""
    return f" (not finished: {stored.status.done} of {stored.status.planned} cases so far)"
