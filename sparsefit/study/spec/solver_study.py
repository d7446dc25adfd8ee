"""A study of solvers: problems x solvers x tolerances, from one TOML file of ``kind = "solvers"``.

Every case is one solver at one tolerance on one problem: a whole path of penalties with [path], a
single fit without. What a case is judged by is not in the file: the caller's certificate.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np

from sparsefit.codec import Place, build, integer, only, shown, text
from sparsefit.errors import InputError
from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.spec.contenders import Contender, read_contenders, read_tolerances
from sparsefit.study.spec.design import Factor
from sparsefit.study.spec.document import Section, canonical_json, read_section, read_toml, required
from sparsefit.study.spec.names import numbered
from sparsefit.study.spec.solver_problems import ProblemSource, read_problems
from sparsefit.study.spec.study import NAME

KIND = "solvers"
KEYS = (
    *("name", "kind", "question", "seed", "accuracies", "tolerances", "path", "clock"),
    *("problems", "backends", "flights", "derivative", "library"),
)
ACCURACIES = (1e-4, 1e-6, 1e-8)
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10)
MOST_CASES = 20_000


@dataclass(frozen=True)
class PathRule:
    """The penalties of [path]: `points` of them, from alpha_max down to `lowest` times it."""

    points: int = 30
    lowest: float = 1e-3

    def __post_init__(self) -> None:
        if not 1 <= self.points <= 1000:
            raise InputError(f"points must be 1 to 1000, not {self.points}")
        if not 0.0 < self.lowest < 1.0:
            raise InputError(f"lowest must be above 0 and below 1, not {self.lowest:g}")

    @property
    def fractions(self) -> tuple[float, ...]:
        """alpha / alpha_max, descending; one point is the lowest."""
        if self.points == 1:
            return (self.lowest,)
        return tuple(np.geomspace(1.0, self.lowest, self.points).tolist())


@dataclass(frozen=True)
class Clock:
    """How a solve is timed: [clock].

    limit: seconds of CPU time (ten times as many on the wall) after which a solve is killed; a
    case is repeated until the 95 % interval of its median is within `precision` of it, `repeats`
    are made or they took `seconds`.
    shift: seconds added in the shifted geometric mean, so that the shortest do not decide it.
    """

    limit: float = 20.0
    repeats: int = 25
    seconds: float = 2.0
    precision: float = 0.05
    shift: float = 0.001

    def __post_init__(self) -> None:
        for name in ("limit", "precision", "shift"):
            if getattr(self, name) <= 0.0:
                raise InputError(f"{name} must be above 0, not {getattr(self, name):g}")
        if self.seconds < 0.0:
            raise InputError(f"seconds must be 0 or above, not {self.seconds:g}")
        if not 1 <= self.repeats <= 1000:
            raise InputError(f"repeats must be 1 to 1000, not {self.repeats}")


@dataclass(frozen=True)
class SolverCell:
    """What is asked for every problem: a contender, by its place in the study, at a tolerance."""

    index: int
    contender: int
    tolerance: float
    backend: str
    label: str
    solver: str

    @property
    def names(self) -> tuple[str, ...]:
        """What a user may call it: its back-end, its objective or its solver."""
        return (self.backend, self.label, self.solver)


class SolverCase(NamedTuple):
    """One contender at one tolerance on one problem, by their places in the study."""

    problem: int
    contender: int
    tolerance: float


@dataclass(frozen=True, eq=False)
class SolverStudy:
    """A file of ``kind = "solvers"``, checked and resolved; made by `SolverStudy.load` only.

    fractions: the penalties of every path; none where single fits are made. accuracies: the
    certificates at which success is counted, loosest first.
    """

    path: str
    name: str
    question: str
    seed: int
    problems: tuple[ProblemSource, ...]
    contenders: tuple[Contender, ...]
    fractions: tuple[float, ...]
    accuracies: tuple[float, ...]
    clock: Clock
    hash: str
    store_weights: ClassVar[bool] = False
    sweep: ClassVar[tuple[Factor, ...]] = ()

    @classmethod
    def load(cls, path: str | Path) -> SolverStudy:
        """Read and check a study file; data files are digested, problems are not built yet.

        Raises:
            InputError: with the file, the section and the key (or the line) of the first fault.
        """
        document = read_toml(path)
        place = Place(str(path))
        only(document, KEYS, place)
        return _read(document, place)

    @property
    def objectives(self) -> tuple[str, ...]:
        """What is solved, by label, in the order of the file."""
        return tuple(dict.fromkeys(one.objective for one in self.contenders))

    @property
    def missing(self) -> dict[str, str]:
        """Why each solver that cannot run here is missing."""
        return {one.solver: one.missing for one in self.contenders if one.missing}

    @property
    def at_most(self) -> float:
        """Seconds of CPU [s] that solves take if all of them reach all limits."""
        clock = self.clock
        each = (
            len(one.tolerances) * ((one.limit or clock.limit) + clock.seconds)
            for one in self.contenders
            if not one.missing
        )
        return self.count * sum(each)

    @property
    def planned(self) -> int:
        """How many cases there are, those of missing contenders too."""
        return self.count * len(self.cells)

    @property
    def count(self) -> int:
        """The number of problems, which are to its cells what flights are in other studies."""
        return len(self.problems)

    @cached_property
    def cells(self) -> tuple[SolverCell, ...]:
        """Every contender at each of its tolerances."""
        asked = [
            (number, tolerance, one)
            for number, one in enumerate(self.contenders)
            for tolerance in one.tolerances
        ]
        return tuple(
            SolverCell(index, number, tolerance, one.backend, one.objective, one.solver)
            for index, (number, tolerance, one) in enumerate(asked)
        )

    def case(self, problem: int, cell: int) -> SolverCase:
        """The case of a problem and a cell."""
        asked = self.cells[cell]
        return SolverCase(problem, asked.contender, asked.tolerance)

    def identities(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """What determines the rows of each cell, and of each problem, as digests.

        The limits of the clock are among it: another limit lets others fail.
        """
        clock = {key: value for key, value in asdict(self.clock).items() if key != "shift"}
        common = [self.fractions, clock]
        cells = [
            canonical_json([self.contenders[one.contender].identity, str(one.tolerance), *common])
            for one in self.cells
        ]
        problems = [source.identity for source in self.problems]
        return numbered(map(_digest, cells)), numbered(map(_digest, problems))

    def case_id(self, case: SolverCase) -> str:
        """Readable by problem, stable whatever else the study plans: `003-9f1c0d6a41b2e857`."""
        identity = canonical_json(
            [
                self.problems[case.problem].identity,
                self.contenders[case.contender].identity,
                str(case.tolerance),
                self.fractions,
            ]
        )
        return f"{case.problem:03d}-{_digest(identity)}"

    def build(self) -> tuple[RegressionProblem, ...]:
        """Every problem, so that one that is none is refused before work starts."""
        return tuple(source.build() for source in self.problems)


def is_solver_study(path: str | Path) -> bool:
    """Whether a study file asks for a comparison of solvers. Raises InputError on another kind."""
    document = read_toml(path)
    kind = document.get("kind", "flights")
    if kind not in (KIND, "flights"):
        near = f'"{KIND}", or no kind at all for a study of flights'
        raise Place(str(path)).at("kind").error(f"has unknown value {shown(kind)}: write {near}")
    return kind == KIND


def _read(document: Section, place: Place) -> SolverStudy:
    name = text(required(document, "name", place), place.at("name"))
    if not NAME.fullmatch(name):
        allowed = "1 to 64 of a-z, 0-9, _ and -: it is the results folder"
        raise place.at("name").error(f"must be {allowed}, not {shown(name)}")
    question = text(document.get("question", "Which solver is fastest?"), place.at("question"))
    seed = integer(document.get("seed", 0), place.at("seed"), least=0)
    asked = document.get("tolerances", list(TOLERANCES))
    tolerances = read_tolerances(asked, place.at("tolerances"))
    levels = document.get("accuracies", list(ACCURACIES))
    path: tuple[float, ...] = ()
    if "path" in document:
        rules = read_section(document["path"], place.at("path"))
        path = build(PathRule, rules, place.within("path")).fractions
    clock = read_section(document.get("clock", {}), place.at("clock"))
    problems = read_problems(document, seed, place)
    contenders = read_contenders(document, tolerances, place, path=bool(path))
    study = SolverStudy(
        path=place.file,
        name=name,
        question=question,
        seed=seed,
        problems=problems,
        contenders=contenders,
        fractions=path,
        accuracies=read_tolerances(levels, place.at("accuracies")),
        clock=build(Clock, clock, place.within("clock")),
        hash=_hash(document, problems),
    )
    if study.planned > MOST_CASES:
        raise InputError(f"{place.file}: plans {study.planned} cases, more than {MOST_CASES}")
    return study


def _digest(content: str) -> str:
    return hashlib.sha256(content.encode(errors="backslashreplace")).hexdigest()[:16]


def _hash(document: Section, problems: tuple[ProblemSource, ...]) -> str:
    """sha256 of what the cases depend on, what the data files hold among it."""
    left = {key: value for key, value in document.items() if key not in ("question", "accuracies")}
    content = canonical_json([left, [source.identity for source in problems]])
    return hashlib.sha256(content.encode()).hexdigest()
