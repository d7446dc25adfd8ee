"""Summaries and intervals over units, which are flights or problems.

Values form an array (..., units, cases of a unit), with NaN for missing ones. Intervals are
percentiles of a bootstrap that draws whole units, the same ones for all candidates (Efron, 1979);
shares have Wilson intervals (Wilson, 1927).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from sparsefit.arrays import Array, IntArray

if TYPE_CHECKING:
    import pandas as pd

Statistic: TypeAlias = Callable[[Array], Array]  # of (..., units, cases), (...,)
RESAMPLES = 2000
CHUNK = 4_000_000  # numbers drawn at once, a limit of memory
ROUNDING = 1e-9  # relative difference of equal numbers
TINY = 1e-6  # percent: smaller errors are due to quadrature and rounding
QUANTILES = {"median": 0.5, "9 of 10": 0.9, "95th percentile": 0.95}


def mean(values: Array) -> Array:
    """Return the mean (...,) over the last axis, NaN excluded; NaN if all are."""
    finite = ~np.isnan(values)
    count = finite.sum(axis=-1)
    total: Array = np.where(finite, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


SUMMARIES: dict[str, Statistic] = {
    "mean": mean,
    "value": mean,  # of a single case
    "geometric mean": lambda values: np.exp(mean(np.log(np.maximum(values, TINY)))),
    "rms": lambda values: np.sqrt(mean(values**2)),
    "share": lambda values: 100.0 * mean(values),
    "largest": lambda values: -np.sort(-values, axis=-1)[..., 0],
}
SUMMARY_NAMES = (*QUANTILES, *SUMMARIES)


def quantile(values: Array, share: float, *, observed: bool = False) -> Array:
    """Return the quantile (...,) over the last axis, NaN excluded; infinity is a valid value.

    Linear between observations (Hyndman and Fan, 1996, definition 7), or an `observed` value
    (definition 1), as an interpolation between a value and a failure has no meaning.
    """
    ordered = np.sort(values, axis=-1)  # NaN comes last
    count = (~np.isnan(ordered)).sum(axis=-1)
    last = np.maximum(count - 1, 0)
    place = np.ceil(np.maximum(share * count - 1.0, 0.0)) if observed else share * last
    low = np.floor(place).astype(np.intp)
    high = np.minimum(low + 1, last)
    first, second = (
        np.take_along_axis(ordered, at[..., None], axis=-1)[..., 0] for at in (low, high)
    )
    exact = (first == second) | (place == low)  # inf - inf would be NaN
    start, end = np.where(exact, 0.0, first), np.where(exact, 0.0, second)
    between: Array = start + (place - low) * (end - start)
    return np.where(count > 0, np.where(exact, first, between), np.nan)


def by_unit(values: Array, units: pd.Series) -> Array:
    """Return the values (rows,) of cases of units (rows,) as an array (units, cases of a unit)."""
    import pandas as pd

    place, rows = pd.factorize(units)
    within = units.groupby(units, sort=False).cumcount().to_numpy()
    grid = np.full((len(rows), int(within.max(initial=-1)) + 1), np.nan)
    grid[place, within] = values
    return grid


def pooled(reduce: Statistic) -> Statistic:
    """Return a summary of arrays (..., units, cases) over both axes."""
    return lambda grid: reduce(grid.reshape(*grid.shape[:-2], -1))


def resampled(statistic: Callable[[IntArray], Array], units: int, width: int = 1, seed: int = 0,
              resamples: int = RESAMPLES) -> Array:  # fmt: skip
    """Return the bootstrap distribution (resamples,) of a statistic.

    Args:
        statistic: a function of the indices (n, units) of drawn units that returns (n,) values.
        width: numbers of values of a unit, for the limit of memory.
    """
    rng = np.random.default_rng(seed)
    each = max(1, CHUNK // max(1, units * width))
    sizes = [min(each, resamples - start) for start in range(0, resamples, each)]
    return np.concatenate([statistic(rng.integers(units, size=(n, units))) for n in sizes])


def ends(distribution: Array) -> tuple[float, float]:
    """Return the 95 % percentile interval of a bootstrap distribution."""
    low, high = (float(quantile(distribution, share)) for share in (0.025, 0.975))
    return low, high


def interval(statistic: Statistic, grid: Array) -> tuple[float, float]:
    """Return the 95 % interval of a statistic of values (units, cases); NaN for a single unit."""
    if len(grid) < 2:
        return math.nan, math.nan
    return ends(resampled(lambda at: statistic(grid[at]), len(grid), grid[0].size))


def wilson(part: float, whole: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval [%] of the share part/whole; NaN if whole is 0."""
    if not whole:
        return math.nan, math.nan
    p, z2 = part / whole, 1.959963984540054**2
    middle = (p + z2 / (2 * whole)) / (1 + z2 / whole)
    half = math.sqrt(z2 * (p * (1 - p) / whole + z2 / (4 * whole**2))) / (1 + z2 / whole)
    return 100.0 * max(middle - half, 0.0), 100.0 * min(middle + half, 1.0)


@dataclass(frozen=True)
class Difference:
    """A difference with its 95 % interval.

    identical: whether both candidates have equal values, to rounding, in every case.
    """

    effect: float
    low: float
    high: float
    identical: bool = False

    @property
    def tie(self) -> bool:
        """Whether the interval contains 0; for a single unit, whether the values are identical."""
        return self.identical or self.low <= 0.0 <= self.high


def ratio(numerator: Array, denominator: Array) -> tuple[float, float, float]:
    """Return the geometric mean of paired ratios (n,) and its 95 % interval over the pairs.

    Pairs with a value that is not finite are excluded; with fewer than five the interval is NaN.
    """
    logs = np.log(numerator) - np.log(denominator)
    logs = logs[np.isfinite(logs)]
    if not len(logs):
        return math.nan, math.nan, math.nan
    low, high = interval(pooled(mean), logs[:, None]) if len(logs) >= 5 else (math.nan, math.nan)
    return math.exp(logs.mean()), math.exp(low), math.exp(high)
