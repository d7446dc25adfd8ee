"""The columns of `cases.parquet` of both kinds of study, each declared here and nowhere else.

A line says the name of a column, its kind and, of flights, how it is read from a case. A column
without a reader comes from the plan, or from the outcome by its name. To add one, add a line.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias, cast

if TYPE_CHECKING:
    from sparsefit.study.reading import Reading

Value: TypeAlias = str | float | int | bool
STATUSES = (
    *("ok", "misfit", "inaccurate", "unidentifiable", "error", "timeout", "crashed", "skipped"),
)
FAILED = ("error", "timeout", "crashed")  # rows that --retry-failed computes again
PARAMETERS = ("mean_velocity", "length_scale", "timescale")  # [m/s], [m], [s]
WITHIN = 1.0  # percent: the error within which all length scales count as right
MAX_REASON = 500  # characters of a reason that are kept


@dataclass(frozen=True)
class Kind:
    """The content of a column: its Arrow type, how a value is made one, what stands for no value.

    types: of its values in JSON; dense: of numbers that never repeat, which pack best by bytes of
    equal rank.
    """

    arrow: str
    cast: Callable[[Any], Value]
    empty: Value
    types: tuple[type, ...]
    dense: bool = False

    def of(self, value: Value | None) -> Value:
        """The value as this kind; the empty one in place of None."""
        return self.empty if value is None else self.cast(value)


TEXT = Kind("string", str, "", (str,))
FLAG = Kind("bool", bool, False, (bool,))
WHOLE = Kind("int64", int, 0, (int,))
LEVEL = Kind("float64", float, math.nan, (float, int))  # numbers that repeat from row to row
REAL = Kind("float64", float, math.nan, (float, int), dense=True)
SINGLE = Kind("float32", float, math.nan, (float, int), dense=True)  # seven digits are enough

Read: TypeAlias = "Callable[[Reading], Value | None]"


@dataclass(frozen=True)
class Column:
    """One column; read: its value from a case of flights, None where there is nothing to read."""

    name: str
    kind: Kind
    read: Read | None = None


@dataclass(frozen=True)
class Outcome:
    """The end of the case of a unit and a cell ended.

    values: the columns that are not planned, by name; shared_seconds of its `seconds` [s] were
    spent for other fits too; weights: (length scale [m], weight) pairs; body: these three as JSON,
    where a worker has told them.
    """

    unit: int
    cell: int
    status: str
    reason: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)
    shared_seconds: float = 0.0
    weights: tuple[tuple[float, float], ...] = ()
    body: str = ""


def body_of(outcome: Outcome) -> str:
    """Values, shared seconds and weights of an outcome as JSON, empty ones left out."""
    if outcome.body:
        return outcome.body
    values = {n: v for n, v in outcome.values.items() if v == v and v != ""}
    return json.dumps([values, outcome.shared_seconds, outcome.weights], separators=(",", ":"))


def read_body(body: str) -> tuple[dict[str, Any], float, list[tuple[float, float]]]:
    """The values, the shared seconds and the weights of `body_of`."""
    values, shared, weights = json.loads(body)
    return values, shared, weights


def outcome_of(
    unit: int, cell: int, status: Any, reason: Any, body: str, kinds: Mapping[str, Kind]
) -> Outcome:
    """The outcome that a worker has told, held against the kinds of the columns.

    Raises:
        ValueError, TypeError, LookupError: a status, a column or a value that there is not.
    """
    values, shared, weights = json.loads(body)
    if status not in STATUSES or not isinstance(reason, str):
        raise ValueError(f"a status that there is not: {status!r}"[:80])
    reason.encode()
    for name, value in values.items():
        kind = type(value)
        if kind not in kinds[name].types:
            raise ValueError(f"{name} is no {kinds[name].arrow}")
        if kind is str:
            value.encode()
        elif kind is int and not -(2**63) <= value < 2**63:
            raise ValueError(f"{name} is too large")
    pairs = tuple((float(scale), float(weight)) for scale, weight in weights)
    return Outcome(unit, cell, status, reason, values, float(shared), pairs, body)


def _three(prefix: str, kind: Kind, read: Callable[[Reading, str], Value | None]) -> list[Column]:
    """A column for each of the three parameters, by name."""

    def at(parameter: str) -> Read:
        return lambda case: read(case, parameter)

    return [Column(f"{prefix}_{name}", kind, at(name)) for name in PARAMETERS]


def _of(path: str) -> Read:
    """The attribute at a dotted path from the case; None where one on the way is None."""

    def read(case: Reading) -> Value | None:
        value: Any = case
        for name in path.split("."):
            value = getattr(value, name, None)
        return cast("Value | None", value)

    return read


def _item(path: str, place: int) -> Read:
    """Item number `place` of a pair at a dotted path; None where there is no pair."""
    pair = _of(path)
    return lambda case: (pair(case) or (None, None))[place]  # type: ignore[index]


def _or_none(path: str) -> Read:
    """A text at a dotted path; None where it is empty."""
    read = _of(path)
    return lambda case: str(read(case)) if read(case) else None


FLIGHT_COLUMNS: tuple[Column, ...] = (
    *(Column(name, TEXT) for name in ("case_id", "study")),
    Column("flight", WHOLE),
    *(Column(name, TEXT) for name in ("split", "protocol", "backend", "settings", "label")),
    *(Column(name, TEXT) for name in ("status", "reason")),
    *(Column(f"true_{name}", LEVEL) for name in PARAMETERS),
    *_three("est", REAL, lambda case, name: getattr(case.estimate, name)),
    Column("grid_length_scale", LEVEL, _of("estimate.grid_length_scale")),
    Column("hit", FLAG, _of("hit")),
    Column("certificate_kind", TEXT, _of("estimate.certificate.kind")),
    Column("certificate", SINGLE, _of("estimate.certificate.value")),
    Column("seconds", SINGLE, _of("fit.seconds")),
    Column("samples", WHOLE, _of("problem.samples")),
    Column("columns", WHOLE, _of("problem.columns")),
    Column("scales_true", LEVEL, _of("scale_sets.score.true")),
    Column("scales_detected", LEVEL, _of("scale_sets.score.detected")),
    Column("scales_missed", LEVEL, _of("scale_sets.score.missed")),
    Column("scales_spurious", LEVEL, _of("scale_sets.score.spurious")),
    Column("scales_max_length_scale_error", LEVEL, _of("scale_sets.score.max_length_scale_error")),
    Column(
        "scales_max_mean_velocity_error", LEVEL, _of("scale_sets.score.max_mean_velocity_error")
    ),
    Column(
        "scales_within_1_percent",
        LEVEL,
        lambda case: case.scale_sets.score.within(WITHIN) if case.scale_sets else None,
    ),
    Column("true_scales", TEXT, _of("scale_sets.true")),
    Column("est_scales", TEXT, _of("scale_sets.estimated")),
    Column("flow", TEXT),
    Column("extent", SINGLE, _of("yardstick.extent")),
    *_three("se", SINGLE, lambda case, name: case.standard_error(name)),
    *_three("low", REAL, lambda case, name: case.interval(name)[0]),
    *_three("high", REAL, lambda case, name: case.interval(name)[1]),
    *_three("bound", SINGLE, lambda case, name: case.bound(name)),
    Column("doubt", TEXT, _or_none("estimate.doubt")),
    *(Column(f"true_{name}", LEVEL) for name in ("length_scale_x", "length_scale_y", "heading")),
    *(Column(f"true_{name}", LEVEL) for name in ("drift_x", "drift_y")),
    Column("est_heading", SINGLE, _of("estimate.heading")),
    Column("est_shape", TEXT, _or_none("estimate.shape")),
    Column("est_drift_x", SINGLE, _item("estimate.drift", 0)),
    Column("est_drift_y", SINGLE, _item("estimate.drift", 1)),
    Column("prediction_error", SINGLE, _of("prediction_error")),
    Column("outliers", WHOLE, _of("estimate.repairs.outliers")),
    Column("wander", SINGLE, _of("estimate.agreement.wander")),
    Column("repairs", TEXT, _of("estimate.repairs.words")),
    Column("r_squared", SINGLE, _of("estimate.goodness.r_squared")),
    Column("whiteness", SINGLE, _of("estimate.goodness.whiteness")),
    Column("turbulence_ratio", SINGLE, _of("estimate.goodness.likelihood_ratio")),
    Column("turbulence", SINGLE, _of("estimate.goodness.turbulence")),
    Column("turbulence_share", SINGLE, _of("estimate.goodness.turbulence_share")),
    Column("cause", TEXT, _or_none("estimate.goodness.suspect.cause")),
    Column("log", TEXT),
    Column("est_length_scale_x", SINGLE, _item("estimate.length_scales", 0)),
    Column("est_length_scale_y", SINGLE, _item("estimate.length_scales", 1)),
    *(Column(name, TEXT) for name in ("identity", "version")),
)
PROBLEM_COLUMNS: tuple[Column, ...] = (
    *(Column(name, TEXT) for name in ("case_id", "study", "problem", "series", "level")),
    *(Column(name, WHOLE) for name in ("samples", "columns", "targets")),
    *(Column(name, TEXT) for name in ("objective", "backend", "settings", "solver")),
    Column("tolerance", LEVEL),  # asked of the solver; NaN where it has none
    Column("points", WHOLE),  # penalties of the path, 1 for a single fit
    *(Column(name, TEXT) for name in ("status", "reason")),
    Column("word", TEXT),  # the back-end's own status
    Column("certificate_kind", TEXT),
    Column("certificate", REAL),  # its own duality gap, worst over the path
    Column("excess", REAL),  # above the best certified lower bound, worst over the path
    Column("cpu", REAL),  # median [s] of the solver's processes
    *(Column(name, REAL) for name in ("cpu_low", "cpu_high")),  # 95 % interval of the median
    Column("wall", REAL),  # median [s] of the parent's clock: the time that counts
    *(Column(name, WHOLE) for name in ("repeats",)),
    Column("known", FLAG),  # whether the median is known to the precision asked for
    Column("first", REAL),  # [s] imports and compilation, on a small problem
    Column("memory", REAL),  # MB above what the process had, at its highest
    Column("load", REAL),  # of the machine, when the case began
    Column("disturbed", FLAG),  # whether the wall clock ran well ahead of the CPU's
    Column("flight", WHOLE),  # the problem's number
    *(Column(name, TEXT) for name in ("identity", "version")),
    *(Column(name, REAL) for name in ("wall_low", "wall_high")),
    Column("holdout_error", REAL),  # share of the held-out squares that is not predicted
    Column("holdout_error_se", REAL),
    Column("alpha_fraction", REAL),  # chosen on the folds; NaN of single fits
    *(Column(name, WHOLE) for name in ("support", "true_support")),
    *(Column(name, REAL) for name in ("precision", "recall", "f1", "stability")),
)


def kinds_of(columns: Sequence[Column]) -> dict[str, Kind]:
    """The kind of each column, by name."""
    return {column.name: column.kind for column in columns}


def values_of(case: Reading) -> dict[str, Value]:
    """The values that the columns read from a case of flights, by name; those there are."""
    read = ((column, column.read(case)) for column in FLIGHT_COLUMNS if column.read)
    return {c.name: c.kind.of(value) for c, value in read if value is not None}
