"""Statistics over flights and problems: the unit is drawn whole, with every case made of it.

Numbers stand as a grid (..., units, cases of each), NaN where a case has none. Candidates are
tried on the same units, so the same units are drawn for all of them (paired). Intervals are
percentiles of a bootstrap over units (Efron, 1979), shares have Wilson's interval (Wilson, 1927).
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
CHUNK = 4_000_000  # numbers drawn at once, by the memory that they take
ROUNDING = 1e-9  # of the larger of two numbers: no difference
TINY = 1e-6  # percent: a smaller error is quadrature and rounding
QUANTILES = {"median": 0.5, "9 of 10": 0.9, "95th percentile": 0.95}


def mean(values: Array) -> Array:
    """Return the mean (...,) of (..., n) numbers that are not NaN; NaN of none."""
    finite = ~np.isnan(values)
    count = finite.sum(axis=-1)
    total: Array = np.where(finite, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


SUMMARIES: dict[str, Statistic] = {
    "mean": mean,
    "geometric mean": lambda values: np.exp(mean(np.log(np.maximum(values, TINY)))),
    "rms": lambda values: np.sqrt(mean(values**2)),
    "share": lambda values: 100.0 * mean(values),
    "largest": lambda values: -np.sort(-values, axis=-1)[..., 0],
}
SUMMARY_NAMES = (*QUANTILES, *SUMMARIES)


def quantile(values: Array, share: float, *, observed: bool = False) -> Array:
    """Return the quantile (...,) of (..., n) numbers that are not NaN; infinity is the largest.

    Linear between observations (Hyndman and Fan's definition 7), or `observed`, the least value
    that so large a share does not exceed (definition 1): there is no value halfway to a failure.
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
    exact = (first == second) | (place == low)  # two infinities have no number between them
    start, end = np.where(exact, 0.0, first), np.where(exact, 0.0, second)
    between: Array = start + (place - low) * (end - start)
    return np.where(count > 0, np.where(exact, first, between), np.nan)


def by_unit(values: Array, units: pd.Series) -> Array:
    """Return the numbers (rows,) of cases of units (rows,) as a grid (units, cases of each)."""
    import pandas as pd

    place, rows = pd.factorize(units)
    within = units.groupby(units, sort=False).cumcount().to_numpy()
    grid = np.full((len(rows), int(within.max(initial=-1)) + 1), np.nan)
    grid[place, within] = values
    return grid


def pooled(reduce: Statistic) -> Statistic:
    """Return the summary of a grid (..., units, cases), all cases of the units together."""
    return lambda grid: reduce(grid.reshape(*grid.shape[:-2], -1))


def resampled(statistic: Callable[[IntArray], Array], units: int, width: int = 1, seed: int = 0,
              resamples: int = RESAMPLES) -> Array:  # fmt: skip
    """Return a statistic (resamples,) of units drawn with replacement, as many as there are.

    Args:
        statistic: of the places (n, units) of drawn units, (n,); one seed draws one set of places.
        width: the numbers of a unit, by which the work is cut to what memory holds.
    """
    rng = np.random.default_rng(seed)
    each = max(1, CHUNK // max(1, units * width))
    sizes = [min(each, resamples - start) for start in range(0, resamples, each)]
    return np.concatenate([statistic(rng.integers(units, size=(n, units))) for n in sizes])


def ends(distribution: Array) -> tuple[float, float]:
    """Return the 95 % percentile interval of resampled values; NaN of none."""
    low, high = (float(quantile(distribution, share)) for share in (0.025, 0.975))
    return low, high


def interval(statistic: Statistic, grid: Array) -> tuple[float, float]:
    """Return the 95 % interval of a statistic of a grid (units, cases); NaN of a single unit."""
    if len(grid) < 2:
        return math.nan, math.nan
    return ends(resampled(lambda at: statistic(grid[at]), len(grid), grid[0].size))


def wilson(part: float, whole: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval [%] of a share of `whole` units; NaN of none."""
    if not whole:
        return math.nan, math.nan
    p, z2 = part / whole, 1.959963984540054**2
    middle = (p + z2 / (2 * whole)) / (1 + z2 / whole)
    half = math.sqrt(z2 * (p * (1 - p) / whole + z2 / (4 * whole**2))) / (1 + z2 / whole)
    return 100.0 * max(middle - half, 0.0), 100.0 * min(middle + half, 1.0)


@dataclass(frozen=True)
class Difference:
    """A difference with its 95 % interval.

    identical: whether the two agree to rounding in every case.
    """

    effect: float
    low: float
    high: float
    identical: bool = False

    @property
    def tie(self) -> bool:
        """Whether the interval holds 0."""
        return not (self.low > 0.0 or self.high < 0.0)


def ratio(numerator: Array, denominator: Array) -> tuple[float, float, float]:
    """Return the geometric mean of paired ratios (n,) and its 95 % interval over the pairs.

    Pairs with a value that is not finite are left out; the interval of fewer than five is NaN.
    """
    logs = np.log(numerator) - np.log(denominator)
    logs = logs[np.isfinite(logs)]
    if not len(logs):
        return math.nan, math.nan, math.nan
    low, high = interval(pooled(mean), logs[:, None]) if len(logs) >= 5 else (math.nan, math.nan)
    return math.exp(logs.mean()), math.exp(low), math.exp(high)
