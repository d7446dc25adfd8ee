"""The columns of `cases.parquet` of both kinds of study, each declared here and nowhere else.

A row says the kind and the name of columns and, of flights, where in a case they are read. A column
without a path comes from the plan, or from the outcome by its name. To add one, add a row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

Value: TypeAlias = str | float | int | bool
STATUSES = (
    *("ok", "misfit", "inaccurate", "unidentifiable", "error", "timeout", "crashed", "skipped"),
)
FAILED = ("error", "timeout", "crashed")  # rows that --retry-failed computes again
PARAMETERS = ("mean_velocity", "length_scale", "timescale")  # [m/s], [m], [s]
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


TEXT = Kind("string", str, "", (str,))
FLAG = Kind("bool", bool, False, (bool,))
WHOLE = Kind("int64", int, 0, (int,))
LEVEL = Kind("float64", float, math.nan, (float, int))  # numbers that repeat from row to row
REAL = Kind("float64", float, math.nan, (float, int), dense=True)
SINGLE = Kind("float32", float, math.nan, (float, int), dense=True)  # seven digits are enough


@dataclass(frozen=True)
class Column:
    """One column; path: the names from a case of flights to its value, `.0` of a pair."""

    name: str
    kind: Kind
    path: str = ""

    def read(self, case: object) -> Value | None:
        """The value of a case; None where there is nothing on the way."""
        value: Any = case
        for name in self.path.split("."):
            if value is None:
                return None
            if isinstance(value, dict):
                value = value.get(name)
            else:
                value = value[int(name)] if name.isdigit() else getattr(value, name)
        return None if value is None or value == "" else self.kind.cast(value)


@dataclass(frozen=True)
class Outcome:
    """The end of the case of a unit and a cell; values: the columns that are not planned."""

    unit: int
    cell: int
    status: str
    reason: str = ""
    values: Mapping[str, Value] = field(default_factory=dict)


def _columns(*rows: tuple[Kind, str] | tuple[Kind, str, str]) -> tuple[Column, ...]:
    """Columns of rows (kind, names, path); `*`: each of the three parameters; `{}`: the name."""
    return tuple(
        Column(name.replace("*", each), kind, "".join(path).replace("*", each).format(name))
        for kind, names, *path in rows
        for name in names.split()
        for each in (PARAMETERS if "*" in name else ("",))
    )


FLIGHT_COLUMNS = _columns(
    (TEXT, "case_id study"),
    (WHOLE, "flight"),
    (TEXT, "split protocol backend settings label status reason"),
    (LEVEL, "true_*"),
    (REAL, "est_*", "estimate.*"),
    (LEVEL, "grid_length_scale", "estimate.grid_length_scale"),
    (FLAG, "hit", "hit"),
    (TEXT, "certificate_kind", "estimate.certificate.kind"),
    (SINGLE, "certificate", "estimate.certificate.value"),
    (SINGLE, "seconds", "fit.seconds"),
    (WHOLE, "samples columns", "problem.{}"),
    (LEVEL, "scales_true scales_detected scales_missed scales_spurious", "scale_sets.{}"),
    (LEVEL, "scales_max_length_scale_error scales_max_mean_velocity_error", "scale_sets.{}"),
    (LEVEL, "scales_within_1_percent", "scale_sets.{}"),
    (TEXT, "true_scales est_scales", "scale_sets.{}"),
    (TEXT, "flow"),
    (SINGLE, "extent", "flown.extent"),
    (SINGLE, "se_*", "estimate.uncertainty.*"),
    (REAL, "low_*", "estimate.uncertainty.*_interval.0"),
    (REAL, "high_*", "estimate.uncertainty.*_interval.1"),
    (SINGLE, "bound_*", "flown.bounds.*"),
    (TEXT, "doubt", "estimate.doubt"),
    (LEVEL, "true_length_scale_x true_length_scale_y true_heading true_drift_x true_drift_y"),
    (SINGLE, "est_heading", "estimate.heading"),
    (TEXT, "est_shape", "estimate.shape"),
    (SINGLE, "est_drift_x", "estimate.drift.0"),
    (SINGLE, "est_drift_y", "estimate.drift.1"),
    (SINGLE, "prediction_error", "prediction_error"),
    (WHOLE, "outliers", "estimate.repairs.outliers"),
    (SINGLE, "wander", "estimate.position_wander"),
    (TEXT, "repairs", "estimate.repairs.words"),
    (SINGLE, "r_squared whiteness", "estimate.goodness.{}"),
    (SINGLE, "turbulence_ratio", "estimate.goodness.likelihood_ratio"),
    (SINGLE, "turbulence turbulence_share", "estimate.goodness.{}"),
    (TEXT, "cause", "estimate.goodness.suspect.cause"),
    (TEXT, "log"),
    (SINGLE, "est_length_scale_x", "estimate.length_scales.0"),
    (SINGLE, "est_length_scale_y", "estimate.length_scales.1"),
    (TEXT, "version"),
)
PROBLEM_COLUMNS = _columns(
    (TEXT, "case_id study problem series"),
    (WHOLE, "samples columns targets"),
    (TEXT, "objective backend settings solver"),
    (LEVEL, "tolerance"),  # asked of the solver; NaN where it has none
    (WHOLE, "points"),  # penalties of the path, 1 for a single fit
    (TEXT, "status reason word certificate_kind"),  # word: the back-end's own status
    (REAL, "certificate excess"),  # the gap, and above the best lower bound: worst over the path
    (REAL, "cpu cpu_low cpu_high"),  # median [s] of the solver's processes, 95 % interval
    (REAL, "wall"),  # median [s] of the parent's clock: the time that counts
    (WHOLE, "repeats"),
    (FLAG, "known"),  # whether the median is known to the precision asked for
    (REAL, "first memory load"),  # [s] of imports; [MB] above what it had; when the case began
    (FLAG, "disturbed"),  # whether the wall clock ran well ahead of the CPU's
    (WHOLE, "flight"),  # the problem's number
    (TEXT, "version"),
    (REAL, "wall_low wall_high"),
    (REAL, "holdout_error holdout_error_se"),  # share of the held-out squares not predicted
    (REAL, "alpha_fraction"),  # chosen on the folds; NaN of single fits
    (WHOLE, "support true_support"),
    (REAL, "precision recall f1 stability"),
)


def kinds_of(columns: Sequence[Column]) -> dict[str, Kind]:
    """The kind of each column, by name."""
    return {column.name: column.kind for column in columns}
