"""The keys of a study file: a record for each section; `keys.toml` has their words.

The keys of [flights] are quantities, and options of `simulate`: a row each says unit, range and
random streams. Every random quantity has its own stream, by its place: a row at the end changes no
other's draws, and a quantity that went leaves its streams behind. How flights are read are records
of the estimator.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from sparsefit.codec import Place, build
from sparsefit.errors import InputError, suggestion
from sparsefit.study.schema import ANY, INSIDE, NOT_NEGATIVE, POSITIVE, SHARE, Range, Section, key

MOST_VALUES = 128_000_000  # numbers in a regression problem: a gigabyte
COUNTED = Range(least=0, most=100_000)
StudyKind: TypeAlias = Literal["flights", "problems", "solvers"]
Three: TypeAlias = tuple[float, float, float]
DataSet: TypeAlias = Literal["diabetes", "diabetes-quadratic", "linnerud", "digits", "iris", "wine",
                             "breast-cancer"]  # fmt: skip
Alteration: TypeAlias = Literal["as it is", "duplicated columns", "units 1e-12 to 1e12"]
FLOW_KEYS = ("mean_velocity", "length_scale", "timescale")
RATIO = Range(least=0.01, most=100.0)
TURBULENCE_FIELD = "turbulence_field"  # the stream of the field of turbulence, which has no key
# Words that people write for a key.
SYNONYMS = {
    **dict.fromkeys(("dropouts", "dropout"), "lost_samples"),
    **dict.fromkeys(("rate", "frequency"), "sample_rate"),
    "noise": "velocity_noise",
    "speed": "mean_velocity",
    "tau": "response_time",
    "thrust": "thrust_acceleration",
}


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

    criterion: str = ""
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

    def changed(self, place: Place | None = None, /, **options: object) -> SelectionRule:
        """The rule with these options in place of its own; InputError names one that is wrong."""
        values = {name: own for name, own in {**vars(self), **options}.items() if own != ""}
        return build(type(self), values, place or Place("select", "select"))


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
class ContenderKeys(BackendKeys):
    """The keys of [[backends]] in a study of problems, beside settings."""

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
class StudyFile:
    """A study file, its sections as records where their keys are those of no part of a case."""

    name: str
    question: str
    kind: StudyKind = "flights"
    seed: int = 0
    run: RunRule = key(RunRule)
    outputs: Outputs = key(Outputs)
    select: SelectionRule = key(SelectionRule)
    flights: Section = key(dict)
    derivative: Section = key(dict)
    library: Section = key(dict)
    backends: tuple[Section, ...] = key()

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]{1,64}", self.name):
            raise InputError("name must be 1 to 64 of a-z, 0-9, _ and -: it is the results folder")


@dataclass(frozen=True, kw_only=True)
class FlightFile(StudyFile):
    """A study of flights."""

    flights: Section
    readout: Section = key(dict)
    online: Section = key(dict)
    estimator: Section = key(dict)
    protocols: tuple[Section, ...] = key(())
    sweep: Section = key(dict)
    split: Split | None = None


@dataclass(frozen=True, kw_only=True)
class ProblemFile(StudyFile):
    """A study of regression problems."""

    tolerances: tuple[float, ...] = key((1e-4, 1e-6, 1e-8, 1e-10), INSIDE)
    path: PathRule | None = None
    clock: Clock = key(Clock)
    problems: tuple[Section, ...] = key()
    solvers: tuple[Section, ...] = key(())


@dataclass(frozen=True)
class Quantity:
    """A quantity: its name, unit and range.

    streams: the random numbers that it fills, two of a pair [x, y]; needs: the quantities without
    which it has no meaning; of_flow: whether still air leaves it out; shapes: whether cells with it
    are other than squares along the axes that stand; fault: the field of `LogFaults` that it is.
    """

    name: str
    unit: str
    range: Range
    streams: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()
    of_flow: bool = False
    shapes: bool = False
    fault: str = ""


def _q(name: str, unit: str, range: Range, *needs: str, axes: str = "",
       of_flow: bool = False, shapes: bool = False, fault: str = "") -> Quantity:  # fmt: skip
    streams = (f"{axes}_x", f"{axes}_y") if axes else (name,)
    return Quantity(name, unit, range, streams, needs, of_flow or shapes, shapes, fault)


def _without_key(*streams: str) -> Quantity:
    return Quantity("", "", ANY, streams)


_ROWS = (
    _q("mean_velocity", "m/s", POSITIVE, of_flow=True),
    _q("length_scale", "m", POSITIVE, of_flow=True),
    _q("timescale", "s", POSITIVE, of_flow=True),
    _q("response_time", "s", POSITIVE),
    _q("thrust_acceleration", "m/s²", ANY, axes="thrust"),
    _q("initial_position", "m", ANY, axes="position"),
    _q("initial_velocity", "m/s", ANY, axes="velocity"),
    _q("duration", "s", POSITIVE),
    _q("sample_rate", "Hz", POSITIVE),
    _q("process_noise", "m/s²", NOT_NEGATIVE),
    _q("position_noise", "m", NOT_NEGATIVE),
    _q("velocity_noise", "m/s", NOT_NEGATIVE),
    _q("wind", "m/s", ANY, axes="wind"),
    _q("second_scale_ratio", "", RATIO, "second_velocity_ratio", of_flow=True),
    _q("second_velocity_ratio", "", RATIO, "second_scale_ratio", of_flow=True),
    _without_key("third_scale_ratio", "third_velocity_ratio"),
    _q("believed_response_time_ratio", "", POSITIVE),
    _q("believed_thrust_ratio", "", NOT_NEGATIVE),
    _q("heading", "rad", ANY, shapes=True),
    _q("aspect", "", RATIO, shapes=True),
    _q("angle", "rad", Range(above=0.0, below=math.pi), shapes=True),
    _q("offset", "m", ANY, axes="offset", shapes=True),
    _q("drift_ratio", "", NOT_NEGATIVE, "drift_direction", shapes=True),
    _q("drift_direction", "rad", ANY, of_flow=True),
    _q("swell", "", Range(least=0.0, most=0.99), shapes=True),
    _q("swell_period", "s", POSITIVE, of_flow=True),
    _q("swell_phase", "rad", ANY, of_flow=True),
    _q("second_heading", "rad", ANY, "second_scale_ratio", shapes=True),
    _q("wind_ratio", "", NOT_NEGATIVE, "wind_direction", of_flow=True),
    _q("wind_direction", "rad", ANY),
    _q("turbulence_ratio", "", NOT_NEGATIVE, "turbulence_length", of_flow=True),
    _q("turbulence_length", "m", POSITIVE, of_flow=True),
    _q("turbulence_memory", "s", POSITIVE, of_flow=True),
    _without_key(TURBULENCE_FIELD),
    _q("time_jitter", "", Range(least=0.0, most=0.49)),
    _q("position_wander", "m", NOT_NEGATIVE, fault="wander"),
    _q("position_wander_time", "s", POSITIVE, fault="wander_time"),
    _q("outliers", "", SHARE, fault="outliers"),
    _q("outlier_size", "m/s", NOT_NEGATIVE, fault="outlier_size"),
    _q("jumps", "", NOT_NEGATIVE, fault="jumps"),
    _q("jump_size", "m", NOT_NEGATIVE, fault="jump_size"),
    _q("gaps", "", NOT_NEGATIVE, fault="gaps"),
    _q("gap_duration", "s", NOT_NEGATIVE, fault="gap_duration"),
    _q("drag", "1/m", POSITIVE),
    _q("thrust_turn", "m/s²", NOT_NEGATIVE, "thrust_period"),
    _q("thrust_period", "s", POSITIVE),
    _q("thrust_phase", "rad", ANY),
    _q("thrust_noise", "m/s²", NOT_NEGATIVE, "thrust_turn"),
    _q("believed_drag_ratio", "", POSITIVE),
    _q("believed_response_time", "s", POSITIVE),
    _without_key("believed_drag"),
    _q("together", "flights", Range(least=1.0, most=64.0)),
    _q("lost_samples", "", SHARE, fault="lost_samples"),
)  # fmt: skip
STREAMS = tuple(stream for row in _ROWS for stream in row.streams)
QUANTITIES = {row.name: row for row in _ROWS if row.name}
QUANTITIES["measurement_noise"] = Quantity(  # both in one key, so that a sweep moves both
    "measurement_noise", "m/s, m", NOT_NEGATIVE, ("velocity_noise", "position_noise")
)  # fmt: skip


@dataclass(frozen=True)
class FlightWords:
    """The keys of [flights] that are words."""

    flow: Literal["cellular", "none", "turbulence"] = "cellular"
    turbulence_spectrum: Literal["dryden", "von-karman"] = "dryden"
    thrust_log: Literal["measured", "none"] = "measured"


def nearest(name: str, names: Iterable[str]) -> str:
    """The nearest key of [flights] for a message, and not all of the sixty."""
    if name in SYNONYMS:
        return f': did you mean "{SYNONYMS[name]}"?'
    near = suggestion(name, names)
    return near if "did you mean" in near else ": `sparsefit simulate --help` lists them"
