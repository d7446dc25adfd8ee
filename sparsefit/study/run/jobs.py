"""What a run has to do, as jobs for workers, and what its rows cost in back-ends."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.worker import Job
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.plan import fit_key, flight_key, sharing
from sparsefit.study.spec.study import Study


def jobs(study: Study, wanted: BoolArray) -> Iterator[Job]:
    """The cases ``wanted`` (flights, cells), one job per flight and variant of it.

    So nothing is simulated twice.
    """
    variants = _variants(study)
    for flight in np.flatnonzero(wanted.any(axis=1)).tolist():
        for variant in variants:
            cells = variant[wanted[flight, variant]].tolist()
            if cells:
                yield Job(flight, tuple(cells))


def count_jobs(study: Study, wanted: BoolArray) -> int:
    """How many there are of them."""
    return sum(int(wanted[:, variant].any(axis=1).sum()) for variant in _variants(study))


def _variants(study: Study) -> list[np.ndarray[tuple[int], np.dtype[np.intp]]]:
    groups = sharing(study.cells, flight_key)
    return [np.array([cell.index for cell in group], dtype=np.intp) for group in groups]


class SolverTime:
    """Seconds in back-ends: what several cases or fits share is counted once."""

    def __init__(self, study: Study) -> None:
        self._fit = _numbered(study.cells)
        self._seconds: Array = np.zeros((study.count, int(self._fit.max(initial=-1)) + 1))

    def note(self, outcome: Outcome) -> None:
        """Add what the fit of this case took, unless another case has told it."""
        seconds = float(outcome["seconds"])
        if not math.isnan(seconds):
            fit = self._fit[outcome.cell]
            self._seconds[outcome.flight, fit] = seconds - outcome.shared_seconds

    @property
    def total(self) -> float:
        """The seconds [s] of all fits so far."""
        return float(self._seconds.sum())


def _numbered(cells: Sequence[Cell]) -> np.ndarray[tuple[int], np.dtype[np.intp]]:
    """The number of the fit that each cell reads."""
    numbers = np.zeros(len(cells), dtype=np.intp)
    for number, group in enumerate(sharing(cells, fit_key)):
        numbers[[cell.index for cell in group]] = number
    return numbers
