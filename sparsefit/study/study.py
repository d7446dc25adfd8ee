"""`sf.Study`: a study from Python, of which the verbs of the command line are calls.

    study = sf.Study.from_file("mine.toml")
    study.plan()                       # a frame, one row a case
    study.run(progress=print)
    study.cases                        # the plan with the outcomes
    study.table("errors"); study.figure("ecdf"); study.select(over="worst")

Results lie beside the study file unless said: `studies/mine.toml` has `results/mine`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.errors import InputError
from sparsefit.study.definition import Definition, definition_of, read_definition
from sparsefit.study.export import cases_table, read_cases, read_weights
from sparsefit.study.plan import Experiment, Plan
from sparsefit.study.runner import Progress, Request, RunStatus, RunSummary, run, status
from sparsefit.study.store import Store

if TYPE_CHECKING:
    import pandas as pd

RESULTS, STUDIES = "results", "studies"


@dataclass(frozen=True, eq=False)
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
            from sparsefit.study.flight_experiment import FlightExperiment

            return FlightExperiment(self.definition)
        from sparsefit.study.problem_experiment import ProblemExperiment

        return ProblemExperiment(self.definition)

    @cached_property
    def planned(self) -> Plan:
        """The plan: every case before any is run."""
        return Plan(self.experiment)

    @property
    def factors(self) -> Mapping[str, str]:
        """All that varies by dotted key: "condition" or "candidate"."""
        return self.experiment.factors()

    def plan(self) -> pd.DataFrame:
        """One row a case: unit, condition, candidate, title and the level of every factor."""
        return self.planned.frame()

    def run(
        self,
        *,
        progress: Progress | None = None,
        stopping: Callable[[], None] | None = None,
        **request: Any,
    ) -> RunSummary:
        """Compute the cases that have no row; see `runner.Request` for the options.

        Raises:
            InputError: if the folder cannot be written, is in use, or is another study's.
            KeyboardInterrupt: interrupted; the rows so far are on the disk.
        """
        try:
            return run(self.planned, self.folder, Request(**request), progress, stopping)
        finally:
            self.__dict__.pop("cases", None)

    def status(self) -> RunStatus:
        """How far the study is; changes nothing, also while it runs."""
        return status(self.planned, self.folder)

    @cached_property
    def cases(self) -> pd.DataFrame:
        """The rows that are there, finished or not, in plan order, with the plan's columns."""
        store = Store.read(self.folder, self.planned)
        if store.finished:
            table = read_cases(self.folder)
            return self._joined(table, self.plan())
        rows = [(self.planned.place_of[row.key], row) for row in store.rows()]
        if not rows:
            words = f"0 of {self.planned.size} cases are there; run them first"
            raise InputError(f"{self.folder}: {words}: sparsefit study run {self.path}")
        table = cases_table(self.planned, self.planned.columns(), rows).to_pandas()
        frame = self.plan().iloc[[place for place, _ in rows]].reset_index(drop=True)
        return self._joined(table, frame)

    def _joined(self, table: pd.DataFrame, plan: pd.DataFrame) -> pd.DataFrame:
        """The columns of the plan, and those of the rows that it has not."""
        fresh = [name for name in table.columns if name not in plan.columns]
        return plan.join(table[fresh])

    @property
    def weights(self) -> pd.DataFrame:
        """`case_id, length_scale [m], weight`, where the study keeps weights."""
        return read_weights(self.folder)

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
