"""Rows of one study that were computed in several places, brought together in one folder.

Each place ran the same study file, with `--only` say, and has a part of its rows, finished or not.
No file is believed without the checksum that its manifest tells, and no row without a status. Two
rows of one case must agree in status, and in U0, L_w and tau_w to 6 digits. Solvers, which are
timed by turns in one run, have no parts.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from sparsefit.errors import InputError, told_with
from sparsefit.study.columns import PARAMETERS, STATUSES
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
        InputError: if a part is no results folder, is damaged or of another study, if two rows of
            one case differ (nothing is taken then), or the folder is in use.
    """
    if plan.experiment.alone:
        words = "its solvers are timed by turns, in one run: there is nothing to merge"
        raise InputError(f"{plan.experiment.definition.name}: {words}")
    stored = {part: _rows_of(plan, part) for part in map(Path, parts)}
    merged = []
    with locked(folder):
        rows = {row.key: (folder, row) for row in _whole(plan, folder)}
        for part, theirs in stored.items():
            for row in theirs:
                first, other = rows.setdefault(row.key, (part, row))
                if not _alike(row, other):
                    case = plan.case_ids[plan.place_of[row.key]]
                    words = f"differs between {first} and {part}: leave one of them out"
                    raise InputError(f"case {case} {words}")
            taken = sum(first == part for first, _ in rows.values())
            merged.append(MergedPart(part, len(theirs), taken))
        with Store.opened(folder, plan) as own:
            for first, row in rows.values():
                if first != folder:
                    own.put_row(row)
    if len(rows) == plan.size:  # only its order is left
        run(plan, folder, processes=1)
    return merged


def _rows_of(plan: Plan, part: Path) -> list[Row]:
    """The rows of a results folder whose export, if it has one, is as its manifest says."""
    if (part / CASES).is_file():
        check_whole(part / CASES, strict=True)
    elif not (part / STORE).is_file():
        name = plan.experiment.definition.name
        raise InputError(f"{part}: holds no rows of {name}: give a results folder of the study")
    return _whole(plan, part)


def _whole(plan: Plan, folder: Path) -> list[Row]:
    with told_with(folder):
        return [row for row in Store.read(folder, plan).rows() if row.status in STATUSES]


def _alike(first: Row, second: Row) -> bool:
    """Whether two rows of one case agree; rounding may differ on another machine."""
    mine, other = json.loads(first.body), json.loads(second.body)
    names = [f"est_{name}" for name in PARAMETERS]
    near = (math.isclose(mine.get(n, 0.0), other.get(n, 0.0), rel_tol=1e-6) for n in names)
    return first.status == second.status and all(near)
