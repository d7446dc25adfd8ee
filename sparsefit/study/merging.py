"""Rows of one study that were computed in several places, brought together in one folder.

Each place ran the same study file, with `--only` say, and has a part of its rows, finished or not.
Two rows of one case must tell alike: their status, and the judged numbers to 6 digits. Times of
solvers are taken by whole comparisons, and from one machine only. No file is believed without the
checksum that its manifest tells, and no row without a status.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, told_with
from sparsefit.study.columns import STATUSES, read_body
from sparsefit.study.export import CASES, Row
from sparsefit.study.manifest import check_whole
from sparsefit.study.plan import Plan
from sparsefit.study.runner import Request, locked, make_folder, run
from sparsefit.study.store import STORE, Store

ALIKE = 1e-6  # relative: by which another machine's rounding may differ


@dataclass(frozen=True)
class Part:
    """One folder that rows were taken from: how many it had, and how many were new.

    alike: how many tell what a row that was there tells; other: how many tell something else.
    """

    folder: Path
    rows: int
    taken: int
    alike: int = 0
    other: int = 0


@dataclass(frozen=True)
class Merged:
    """The parts of a merge, and how much of the study is there now."""

    folder: Path
    parts: tuple[Part, ...]
    planned: int
    done: int

    @property
    def finished(self) -> bool:
        """Whether every planned case is there."""
        return self.done == self.planned


def merge(
    plan: Plan, folder: Path, parts: Sequence[str | Path], *, keep_first: bool = False
) -> Merged:
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
    stores = []
    for part in folders:
        with told_with(part):
            stores.append(Store.read(part, plan))
    make_folder(folder)
    with locked(folder):
        registered = {row.key: (folder, row) for row in Store.read(folder, plan).rows()}
        taken: list[Row] = []
        content = []
        for part, store in zip(folders, stores, strict=True):
            with told_with(part):
                rows = {row.key: row for row in store.rows() if row.status in STATUSES}
                if registered:
                    _check_beside(plan, store, [row for _, row in registered.values()])
            alike = other = 0
            for key, row in rows.items():
                if key not in registered:
                    continue
                first, same = registered[key], _same(plan, registered[key][1], row)
                alike, other = alike + same, other + (not same)
                if not same and not keep_first:
                    raise InputError(_clash(plan, first, (part, row)))
            new = [rows[key] for key in _takes(plan, set(registered), set(rows))]
            registered |= {row.key: (part, row) for row in new}
            taken += new
            content.append(Part(part, len(rows), len(new), alike, other))
        with Store.opened(folder, plan) as store:
            for row in taken:
                store.put_row(row)
    done = int(Store.read(folder, plan).done.sum())
    if done == plan.size:  # only its order is left
        run(plan, folder, Request(processes=1))
    return Merged(folder, tuple(content), plan.size, done)


def _folder_of(plan: Plan, part: Path) -> Path:
    for folder in (part, part / plan.experiment.definition.name):
        if (folder / CASES).is_file():
            check_whole(folder / CASES, strict=True)
            return folder
        if (folder / STORE).is_file():
            return folder
    name = plan.experiment.definition.name
    raise InputError(f"{part}: holds no rows of {name}: give a results folder of the study")


def _check_beside(plan: Plan, store: Store, rows: Sequence[Row]) -> None:
    """Refuse times of another machine beside those that are there."""
    if not plan.experiment.alone:
        return
    machines = {version.rpartition(" on ")[2] for version in store.versions}
    if machines | {row.version.rpartition(" on ")[2] for row in rows} != machines:
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
    content = [values.get(name) for name in plan.experiment.judged]
    return [math.nan if value is None else float(value) for value in content]


def _same(plan: Plan, first: Row, second: Row) -> bool:
    pairs = zip(_judged(plan, first), _judged(plan, second), strict=True)
    return first.status == second.status and all(
        math.isclose(a, b, rel_tol=ALIKE) or (math.isnan(a) and math.isnan(b)) for a, b in pairs
    )


def _clash(plan: Plan, first: tuple[Path, Row], second: tuple[Path, Row]) -> str:
    case = plan.case_ids[plan.place_of[second[1].key]]
    sides = []
    for folder, row in (first, second):
        numbers = _judged(plan, row)
        content = f": U0 {numbers[0]:.7g} m/s, L_w {numbers[1]:.7g} m" if numbers else ""
        sides.append(f"{folder} ({row.status}{content})")
    remedy = "leave one out, or add --keep-first"
    return f"case {case} differs between {' and '.join(sides)}: {remedy}"
