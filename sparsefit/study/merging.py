"""Rows of one study that were computed in several places, brought together in one folder.

Each place ran the same study file, with `--only` say, and has a part of its rows, finished or not.
No file is believed without the checksum that its manifest tells, and no row without a status. Of
two rows of one case the folder's own counts, or that of the first part; `study compare` holds them
against each other. Solvers, which are timed by turns in one run, have no parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from sparsefit.errors import InputError, told_with
from sparsefit.study.columns import STATUSES
from sparsefit.study.export import CASES, Row
from sparsefit.study.manifest import check_whole
from sparsefit.study.plan import Plan
from sparsefit.study.runner import locked, run
from sparsefit.study.store import STORE, Store


class MergedPart(NamedTuple):
    """One folder that rows were taken from: how many it had, and how many were new."""

    folder: Path
    rows: int
    taken: int


def merge(plan: Plan, folder: Path, parts: Sequence[str | Path]) -> list[MergedPart]:
    """Take into the folder of a study the rows that the parts, results folders of it, have.

    Once all are there the study is finished, as if it had been run here.

    Raises:
        InputError: if a part is no results folder, is damaged or of another study (nothing is taken
            then), or the folder is in use.
    """
    if plan.experiment.alone:
        words = "its solvers are timed by turns, in one run: there is nothing to merge"
        raise InputError(f"{plan.experiment.definition.name}: {words}")
    stored = {part: _rows_of(plan, part) for part in map(Path, parts)}
    if folder.resolve() in {part.resolve() for part in stored}:
        raise InputError(f"{folder}: merges into itself: give the other parts, or other --results")
    merged = []
    with locked(folder), Store.opened(folder, plan) as own:
        known = {row.key for row in own.rows() if row.status in STATUSES}
        for part, rows in stored.items():
            new = [row for row in rows if row.key not in known]
            for row in new:
                own.put_row(row)
            known |= {row.key for row in new}
            merged.append(MergedPart(part, len(rows), len(new)))
    if len(known) == plan.size:  # only its order is left
        run(plan, folder, processes=1)
    return merged


def _rows_of(plan: Plan, part: Path) -> list[Row]:
    """The rows of a results folder whose export, if it has one, is as its manifest says."""
    if (part / CASES).is_file():
        check_whole(part / CASES, strict=True)
    elif not (part / STORE).is_file():
        name = plan.experiment.definition.name
        raise InputError(f"{part}: holds no rows of {name}: give a results folder of the study")
    with told_with(part):
        return [row for row in Store.read(part, plan).rows() if row.status in STATUSES]
