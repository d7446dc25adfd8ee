"""Statistics over flights: the unit that is drawn, whole, with all that was made of it.

Candidates of one study are compared on the same flights, so the same flights are drawn for all of
them (paired). Values stand as (flights, cases of each), NaN where a case has no number.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sparsefit.arrays import Array
from sparsefit.study.evidence.measure import QUANTILES, TINY

Draws: TypeAlias = NDArray[np.int64]
RESAMPLES = 2000
ENDS = (0.025, 0.975)
SAME = 1e-9  # of the larger of two numbers: rounding, no difference


def reduce(summary: str, values: Array) -> Array:
    """(...,) a summary of the last axis of (..., n), over what is not NaN; NaN of nothing."""
    if summary in QUANTILES:
        return quantile(values, QUANTILES[summary])
    return _REDUCED[summary](values)


def _mean(values: Array) -> Array:
    known = ~np.isnan(values)
    count = known.sum(axis=-1)
    total: Array = np.where(known, values, 0.0).sum(axis=-1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


_REDUCED: dict[str, Callable[[Array], Array]] = {
    "mean": _mean,
    "share": lambda values: 100.0 * _mean(values),
    "rms": lambda values: np.sqrt(_mean(values**2)),
    "geometric mean": lambda values: np.exp(_mean(np.log(np.maximum(values, TINY)))),
    "largest": lambda values: -np.sort(-values, axis=-1)[..., 0],
    "number": lambda values: np.nansum(values, axis=-1),
}


def quantile(values: Array, share: float) -> Array:
    """(...,) the quantile of what is not NaN along the last axis, linear between observations."""
    ordered = np.sort(values, axis=-1)  # NaN comes last
    count = (~np.isnan(ordered)).sum(axis=-1)
    place = share * np.maximum(count - 1, 0)
    low = np.floor(place).astype(np.int64)
    high = np.minimum(low + 1, np.maximum(count - 1, 0))
    first, second = (
        np.take_along_axis(ordered, at[..., None], axis=-1)[..., 0] for at in (low, high)
    )
    # Between two infinities, or at an observation, there is nothing to interpolate.
    exact = (first == second) | (place == low)
    start, end = np.where(exact, 0.0, first), np.where(exact, 0.0, second)
    between: Array = start + (place - low) * (end - start)
    return np.where(count > 0, np.where(exact, first, between), np.nan)


def draws(flights: int, seed: int, resamples: int = RESAMPLES) -> Draws:
    """(resamples, flights) flights drawn with replacement, as many as there are each time."""
    return np.random.default_rng(seed).integers(flights, size=(resamples, flights))


def interval(distribution: Array) -> tuple[float, float]:
    """The 95 % percentile interval of resampled values; NaN of none."""
    known = distribution[~np.isnan(distribution)]
    if not known.size:
        return math.nan, math.nan
    low, high = np.quantile(known, ENDS)
    return float(low), float(high)


@dataclass(frozen=True)
class Difference:
    """How much more `effect` one has than another, its 95 % interval and the flights it is from.

    same: no flight tells the two apart.
    """

    effect: float
    low: float
    high: float
    flights: int
    same: bool = False

    @classmethod
    def of(
        cls, effect: float, distribution: Array, flights: int, *, same: bool = False
    ) -> Difference:
        """The difference with the percentile interval of its resampled values."""
        return cls(effect, *interval(distribution), flights, same)

    @property
    def tie(self) -> bool:
        """Whether the interval holds 0: the flights do not tell the two apart."""
        return not (self.low > 0.0 or self.high < 0.0)

    @property
    def more_flights(self) -> float:
        """How many more flights would tell the two apart if the effect is what it seems.

        The interval narrows with the root of the flights; infinite where there is no effect.
        """
        if not self.tie:
            return 0.0
        if self.same or not self.effect:
            return math.inf
        half = (self.high - self.low) / 2.0
        return max(1.0, math.ceil(self.flights * ((half / self.effect) ** 2 - 1.0)))


def best_probabilities(distributions: Array) -> Array:
    """(candidates,) how often each has the least of (candidates, resamples); ties are shared."""
    least = np.nanmin(distributions, axis=0)
    is_least = distributions <= least + SAME * np.abs(least)
    return np.asarray((is_least / is_least.sum(axis=0)).mean(axis=1))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values adjusted for as many tests by Holm's step-down rule (Holm, 1979)."""
    order = np.argsort(p_values)
    count, worst, adjusted = len(order), 0.0, [0.0] * len(order)
    for rank, place in enumerate(order):
        worst = max(worst, min(1.0, (count - rank) * p_values[place]))
        adjusted[int(place)] = worst
    return adjusted
