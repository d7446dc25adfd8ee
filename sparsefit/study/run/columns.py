"""The columns of `cases.parquet`, each declared here and nowhere else.

A line of `COLUMNS` says what a column is called, what it holds and what it is read from: a case
as it is planned, or a case that was read. The unfinished rows of a run, the file, its types and
its encoding follow from it. To add a column, add a line.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, Generic, TypeAlias, TypeVar

from sparsefit.flight.flow import Cells
from sparsefit.score import ScalesScore
from sparsefit.study.run.reading import PARAMETERS, Reading, ScaleSets
from sparsefit.study.spec.logs import Logs
from sparsefit.study.spec.plan import Case
from sparsefit.study.spec.study import Study

Value: TypeAlias = str | float | int | bool
PlannedRow = TypeVar("PlannedRow")
WITHIN = 1.0  # percent: the error within which all length scales count as right


@dataclass(frozen=True)
class Kind:
    """What a column holds: its Arrow type, how a value is made one, and what stands for none.

    dense: numbers that never repeat, which pack best by bytes of equal rank.
    """

    arrow: str
    cast: Callable[[Any], Value]
    empty: Value
    dense: bool = False

    def of(self, value: Value | None) -> Value:
        """The value as this kind; what stands for none where it is None."""
        return self.empty if value is None else self.cast(value)


TEXT = Kind("string", str, "")
FLAG = Kind("bool", bool, False)
WHOLE = Kind("int64", int, 0)  # 0 where no library was built
LEVEL = Kind("float64", float, math.nan)  # numbers that repeat from row to row
REAL = Kind("float64", float, math.nan, dense=True)
SINGLE = Kind("float32", float, math.nan, dense=True)  # of what seven digits are enough


@dataclass(frozen=True)
class Planned:
    """A case as it is planned; `flow` is the fastest of the true ones, None in still air.

    identity: what it is, whatever study asks for it (`study/spec/identity.py`).
    """

    study: Study
    case: Case
    flow: Cells | None
    identity: str = ""


@dataclass(frozen=True)
class Column(Generic[PlannedRow]):
    """One column: known as `planned`, or `read` from a case, None where there is nothing to read.

    Neither: `status`, `reason` and `version`, which every case has however it ends, and what a
    study of solvers measures.
    """

    name: str
    kind: Kind
    planned: Callable[[PlannedRow], Value | None] | None = None
    read: Callable[[Reading], Value | None] | None = None


def _three(
    prefix: str, kind: Kind, read: Callable[[Reading, str], Value | None]
) -> list[Column[Planned]]:
    """A column for each of the three parameters, by name."""

    def at(parameter: str) -> Callable[[Reading], Value | None]:
        return lambda case: read(case, parameter)

    return [Column(f"{prefix}_{name}", kind, read=at(name)) for name in PARAMETERS]


def _true(name: str, read: Callable[[Cells], float]) -> Column[Planned]:
    """What belongs to the true flow, nothing in still air."""
    return Column(
        f"true_{name}", LEVEL, planned=lambda row: None if row.flow is None else read(row.flow)
    )


def _of_certificate(name: str, kind: Kind, field: str) -> Column[Planned]:
    """A field of the certificate of the fit, where there is one."""
    return Column(name, kind, read=lambda case: getattr(case.estimate.certificate, field, None))


def _of_goodness(name: str, field: str) -> Column[Planned]:
    """A field of how well refined modes fit, where they were assessed."""
    return Column(name, SINGLE, read=lambda case: getattr(case.estimate.goodness, field, None))


def _cause(case: Reading) -> str | None:
    """What the flow seems to be instead, where it seems so."""
    goodness = case.estimate.goodness
    return str(goodness.suspect.cause) if goodness and goodness.suspect else None


def _of_scales(name: str, kind: Kind, read: Callable[[ScaleSets], Value]) -> Column[Planned]:
    """What is said of several scales at once: nothing where one flow is read as one."""
    return Column(
        name,
        kind,
        read=lambda case: None if case.scale_sets is None else read(case.scale_sets),
    )


def _of_score(name: str, read: Callable[[ScalesScore], Value]) -> Column[Planned]:
    return _of_scales(f"scales_{name}", LEVEL, lambda sets: read(sets.score))


def _side(case: Reading, axis: int) -> float | None:
    """A side of the cells that were found, where they are cells."""
    sides = case.estimate.length_scales
    return sides[axis] if sides else None


def _log(row: Planned) -> str | None:
    """Where a flight that was logged comes from."""
    flights = row.case.cell.setup.flights
    return flights.pieces[row.case.flight].label if isinstance(flights, Logs) else None


def _told_flow(row: Planned) -> str:
    """Whether there is a flow; of a flight that was logged nobody knows."""
    if isinstance(row.case.cell.setup.flights, Logs):
        return "unknown"
    return "cellular" if row.flow else "none"


COLUMNS: tuple[Column[Planned], ...] = (
    Column("case_id", TEXT, planned=lambda row: row.case.case_id),
    Column("study", TEXT, planned=lambda row: row.study.name),
    Column("flight", WHOLE, planned=lambda row: row.case.flight),
    Column("split", TEXT, planned=lambda row: row.study.split(row.case.flight)),
    Column("protocol", TEXT, planned=lambda row: row.case.cell.protocol),
    Column("backend", TEXT, planned=lambda row: row.case.cell.backend),
    Column("settings", TEXT, planned=lambda row: row.case.cell.canonical_settings),
    Column("label", TEXT, planned=lambda row: row.case.cell.label),
    Column("status", TEXT),
    Column("reason", TEXT),
    *(_true(name, attrgetter(name)) for name in PARAMETERS),
    *_three("est", REAL, lambda case, name: getattr(case.estimate, name)),
    Column("grid_length_scale", LEVEL, read=lambda case: case.estimate.grid_length_scale),
    Column("hit", FLAG, read=lambda case: case.hit),
    _of_certificate("certificate_kind", TEXT, "kind"),
    _of_certificate("certificate", SINGLE, "value"),
    Column("seconds", SINGLE, read=lambda case: case.fit.seconds),
    Column("samples", WHOLE, read=lambda case: case.problem.samples),
    Column("columns", WHOLE, read=lambda case: case.problem.columns),
    _of_score("true", lambda score: score.true),
    _of_score("detected", lambda score: score.detected),
    _of_score("missed", lambda score: score.missed),
    _of_score("spurious", lambda score: score.spurious),
    _of_score("max_length_scale_error", lambda score: score.max_length_scale_error),
    _of_score("max_mean_velocity_error", lambda score: score.max_mean_velocity_error),
    _of_score("within_1_percent", lambda score: score.within(WITHIN)),
    _of_scales("true_scales", TEXT, lambda sets: sets.true),
    _of_scales("est_scales", TEXT, lambda sets: sets.estimated),
    Column("flow", TEXT, planned=_told_flow),
    Column("extent", SINGLE, read=lambda case: case.yardstick.extent),
    *_three("se", SINGLE, Reading.standard_error),
    *_three("low", REAL, lambda case, name: case.interval(name)[0]),
    *_three("high", REAL, lambda case, name: case.interval(name)[1]),
    *_three("bound", SINGLE, Reading.bound),
    Column("doubt", TEXT, read=lambda case: case.estimate.doubt and str(case.estimate.doubt)),
    _true("length_scale_x", lambda cells: cells.length_scales[0]),
    _true("length_scale_y", lambda cells: cells.length_scales[1]),
    _true("heading", lambda cells: cells.heading),
    _true("drift_x", lambda cells: cells.drift[0]),
    _true("drift_y", lambda cells: cells.drift[1]),
    Column("est_heading", SINGLE, read=lambda case: case.estimate.heading),
    Column("est_shape", TEXT, read=lambda case: case.estimate.shape or None),
    Column("est_drift_x", SINGLE, read=lambda case: (case.estimate.drift or (None,))[0]),
    Column("est_drift_y", SINGLE, read=lambda case: (case.estimate.drift or (None, None))[1]),
    Column("prediction_error", SINGLE, read=lambda case: case.prediction_error),
    Column("outliers", WHOLE, read=lambda case: case.estimate.repairs.outliers),
    Column("wander", SINGLE, read=lambda case: getattr(case.estimate.agreement, "wander", None)),
    Column("repairs", TEXT, read=lambda case: case.estimate.repairs.words),
    _of_goodness("r_squared", "r_squared"),
    _of_goodness("whiteness", "whiteness"),
    _of_goodness("turbulence_ratio", "likelihood_ratio"),
    _of_goodness("turbulence", "turbulence"),
    _of_goodness("turbulence_share", "turbulence_share"),
    Column("cause", TEXT, read=_cause),
    Column("log", TEXT, planned=_log),
    Column("est_length_scale_x", SINGLE, read=lambda case: _side(case, 0)),
    Column("est_length_scale_y", SINGLE, read=lambda case: _side(case, 1)),
    Column("identity", TEXT, planned=lambda row: row.identity),
    Column("version", TEXT),
)
KINDS = {column.name: column.kind for column in COLUMNS}


def values_of(case: Reading) -> dict[str, Value]:
    """What the columns read from a case, by name."""
    return {column.name: column.kind.of(column.read(case)) for column in COLUMNS if column.read}
