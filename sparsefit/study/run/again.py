"""Which cases a run computes: those without a row, and those that are asked for again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError
from sparsefit.study.run.kinds import kind_of
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.spec.identity import AnyStudy

FAILED = ("error", "timeout", "crashed")


@dataclass(frozen=True)
class Again:
    """failed: rows without an answer too; stale: rows of other code too; only: none but these.

    only: names, `*` for any letters, of back-ends, labels and protocols (of problems, objectives
    and solvers), or case ids.
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
        return kind_of(ledger.study).whole(ledger, wanted)


def stale(ledger: Ledger) -> BoolArray:
    """Which rows were made by other code than this (flights, cells)."""
    kind, cells = kind_of(ledger.study), range(len(ledger.study.cells))
    return ledger.made_by_others([kind.version(cell) for cell in cells])


def _named(study: AnyStudy, name: str) -> BoolArray:
    kind = kind_of(study)
    cells = [any(fnmatchcase(one, name) for one in cell.names) for cell in study.cells]
    named: BoolArray = np.array(cells) | kind.flights_called(name)[:, None]
    if not named.any() and (case := kind.find(name)):
        named[case] = True
    if not named.any():
        known = ", ".join(sorted({one for cell in study.cells for one in cell.names[1:]}))
        raise InputError(f'nothing in study {study.name} is called "{name}": give {kind.called} '
                         f"({known}) or a case id")  # fmt: skip
    return named
