"""`sf.Study`: the Python interface of studies, which the command line calls, too::

    study = sf.Study.from_file("mine.toml")
    study.plan()                       # a frame, one row a case
    study.run(progress=print)
    study.cases                        # the plan with the outcomes
    study.table("errors"); study.figure("ecdf"); study.select(over="worst")

By default, results are beside the study file: `studies/mine.toml` has `results/mine`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from sparsefit.codec import Place, build, shown
from sparsefit.errors import InputError
from sparsefit.study import figures, selection, tables
from sparsefit.study.flight_desk import FlightDesk, Reading, estimator_of
from sparsefit.study.flight_experiment import FlightExperiment
from sparsefit.study.keys import FlightFile, Outputs, ProblemFile
from sparsefit.study.plan import Plan
from sparsefit.study.problem_experiment import ProblemExperiment
from sparsefit.study.runner import MergedPart, Progress, RunSummary, merge, run
from sparsefit.study.schema import Section, read_toml
from sparsefit.study.store import Store, cases_table, read_cases
from sparsefit.study.trials import Latency, measured, read_latencies, write_latencies

if TYPE_CHECKING:
    from sparsefit.estimator import Estimator


def plan_of(document: Section, path: str) -> Plan:
    """The plan of the tables of a study file, checked; files that it names lie beside ``path``.

    Raises:
        InputError: with the file, the section and the key (or the line) of the first fault.
    """
    place = Place(path)
    kind = document.get("kind", "flights")
    is_flown = "problems" not in document and kind not in ("problems", "solvers")
    if kind == "flights" and "problems" in document:
        raise place.at("kind").error('missing: a file with [[problems]] says kind = "problems"')
    file: Any = build(FlightFile if is_flown else ProblemFile, document, place)
    outputs = file.outputs
    if outputs.script and not (Path(path).parent / outputs.script).is_file():
        words = f'"{outputs.script}": no such file beside {Path(path).name}'
        raise place.within("outputs").at("script").error(words)
    words = str((outputs.tables, outputs.figures, outputs.headline))
    if is_flown and not file.run.prediction_flights and "prediction-error" in words:
        # All its cases would count as failures.
        words = "missing: prediction-error needs other flights to predict along, 2 say"
        raise place.within("run").at("prediction_flights").error(words)
    return (FlightExperiment if is_flown else ProblemExperiment).read(file, place)


@dataclass(frozen=True, eq=False, repr=False)
class Study:
    """A study, units times candidates, and its results folder; from `from_file` or `from_mapping`.

    Its `name`, `question`, `path` and `seed` are those of the file; `kind` is `flights` or
    `problems`. planned: the units and candidates, every case, and how they are run.
    """

    planned: Plan
    folder: Path

    @classmethod
    def from_file(cls, path: str | Path, results: str | Path | None = None) -> Study:
        """The study of a TOML file.

        Args:
            results: the parent of the results folder; by default `results` beside the study
                file, or beside the folder `studies` that contains it.

        Raises:
            InputError: with the file, the section and the key (or the line) of the first fault.
        """
        beside = Path(path).parent
        if beside.resolve().name == "studies":
            beside = Path(os.path.normpath(beside / ".."))
        return cls._of(plan_of(read_toml(path), str(path)), beside, results)

    @classmethod
    def from_mapping(
        cls,
        document: Mapping[str, Any],
        folder: str | Path = ".",
        results: str | Path | None = None,
    ) -> Study:
        """The study of a mapping with the keys of a file; paths are relative to ``folder``."""
        return cls._of(plan_of(document, str(Path(folder) / "study")), folder, results)

    @classmethod
    def _of(cls, plan: Plan, beside: str | Path, results: str | Path | None) -> Study:
        home = Path(beside) / "results" if results is None else Path(results)
        return cls(plan, home / plan.definition.name)

    def __repr__(self) -> str:
        return f"Study {self.name} of {self.kind}: {self.planned.size} cases, in {self.folder}"

    definition = property(lambda self: self.planned.definition, doc="The study file, checked.")
    name = property(lambda self: self.definition.name, doc="The name of the study.")
    question = property(lambda self: self.definition.question, doc="The question that it answers.")
    seed = property(lambda self: self.definition.seed, doc="The seed of all random numbers.")
    path = property(lambda self: self.planned.path, doc="The study file's path.")
    kind = property(lambda self: self.planned.kind, doc="`flights` or `problems`.")

    @property
    def flights(self) -> FlightExperiment:
        """The plan of a study of flights."""
        if not isinstance(self.planned, FlightExperiment):
            words = "is a study of regression problems, and flies nothing"
            raise InputError(f"{self.path}: {words}: give a study of flights")
        return self.planned

    @property
    def hash(self) -> str:
        """The sha256 of the plan in hexadecimal: results with another one are of another study."""
        return self.planned.hash

    def plan(self) -> pd.DataFrame:
        """A row per case: unit, condition, candidate, title and the level of every factor."""
        return self.planned.frame()

    def run(self, **request: Any) -> RunSummary:
        """Compute the cases that have no row yet, and write them to the results folder.

        Args:
            processes: the number of worker processes; by default that of the processors.
            fresh: discard all rows first.
            retry_failed: compute cases again that ended as error, timeout or crashed.
            stale: compute cases again whose rows are of another version of the code.
            only: compute only these: names of back-ends, labels, protocols or units, with `*` for
                any letters, or ids of cases.
            scheduler: the address of a dask scheduler, whose workers take the place of processes
                of this machine.
            progress: called with (cases done, cases planned, seconds left or None).

        Returns:
            The progress of the study: counts of cases by status, and seconds.

        Raises:
            InputError: if the folder cannot be written, is in use, or is another study's.
            KeyboardInterrupt: interrupted; the rows so far are on the disk.
        """
        try:
            return run(self.planned, self.folder, **request)
        finally:
            self.__dict__.pop("cases", None)

    def status(self) -> RunSummary:
        """The numbers of cases that are planned and done, by status; the study may be running."""
        store = Store.read(self.folder, self.planned)
        return RunSummary.of(store, written=store.finished)

    @cached_property
    def cases(self) -> pd.DataFrame:
        """The cases so far, a row each in the order of the plan: its columns and the outcomes.

        Raises:
            InputError: if no case was run, or the results are damaged or of another study.
        """
        store, frame = Store.read(self.folder, self.planned), self.plan()
        if store.finished:
            table = read_cases(self.folder)
        elif rows := store.rows():
            table = cases_table(self.planned, rows).to_pandas()
            places = [self.planned.place_of[row.case_id] for row in rows]
            frame = frame.iloc[places].reset_index(drop=True)
        else:
            words = f"0 of {self.planned.size} cases are there; run them first"
            raise InputError(f"{self.folder}: {words}: sparsefit study run {self.path}")
        frame = frame.join(table[[name for name in table.columns if name not in frame.columns]])
        if isinstance(self.planned, ProblemExperiment):
            frame.attrs["limit"] = self.planned.definition.clock.limit
        return frame

    @property
    def missing(self) -> dict[str, str]:
        """The solvers that cannot run here, with the reason; empty for flights."""
        contenders = getattr(self.planned, "contenders", ())
        return {each.solver: each.missing for each in contenders if each.missing}

    def counts(self) -> dict[str, Any]:
        """The numbers of units, candidates and cases, for JSON."""
        return self.planned.counts() | ({"missing": self.missing} if self.missing else {})

    def merge(self, parts: Sequence[str | Path]) -> list[MergedPart]:
        """Add the rows of other results folders of this study, and return what each part gave.

        Raises:
            InputError: if a part is no results folder, is damaged or of another study, if two rows
                of one case differ (no row is copied then), the folder is in use, or the study is
                of solvers.
        """
        self.__dict__.pop("cases", None)
        return merge(self.planned, self.folder, parts)

    def again(self, case_id: str) -> Reading:
        """Run one case of flights again, in this process, with its intermediate results.

        Raises:
            InputError: for an unknown id.
            Exception: that of the case, if it fails.
        """
        if (place := self.flights.place_of.get(case_id)) is None:
            words = "its cases.parquet lists them"
            raise InputError(f"{self.name} plans no case {shown(case_id)}: {words}")
        unit, cell = divmod(place, self.planned.shape[1])
        ((_, reading),) = FlightDesk(self.flights).readings(unit, [cell])
        return reading

    def cells_of(self, candidate: str) -> list[int]:
        """The indices of the cells of a candidate, one per condition.

        Raises:
            InputError: for a candidate that the study does not plan.
        """
        candidates = self.planned.cells["candidate"]
        cells = [cell for cell, name in enumerate(candidates) if name == candidate]
        if not cells:
            raise InputError(f"{self.name} plans no candidate {shown(candidate)}: see study.plan()")
        return cells

    def estimator(self, candidate: str) -> Estimator:
        """The estimator that a candidate of a study of flights is.

        Args:
            candidate: its name in the column `candidate` of `plan()`.
        """
        return estimator_of(self.flights, self.flights.points[self.cells_of(candidate)[0]])

    def call(self, candidate: str) -> str:
        """The call of `sparsefit.fit` that solves a regression problem as a candidate does.

        A penalty that was chosen on the folds of each problem is `"auto"`: so it is there, too.
        """
        plan = self.planned
        if not isinstance(plan, ProblemExperiment):
            raise InputError(f"{self.path}: is a study of flights: call its `estimator`")
        contender = plan.contenders[self.cells_of(candidate)[0]]
        settings = dict(contender.settings)
        if plan.fractions and hasattr(contender.settled, "alpha_fraction"):
            settings["alpha_fraction"] = "auto"
        words = "".join(f", {name}={value!r}" for name, value in settings.items())
        return f"sf.fit(problem, {contender.backend!r}{words})"

    @property
    def _titles(self) -> dict[str, str]:
        """The title of each candidate."""
        cells = self.planned.cells
        return dict(zip(cells["candidate"], cells["title"], strict=True))

    @cached_property
    def refusals(self) -> dict[str, str]:
        """The reasons why candidates have no on-board form, by title.

        Raises:
            InputError: if no candidate has one.
        """
        from sparsefit.onboard import refusal

        reasons = {title: refusal(self.estimator(name)) for name, title in self._titles.items()}
        refused = {title: reason for title, reason in reasons.items() if reason}
        if len(refused) == len(reasons):
            raise InputError(f"on_board: no candidate can fly: {next(iter(refused.values()))}")
        return refused

    def flown(self) -> Study:
        """The study of the on-board forms of the candidates on the flights of this one.

        Its results are in the subfolder ``on-board``.
        """
        able = [name for name, title in self._titles.items() if title not in self.refusals]
        return self._part(able, replace(self.flights, on_board=True), "on-board")

    def variant(self, candidates: Sequence[str], count: int) -> Study:
        """The study of these candidates on flights of a new seed, in the subfolder ``fresh``."""
        seed = int(sha256(f"fresh {self.seed}".encode()).hexdigest()[:8], 16)
        file = replace(self.flights.definition, seed=seed, split=None)
        new = replace(self.flights, definition=file, count=count)
        return self._part(candidates, new, "fresh")

    def _part(self, candidates: Sequence[str], plan: FlightExperiment, name: str) -> Study:
        """A study of these candidates of a plan, in a subfolder."""
        chosen = sorted(cell for item in candidates for cell in self.cells_of(item))
        points = tuple(plan.points[cell] for cell in chosen)
        file = replace(plan.definition, name=name, outputs=Outputs())
        part = replace(plan, definition=file, points=points, titled=self._titles)
        return Study(part, self.folder / name)

    @property
    def latencies(self) -> dict[str, Latency]:
        """The latencies [s] and the memory [MB] by candidate that this version has measured."""
        return read_latencies(self.hash, self.folder)

    def latency(
        self,
        candidates: Sequence[str],
        flights: int,
        *,
        again: bool = False,
        progress: Progress | None = None,
    ) -> dict[str, Latency]:
        """Time [s] and memory of one estimate of each candidate; stored ones unless `again`."""
        latencies = {} if again else self.latencies
        trials = [name for name in candidates if name not in latencies]
        for done, name in enumerate(trials):
            if progress:
                progress(done, len(trials), None)
            latencies[name] = measured(self.flights, self.cells_of(name), flights)
            write_latencies(self.hash, self.folder, latencies)  # an interrupt loses one at most
        return {name: latencies[name] for name in candidates}

    def select(self, **rule: Any) -> Any:
        """The selected candidate with its evidence; options replace those of [select].

        Raises:
            InputError: if the study is unfinished or has no split, or an option is unknown.
        """
        return selection.select(self, **rule)

    def table(self, entry: str | Mapping[str, object]) -> Any:
        """The `Table` of the cases that a name, or options, of [outputs] ask for.

        Raises:
            InputError: for a name, an option or a measure that is unknown, with the nearest.
        """
        (made,) = tables.tables(self, self.cases, [entry]).values()
        return made

    def figure(self, entry: str | Mapping[str, object]) -> Any:
        """The matplotlib figure of the cases that a name, or options, of [outputs] ask for.

        Raises:
            InputError: for a name, an option or a measure that is unknown, or if nothing is drawn.
        """
        (picture,) = figures.figures(self, self.cases, [entry]).values()
        if picture.figure is None:
            raise InputError(f"{self.name}: {picture.caption}")
        return picture.figure
