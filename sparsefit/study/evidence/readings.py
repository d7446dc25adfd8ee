"""What is read from each case: errors, bounds, intervals, and how far apart its scales are."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.cases import (
    estimated,
    has_status,
    three_of,
)
from sparsefit.study.evidence.table import Value, plain

OFF = 5.0  # percent: an estimate off by more, in any parameter, should have been flagged


def signed_errors(cases: pd.DataFrame) -> Array:
    """(rows, 3) estimate - truth of U0 [m/s], L_w [m], tau_w [s]; NaN without an estimate."""
    errors = three_of(cases, "est") - three_of(cases, "true")
    errors[~estimated(cases)] = np.nan
    return errors


def percent_errors(cases: pd.DataFrame) -> Array:
    """(rows, 3) signed errors in percent of the truth; NaN where there is no estimate."""
    percent: Array = 100.0 * signed_errors(cases) / three_of(cases, "true")
    return percent


def largest_errors(cases: pd.DataFrame) -> Array:
    """(rows,) the largest |% error| of the three parameters."""
    return np.asarray(np.abs(percent_errors(cases)).max(axis=1))


def bounded(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether a case has status ok, and its flight a finite Cramér-Rao bound."""
    bounds = three_of(cases, "bound")
    known = np.isfinite(bounds).all(axis=1) & (bounds > 0).all(axis=1)
    both: BoolArray = known & has_status(cases, "ok")
    return both


def where(kept: BoolArray, values: Array | BoolArray) -> Array:
    """(rows,) the values of the cases that are kept, NaN of the others."""
    return np.where(kept, values, np.nan)


def _in_intervals(cases: pd.DataFrame, place: int) -> tuple[BoolArray, Array, Array, Array, Array]:
    """Which cases called ok have truth, estimate and interval; those four columns."""
    columns = [three_of(cases, name)[:, place] for name in ("true", "est", "low", "high")]
    known = ~np.isnan(np.column_stack(columns)).any(axis=1)
    true, found, low, high = columns
    return known & has_status(cases, "ok"), true, found, low, high


def held(cases: pd.DataFrame, place: int) -> Array:
    """(rows,) whether the 95 % interval of a parameter holds the truth; NaN without any."""
    kept, true, _, low, high = _in_intervals(cases, place)
    return where(kept, (low <= true) & (true <= high))


def half_width(cases: pd.DataFrame, place: int) -> Array:
    """(rows,) half the width of the 95 % interval, in percent of the estimate."""
    kept, _, found, low, high = _in_intervals(cases, place)
    return where(kept, 50.0 * (high - low) / np.abs(found))


def is_off(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether the numbers, flagged or not, miss the truth by > 5 %, or are missing."""
    true, found = three_of(cases, "true"), three_of(cases, "est")
    near = 100.0 * np.abs(found - true) <= OFF * np.abs(true)
    return np.asarray(~near.all(axis=1), dtype=bool)


def nearest_hits(cases: pd.DataFrame) -> Array:
    """(rows,) whether a case chose the grid scale nearest the truth."""
    hit = np.array([plain(value) is True for value in cases["hit"]], dtype=bool)
    return where(estimated(cases), hit)


def regime(cases: pd.DataFrame, place: int) -> Array:
    """(rows,) largest scale [m], least ratio of neighbouring scales, and of U0; NaN of none."""
    texts = cases["true_scales"] if "true_scales" in cases else [None] * len(cases)
    rows = [_apart(plain(text)) for text in texts]
    return np.array(rows, dtype=float).reshape(-1, 3)[:, place]


def _apart(text: Value) -> tuple[float, float, float]:
    pairs = np.array(json.loads(str(text or "[]")), dtype=float).reshape(-1, 2)
    if not len(pairs):
        return np.nan, np.nan, np.nan
    scales, speeds = np.sort(pairs[:, 0]), pairs[:, 1]
    apart = float(np.min(scales[1:] / scales[:-1])) if len(scales) > 1 else np.inf
    return float(scales[-1]), apart, float(speeds.min() / speeds.max())
