"""The pages of a study: its tables and figures as files, and a README that shows them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from sparsefit.errors import InputError, told_with
from sparsefit.study.evidence.answers import ANSWERS, sentences
from sparsefit.study.evidence.candidates import Criterion, measure_of
from sparsefit.study.evidence.cases import STATUSES
from sparsefit.study.evidence.contrasts import check_contrasts
from sparsefit.study.evidence.sentence import capital
from sparsefit.study.evidence.table import Table
from sparsefit.study.evidence.tables import TABLES, statuses, tables_of
from sparsefit.study.evidence.worlds import planned_regimes
from sparsefit.study.report.drawing import figure_files, to_inline
from sparsefit.study.report.escape import escape_markdown
from sparsefit.study.report.figures import FIGURES, caption, figures_for
from sparsefit.study.report.html_page import Picture, Section, to_html
from sparsefit.study.report.render import table_files, to_markdown, to_text
from sparsefit.study.report.study_page import study_page
from sparsefit.study.run.folder import CASES, made_folder
from sparsefit.study.run.manifest import MANIFEST
from sparsefit.study.spec.outputs import Entry
from sparsefit.study.spec.selection import AVERAGE, WORST
from sparsefit.whole_file import write_files

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

PAGE = "report.html"


def write_report(
    study: Study,
    results_dir: str | Path,
    cases: pd.DataFrame,
    weights: pd.DataFrame | None = None,
    more: Sequence[Section] = (),
) -> list[Path]:
    """Write `results_dir/<study>/`: every table as .md .tex .csv, every figure as .svg .png.

    All of it, and `more` sections, stand in report.html, one file that works offline.

    The tables and figures are those of the study's [outputs], or else all that apply. The same
    cases give the same bytes. README.md holds what is the same on every machine, and links the
    tables that are of this run alone. Each file is replaced in one step.

    Returns:
        The files written, README.md last.

    Raises:
        InputError: if there are no cases, a figure cannot be drawn of them, or the folder
            cannot be written.
    """
    _refuse_empty(study, cases)
    folder = made_folder(study, results_dir)
    tables = tables_of(study, cases)
    entries: Sequence[Entry] = study.figures or figures_for(cases, weights)
    files, captions = table_files(study.name, tables), {}
    pictures: list[Picture] = []
    for asked in map(FIGURES.read, entries):
        name, figure = asked.file_name, FIGURES.make(asked, study, cases, weights)
        title = asked.title or capital(name.replace("-", " "))
        files |= figure_files(name, figure)
        captions[name] = caption(asked)
        inline = to_inline(figure, f"p{len(pictures) + 1}", title)
        pictures.append(Picture(inline, title, captions[name]))
    answers, progress = sentences(study, cases, varies=False), _progress(study, cases)
    page = study_page(study, cases, folder, tables, pictures, answers, progress, more)
    files[PAGE] = to_html(page).encode()
    files["README.md"] = readme(study, cases, tables, captions, answers).encode()
    return write_files(folder, files)


def check_outputs(study: Study) -> None:
    """Refuse a table, figure or answer of [outputs], or a criterion, that is not known.

    Raises:
        InputError: with the file, the kind of output and the nearest name that is known.
    """
    every = ((TABLES, study.tables), (FIGURES, study.figures), (ANSWERS, study.answers))
    for kind, entries in every:
        with told_with(f"{study.path}: [outputs].{kind.noun}s"):
            asked = [kind.read(entry) for entry in entries]
            for one in asked:
                check_contrasts(study, one)
            counted = Counter(one.file_name for one in asked if kind is not ANSWERS)
            if twice := [name for name, count in counted.items() if count > 1]:
                raise InputError(f'two would be the file "{twice[0]}": give each a name')
    with told_with(f"{study.path}: [select]"):
        rule = study.selection
        if rule.over in (AVERAGE, WORST):
            measure_of(rule)
        else:
            Criterion.of(rule, planned_regimes(study))


def write_table(study: Study, folder: Path, name: str, table: Table) -> list[Path]:
    """Write one table as `name`.md, .tex and .csv into the results folder of the study."""
    return write_files(folder, table_files(study.name, {name: table}))


def render_show(study: Study, cases: pd.DataFrame, *, width: int = 100) -> str:
    """Return the study's tables for a terminal `width` columns wide, its question first."""
    _refuse_empty(study, cases)
    tables = tables_of(study, cases).values()
    answers = sentences(study, cases)
    head = [f"{study.name}: {study.question}", *answers, _progress(study, cases)]
    return "\n".join(["\n".join(head), "", *(to_text(table, width=width) for table in tables)])


def readme(
    study: Study,
    cases: pd.DataFrame,
    tables: dict[str, Table],
    captions: dict[str, str],
    answers: Sequence[str],
) -> str:
    """Return the report as Markdown, its figures linked as files beside it."""
    parts = [
        f"# {escape_markdown(study.name)}",
        f"**{escape_markdown(study.question)}**",
        *map(escape_markdown, answers),
        f"{_progress(study, cases)} Seed {study.seed}, study hash `{study.hash[:12]}`. "
        "Written by `sparsefit study report`; do not edit.",
        *(f"![{name}]({name}.svg)\n\n*{words}*" for name, words in captions.items()),
        *(_section(name, table) for name, table in tables.items() if not table.varies),
        *_statuses(study, cases),
        *_of_this_run(tables),
        *_settings(study),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _statuses(study: Study, cases: pd.DataFrame) -> list[str]:
    """How the cases of each setting ended, where not all ended alike."""
    return [to_markdown(statuses(study, cases))] if cases["status"].nunique() > 1 else []


def _of_this_run(tables: dict[str, Table]) -> list[str]:
    """Where stands what another run of the study would print otherwise."""
    named = {"cases": CASES, "versions, machine and time": MANIFEST}
    named |= {table.title: f"{name}.md" for name, table in tables.items() if table.varies}
    links = ", ".join(f"[{escape_markdown(words)}]({file})" for words, file in named.items())
    page = f"`{PAGE}`, which a run leaves here, has all of it on one page that sorts and filters."
    return ["### This run", f"Of the run that made these files: {links}. {page}"]


def _section(name: str, table: Table) -> str:
    links = ", ".join(f"[{suffix}]({name}.{suffix})" for suffix in ("csv", "tex"))
    return f"{to_markdown(table)}\nThis table: {links}."


def _settings(study: Study) -> list[str]:
    """List what the study file sets of flights, derivative, library and readout."""
    if not study.given:
        return []
    lines = [f"- {key}: `{value}`" for key, value in study.given.items()]
    intro = "Swept factors and protocols in the tables override them."
    return ["### Settings", intro, "\n".join(lines)]


def _progress(study: Study, cases: pd.DataFrame) -> str:
    counted = Counter(cases["status"])
    statuses = ", ".join(f"{counted[name]} {name}" for name in STATUSES if counted[name])
    return f"{len(cases)} of {study.planned} planned cases: {statuses}."


def _refuse_empty(study: Study, cases: pd.DataFrame) -> None:
    if cases.empty:
        raise InputError(f"{study.name} has no cases yet: run it first (sparsefit study run)")
