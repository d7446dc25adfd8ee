"""Which cases of a plan have a row, how they ended, by which version, and where the row stands.

A few bytes a case, whatever a row holds: the rows themselves stay on the disk.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sparsefit.arrays import BoolArray
from sparsefit.study.run import partial
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.spec.identity import AnyStudy, names_of
from sparsefit.study.spec.names import Names

NOWHERE = -1


@dataclass(eq=False)
class Ledger:
    """The plan of a study, flights by cells, against the rows of its unfinished run.

    Of a study of solvers a problem stands for a flight, and a solver at a tolerance for a cell.
    place: where each row begins, `NOWHERE` for a case without one, and below that for one that an
    earlier run has left (`earlier.py`); status and version: how it ended and what made it, as
    numbers into `words`; damaged: lines that could not be read; unplanned: rows of cases that the
    study does not plan.
    """

    study: AnyStudy
    names: Names
    place: NDArray[np.int64]
    status: NDArray[np.int16]
    version: NDArray[np.int16]
    words: list[str] = field(default_factory=list)
    damaged: int = 0
    unplanned: int = 0

    @classmethod
    def of(cls, study: AnyStudy) -> Ledger:
        """Nothing done yet."""
        shape = (study.count, len(study.cells))
        return cls(
            study,
            names_of(study),
            np.full(shape, NOWHERE, np.int64),
            np.zeros(shape, np.int16),
            np.zeros(shape, np.int16),
        )

    @classmethod
    def read(cls, study: AnyStudy, folder: Path) -> Ledger:
        """What the unfinished rows in the folder hold of the study."""
        ledger = cls.of(study)
        for line in partial.lines(folder):
            if line is None:
                ledger.damaged += 1
                continue
            case = ledger.names.at(line.flight, line.identity)
            if case is None:
                ledger.unplanned += 1
            else:
                ledger.note(*case, line.record["status"], line.record["version"], line.place)
        return ledger

    def enter(self, rows: partial.Writer, row: Outcome) -> None:
        """Append a row of the plan to the unfinished ones, and note where it stands."""
        place = rows.append(row, self.names.of(row.flight, row.cell))
        self.note(row.flight, row.cell, row.status, row.version, place)

    def note(self, flight: int, cell: int, status: str, version: str, place: int) -> None:
        """A row of this case begins at ``place``; it takes the place of an earlier one."""
        self.place[flight, cell] = place
        self.status[flight, cell] = self._number(status)
        self.version[flight, cell] = self._number(version)

    def _number(self, word: str) -> int:
        if word not in self.words:
            self.words.append(word)
        return self.words.index(word)

    def has(self, flight: int, cell: int) -> bool:
        """Whether this case has a row."""
        return bool(self.place[flight, cell] != NOWHERE)

    @property
    def earlier(self) -> BoolArray:
        """Which rows an earlier run has left, and stand nowhere else (flights, cells)."""
        earlier: BoolArray = self.place < NOWHERE
        return earlier

    @property
    def done(self) -> BoolArray:
        """Which cases have a row (flights, cells)."""
        done: BoolArray = self.place != NOWHERE
        return done

    def ended(self, *statuses: str) -> BoolArray:
        """Which cases have a row of one of these statuses."""
        numbers = [self.words.index(word) for word in statuses if word in self.words]
        return self.done & np.isin(self.status, numbers)

    def made_by_others(self, current: Sequence[str]) -> BoolArray:
        """Which rows were not made by the current version, told of every cell."""
        numbers = [self.words.index(one) if one in self.words else NOWHERE for one in current]
        others: BoolArray = (self.version != np.array(numbers)) & self.done
        return others

    @property
    def statuses(self) -> Counter[str]:
        """How many cases ended in each status."""
        return self._counted(self.status)

    @property
    def versions(self) -> Counter[str]:
        """How many rows each version made."""
        return self._counted(self.version)

    def _counted(self, numbers: NDArray[np.int16]) -> Counter[str]:
        each, counts = np.unique(numbers[self.done], return_counts=True)
        named = zip(each.tolist(), counts.tolist(), strict=True)
        return Counter({self.words[number]: count for number, count in named})

    def rows(self, folder: Path) -> Iterator[Outcome]:
        """Every row of the unfinished run, in plan order, one at a time."""
        flights, cells = np.nonzero(self.place >= 0)
        if not len(flights):
            return
        places = (self.place[flights, cells], flights, cells)
        yield from partial.rows_at(folder, zip(*(one.tolist() for one in places), strict=True))
