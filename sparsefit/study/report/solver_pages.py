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
from sparsefit.study.report.drawing import to_inline, to_png, to_svg
from sparsefit.study.report.escape import escape_markdown
from sparsefit.study.report.html_page import Page, Picture, Section, to_html
from sparsefit.study.report.render import to_csv, to_latex, to_markdown, to_text
from sparsefit.study.report.solver_figures import CAPTIONS, figures_of
from sparsefit.study.report.study_page import manifest_table
from sparsefit.study.run.folder import made_folder
from sparsefit.study.spec.solver_study import SolverStudy
from sparsefit.whole_file import write_whole


def write_solver_report(
    study: SolverStudy, results_dir: str | Path, cases: pd.DataFrame
) -> list[Path]:
    """Write every table as .md .tex .csv, every picture as .svg .png, report.html and README.md.

    Returns:
        The files written, README.md last.
    """
    folder = made_folder(study, results_dir)
    written: list[Path] = []

    def write(name: str, content: bytes | str) -> None:
        write_whole(folder / name, content)
        written.append(folder / name)

    for name, table in tables_of(study, cases).items():
        write(f"{name}.md", to_markdown(table))
        write(f"{name}.tex", to_latex(table))
        write(f"{name}.csv", to_csv(table))
    figures = figures_of(study, cases)
    for name, figure in figures.items():
        write(f"{name}.svg", to_svg(figure))
        write(f"{name}.png", to_png(figure))
    write("report.html", to_html(_page(study, folder, cases, figures)))
    write("README.md", "\n".join(_readme(study, cases, list(figures))) + "\n")
    return written


def _page(
    study: SolverStudy, folder: Path, cases: pd.DataFrame, figures: Mapping[str, Figure]
) -> Page:
    tables = tables_of(study, cases)
    first = [tables.pop(name) for name in list(tables) if name.startswith("summary")]
    titles = {name: capital(name.replace("-", " ")) for name in figures}
    pictures = [
        Picture(to_inline(figure, f"p{place}", titles[name]), titles[name], CAPTIONS[name])
        for place, (name, figure) in enumerate(figures.items(), 1)
    ]
    sections = (
        Section("Summary", first),
        Section("Pictures", pictures),
        Section("Tables", list(tables.values())),
        Section("Methods", [methods(study, cases)]),
        Section("What this comparison cannot tell", [limits(study, cases)]),
        Section("This run", list(manifest_table(folder))),
    )
    kept = [section for section in sections if section.parts]
    return Page(study.name, study.question, sentences(study, cases), kept)


def _readme(study: SolverStudy, cases: pd.DataFrame, figures: list[str]) -> Iterator[str]:
    yield f"# {escape_markdown(study.name)}\n\n{escape_markdown(study.question)}\n"
    for sentence in sentences(study, cases):
        yield f"- {escape_markdown(sentence)}"
    yield f"\n{escape_markdown(methods(study, cases))}\n"
    tables = tables_of(study, cases)
    first = [name for name in tables if name.startswith("summary")]
    yield from (to_markdown(tables.pop(name)) for name in first)
    for name in figures:
        yield f"![{name}]({name}.svg)\n\n{CAPTIONS[name]}\n"
    yield from map(to_markdown, tables.values())
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
    tables = tables_of(study, cases)
    first = [table for name, table in tables.items() if name.startswith(("summary", "failures"))]
    return "\n".join([head, *(to_text(table, width=width) for table in first)])
