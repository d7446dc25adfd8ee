"""Rows of one study that were computed in several places, brought together in one folder.

Each place ran the same study file, with `--only` say, and has a part of its rows, finished or not.
Two rows of one case must tell alike: their status, and the judged numbers to 6 digits. No file is
believed without the checksum that its manifest tells, and no row without a status. Solvers, which
are timed by turns in one run, have no parts.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sparsefit.errors import InputError, told_with
from sparsefit.study.columns import STATUSES, read_body
from sparsefit.study.export import CASES, Row
from sparsefit.study.manifest import check_whole
from sparsefit.study.plan import Plan
from sparsefit.study.runner import locked, run
from sparsefit.study.store import STORE, Store


@dataclass(frozen=True)
class MergedPart:
    """One folder that rows were taken from: how many it had, and how many were new."""

    folder: Path
    rows: int
    taken: int


def merge(plan: Plan, folder: Path, parts: Sequence[str | Path]) -> list[MergedPart]:
    """Take into the folder of a study the rows that the parts have.

    Once all are there the study is finished, as if it had been run here.

    Args:
        parts: results folders of the study, or folders with one under its name.

    Raises:
        InputError: if a part is no results folder, is damaged or of another study, if two rows of
            one case tell different things (nothing is taken then), or the folder is in use.
    """
    if plan.experiment.alone:
        words = "its solvers are timed by turns, in one run: there is nothing to merge"
        raise InputError(f"{plan.experiment.definition.name}: {words}")
    stored = {part: _rows_of(plan, part) for part in (_folder_of(plan, Path(p)) for p in parts)}
    if folder.resolve() in {part.resolve() for part in stored}:
        words = "merges into itself: give the other parts, or other --results"
        raise InputError(f"{folder}: {words}")
    merged = []
    with locked(folder):
        rows = {key: (folder, row) for key, row in _rows_of(plan, folder).items()}
        for part, theirs in stored.items():
            for key in theirs.keys() & rows.keys():
                _check_alike(plan, rows[key], (part, theirs[key]))
            merged.append(MergedPart(part, len(theirs), len(theirs.keys() - rows.keys())))
            rows = {key: (part, row) for key, row in theirs.items()} | rows
        with Store.opened(folder, plan) as own:
            for part, row in rows.values():
                if part != folder:
                    own.put_row(row)
    if len(rows) == plan.size:  # only its order is left
        run(plan, folder, processes=1)
    return merged


def _folder_of(plan: Plan, part: Path) -> Path:
    name = plan.experiment.definition.name
    for folder in (part, part / name):
        if (folder / CASES).is_file():
            check_whole(folder / CASES, strict=True)
            return folder
        if (folder / STORE).is_file():
            return folder
    raise InputError(f"{part}: holds no rows of {name}: give a results folder of the study")


def _rows_of(plan: Plan, folder: Path) -> dict[str, Row]:
    with told_with(folder):
        rows = Store.read(folder, plan).rows()
        return {row.key: row for row in rows if row.status in STATUSES}


def _check_alike(plan: Plan, *sides: tuple[Path, Row]) -> None:
    """Refuse two rows of one case whose status or judged numbers differ."""
    bodies = [read_body(row.body) for _, row in sides]
    names = plan.experiment.judged
    numbers = np.array([[float(body.get(name, math.nan)) for name in names] for body in bodies])
    same = sides[0][1].status == sides[1][1].status
    # Rounding may differ on another machine.
    if same and np.allclose(numbers[0], numbers[1], 1e-6, 0.0, equal_nan=True):
        return
    words = " and ".join(
        f"{folder} ({row.status} {' '.join(f'{value:.7g}' for value in values)})"
        for (folder, row), values in zip(sides, numbers, strict=True)
    )
    case = plan.case_ids[plan.place_of[sides[0][1].key]]
    raise InputError(f"case {case} differs between {words}: leave one of them out")
