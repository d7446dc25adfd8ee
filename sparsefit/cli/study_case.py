"""`sparsefit study show STUDY --case CASE_ID`: run one case again, draw it, print its numbers."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from sparsefit.cli.output import check_output, print_json, table_record, terminal_width
from sparsefit.cli.parser import Parser

if TYPE_CHECKING:
    from sparsefit.study.evidence.table import Table
    from sparsefit.study.run.one_case import OneCase
    from sparsefit.study.spec.solver_study import SolverStudy
    from sparsefit.study.spec.study import Study

SUFFIXES = (".html", ".svg", ".png")


def add_options(show: Parser) -> None:
    """Declare what only `show --case` has."""
    show.add_argument(
        "--case",
        metavar="CASE_ID",
        help="run this one case again in this process, draw it, and print its numbers beside the "
        "stored ones; ids stand in cases.parquet, in `errors` and in report.html",
    )
    show.add_argument(
        "-o",
        "--output",
        metavar="FILE",
        help="picture of the case, .html, .svg or .png; default: case-CASE_ID.html in the "
        "results folder of the study",
    )
    show.add_argument("--force", action="store_true", help="overwrite FILE")


def show_case(args: argparse.Namespace) -> int:
    """Exit 0 if the case could be run, whatever it is called."""
    from sparsefit.study.report.case import case_table, row_of
    from sparsefit.study.report.render import to_text
    from sparsefit.study.run.held import cases_of
    from sparsefit.study.run.one_case import find_case, run_again
    from sparsefit.study.spec.load import load_study
    from sparsefit.study.spec.solver_study import SolverStudy

    study = load_study(args.study)
    if isinstance(study, SolverStudy):
        return _show_solve(args, study)
    find_case(study, args.case)
    file = _file(args, study, args.case)
    stored = row_of(cases_of(study, Path(args.results) / study.name), args.case)
    again = run_again(study, args.case)
    table = case_table(study, again, stored)
    _draw(file, study, again, table)
    if args.json:
        print_json({"case": args.case, "picture": str(file), **table_record(table)})
    else:
        print(f"{to_text(table, width=terminal_width())}\nwritten to {file}")
    return 0


def _show_solve(args: argparse.Namespace, study: SolverStudy) -> int:
    """The same of a study of solvers: solved and judged again, alone, and nothing drawn."""
    from sparsefit.errors import InputError
    from sparsefit.study.evidence.table import Column, Table
    from sparsefit.study.report.case import text_of
    from sparsefit.study.report.render import to_text
    from sparsefit.study.run.held import cases_of
    from sparsefit.study.run.one_case import solved_again
    from sparsefit.study.run.store import cases_table

    if args.output is not None:
        raise InputError("--output: there is no flight to draw in a study of solvers")
    again = cases_table(study, [solved_again(study, args.case)]).to_pylist()[0]
    rows = cases_of(study, Path(args.results) / study.name)
    stored = rows[rows["case_id"] == args.case].to_dict("records")
    before = stored[0] if stored else {}
    columns = (Column("what", align="left"), Column("stored"), Column("now"))
    told = [(name, text_of(before.get(name)), text_of(value)) for name, value in again.items()]
    table = Table(f"Case {args.case}", columns, tuple(told))
    if args.json:
        print_json({"case": args.case, **table_record(table)})
    else:
        print(to_text(table, width=terminal_width()))
    return 0


def _file(args: argparse.Namespace, study: Study, case_id: str) -> Path:
    from sparsefit.errors import InputError
    from sparsefit.study.run.folder import made_folder

    if args.output is None:
        return made_folder(study, args.results) / f"case-{case_id}.html"
    file = Path(args.output)
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"--output: {file} must end in {', '.join(SUFFIXES)}: no other is drawn")
    check_output(args.output, force=args.force)
    return file


def _draw(file: Path, study: Study, again: OneCase, table: Table) -> None:
    from sparsefit.study.report.case import CAPTION, case_figure
    from sparsefit.study.report.drawing import to_inline, to_png, to_svg
    from sparsefit.study.report.html_page import Page, Picture, Section, to_html
    from sparsefit.whole_file import write_whole

    figure, estimate = case_figure(again), again.estimate
    if file.suffix.lower() != ".html":
        write_whole(file, to_svg(figure) if file.suffix.lower() == ".svg" else to_png(figure))
        return
    name = again.case.case_id
    picture = Picture(to_inline(figure, "p1", f"Case {name}"), "Picture", CAPTION)
    sections = (Section("Picture", (picture,)), Section("Numbers", (table,)))
    answer = f"{estimate.status}: {estimate.reason}" if estimate.reason else estimate.status
    page = Page(study.name, f"Case {name}", (answer,), sections, table.title)
    write_whole(file, to_html(page).encode())
