"""What a study of flights does in its own way in a run."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.flight.flow import Cells
from sparsefit.score import strongest
from sparsefit.study.run.columns import COLUMNS, Column, Planned
from sparsefit.study.run.jobs import SolverTime, count_jobs, jobs
from sparsefit.study.run.kind import Place
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.pool import Timed, outcomes
from sparsefit.study.run.reading import PARAMETERS
from sparsefit.study.run.version import version_of
from sparsefit.study.spec.names import Names
from sparsefit.study.spec.plan import Case, flight_key
from sparsefit.study.spec.study import Study


@dataclass(frozen=True)
class FlightKind:
    """A study of flights, as `Kind` asks for it."""

    study: Study

    @property
    def columns(self) -> Sequence[Column[Planned]]:
        """The columns of its rows."""
        return COLUMNS

    @property
    def judged(self) -> Sequence[str]:
        """The estimates."""
        return [f"est_{name}" for name in PARAMETERS]

    def planned(self, ordered: Sequence[Outcome], names: Names) -> list[Planned]:
        """The cases with the fastest of their true flows."""
        study, rows = self.study, []
        flows: dict[tuple[int, object], Cells | None] = {}
        for outcome in ordered:
            cell = study.cells[outcome.cell]
            flown = (outcome.flight, flight_key(cell))
            if flown not in flows:
                flow = study.draw(outcome.flight, cell).flow
                flows[flown] = None if flow is None else strongest(flow)
            name = names.of(outcome.flight, outcome.cell)
            rows.append(Planned(study, Case(outcome.flight, cell), flows[flown], name))
        return rows

    def case_id(self, flight: int, cell: int) -> str:
        """Of the number of the flight and the key of the cell."""
        return Case(flight, self.study.cells[cell]).case_id

    def find(self, case_id: str) -> tuple[int, int] | None:
        """(flight, cell) of the case that is called so; None where none is."""
        number, _, key = case_id.partition("-")
        flight = int(number) if number.isdecimal() and len(number) < 10 else -1
        cell = self._cells.get(key)
        return None if cell is None or not 0 <= flight < self.study.count else (flight, cell)

    @cached_property
    def _cells(self) -> dict[str, int]:
        return {cell.key: cell.index for cell in self.study.cells}

    @property
    def called(self) -> str:
        """What a case may be named by, in words."""
        return "a back-end, a label, a protocol"

    def flights_called(self, name: str) -> BoolArray:
        """None: flights have numbers."""
        return np.zeros(self.study.count, dtype=bool)

    def version(self, cell: int) -> str:
        """The code, and a plug-in's."""
        return version_of(self.study.cells[cell].backend)

    def whole(self, ledger: Ledger, wanted: BoolArray) -> BoolArray:
        """Every case stands for itself."""
        return wanted

    def takes(self, held: Ledger, mine: Ledger) -> BoolArray:
        """What is not there yet."""
        return held.done & ~mine.done

    def placed(self, place: Place, *, asked: int | None) -> Place:
        """There; dask is refused where it is not installed."""
        if place.executor == "dask":
            from sparsefit.study.run.on_dask import distributed

            distributed()
        return place

    def compute(
        self, wanted: BoolArray, place: Place, stop: Callable[[], bool]
    ) -> Generator[Timed, None, None]:
        """In processes that are watched, here or on the workers of dask."""
        todo, count = jobs(self.study, wanted), count_jobs(self.study, wanted)
        if place.executor != "dask":
            return outcomes(self.study, todo, min(place.processes, max(count, 1)), stop)
        from sparsefit.study.run.on_dask import outcomes_on_dask

        return outcomes_on_dask(
            self.study, todo, count, scheduler=place.scheduler, processes=place.processes, stop=stop
        )

    def spent(self) -> SolverTime:
        """Seconds in fits, those that are shared once."""
        return SolverTime(self.study)

    def made_with(self) -> Mapping[str, object]:
        """Nothing more."""
        return {}
