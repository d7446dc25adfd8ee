"""Rows of one study that were computed in several places, brought together in one folder.

Each place ran the same study file, with `--only` say, and holds a part of its rows, finished or
not. A row counts by what determines its numbers, so that no part needs to know of the others.
Two rows of one case must say the same: their status, and U0, L_w and tau_w to 6 digits. Times of
solvers are taken by whole comparisons, and from one machine only.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sparsefit.errors import InputError, told_with
from sparsefit.study.run import partial
from sparsefit.study.run.folder import CASES, made_folder
from sparsefit.study.run.held import begin, found, rows_of
from sparsefit.study.run.kinds import kind_of
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.lock import locked
from sparsefit.study.run.runner import run
from sparsefit.study.spec.identity import AnyStudy

ALIKE = 1e-6  # relative: what another machine's rounding may change


@dataclass(frozen=True)
class Part:
    """One folder that rows were taken from: how many it had, and how many were new.

    alike: how many say what a row that was there says; other: how many say something else.
    """

    folder: Path
    rows: int
    taken: int
    alike: int = 0
    other: int = 0


@dataclass(frozen=True)
class Merged:
    """What a merge did: the parts, and how much of the study is there now."""

    folder: Path
    parts: tuple[Part, ...]
    planned: int
    done: int

    @property
    def finished(self) -> bool:
        """Whether every planned case is there."""
        return self.done == self.planned


def merge(
    study: AnyStudy,
    results_dir: str | Path,
    parts: Sequence[str | Path],
    *,
    keep_first: bool = False,
) -> Merged:
    """Take into `results_dir/<name>` the rows of the study that the parts hold.

    A case that is there, or in an earlier part, keeps its row. Once all are there the study is
    finished, as if it had been run here; until then `study run` computes what is missing.

    Args:
        parts: results folders of the study, or folders that hold one under its name.
        keep_first: where rows of one case differ, keep the first instead of refusing them.

    Raises:
        InputError: if a part is no results folder or is of another study, if two rows of one case
            say different things (nothing is taken then), or the folder is in use.
    """
    folders = [_folder(study, Path(part)) for part in parts]
    target = Path(results_dir) / study.name
    if target.resolve() in {one.resolve() for one in folders}:
        raise InputError(f"{target}: merges into itself: give the other parts, or other --results")
    told = [(part, _held(study, part)) for part in folders]
    here = (target, found(study, target))
    _check_beside(study, [here, *told])
    counts = _compared(study, [here, *told], keep_first=keep_first)
    folder = made_folder(study, results_dir)
    with locked(folder):
        ledger = found(study, folder)
        begin(study, folder)
        merged = tuple(
            replace(_take(ledger, folder, part, held), alike=alike, other=other)
            for (part, held), (alike, other) in zip(told, counts, strict=True)
        )
        done = int(ledger.done.sum())
    if done == study.planned:  # what is left is to put it in order
        run(study, results_dir, processes=1)
    return Merged(folder, merged, study.planned, done)


def _check_beside(study: AnyStudy, held: Sequence[tuple[Path, Ledger]]) -> None:
    """Raise InputError where rows of two folders may not stand beside each other."""
    kind, nonempty = kind_of(study), [one for one in held if one[1].done.any()]
    for place, (folder, ledger) in enumerate(nonempty):
        with told_with(folder):
            for _, other in nonempty[:place]:
                kind.takes(ledger, other)


def _folder(study: AnyStudy, part: Path) -> Path:
    for folder in (part, part / study.name):
        if (folder / CASES).is_file() or (folder / partial.FOLDER).is_dir():
            return folder
    raise InputError(f"{part}: holds no rows of {study.name}: give a results folder of the study")


def _held(study: AnyStudy, part: Path) -> Ledger:
    with told_with(part):
        return found(study, part)


Said = tuple[Path, str, tuple[float, ...]]  # where a row stands, its status and its numbers


def _compared(
    study: AnyStudy, held: Sequence[tuple[Path, Ledger]], *, keep_first: bool
) -> list[tuple[int, int]]:
    """Of every part, the first folder being ours: rows that say the same as before, and others."""
    said: dict[tuple[int, int], Said] = {}
    kind = kind_of(study)
    counts, clashes = [], []
    for folder, ledger in held:
        alike = other = 0
        for row in rows_of(ledger, folder):
            own = (folder, row.status, tuple(float(row[name]) for name in kind.judged))
            first = said.setdefault((row.flight, row.cell), own)
            if _same(first, own):
                alike += first is not own
            else:
                other += 1
                clashes.append((kind.case_id(row.flight, row.cell), first, own))
        counts.append((alike, other))
    if clashes and not keep_first:
        raise InputError(_clash(*clashes[0], len(clashes)))
    return counts[1:]


def _same(one: Said, other: Said) -> bool:
    return one[1] == other[1] and all(
        math.isclose(a, b, rel_tol=ALIKE) or (math.isnan(a) and math.isnan(b))
        for a, b in zip(one[2], other[2], strict=True)
    )


def _clash(case: str, one: Said, other: Said, count: int) -> str:
    more = f" (and {count - 1} more)" if count > 1 else ""
    sides = " and ".join(
        f"{folder} ({status}{_told(values)})" for folder, status, values in (one, other)
    )
    return f"case {case}{more} differs between {sides}: leave one out, or add --keep-first"


def _told(values: tuple[float, ...]) -> str:
    return f": U0 {values[0]:.7g} m/s, L_w {values[1]:.7g} m" if values else ""


def _take(ledger: Ledger, folder: Path, part: Path, held: Ledger) -> Part:
    taken, count = 0, 0
    wanted = kind_of(ledger.study).takes(held, ledger)
    with partial.appending(folder) as rows:
        for outcome in rows_of(held, part):
            count += 1
            if wanted[outcome.flight, outcome.cell]:
                ledger.enter(rows, outcome)
                taken += 1
    return Part(part, count, taken)
