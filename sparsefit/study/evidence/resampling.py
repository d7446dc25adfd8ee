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
import pandas as pd
from numpy.typing import NDArray

from sparsefit.arrays import Array
from sparsefit.study.evidence.measure import Measure, Share
from sparsefit.study.evidence.summary import quantile

Draws: TypeAlias = NDArray[np.int64]
RESAMPLES = 2000
SEED = 0
CHUNK = 4_000_000  # numbers resampled at once
ENDS = (0.025, 0.975)
SAME = 1e-9  # of the larger of two numbers: rounding, no difference


def by_flight(values: Array, cases: pd.DataFrame, flights: pd.Index[int] | None = None) -> Array:
    """(flights, cases of each) numbers of the rows, NaN where a flight has fewer.

    flights: in this order, where several grids are to be paired.
    """
    known = pd.Index(cases["flight"].unique()) if flights is None else flights
    place = known.get_indexer(pd.Index(cases["flight"]))
    within = cases.groupby("flight", sort=False).cumcount().to_numpy()
    grid = np.full((len(known), int(within.max(initial=-1)) + 1), np.nan)
    grid[place, within] = values
    return grid


def pooled(measure: Measure, grid: Array) -> Array:
    """(...,) the summary of (..., flights, cases of each), all cases together."""
    return measure.reduce(grid.reshape(*grid.shape[:-2], -1))


def resampled(
    statistic: Callable[[Draws], Array],
    flights: int,
    *,
    width: int = 1,
    seed: int = SEED,
    resamples: int = RESAMPLES,
) -> Array:
    """(resamples,) a statistic of flights drawn with replacement, as many as there are each time.

    statistic: of the places of drawn flights (n, flights), (n,); the same seed draws the same.
    width: the numbers of a flight, by which work is cut to what memory holds.
    """
    rng = np.random.default_rng(seed)
    each = max(1, CHUNK // max(1, flights * width))
    sizes = [min(each, resamples - start) for start in range(0, resamples, each)]
    return np.concatenate([statistic(rng.integers(flights, size=(n, flights))) for n in sizes])


def interval(distribution: Array) -> tuple[float, float]:
    """The 95 % percentile interval of resampled values; NaN of none."""
    low, high = (float(quantile(distribution, end)) for end in ENDS)
    return low, high


def bootstrap(
    statistic: Callable[[Draws], Array], flights: int, width: int = 1
) -> tuple[float, float]:
    """The 95 % interval of a statistic of drawn flights; NaN where they are too few to draw."""
    if flights < 2:
        return math.nan, math.nan
    return interval(resampled(statistic, flights, width=width))


def interval_of(measure: Measure, cases: pd.DataFrame) -> tuple[float, float]:
    """The 95 % interval of the summary of a group of cases, by bootstrap over its flights.

    None or all of a sample say nothing of its spread: a share is Wilson's over the flights there.
    """
    grid = by_flight(measure.per_case(cases), cases)
    if measure.summary == "share" and (share := float(pooled(measure, grid))) in (0.0, 100.0):
        flights = int((~np.isnan(grid)).any(axis=1).sum())
        return Share(flights if share else 0, flights).interval
    return bootstrap(lambda at: pooled(measure, grid[at]), *grid.shape)


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
    known = distributions[:, ~np.isnan(distributions).all(axis=0)]
    least = np.nanmin(known, axis=0)
    is_least = known <= least + SAME * np.abs(least)
    return np.asarray((is_least / is_least.sum(axis=0)).mean(axis=1))


def holm(p_values: Sequence[float]) -> list[float]:
    """p-values adjusted for as many tests by Holm's step-down rule (Holm, 1979).

    NaN, where nothing could be tested, stays NaN and is no test.
    """
    tested = sorted((p, place) for place, p in enumerate(p_values) if not math.isnan(p))
    adjusted, worst = [math.nan] * len(p_values), 0.0
    for rank, (p, place) in enumerate(tested):
        worst = max(worst, min(1.0, (len(tested) - rank) * p))
        adjusted[place] = worst
    return adjusted
