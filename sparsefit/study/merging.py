"""Rows of one study that were computed in several places, brought together in one folder.

Each place ran the same study file, with `--only` say, and has a part of its rows, finished or not.
Two rows of one case must tell alike: their status, and the judged numbers to 6 digits. Times of
solvers are taken by whole comparisons, and from one machine only. No file is believed without the
checksum that its manifest tells, and no row without a status.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, told_with
from sparsefit.study.columns import STATUSES, read_body
from sparsefit.study.export import CASES, Row
from sparsefit.study.manifest import check_whole
from sparsefit.study.plan import Plan
from sparsefit.study.runner import locked, run
from sparsefit.study.store import STORE, Store

ALIKE = 1e-6  # relative: by which another machine's rounding may differ


@dataclass(frozen=True)
class MergedPart:
    """One folder that rows were taken from: how many it had, and how many were new."""

    folder: Path
    rows: int
    taken: int


def merge(
    plan: Plan, folder: Path, parts: Sequence[str | Path], *, keep_first: bool = False
) -> list[MergedPart]:
    """Take into the folder of a study the rows that the parts have.

    A case that is there, or in an earlier part, keeps its row. Once all are there the study is
    finished, as if it had been run here.

    Args:
        parts: results folders of the study, or folders with one under its name.
        keep_first: where rows of one case differ, keep the first instead of refusing them.

    Raises:
        InputError: if a part is no results folder, is damaged or of another study, if two rows of
            one case tell different things (nothing is taken then), or the folder is in use.
    """
    folders = [_folder_of(plan, Path(part)) for part in parts]
    if folder.resolve() in {part.resolve() for part in folders}:
        words = "merges into itself: give the other parts, or other --results"
        raise InputError(f"{folder}: {words}")
    parts_rows = []
    for part in folders:
        with told_with(part):
            stored = Store.read(part, plan).rows()
            parts_rows.append({row.key: row for row in stored if row.status in STATUSES})
    merged, taken = list[MergedPart](), list[Row]()
    with locked(folder):
        rows = {row.key: (folder, row) for row in Store.read(folder, plan).rows()}
        for part, theirs in zip(folders, parts_rows, strict=True):
            with told_with(part):
                _check_machine(plan, [row for _, row in rows.values()], theirs.values())
            for key in theirs.keys() & rows.keys():
                if not keep_first and not _alike(plan, rows[key][1], theirs[key]):
                    raise InputError(_clash(plan, rows[key], (part, theirs[key])))
            new = [theirs[key] for key in _takes(plan, set(rows), set(theirs))]
            rows |= {row.key: (part, row) for row in new}
            taken += new
            merged.append(MergedPart(part, len(theirs), len(new)))
        with Store.opened(folder, plan) as own:
            for row in taken:
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


def _check_machine(plan: Plan, mine: Iterable[Row], theirs: Iterable[Row]) -> None:
    """Refuse times of another machine beside those that are there."""
    ours, others = ({row.version.rpartition(" on ")[2] for row in rows} for rows in (mine, theirs))
    if plan.experiment.alone and ours and ours != others:
        raise InputError(
            "its times are of another machine, or other versions of what is compared, than those "
            "beside it: no comparison is made of both; run the study on one machine"
        )


def _takes(plan: Plan, mine: set[str], theirs: set[str]) -> list[str]:
    """The keys to take, in plan order: new ones, of timed cases by whole comparisons."""

    def here(keys: set[str]) -> BoolArray:
        return np.array([key in keys for key in plan.keys], dtype=bool).reshape(plan.shape)

    missing = [""] * plan.size
    wanted = here(theirs) & ~here(mine)
    if plan.experiment.alone:
        incomplete = plan.experiment.whole(~here(theirs), here(theirs), missing)
        wanted = plan.experiment.whole(wanted, here(mine), missing) & ~incomplete
    return [key for key, take in zip(plan.keys, wanted.ravel(), strict=True) if take]


def _judged(plan: Plan, row: Row) -> list[float]:
    values = read_body(row.body)[0]
    return [float(values.get(name, math.nan)) for name in plan.experiment.judged]


def _alike(plan: Plan, first: Row, second: Row) -> bool:
    return first.status == second.status and bool(
        np.allclose(_judged(plan, first), _judged(plan, second), ALIKE, 0.0, equal_nan=True)
    )


def _clash(plan: Plan, *rows: tuple[Path, Row]) -> str:
    case = plan.case_ids[plan.place_of[rows[0][1].key]]
    sides = (
        f"{folder} ({row.status} {' '.join(f'{value:.7g}' for value in _judged(plan, row))})"
        for folder, row in rows
    )
    return f"case {case} differs between {' and '.join(sides)}: leave one out, or add --keep-first"
