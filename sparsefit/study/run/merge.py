"""Rows of one study that were computed in several places, brought together in one folder.

Each place ran the same study file, with `--only` say, and holds a part of its rows, finished or
not. A row counts by what determines its numbers, so that no part needs to know of the others.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from sparsefit.errors import InputError, told_with
from sparsefit.study.run import partial
from sparsefit.study.run.folder import CASES, made_folder
from sparsefit.study.run.held import found
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.lock import locked
from sparsefit.study.run.manifest import sparsefit_version
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.runner import run
from sparsefit.study.run.summary import RunSummary
from sparsefit.study.spec.study import Study


@dataclass(frozen=True)
class Part:
    """One folder that rows were taken from: how many it had, and how many were new."""

    folder: Path
    rows: int
    taken: int


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


def merge(study: Study, results_dir: str | Path, parts: Sequence[str | Path]) -> Merged:
    """Take into `results_dir/<name>` the rows of the study that the parts hold.

    A case that is there, or in an earlier part, keeps its row. Once all are there the study is
    finished, as if it had been run here; until then `study run` computes what is missing.

    Args:
        parts: results folders of the study, or folders that hold one under its name.

    Raises:
        InputError: if a part is no results folder or is of another study, or the folder is in use.
    """
    folders = [_folder(study, Path(part)) for part in parts]
    target = Path(results_dir) / study.name
    if target.resolve() in {one.resolve() for one in folders}:
        raise InputError(f"{target}: merges into itself: give the other parts, or other --results")
    told = [(part, _held(study, part)) for part in folders]
    folder = made_folder(study, results_dir)
    with locked(folder):
        ledger = found(study, folder)
        header = {"study_hash": study.hash, "sparsefit": sparsefit_version()}
        partial.begin(folder, header | {"study": study.name, "planned": study.planned})
        merged = tuple(_take(ledger, folder, part, held) for part, held in told)
        done = int(ledger.done.sum())
    if done == study.planned:
        _finish(study, results_dir)
    return Merged(folder, merged, study.planned, done)


def _finish(study: Study, results_dir: str | Path) -> RunSummary:
    """Everything is there: what is left is to put it in order."""
    return run(study, results_dir, processes=1)


def _folder(study: Study, part: Path) -> Path:
    for folder in (part, part / study.name):
        if (folder / CASES).is_file() or (folder / partial.FOLDER).is_dir():
            return folder
    raise InputError(f"{part}: holds no rows of {study.name}: give a results folder of the study")


def _held(study: Study, part: Path) -> Ledger:
    with told_with(part):
        return found(study, part)


def _take(ledger: Ledger, folder: Path, part: Path, held: Ledger) -> Part:
    names, taken, count = list(ledger.cells), 0, 0
    with partial.appending(folder) as rows:
        for outcome in _rows(held, part):
            count += 1
            if not ledger.has(outcome.flight, outcome.cell):
                place = rows.append(outcome, names[outcome.cell])
                ended = (outcome.status, outcome.version, place)
                ledger.note(outcome.flight, outcome.cell, *ended)
                taken += 1
    return Part(part, count, taken)


def _rows(held: Ledger, part: Path) -> Iterator[Outcome]:
    from sparsefit.study.run.earlier import earlier_rows  # Arrow: workers import the runner

    yield from earlier_rows(held, part, held.earlier)
    yield from held.rows(part)
