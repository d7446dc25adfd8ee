"""Summaries of numbers, of which NaN is none and infinity is more than any other."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sparsefit.arrays import Array

TINY = 1e-6  # percent: a smaller error is quadrature and rounding, no ratio of them says anything
QUANTILES = {
    "median": 0.5,
    "first quartile": 0.25,
    "third quartile": 0.75,
    "9 of 10": 0.9,
    "95th percentile": 0.95,
}


def _mean(values: Array) -> Array:
    known = ~np.isnan(values)
    count = known.sum(axis=-1)
    total: Array = np.where(known, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


SUMMARIES: dict[str, Callable[[Array], Array]] = {
    "mean": _mean,
    "geometric mean": lambda values: np.exp(_mean(np.log(np.maximum(values, TINY)))),
    "rms": lambda values: np.sqrt(_mean(values**2)),
    "share": lambda values: 100.0 * _mean(values),
    "largest": lambda values: -np.sort(-values, axis=-1)[..., 0],
    "number": lambda values: np.nansum(values, axis=-1),
}
SUMMARY_WORDS = {name: name for name in (*QUANTILES, *SUMMARIES)} | {
    "share": "share of",
    "number": "number of",
}


def reduce(summary: str, values: Array, *, observed: bool = False) -> Array:
    """(...,) a summary of the last axis of (..., n), over what is not NaN; NaN of nothing.

    observed: quantiles are among the values, where nothing lies halfway to a failure.
    """
    if summary in QUANTILES:
        return quantile(values, QUANTILES[summary], observed=observed)
    return SUMMARIES[summary](values)


def quantile(values: Array, share: float, *, observed: bool = False) -> Array:
    """(...,) the quantile of what is not NaN along the last axis.

    Linear between observations (Hyndman and Fan's definition 7), or `observed`, the least value
    that so large a share does not exceed (definition 1).
    """
    ordered = np.sort(values, axis=-1)  # NaN comes last
    count = (~np.isnan(ordered)).sum(axis=-1)
    last = np.maximum(count - 1, 0)
    place = np.ceil(np.maximum(share * count - 1.0, 0.0)) if observed else share * last
    low = np.floor(place).astype(np.int64)
    high = np.minimum(low + 1, last)
    first, second = (
        np.take_along_axis(ordered, at[..., None], axis=-1)[..., 0] for at in (low, high)
    )
    # Between two infinities, or at an observation, there is nothing to interpolate.
    exact = (first == second) | (place == low)
    start, end = np.where(exact, 0.0, first), np.where(exact, 0.0, second)
    between: Array = start + (place - low) * (end - start)
    return np.where(count > 0, np.where(exact, first, between), np.nan)
