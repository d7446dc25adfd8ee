"""The pages of a study of solvers: tables and pictures as files, and a README that shows them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from sparsefit.study.evidence.sentence import capital
from sparsefit.study.evidence.solver_answers import limits, sentences
from sparsefit.study.evidence.solver_tables import tables_of
from sparsefit.study.evidence.table import Table
from sparsefit.study.report.drawing import figure_files, to_inline
from sparsefit.study.report.escape import escape_markdown
from sparsefit.study.report.html_page import Page, Picture, Section, to_html
from sparsefit.study.report.render import table_files, to_markdown, to_text
from sparsefit.study.report.solver_figures import CAPTIONS, figures_of
from sparsefit.study.report.study_page import manifest_table
from sparsefit.study.run.folder import made_folder
from sparsefit.study.spec.solver_study import SolverStudy
from sparsefit.whole_file import write_files


def write_solver_report(
    study: SolverStudy, results_dir: str | Path, cases: pd.DataFrame
) -> list[Path]:
    """Write every table as .md .tex .csv, every picture as .svg .png, report.html and README.md.

    Returns:
        The files written, README.md last.
    """
    folder = made_folder(study, results_dir)
    tables, figures = tables_of(study, cases), figures_of(study, cases)
    files = table_files(study.name, tables)
    for name, figure in figures.items():
        files |= figure_files(name, figure)
    files["report.html"] = to_html(_page(study, cases, folder, tables, figures)).encode()
    files["README.md"] = ("\n".join(_readme(study, cases, tables, list(figures))) + "\n").encode()
    return write_files(folder, files)


def _page(
    study: SolverStudy,
    cases: pd.DataFrame,
    folder: Path,
    tables: Mapping[str, Table],
    figures: Mapping[str, Figure],
) -> Page:
    titles = {name: capital(name.replace("-", " ")) for name in figures}
    pictures = [
        Picture(to_inline(figure, f"p{place}", titles[name]), titles[name], CAPTIONS[name])
        for place, (name, figure) in enumerate(figures.items(), 1)
    ]
    sections = (
        Section("Summary", _named(tables, "summary")),
        Section("Pictures", pictures),
        Section("Tables", _others(tables)),
        Section("Methods", [methods(study, cases)]),
        Section("What this comparison cannot tell", [limits(study, cases)]),
        Section("This run", list(manifest_table(folder))),
    )
    kept = [section for section in sections if section.parts]
    return Page(study.name, study.question, sentences(study, cases), kept)


def _named(tables: Mapping[str, Table], *starts: str) -> list[Table]:
    return [table for name, table in tables.items() if name.startswith(starts)]


def _others(tables: Mapping[str, Table]) -> list[Table]:
    return [table for name, table in tables.items() if not name.startswith("summary")]


def _readme(
    study: SolverStudy, cases: pd.DataFrame, tables: Mapping[str, Table], figures: list[str]
) -> Iterator[str]:
    yield f"# {escape_markdown(study.name)}\n\n{escape_markdown(study.question)}\n"
    for sentence in sentences(study, cases):
        yield f"- {escape_markdown(sentence)}"
    yield f"\n{escape_markdown(methods(study, cases))}\n"
    yield from map(to_markdown, _named(tables, "summary"))
    for name in figures:
        yield f"![{name}]({name}.svg)\n\n{CAPTIONS[name]}\n"
    yield from map(to_markdown, _others(tables))
    yield f"## What this comparison cannot tell\n\n{escape_markdown(limits(study, cases))}\n"
    yield "Written by `sparsefit study run` from `cases.parquet`; `manifest.json` has versions."


def methods(study: SolverStudy, cases: pd.DataFrame) -> str:
    """How it was done, in a paragraph made of the study file."""
    clock, count = study.clock, len(study.fractions)
    work = "a single fit"
    if count:
        ends = f"from {study.fractions[0]:g} to {study.fractions[-1]:g} times alpha_max"
        work = f"a path of {count} penalties {ends}"
    states = Counter(cases["status"])
    counted = ", ".join(f"{number} {state}" for state, number in states.most_common())
    return (
        f"{len(cases)} cases ({counted}): {len(study.problems)} problems, each {work}. One process "
        "at a time, BLAS on one thread; imports and compilation apart; what a solver forms of Z'Z "
        "or a QR is in its time. Cases of a problem are timed by turns, in alternating order, "
        f"until the 95 % interval of the median is within {100 * clock.precision:g} % of it, "
        f"{clock.repeats} repeats are made or they took {clock.seconds:g} s; a solve is killed "
        f"after {clock.limit:g} s. The judge is the certificate that sparsefit computes from the "
        "rows of each problem, whatever a solver says of itself."
    )


def render_solvers(study: SolverStudy, cases: pd.DataFrame, *, width: int) -> str:
    """The question, the answers, the summary and who failed where, for a terminal."""
    head = "\n".join([f"{study.name}: {study.question}", *sentences(study, cases), ""])
    first = _named(tables_of(study, cases), "summary", "failures")
    return "\n".join([head, *(to_text(table, width=width) for table in first)])
