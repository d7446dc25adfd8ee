"""The keys of a study file: a record for each section; `keys.toml` has their words.

Flights are drawn by the quantities of `quantities`; how they are read are records of the estimator.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from sparsefit.codec import Place, build
from sparsefit.errors import InputError
from sparsefit.study.schema import INSIDE, NOT_NEGATIVE, POSITIVE, SHARE, Range, Section, key

MOST_VALUES = 128_000_000  # numbers in a regression problem: a gigabyte
COUNTED = Range(least=0, most=100_000)
StudyKind: TypeAlias = Literal["flights", "problems", "solvers"]
Three: TypeAlias = tuple[float, float, float]
DataSet: TypeAlias = Literal["diabetes", "diabetes-quadratic", "linnerud", "digits", "iris", "wine",
                             "breast-cancer"]  # fmt: skip
Alteration: TypeAlias = Literal["as it is", "duplicated columns", "units 1e-12 to 1e12"]


@dataclass(frozen=True, kw_only=True)
class Heading:
    """The keys at the top of every study file."""

    name: str
    question: str
    kind: StudyKind = "flights"
    seed: int = 0

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]{1,64}", self.name):
            raise InputError("name must be 1 to 64 of a-z, 0-9, _ and -: it is the results folder")


@dataclass(frozen=True)
class Split:
    """The flights of a choice, and those that score it: [split]."""

    validate: int = key(range=POSITIVE)
    evaluate: int = key(range=POSITIVE)


@dataclass(frozen=True)
class RunRule:
    """The rules by which cases are run: [run]."""

    case_timeout: float = key(60.0, POSITIVE, "s")
    tolerance: float = key(1e-8, INSIDE)
    prediction_flights: int = 0
    max_memory: float | None = key(None, Range(least=256.0), "MB")


@dataclass(frozen=True)
class Reference:
    """Printed numbers that a study is held against; each triple is U0, L_w and tau_w."""

    name: str
    flights: int | None = None
    deviation: Three | None = None
    signed_error: Three | None = key(None, unit="%")


@dataclass(frozen=True)
class Outputs:
    """The tables and figures asked for, empty: those that fit the cases: [outputs]."""

    tables: tuple[object, ...] = key(())
    figures: tuple[object, ...] = key(())
    headline: str = ""
    reference: Reference | None = None
    script: str = ""

    def __post_init__(self) -> None:
        if not all(isinstance(entry, str | Mapping) for entry in self.tables + self.figures):
            raise InputError("tables and figures are names in quotes, or tables of options")


@dataclass(frozen=True, kw_only=True)
class SelectionRule:
    """The rule by which a candidate is chosen, constraints with it: [select]."""

    criterion: str = "mean timescale-error"
    over: str = "average"
    margin: float = key(0.05, Range(least=0.0, below=1.0))
    on_board: bool = False
    latency_flights: int = key(100, COUNTED)
    check: int = key(0, COUNTED)
    max_failure: float | None = key(None, SHARE)
    max_silent_misses: float | None = key(None, SHARE)
    max_error: float | None = key(None, POSITIVE, "%")
    max_latency_p99: float | None = key(None, POSITIVE, "s")
    max_memory: float | None = key(None, POSITIVE, "MB")

    def __post_init__(self) -> None:
        for name in ("max_latency_p99", "max_memory"):
            if getattr(self, name) and not self.latency_flights:
                raise InputError(f"latency_flights = 0 measures nothing, and {name} needs it")

    @property
    def measure(self) -> tuple[str, str]:
        """The summary and the measure that the criterion names; an empty summary is the mean."""
        summary, _, name = self.criterion.rpartition(" ")
        return summary, name

    def changed(self, place: Place | None = None, /, **options: object) -> SelectionRule:
        """The rule with these options in place of its own; InputError names one that is wrong."""
        values = {**vars(self), **options}
        return build(type(self), values, place or Place("select", "select"))


@dataclass(frozen=True, kw_only=True)
class ProblemSelection(SelectionRule):
    """The rule by which a study of problems chooses."""

    criterion: str = "mean holdout-error"

    def __post_init__(self) -> None:
        for name in ("on_board", "check", "max_silent_misses", "max_error", "max_latency_p99",
                     "max_memory"):  # fmt: skip
            if getattr(self, name):
                raise InputError(f"{name} is for flights: a study of problems has no such rule")


@dataclass(frozen=True)
class BackendKeys:
    """The keys of [[backends]] beside settings."""

    name: str
    label: str = ""


@dataclass(frozen=True)
class EstimatorKeys:
    """The keys of [estimator], settings of no part of it."""

    free: tuple[str, ...] = ()


@dataclass(frozen=True)
class ProtocolKeys:
    """The keys of [[protocols]] beside those that it sets."""

    name: str


@dataclass(frozen=True)
class LogRules:
    """The keys of [flights] where the flights come from files."""

    files: tuple[str, ...] = key()
    windows: tuple[float, ...] = key((), POSITIVE, "s")
    response_time: float | None = key(None, POSITIVE, "s")
    drag: float | None = key(None, POSITIVE, "1/m")


@dataclass(frozen=True)
class ProblemKeys:
    """The keys of [[problems]]; those of a generator stand beside them."""

    name: str = ""
    flights: Mapping[str, object] = key(dict)
    file: str = ""
    target: tuple[str, ...] = key(())
    intercept: bool = False
    dataset: DataSet | None = None
    generator: Literal["correlated", "wide", "sparse", "grouped"] | None = None
    test: str = ""
    library: Mapping[str, object] = key(dict)
    alter: tuple[Alteration, ...] = key(("as it is",))
    count: int = key(1, Range(least=1, most=10_000))


@dataclass(frozen=True, kw_only=True)
class Generator:
    """The keys of a problem that is drawn: y = Z w + noise, w of random signs on its support.

    Neighbouring columns correlate by rho to the power of their distance.
    """

    samples: int = key(200, Range(least=2))
    columns: int = key(100, Range(least=1))
    targets: int = key(1, Range(least=1))
    support: int = key(5, Range(least=1))
    snr: float = key(5.0, POSITIVE)
    correlation: float = key(0.0, Range(least=0.0, below=1.0))
    group: int = key(1, Range(least=1))
    density: float = key(1.0, Range(above=0.0, most=1.0))

    def __post_init__(self) -> None:
        if self.samples * self.columns * self.density > MOST_VALUES:
            raise InputError(f"samples times columns must be at most {MOST_VALUES}")
        if self.support * self.group > self.columns:
            raise InputError("support must lie within the columns")
        if self.correlation and self.density < 1.0:
            raise InputError("correlation is of dense columns: drop it, or density")


@dataclass(frozen=True)
class ContenderKeys:
    """The keys of [[backends]] in a study of problems, beside settings."""

    name: str
    label: str = ""
    solver: tuple[str, ...] = key(("",))
    tolerances: tuple[float, ...] = key((), INSIDE)
    certified: bool = False


@dataclass(frozen=True)
class SolverKeys:
    """The keys of [[solvers]] beside settings."""

    name: str = ""
    file: str = ""
    command: tuple[str, ...] = key(())
    start: float = key(60.0, POSITIVE, "s")


@dataclass(frozen=True)
class PathRule:
    """The penalties of [path]."""

    points: int = key(30, Range(least=1, most=1000))
    lowest: float = key(1e-3, INSIDE)


@dataclass(frozen=True)
class Clock:
    """The rules by which a solve is timed: [clock]."""

    limit: float = key(20.0, POSITIVE, "s")
    repeats: int = key(25, Range(least=1, most=1000))
    seconds: float = key(2.0, NOT_NEGATIVE, "s")
    precision: float = key(0.05, POSITIVE)


@dataclass(frozen=True, kw_only=True)
class StudyFile(Heading):
    """A study file, its sections as records where their keys are those of no part of a case."""

    run: RunRule = key(RunRule)
    outputs: Outputs = key(Outputs)


@dataclass(frozen=True, kw_only=True)
class FlightFile(StudyFile):
    """A study of flights."""

    flights: Section
    derivative: Section = key(dict)
    library: Section = key(dict)
    readout: Section = key(dict)
    online: Section = key(dict)
    estimator: Section = key(dict)
    backends: tuple[Section, ...] = key()
    protocols: tuple[Section, ...] = key(())
    sweep: Section = key(dict)
    split: Split | None = None
    select: SelectionRule = key(SelectionRule)


@dataclass(frozen=True, kw_only=True)
class ProblemFile(StudyFile):
    """A study of regression problems."""

    tolerances: tuple[float, ...] = key((1e-4, 1e-6, 1e-8, 1e-10), INSIDE)
    path: PathRule | None = None
    clock: Clock = key(Clock)
    problems: tuple[Section, ...] = key()
    backends: tuple[Section, ...] = key()
    solvers: tuple[Section, ...] = key(())
    flights: Section = key(dict)
    derivative: Section = key(dict)
    library: Section = key(dict)
    select: ProblemSelection = key(ProblemSelection)
