"""Measures flight by flight: flights are drawn, not cases, for several cases share a flight."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence.cases import in_a_flow
from sparsefit.study.evidence.measure import Failure, Measure, Share
from sparsefit.study.evidence.resampling import RESAMPLES, Draws, reduce

CHUNK = 4_000_000  # numbers resampled at once
SEED = 0


def per_case(measure: Measure, cases: pd.DataFrame) -> Array:
    """(rows,) the measure of each case, NaN where it has none; a failure counts as it says."""
    applies = measure.applies
    of = applies(cases) if applies else np.ones(len(cases), dtype=bool)
    read: Array = np.where(of, measure.read(cases), np.nan)
    if measure.failure is Failure.LEFT_OUT:
        return read
    worst = math.inf if measure.failure is Failure.INFINITE else measure.miss
    return np.where(np.isnan(read) & of & in_a_flow(cases), worst, read)


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


def pooled(summary: str, grid: Array) -> Array:
    """(...,) the summary of (..., flights, cases of each), all cases together."""
    return reduce(summary, grid.reshape(*grid.shape[:-2], -1))


def bootstrap(statistic: Callable[[Draws], Array], flights: int, seed: int = SEED) -> Array:
    """(2,) the 95 % percentile interval of a statistic of drawn flights (..., flights).

    Raises nothing where flights are too few to draw, or have no number: the interval is NaN.
    """
    if flights < 2:
        return np.full(2, np.nan)
    from scipy import stats  # slow to import, and only tables need it

    # An end between two infinities is NaN, and so is one of draws without a number: not known.
    with np.errstate(invalid="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", stats.DegenerateDataWarning)
        result = stats.bootstrap(
            (np.arange(flights),),
            lambda at, axis: statistic(at),
            vectorized=True,
            n_resamples=RESAMPLES,
            batch=max(1, CHUNK // max(1, 100 * flights)),
            method="percentile",
            random_state=np.random.default_rng(seed),
        )
    return np.array(result.confidence_interval)


def interval_of(measure: Measure, cases: pd.DataFrame, summary: str = "") -> tuple[float, float]:
    """The 95 % interval of the summary of a group of cases, by bootstrap over its flights."""
    grid = by_flight(per_case(measure, cases), cases)
    told = summary or measure.summary
    if told == "share":
        return share_interval(grid)
    low, high = bootstrap(lambda at: pooled(told, grid[at]), len(grid))
    return float(low), float(high)


def share_interval(grid: Array) -> tuple[float, float]:
    """The 95 % interval [%] of a share of (flights, cases of each).

    None or all of a sample say nothing of its spread: there, it is Wilson's over the flights.
    """
    low, high = map(float, bootstrap(lambda at: pooled("share", grid[at]), len(grid)))
    share = float(pooled("share", grid))
    if share not in (0.0, 100.0):
        return low, high
    flights = int((~np.isnan(grid)).any(axis=1).sum())
    return Share(flights if share else 0, flights).interval
