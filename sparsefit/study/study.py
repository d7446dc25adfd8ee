"""`sf.Study`: a study from Python, of which the verbs of the command line are calls.

    study = sf.Study.from_file("mine.toml")
    study.plan()                       # a frame, one row a case
    study.run(progress=print)
    study.cases                        # the plan with the outcomes
    study.table("errors"); study.figure("ecdf"); study.select(over="worst")

Results lie beside the study file unless said: `studies/mine.toml` has `results/mine`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from difflib import get_close_matches
from functools import cached_property
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.codec import shown
from sparsefit.errors import InputError, SparsefitError, described
from sparsefit.study.columns import Outcome
from sparsefit.study.contenders import ProblemDesign
from sparsefit.study.definition import Definition, definition_of, read_definition
from sparsefit.study.flight_desk import FlightDesk, Reading, estimator_of
from sparsefit.study.flight_experiment import FlightExperiment
from sparsefit.study.keys import Outputs
from sparsefit.study.latency import Latency, measured, read_latencies, write_latencies
from sparsefit.study.plan import Batch, Experiment, Plan
from sparsefit.study.pool import outcomes
from sparsefit.study.problem_experiment import ProblemExperiment
from sparsefit.study.runner import MergedPart, Progress, RunSummary, merge, run
from sparsefit.study.store import Store, cases_table, read_cases

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit import Estimator

RESULTS, STUDIES = "results", "studies"


@dataclass(frozen=True, eq=False, repr=False)
class Study(Definition):
    """A study file and its results folder; made by `from_file` or `from_mapping`.

    It has the `name`, `kind`, `question`, `path`, `seed` and `hash` of its file.
    """

    folder: Path = Path()

    @classmethod
    def from_file(cls, path: str | Path, results: str | Path | None = None) -> Study:
        """The study of a TOML file.

        Args:
            results: the folder in which the study's own lies; by default `results` beside the
                study file, or beside the folder `studies` that it lies in.

        Raises:
            InputError: with the file, the section and the key (or the line) of the first fault.
        """
        beside = Path(path).parent
        if beside.resolve().name == STUDIES:
            beside = Path(os.path.normpath(beside / ".."))
        return cls._of(read_definition(path), beside, results)

    @classmethod
    def from_mapping(
        cls,
        document: Mapping[str, Any],
        folder: str | Path = ".",
        results: str | Path | None = None,
    ) -> Study:
        """The study of a mapping with the keys of a file; files that it names lie in ``folder``."""
        return cls._of(definition_of(document, str(Path(folder) / "study")), folder, results)

    @classmethod
    def _of(cls, own: Definition, beside: str | Path, results: str | Path | None) -> Study:
        home = Path(beside) / RESULTS if results is None else Path(results)
        return cls(**vars(own), folder=home / own.name)

    def __repr__(self) -> str:
        return f"Study {self.name} of {self.kind}: {self.planned.size} cases, in {self.folder}"

    @cached_property
    def definition(self) -> Definition:
        """The study file alone, as its workers get it."""
        return Definition(**{item.name: getattr(self, item.name) for item in fields(Definition)})

    @cached_property
    def experiment(self) -> Experiment:
        """The kind of study: what its units and candidates are, and how they are run."""
        if self.kind == "flights":
            return FlightExperiment(self.definition)
        return ProblemExperiment(self.definition)

    @cached_property
    def planned(self) -> Plan:
        """The plan: every case before any is run."""
        return Plan(self.experiment)

    def plan(self) -> pd.DataFrame:
        """One row a case: unit, condition, candidate, title and the level of every factor."""
        return self.planned.frame()

    def run(self, **request: Any) -> RunSummary:
        """Compute the cases that have no row; `runner.run` has the options.

        Raises:
            InputError: if the folder cannot be written, is in use, or is another study's.
            KeyboardInterrupt: interrupted; the rows so far are on the disk.
        """
        try:
            return run(self.planned, self.folder, **request)
        finally:
            self.__dict__.pop("cases", None)

    def status(self) -> RunSummary:
        """The progress of the study; changes nothing, also while it runs."""
        return RunSummary.of(Store.read(self.folder, self.planned))

    @cached_property
    def cases(self) -> pd.DataFrame:
        """The rows that are there, finished or not, in plan order, with the plan's columns."""
        store, frame = Store.read(self.folder, self.planned), self.plan()
        if store.finished:
            table = read_cases(self.folder)
        elif rows := store.rows():
            table = cases_table(self.planned, rows).to_pandas()
            places = [self.planned.place_of[row.key] for row in rows]
            frame = frame.iloc[places].reset_index(drop=True)
        else:
            words = f"0 of {self.planned.size} cases are there; run them first"
            raise InputError(f"{self.folder}: {words}: sparsefit study run {self.path}")
        frame = frame.join(table[[name for name in table.columns if name not in frame.columns]])
        if isinstance(self.design, ProblemDesign):
            frame.attrs["limit"] = self.design.clock.limit
        return frame

    @property
    def missing(self) -> dict[str, str]:
        """Why each solver that cannot run here is missing; empty of flights."""
        if not isinstance(self.design, ProblemDesign):
            return {}
        return {each.solver: each.missing for each in self.design.contenders if each.missing}

    def counts(self) -> dict[str, Any]:
        """The size of the study, JSON-ready."""
        return self.planned.counts() | ({"missing": self.missing} if self.missing else {})

    def merge(self, parts: Sequence[str | Path]) -> list[MergedPart]:
        """Take the rows of other results folders of this study; see `runner.merge`."""
        self.__dict__.pop("cases", None)
        return merge(self.planned, self.folder, parts)

    def again(self, case_id: str) -> Reading | Outcome:
        """One case run once more: of flights in this process, with all it was read from.

        Raises:
            InputError: if the study plans none of this id, with the nearest that it does.
            SparsefitError: if the case fails, as it then did in the run, with its error.
        """
        place = self.planned.place_of_case.get(case_id)
        if place is None:
            ids = self.planned.case_ids
            near, *_ = get_close_matches(case_id, ids, 1) or ids
            where = "ids stand in its cases.parquet and report.html"
            raise InputError(f"{self.name} plans no case {shown(case_id)}: {where}, {near} say")
        unit, cell = self.planned.at(place)
        if self.kind == "flights":
            try:
                ((_, reading),) = FlightDesk(self.definition).readings(unit, [cell])
            except InputError:
                raise
            except Exception as error:
                raise SparsefitError(f"{case_id} ends in an error: {described(error)}") from error
            return reading
        (outcome,) = outcomes(self.experiment, iter([Batch(unit, (cell,))]), 1)
        return outcome

    def cells_of(self, candidate: str) -> list[int]:
        """The cells of a candidate: one for every condition."""
        candidates = self.experiment.cells["candidate"]
        cells = [cell for cell, name in enumerate(candidates) if name == candidate]
        if not cells:
            raise InputError(f"{self.name} plans no candidate {shown(candidate)}: see study.plan()")
        return cells

    def estimator(self, candidate: str) -> Estimator:
        """The estimator that the cases of a candidate use."""
        return estimator_of(self, self.flights.cells[self.cells_of(candidate)[0]])

    @property
    def _titles(self) -> dict[str, str]:
        """The title of each candidate."""
        cells = self.experiment.cells
        return dict(zip(cells["candidate"], cells["title"], strict=True))

    @cached_property
    def refusals(self) -> dict[str, str]:
        """Why each candidate that cannot fly as it is cannot, by title.

        Raises:
            InputError: if none of them can.
        """
        from sparsefit.onboard import refusal

        reasons = {title: refusal(self.estimator(name)) for name, title in self._titles.items()}
        refused = {title: reason for title, reason in reasons.items() if reason}
        if len(refused) == len(reasons):
            raise InputError(f"on_board: no candidate can fly: {next(iter(refused.values()))}")
        return refused

    def flown(self) -> Study:
        """The candidates that can fly, on the flights of the study, sample by sample as exported.

        Its cases lie in the folder ``on-board`` within the study's own.
        """
        able = [name for name, title in self._titles.items() if title not in self.refusals]
        return self._part(able, "on-board", on_board=True)

    def variant(self, candidates: Sequence[str], count: int) -> Study:
        """These candidates on flights of fresh seeds, in the folder ``fresh``."""
        seed = int(sha256(f"fresh {self.seed}".encode()).hexdigest()[:8], 16)
        design = replace(self.flights, count=count, validate_count=None)
        return self._part(candidates, "fresh", seed=seed, design=design)

    def _part(self, candidates: Sequence[str], name: str, **changes: Any) -> Study:
        """These candidates, in a folder within the study's own; changes: of the definition."""
        own = changes.pop("design", self.flights)
        chosen = sorted(cell for item in candidates for cell in self.cells_of(item))
        cells = tuple(replace(own.cells[cell], index=i) for i, cell in enumerate(chosen))
        content = f"{self.hash} {name} {own.count} {' '.join(cell.key for cell in cells)}"
        changes |= {"name": name, "hash": sha256(content.encode()).hexdigest()}
        changes |= {"outputs": Outputs(), "design": replace(own, cells=cells, titles=self._titles)}
        return replace(self, **changes, folder=self.folder / name)

    @property
    def latencies(self) -> dict[str, Latency]:
        """The times by candidate that were measured before, by this version."""
        return read_latencies(self.hash, self.folder)

    def latency(
        self,
        candidates: Sequence[str],
        flights: int,
        *,
        again: bool = False,
        progress: Progress | None = None,
    ) -> dict[str, Latency]:
        """Seconds and memory of one estimate of each candidate; known ones are not timed anew."""
        latencies = {} if again else self.latencies
        trials = [name for name in candidates if name not in latencies]
        for done, name in enumerate(trials):
            if progress:
                progress(done, len(trials), None)
            latencies[name] = measured(self.definition, self.cells_of(name), flights)
        if trials:
            write_latencies(self.hash, self.folder, latencies)
        return {name: latencies[name] for name in candidates}

    def select(self, **rule: Any) -> Any:
        """The candidate to deploy, and why; options take the place of those in [select]."""
        return import_module("sparsefit.study.selection").select(self, **rule)

    def table(self, entry: str | Mapping[str, object]) -> Any:
        """A table of the cases, by its name or options as in [outputs]."""
        return import_module("sparsefit.study.tables").table(self, entry)

    def figure(self, entry: str | Mapping[str, object]) -> Any:
        """A figure of the cases, by its name or options as in [outputs]."""
        return import_module("sparsefit.study.figures").figure(self, entry)
