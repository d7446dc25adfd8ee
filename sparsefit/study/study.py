"""`sf.Study`: a study from Python, of which the verbs of the command line are calls.

    study = sf.Study.from_file("mine.toml")
    study.plan()                       # a frame, one row a case
    study.run(progress=print)
    study.cases                        # the plan with the outcomes
    study.table("errors"); study.figure("ecdf"); study.select(over="worst")

Results lie beside the study file unless said: `studies/mine.toml` has `results/mine`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from functools import cached_property
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.codec import shown
from sparsefit.errors import InputError
from sparsefit.study.columns import Outcome
from sparsefit.study.contenders import ProblemDesign
from sparsefit.study.definition import Definition, definition_of, read_definition
from sparsefit.study.export import cases_table, read_cases
from sparsefit.study.flight_desk import Reading, estimator_of, read_again
from sparsefit.study.flight_experiment import FlightExperiment
from sparsefit.study.keys import Outputs
from sparsefit.study.latency import Latency, measure, read_latencies, write_latencies
from sparsefit.study.merging import MergedPart, merge
from sparsefit.study.plan import Batch, Experiment, Plan
from sparsefit.study.pool import outcomes
from sparsefit.study.problem_experiment import ProblemExperiment
from sparsefit.study.runner import Progress, RunSummary, run
from sparsefit.study.store import Store

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit import Estimator

RESULTS, STUDIES = "results", "studies"


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """A study file and its results folder; made by `from_file` or `from_mapping`."""

    definition: Definition
    folder: Path

    @classmethod
    def from_file(cls, path: str | Path, results: str | Path | None = None) -> Study:
        """The study of a TOML file.

        Args:
            results: the folder in which the study's own lies; by default `results` beside the
                study file, or beside the folder `studies` that it lies in.

        Raises:
            InputError: with the file, the section and the key (or the line) of the first fault.
        """
        definition = read_definition(path)
        beside = Path(path).resolve().parent
        home = beside.parent if beside.name == STUDIES else beside
        shown = Path(path).parent / ".." if beside.name == STUDIES else Path(path).parent
        folder = Path(results) if results is not None else _short(home, shown) / RESULTS
        return cls(definition, folder / definition.name)

    @classmethod
    def from_mapping(
        cls,
        document: Mapping[str, Any],
        folder: str | Path = ".",
        results: str | Path | None = None,
    ) -> Study:
        """The study of a mapping with the keys of a file; files that it names lie in ``folder``."""
        definition = definition_of(document, str(Path(folder) / "study"))
        home = Path(results) if results is not None else Path(folder) / RESULTS
        return cls(definition, home / definition.name)

    def __repr__(self) -> str:
        cases = f"{self.planned.size} cases"
        with suppress(InputError):  # of damaged results
            cases = f"{self.status().done} of {cases}"
        return f"Study({self.name!r}, {self.kind}, {cases}, in {str(self.folder)!r})"

    @property
    def name(self) -> str:
        """The name of the study, and of its results folder."""
        return self.definition.name

    @property
    def question(self) -> str:
        """The question that it asks."""
        return self.definition.question

    @property
    def kind(self) -> str:
        """`flights` or `problems`."""
        return self.definition.kind

    @property
    def path(self) -> str:
        """The study file."""
        return self.definition.path

    @property
    def seed(self) -> int:
        """The seed of all that is random."""
        return self.definition.seed

    @property
    def hash(self) -> str:
        """sha256 of all that the cases depend on."""
        return self.definition.hash

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
        elif rows := list(store.rows()):
            table = cases_table(self.planned, self.planned.columns(), rows).to_pandas()
            places = [self.planned.place_of[row.key] for row in rows]
            frame = frame.iloc[places].reset_index(drop=True)
        else:
            words = f"0 of {self.planned.size} cases are there; run them first"
            raise InputError(f"{self.folder}: {words}: sparsefit study run {self.path}")
        frame = frame.join(table[[name for name in table.columns if name not in frame.columns]])
        design = self.definition.design
        if isinstance(design, ProblemDesign):
            frame.attrs["limit"] = design.clock.limit
        return frame

    @property
    def missing(self) -> dict[str, str]:
        """Why each solver that cannot run here is missing; empty of flights."""
        design = self.definition.design
        contenders = design.contenders if isinstance(design, ProblemDesign) else ()
        return {c.solver: c.missing for c in contenders if c.missing}

    def counts(self) -> dict[str, Any]:
        """The size of the study, JSON-ready."""
        return self.planned.counts() | ({"missing": self.missing} if self.missing else {})

    def merge(self, parts: Sequence[str | Path]) -> list[MergedPart]:
        """Take the rows of other results folders of this study; see `merging.merge`."""
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
        if isinstance(self.experiment, FlightExperiment):
            return read_again(self.definition, unit, self.definition.flights.cells[cell])
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
        cell = self.definition.flights.cells[self.cells_of(candidate)[0]]
        return estimator_of(self.definition, cell)

    @cached_property
    def refusals(self) -> dict[str, str]:
        """Why each candidate that cannot fly as it is cannot, by title.

        Raises:
            InputError: if none of them can.
        """
        from sparsefit.onboard import refusal

        cells = self.experiment.cells
        titles = dict(zip(cells["candidate"], cells["title"], strict=True))
        reasons = {title: refusal(self.estimator(name)) for name, title in titles.items()}
        refused = {title: reason for title, reason in reasons.items() if reason}
        if len(refused) == len(titles):
            raise InputError(f"on_board: no candidate can fly: {next(iter(refused.values()))}")
        return refused

    def flown(self) -> Study:
        """The candidates that can fly, on the flights of the study, sample by sample as exported.

        Its cases lie in the folder ``on-board`` within the study's own.
        """
        cells = self.experiment.cells
        pairs = zip(cells["candidate"], cells["title"], strict=True)
        able = dict.fromkeys(name for name, title in pairs if title not in self.refusals)
        return self._part(list(able), "on-board", on_board=True)

    def variant(self, candidates: Sequence[str], count: int) -> Study:
        """These candidates on flights of fresh seeds, in the folder ``fresh``."""
        seed = int(sha256(f"fresh {self.seed}".encode()).hexdigest()[:8], 16)
        design = replace(self.definition.flights, count=count, validate_count=None)
        return self._part(candidates, "fresh", seed=seed, design=design)

    def _part(self, candidates: Sequence[str], name: str, **changes: Any) -> Study:
        """These candidates, in a folder within the study's own; changes: of the definition."""
        own = changes.pop("design", self.definition.flights)
        chosen = sorted(cell for item in candidates for cell in self.cells_of(item))
        cells = tuple(replace(own.cells[cell], index=i) for i, cell in enumerate(chosen))
        content = f"{self.hash} {name} {own.count} {' '.join(cell.key for cell in cells)}"
        changes |= {"name": name, "hash": sha256(content.encode()).hexdigest()}
        changes |= {"outputs": Outputs(), "design": replace(own, cells=cells)}
        return Study(replace(self.definition, **changes), self.folder / name)

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
        registered = {} if again else self.latencies
        trials = {name: self.cells_of(name) for name in candidates if name not in registered}
        measured = measure(self.definition, trials, flights, progress)
        if measured:
            write_latencies(self.hash, self.folder, {**registered, **measured})
        every = {**registered, **measured}
        return {name: every[name] for name in candidates}

    def select(self, **rule: Any) -> Any:
        """The candidate to deploy, and why; options take the place of those in [select]."""
        return import_module("sparsefit.study.selection").select(self, **rule)

    def table(self, entry: str | Mapping[str, object]) -> Any:
        """A table of the cases, by its name or options as in [outputs]."""
        return import_module("sparsefit.study.tables").table(self, entry)

    def figure(self, entry: str | Mapping[str, object]) -> Any:
        """A figure of the cases, by its name or options as in [outputs]."""
        return import_module("sparsefit.study.figures").figure(self, entry)


def _short(home: Path, shown: Path) -> Path:
    """The folder as a user would write it, where that is shorter than its whole path."""
    try:
        return home.relative_to(Path.cwd())
    except ValueError:
        return home if shown.is_absolute() else shown
