"""The experiment with regression problems: units are problems, candidates are solvers.

A case is one solver at one tolerance on one problem: a whole path of penalties with [path], a
single fit without. Cases of one problem and one objective are certified one by one and timed by
turns until the median is known; the answer of every timed repeat is checked. A study of
`kind = "problems"` also cross-validates.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sparsefit import backends
from sparsefit.arrays import BoolArray
from sparsefit.study.arena import JUDGE, Arena, size_of
from sparsefit.study.columns import PROBLEM_COLUMNS, Outcome
from sparsefit.study.contenders import ProblemDesign
from sparsefit.study.data_sets import Data, shipping
from sparsefit.study.manifest import code_version, processor, versions
from sparsefit.study.plan import Batch, Plan, telling
from sparsefit.study.problem_desk import JudgeDesk, SolverDesk
from sparsefit.study.schema import canonical_json, digest, numbered
from sparsefit.study.worker import Crew
from sparsefit.whole_file import refusing

ON = " on "  # between the code and the machine


@dataclass(frozen=True, eq=False)
class ProblemExperiment(Plan):
    """Problems x (solvers x tolerances x settings), timed one at a time."""

    stored = PROBLEM_COLUMNS
    called = ("backend", "objective", "solver")
    alone = True

    @property
    def design(self) -> ProblemDesign:
        """The problems and cells of the study file."""
        design = self.definition.design
        assert isinstance(design, ProblemDesign)
        return design

    @cached_property
    def units(self) -> dict[str, list[Any]]:
        """The problems."""
        sources = self.design.problems
        return {
            "flight": list(range(len(sources))),
            "unit": [source.name for source in sources],
            "problem": [source.name for source in sources],
            "series": [source.series for source in sources],
            "split": ["all"] * len(sources),
            "case_id": numbered(digest(source.identity)[:8] for source in sources),
        }

    @cached_property
    def cells(self) -> dict[str, list[Any]]:
        """The contenders, in their titles at a tolerance where they take part at several."""
        contenders, case_ids = self.design.contenders, self.design.cell_identities()
        names = [contender.names for contender in contenders]
        several = Counter(names)
        ends = [f" at {c.tolerance:g}" if several[c.names] > 1 else "" for c in contenders]
        words = (", ".join(filter(None, each)) for each in telling(names))
        titles = (name or contenders[0].objective for name in words)
        return {
            "condition": [""] * len(contenders),
            "candidate": [digest(case_id)[:12] for case_id in case_ids],
            "title": list(map("".join, zip(titles, ends, strict=True))),
            "label": [objective for objective, _ in names],
            **{
                name: [getattr(contender, name) for contender in contenders]
                for name in ("objective", "backend", "solver", "tolerance")
            },
            "settings": [contender.content for contender in contenders],
            "case_id": case_ids,
        }

    def version(self, cell: int) -> str:
        """The version of the code and of a plug-in, and a digest of the machine."""
        name = self.design.contenders[cell].backend
        return f"{code_version(backends.distribution(name))}{ON}{self._machine}"

    @cached_property
    def _machine(self) -> str:
        """A digest of the processor and the versions of what computes."""
        return digest(canonical_json([processor(), os.cpu_count(), versions()]))[:8]

    def whole(self, wanted: BoolArray, version: NDArray[Any]) -> BoolArray:
        """All cells that are timed with a case ``wanted``, and those timed on another machine."""
        if not wanted.any():
            return wanted
        here = [word.rpartition(ON)[2] in ("", self._machine) for word in version.flat]
        wanted = wanted | ~np.reshape(here, version.shape)
        whole = np.zeros_like(wanted)
        for cells in self._objectives.values():
            whole[:, cells] = wanted[:, cells].any(axis=1, keepdims=True)
        return whole

    @cached_property
    def _objectives(self) -> dict[str, list[int]]:
        cells: dict[str, list[int]] = {}
        for cell, objective in enumerate(self.cells["objective"]):
            cells.setdefault(objective, []).append(cell)
        return cells

    def truth(self, unit: int, cell: int) -> Mapping[str, Any]:
        return size_of(self._data[unit])

    @cached_property
    def _data(self) -> list[Data]:
        """Every problem, so that a bad one is refused before work starts."""
        return [source.build() for source in self.design.problems]

    def desk(self, name: str) -> tuple[type, tuple[Any, ...]]:
        """A process for each family of solvers, and one for the judge."""
        arguments = (self.design.contenders, self.design.fractions)
        return (JudgeDesk if name == JUDGE else SolverDesk), arguments

    def check(self) -> None:
        """Refuse data sets whose package is missing."""
        for source in self.design.problems:
            if source.keys.dataset:
                shipping(source.keys.dataset)

    def batches(self, wanted: BoolArray) -> Iterator[Batch]:
        """All cases of one problem and one objective, which are timed by turns."""
        _ = self._data
        for unit in np.flatnonzero(wanted.any(axis=1)).tolist():
            for cells in self._objectives.values():
                if mine := [cell for cell in cells if wanted[unit, cell]]:
                    yield Batch(unit, tuple(mine))

    def run(self, batches: Iterator[Batch], crew: Crew) -> Iterator[list[Outcome]]:
        with refusing(crew.home):
            arena = Arena(self.design, crew)
            for batch in batches:
                yield arena.outcomes(batch.unit, self._data[batch.unit], batch.cells)
