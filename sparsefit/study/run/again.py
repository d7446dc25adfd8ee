"""Which cases a run computes: those without a row, and those that are asked for again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.version import version_of
from sparsefit.study.spec.plan import Case
from sparsefit.study.spec.study import Study

FAILED = ("error", "timeout", "crashed")


@dataclass(frozen=True)
class Again:
    """failed: rows without an answer too; stale: rows of other code too; only: none but these.

    only: names, `*` for any letters, of back-ends, labels and protocols, or case ids.
    """

    failed: bool = False
    stale: bool = False
    only: Sequence[str] = ()

    def wanted(self, ledger: Ledger) -> BoolArray:
        """The cases to compute (flights, cells).

        Raises:
            InputError: where a name in `only` is that of nothing in the study.
        """
        wanted = ~ledger.done
        if self.failed:
            wanted |= ledger.ended(*FAILED)
        if self.stale:
            wanted |= stale(ledger)
        if self.only:
            named = [_named(ledger.study, name) for name in self.only]
            wanted &= np.logical_or.reduce(named)
        return wanted


def stale(ledger: Ledger) -> BoolArray:
    """Which rows were made by other code than this (flights, cells)."""
    cells = ledger.study.cells
    current = {cell.backend: version_of(cell.backend) for cell in cells}
    return ledger.made_by_others([current[cell.backend] for cell in cells])


def _named(study: Study, name: str) -> BoolArray:
    named = np.zeros((study.count, len(study.cells)), dtype=bool)
    for cell in study.cells:
        told = (cell.backend, cell.label, cell.protocol)
        named[:, cell.index] = any(fnmatchcase(one, name) for one in told)
    flight = name.partition("-")[0]
    if not named.any() and flight.isdecimal() and int(flight) < study.count:
        for cell in study.cells:
            named[int(flight), cell.index] = Case(int(flight), cell).case_id == name
    if not named.any():
        labels = sorted({cell.label for cell in study.cells} | {c.protocol for c in study.cells})
        raise InputError(
            f'nothing in study {study.name} is called "{name}": give a back-end, a label, a '
            f"protocol ({', '.join(labels)}) or a case id"
        )
    return named
