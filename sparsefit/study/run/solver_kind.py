"""What a study of solvers does in its own way in a run: its cases are timed by turns.

Those of one problem and one objective are computed together or not at all, and no time stands
beside that of another machine: what a row is made by is the code, and on what it ran.
"""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError
from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.run.columns import Column
from sparsefit.study.run.kind import Place
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.manifest import processor, version_of, versions
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.pool import Timed
from sparsefit.study.run.solver_columns import SOLVER_COLUMNS, PlannedSolve
from sparsefit.study.run.version import version_of as code_of
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.names import Names
from sparsefit.study.spec.solver_study import SolverStudy

ON = " on "  # between the code and the machine
MISSING = "skipped"
PEERS = ("scikit-learn", "celer", "skglm", "group-lasso", "spams-bin", "scs", "highspy", "piqp",
         "daqp", "pysindy", "numba")  # fmt: skip


@dataclass
class Clocked:
    """Adds up the seconds of CPU that the timed solves took."""

    total: float = 0.0

    def note(self, outcome: Outcome) -> None:
        """Add the repeats of a case."""
        seconds = float(outcome["cpu"]) * float(outcome["repeats"])
        self.total += seconds if seconds == seconds else 0.0


@dataclass(frozen=True)
class SolverKind:
    """A study of solvers, as `Kind` asks for it: problems for flights, solvers for cells."""

    study: SolverStudy

    @property
    def columns(self) -> Sequence[Column[PlannedSolve]]:
        """The columns of its rows."""
        return SOLVER_COLUMNS

    @property
    def judged(self) -> Sequence[str]:
        """None: no time is like another."""
        return ()

    def planned(self, ordered: Sequence[Outcome], names: Names) -> list[PlannedSolve]:
        """The cases with their problems and contenders."""
        places = [(outcome.flight, outcome.cell) for outcome in ordered]
        return [PlannedSolve(self.study, self.study.case(*at), names.of(*at)) for at in places]

    def case_id(self, flight: int, cell: int) -> str:
        """Of the number of the problem and a digest of the case."""
        return self.study.case_id(self.study.case(flight, cell))

    def find(self, case_id: str) -> tuple[int, int] | None:
        """(problem, cell) of the case that is called so; None where none is."""
        return self._ids.get(case_id)

    @cached_property
    def _ids(self) -> dict[str, tuple[int, int]]:
        places = np.ndindex(self.study.count, len(self.study.cells))
        return {self.case_id(*at): at for at in places}

    @property
    def called(self) -> str:
        """What a case may be named by, in words."""
        return "a problem, a back-end, an objective, a solver"

    def flights_called(self, name: str) -> BoolArray:
        """Problems by their names, or that of their entry."""
        told = [(source.name, source.series) for source in self.study.problems]
        return np.array([any(fnmatchcase(one, name) for one in each) for each in told])

    def version(self, cell: int) -> str:
        """The code, a plug-in's, and on what it runs."""
        return f"{code_of(self.study.cells[cell].backend)}{ON}{self._machine}"

    @cached_property
    def _machine(self) -> str:
        return hashlib.sha256(canonical_json(timed_on()).encode()).hexdigest()[:8]

    def whole(self, ledger: Ledger, wanted: BoolArray) -> BoolArray:
        """All that take turns with a case ``wanted``, and all that was timed elsewhere."""
        wanted = wanted | self._here_now(ledger)
        if not wanted.any():
            return wanted
        others = [number for number, word in enumerate(ledger.words) if not self._is_here(word)]
        elsewhere: BoolArray = ledger.done & np.isin(ledger.version, others)
        return self._together(wanted | elsewhere)

    def _is_here(self, version: str) -> bool:
        return version.rpartition(ON)[2] == self._machine

    def _here_now(self, ledger: Ledger) -> BoolArray:
        """Cases of solvers that were missing and are not any more."""
        there = [not self.study.contenders[cell.contender].missing for cell in self.study.cells]
        found: BoolArray = ledger.ended(MISSING) & np.array(there)
        return found

    def _together(self, some: BoolArray) -> BoolArray:
        """Every case of a problem and an objective of which there are some."""
        found = np.zeros_like(some)
        for cells in self._objectives:
            found[:, cells] = some[:, cells].any(axis=1, keepdims=True)
        return found

    @property
    def _objectives(self) -> Iterator[list[int]]:
        for objective in self.study.objectives:
            yield [cell.index for cell in self.study.cells if cell.label == objective]

    def takes(self, held: Ledger, mine: Ledger) -> BoolArray:
        """Whole comparisons that are not there yet.

        Raises:
            InputError: where they were timed on different machines, or by different versions.
        """
        made = {word.rpartition(ON)[2] for one in (held, mine) for word in one.versions}
        if len(made) > 1:
            raise InputError(
                "its times are of another machine, or other versions of what is compared, than "
                "those beside it: no comparison is made of both; run the study on one machine"
            )
        theirs, ours = (self._together(~one.done) for one in (held, mine))
        taken: BoolArray = ours & ~theirs
        return taken

    def placed(self, place: Place, *, asked: int | None) -> Place:
        """One process of this machine; the problems are built, so that one that is none is refused.

        Raises:
            InputError: where another place is asked for.
        """
        if asked not in (None, 1):
            raise InputError("a study of solvers works in one process: leave --processes away")
        if place.executor != "processes":
            raise InputError("a study of solvers runs on this machine: leave --executor away")
        _ = self._problems
        return replace(place, processes=1)

    @cached_property
    def _problems(self) -> tuple[RegressionProblem, ...]:
        return self.study.build()

    def compute(
        self, wanted: BoolArray, place: Place, stop: Callable[[], bool]
    ) -> Generator[Timed, None, None]:
        """One process works at a time; what takes turns comes together.

        Raises:
            InputError: where a problem is none.
        """
        from sparsefit.study.run.solver_cases import measured
        from sparsefit.study.run.solver_crew import Crew

        crew = Crew(self.study, self._problems)
        try:
            for problem, cells in self._arenas(wanted):
                if stop():
                    return
                begun = time.monotonic()
                rows = measured(self.study, crew, problem, cells)
                each = (time.monotonic() - begun) / len(rows)
                yield from ((row, each) for row in rows)
        finally:
            crew.close()

    def _arenas(self, wanted: BoolArray) -> Iterator[tuple[int, list[int]]]:
        """(problem, cells) of what is timed by turns: those of one problem and one objective."""
        for problem in range(self.study.count):
            for cells in self._objectives:
                chosen = [cell for cell in cells if wanted[problem, cell]]
                if chosen:
                    yield problem, chosen

    def spent(self) -> Clocked:
        """The timed solves."""
        return Clocked()

    def made_with(self) -> Mapping[str, object]:
        """The kind, the versions of all who may take part, and on what it ran."""
        return {
            "kind": "solvers",
            "versions": versions() | {name: version_of(name) for name in PEERS},
            "processor": processor(),
            "timed": timed_on(),
        }


def timed_on() -> dict[str, object]:
    """On what times are those of one comparison."""
    peers = {name: version_of(name) for name in PEERS}
    return {"processor": processor(), "processors": os.cpu_count(), "versions": versions() | peers}
