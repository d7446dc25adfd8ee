"""The evidence of a selection as a page: what was chosen, how sure that is, and why others lost."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.study.evidence.fresh import Check
from sparsefit.study.evidence.selection import Selection
from sparsefit.study.evidence.selection_tables import latency_table, regime_table, selection_table
from sparsefit.study.evidence.table import Table
from sparsefit.study.evidence.verdicts import checked, headline, sentences
from sparsefit.study.report.drawing import figure_files, laid_out, to_inline
from sparsefit.study.report.escape import escape_markdown
from sparsefit.study.report.html_page import Code, Page, Part, Picture, Section, to_html
from sparsefit.study.report.pareto import CAPTION, pareto
from sparsefit.study.report.render import table_files, to_markdown
from sparsefit.study.run.latency import processor_of
from sparsefit.study.run.manifest import sparsefit_version
from sparsefit.whole_file import write_files

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

PAGE = "evidence.md"


def write_evidence(
    study: Study, folder: Path, selection: Selection, check: Check | None = None
) -> list[Path]:
    """Write the evidence page, its picture and its tables into the results folder of the study.

    Args:
        check: what fresh flights say, where there are any.

    Returns:
        The files written, the page last.
    """
    files = evidence_files(study, selection, processor_of(folder), check)
    return write_files(folder, files)


def evidence_files(
    study: Study, selection: Selection, processor: str = "", check: Check | None = None
) -> dict[str, bytes]:
    """The files of the evidence by name, the page last; times in files of their own."""
    tables = evidence_tables(selection, processor)
    files = table_files(study.name, tables)
    pictures: list[Picture] = []
    if _timed(selection):
        figure = laid_out(lambda: pareto(selection))
        files |= figure_files("pareto", figure)
        inline = to_inline(figure, "p1", "Accuracy and latency")
        pictures.append(Picture(inline, "Accuracy and latency", CAPTION))
    page = _page(study, selection, check, list(tables.values()), pictures)
    files["evidence.html"] = to_html(page).encode()
    files[PAGE] = evidence_markdown(study, selection, check).encode()
    return files


def evidence_tables(selection: Selection, processor: str = "") -> dict[str, Table]:
    """The tables of the evidence by file name; `processor` is what was timed on."""
    timed = latency_table(selection, processor)
    return {
        "selection": selection_table(selection),
        "regimes": regime_table(selection),
        **({"latency": timed} if timed else {}),
    }


def _page(
    study: Study,
    selection: Selection,
    check: Check | None,
    tables: list[Table],
    pictures: list[Picture],
) -> Page:
    """The evidence as a page that sorts and filters, times in its last section."""
    said = [*sentences(selection), *(checked(selection, check) if check else ())]
    lasting = [table for table in tables if not table.varies]
    timed: list[Part] = [*pictures, *(table for table in tables if table.varies)]
    sections = (
        Section("What the choice rests on", said),
        Section("Tables", lasting),
        Section("The rule", [Code(value, name) for name, value in _rule(selection)]),
        Section("Times on one machine", timed),
    )
    kept = [section for section in sections if section.parts]
    made = f"Study hash {study.hash[:12]}, seed {study.seed}, sparsefit {sparsefit_version()}."
    question = f"{study.name}: the evidence of the selection"
    return Page(question, study.question, (headline(selection),), kept, made)


def evidence_markdown(study: Study, selection: Selection, check: Check | None = None) -> str:
    """The page; its picture and times, which no other machine shares, are files beside it."""
    every = [*sentences(selection), *(checked(selection, check) if check else ())]
    said = "\n".join(f"- {escape_markdown(one)}" for one in every)
    shown = f"![accuracy and latency](pareto.svg)\n\n*{CAPTION}* The times: [latency](latency.md)."
    picture = [shown] if _timed(selection) else []
    tables = evidence_tables(selection).values()
    parts = [
        f"# {escape_markdown(study.name)}: the evidence of the selection",
        f"**{escape_markdown(study.question)}**",
        f"**{escape_markdown(headline(selection))}**",
        said,
        *picture,
        *(to_markdown(table) for table in tables if not table.varies),
        _provenance(study, selection),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _rule(selection: Selection) -> Iterator[tuple[str, str]]:
    """What was asked of the choice, names and values as JSON."""
    for field in fields(selection.rule):
        value = getattr(selection.rule, field.name)
        if value not in (None, ()):
            yield field.name, json.dumps(value)


def _provenance(study: Study, selection: Selection) -> str:
    lines = [f"- {name}: `{value}`" for name, value in _rule(selection)]
    said = (
        f"Study hash `{study.hash[:12]}`, seed {study.seed}, sparsefit {sparsefit_version()}. "
        "Written by `sparsefit select`; do not edit."
    )
    return "\n\n".join(["### The rule", "\n".join(lines), said])


def _timed(selection: Selection) -> bool:
    return any(one.latency and np.isfinite(one.latency.median) for one in selection.ranked)
