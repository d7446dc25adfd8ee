"""The page of a study: its question and answers, pictures, tables, methods, and the run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import pandas as pd

from sparsefit.study.evidence.answers import sentences
from sparsefit.study.evidence.table import Column, Table
from sparsefit.study.report.html_page import Code, Page, Part, Picture, Section
from sparsefit.study.report.methods import methods, protocols
from sparsefit.study.report.points import points_of
from sparsefit.study.report.vector import linked_names
from sparsefit.study.run.manifest import read_manifest

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

POINTS = (
    "Point at a mark, or reach it by Tab and the arrows, to see a case and the command that runs "
    "it again. A mark that summarises many leads to the one that is there, or of a share the first "
    "that speaks against it; of the errors of all cases only the largest lead anywhere."
)
RUN = "This run"  # the last section: all before it is the same on every machine


def study_page(
    study: Study,
    cases: pd.DataFrame,
    folder: Path,
    tables: Mapping[str, Table],
    pictures: Sequence[Picture],
    answers: Sequence[str],
    progress: str,
    more: Sequence[Section] = (),
) -> Page:
    """Return the page of a study, `more` sections between its tables and its methods.

    answers: those that are the same on every machine. What depends on the machine stands in the
    last section, with the manifest in `folder`.
    """
    named = [name for picture in pictures for name in linked_names(picture.svg)]
    told = [POINTS] if named else []
    shown = [table for table in tables.values() if not table.varies]
    sections = [
        *([Section("Pictures", [*pictures, *told])] if pictures else []),
        *([Section("Tables", shown)] if shown else []),
        *more,
        Section("Methods", [*methods(study), *protocols(study)]),
        Section(RUN, list(_run(study, cases, folder, tables))),
    ]
    points = points_of(study, cases, named)
    return Page(study.name, study.question, answers, sections, progress, points)


def _run(
    study: Study, cases: pd.DataFrame, folder: Path, tables: Mapping[str, Table]
) -> Iterator[Part]:
    yield from sentences(study, cases, varies=True)
    yield Code(study.hash, "Study hash (SHA-256 of what its cases depend on):")
    yield from manifest_table(folder)
    yield from (table for table in tables.values() if table.varies)


def manifest_table(folder: Path) -> Iterator[Table]:
    """Give what the manifest of a results folder holds, where there is one."""
    heads = tuple(Column(name, align="left") for name in ("what", "value"))
    if manifest := read_manifest(folder):
        yield Table("Versions, machine and time", heads, tuple(_flat(manifest)))


def _flat(record: Mapping[str, object], before: str = "") -> Iterator[tuple[str, str]]:
    for key, value in record.items():
        words = f"{before}{key.replace('_', ' ')}"
        if isinstance(value, Mapping):
            yield from _flat(value, f"{words}: ")
        else:
            yield words, "–" if value is None else str(value)
