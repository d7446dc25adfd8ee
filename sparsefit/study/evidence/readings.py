"""What is read from each case: errors, bounds, intervals, and how far apart its scales are.

Of the three parameters U0 [m/s], L_w [m] and tau_w [s], in this order, everything is read at once,
as an array (rows, 3); NaN stands where a case has no such number.
"""

from __future__ import annotations

import json

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends import finds_its_own
from sparsefit.study.evidence.cases import (
    called_empty,
    estimated,
    has_status,
    in_a_flow,
    in_still_air,
    three_of,
)
from sparsefit.study.evidence.table import Value, plain

OFF = 5.0  # percent: an estimate off by more, in any parameter, should have been flagged


def where(kept: BoolArray, values: Array | BoolArray) -> Array:
    """Return the values of the cases that are kept, NaN of the others; (rows,) or (rows, 3)."""
    return np.where(kept if values.ndim == 1 else kept[:, None], values, np.nan)


def signed_errors(cases: pd.DataFrame) -> Array:
    """(rows, 3) estimate - truth of U0 [m/s], L_w [m], tau_w [s]; NaN without an estimate."""
    return where(estimated(cases), three_of(cases, "est") - three_of(cases, "true"))


def percent_errors(cases: pd.DataFrame) -> Array:
    """(rows, 3) signed errors in percent of the truth; NaN where there is no estimate."""
    percent: Array = 100.0 * signed_errors(cases) / three_of(cases, "true")
    return percent


def sizes(cases: pd.DataFrame) -> Array:
    """(rows, 3) the errors in percent of the truth without their signs."""
    return np.abs(percent_errors(cases))


def bounded(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether a case has status ok, and its flight a finite Cramér-Rao bound."""
    bounds = three_of(cases, "bound")
    known = np.isfinite(bounds).all(axis=1) & (bounds > 0).all(axis=1)
    both: BoolArray = known & has_status(cases, "ok")
    return both


def efficiencies(cases: pd.DataFrame) -> Array:
    """(rows, 3) error / Cramér-Rao bound of the cases that are `bounded`."""
    return where(bounded(cases), signed_errors(cases) / three_of(cases, "bound"))


def bounds(cases: pd.DataFrame) -> Array:
    """(rows, 3) the Cramér-Rao bound in percent of the truth, of the cases that are `bounded`."""
    return where(bounded(cases), 100.0 * three_of(cases, "bound") / three_of(cases, "true"))


def _with_intervals(cases: pd.DataFrame) -> BoolArray:
    """(rows, 3) whether a case is called ok and has truth, estimate and interval."""
    columns = [three_of(cases, name) for name in ("true", "est", "low", "high")]
    known: BoolArray = ~np.isnan(columns).any(axis=0) & has_status(cases, "ok")[:, None]
    return known


def held(cases: pd.DataFrame) -> Array:
    """(rows, 3) whether the 95 % interval holds the truth; NaN without one."""
    true, low, high = (three_of(cases, name) for name in ("true", "low", "high"))
    return np.where(_with_intervals(cases), (low <= true) & (true <= high), np.nan)


def half_widths(cases: pd.DataFrame) -> Array:
    """(rows, 3) half the width of the 95 % interval, in percent of the estimate."""
    found, low, high = (three_of(cases, name) for name in ("est", "low", "high"))
    return np.where(_with_intervals(cases), 50.0 * (high - low) / np.abs(found), np.nan)


def is_off(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether the numbers, flagged or not, miss the truth by > 5 %, or are missing."""
    true, found = three_of(cases, "true"), three_of(cases, "est")
    near = 100.0 * np.abs(found - true) <= OFF * np.abs(true)
    return np.asarray(~near.all(axis=1), dtype=bool)


def off_among(cases: pd.DataFrame, status: str) -> Array:
    """(rows,) whether a case is off, of those in a flow that ended in this status."""
    return where(in_a_flow(cases) & has_status(cases, status), is_off(cases))


def false_alarms(cases: pd.DataFrame) -> Array:
    """(rows,) whether a case without a flow has an estimate."""
    return where(in_still_air(cases), has_status(cases, "ok") | has_status(cases, "inaccurate"))


def called_so(cases: pd.DataFrame) -> Array:
    """(rows,) whether a case without a flow is unidentifiable because none was detected."""
    said = has_status(cases, "unidentifiable") & called_empty(cases)
    return where(in_still_air(cases), said)


def on_a_grid(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether there was a flow and candidate scales to choose from."""
    backends = cases["backend"].astype(str)
    gridless = [name for name in backends.unique() if finds_its_own(name)]
    return in_a_flow(cases) & ~backends.isin(gridless).to_numpy(dtype=bool)


def nearest_hits(cases: pd.DataFrame) -> Array:
    """(rows,) whether a case chose the grid scale nearest the truth."""
    return where(estimated(cases), cases["hit"].isin([True]).to_numpy(dtype=bool))


def regimes(cases: pd.DataFrame) -> Array:
    """(rows, 3) largest scale [m], least ratio of neighbouring scales, and of U0; NaN of none."""
    texts = cases["true_scales"] if "true_scales" in cases else [None] * len(cases)
    return np.array([_apart(plain(text)) for text in texts], dtype=float).reshape(-1, 3)


def _apart(text: Value) -> tuple[float, float, float]:
    pairs = np.array(json.loads(str(text or "[]")), dtype=float).reshape(-1, 2)
    if not len(pairs):
        return np.nan, np.nan, np.nan
    scales, speeds = np.sort(pairs[:, 0]), pairs[:, 1]
    apart = float(np.min(scales[1:] / scales[:-1])) if len(scales) > 1 else np.inf
    return float(scales[-1]), apart, float(speeds.min() / speeds.max())
