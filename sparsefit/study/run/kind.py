"""What the two kinds of studies, of flights and of solvers, do each in its own way in a run.

All else, what a folder holds, what is computed again, how rows are kept, is the same for both.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from sparsefit.arrays import BoolArray
from sparsefit.study.run.columns import Column
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.pool import Timed
from sparsefit.study.spec.names import Names


@dataclass(frozen=True)
class Place:
    """Where cases are computed: "processes" of this machine, so many, or "dask" at an address."""

    executor: str = "processes"
    scheduler: str | None = None
    processes: int = 1


class Spent(Protocol):
    """Adds up the seconds in back-ends."""

    @property
    def total(self) -> float:
        """The seconds [s] so far."""
        ...

    def note(self, outcome: Outcome) -> None:
        """Add what a case took."""


class Kind(Protocol):
    """A study, and what its kind does in its own way."""

    @property
    def columns(self) -> Sequence[Column[Any]]:
        """The columns of its rows."""
        ...

    @property
    def judged(self) -> Sequence[str]:
        """The columns that two rows of one case must agree in."""
        ...

    def planned(self, ordered: Sequence[Outcome], names: Names) -> list[Any]:
        """What the planned columns of these rows are read from."""
        ...

    def case_id(self, flight: int, cell: int) -> str:
        """What a case is called in its rows."""
        ...

    def find(self, case_id: str) -> tuple[int, int] | None:
        """(flight, cell) of the case that is called so; None where none is."""
        ...

    @property
    def called(self) -> str:
        """What a case may be named by, in words."""
        ...

    def flights_called(self, name: str) -> BoolArray:
        """Which flights (flights,) may be called so, `*` for any letters."""
        ...

    def version(self, cell: int) -> str:
        """What the rows of a cell are made by, here and now."""
        ...

    def whole(self, ledger: Ledger, wanted: BoolArray) -> BoolArray:
        """The cases to compute (flights, cells) so that those ``wanted`` are what they say."""
        ...

    def takes(self, held: Ledger, mine: Ledger) -> BoolArray:
        """Which rows (flights, cells) of a part belong beside those that are there.

        Raises:
            InputError: where rows of the two may not stand beside each other.
        """
        ...

    def placed(self, place: Place, *, asked: int | None) -> Place:
        """Where it is computed, of a place; asked: how many processes, None for as many as fit.

        Raises:
            InputError: where the study cannot run there.
        """
        ...

    def compute(
        self, wanted: BoolArray, place: Place, stop: Callable[[], bool]
    ) -> Generator[Timed, None, None]:
        """The outcomes of the cases ``wanted``, as they come, until ``stop()``."""
        ...

    def spent(self) -> Spent:
        """What adds up the seconds in back-ends."""
        ...

    def made_with(self) -> Mapping[str, object]:
        """What the manifest tells beside what it tells of every study."""
        ...
