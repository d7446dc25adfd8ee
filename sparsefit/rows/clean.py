"""A log made fit for the search: gaps, uneven steps and outliers.

A step much longer than the others is a gap, which no filter crosses; uneven steps are made even for
filters that need it. An outlier is a position or velocity far from what a polynomial through its
neighbours predicts, by robust standard deviations and beside the samples around it (Hampel, 1974).
A clean log comes out as the very arrays that went in. The likelihood reads the log as it is.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.cached import cached_property
from sparsefit.flight import Flight
from sparsefit.logs.checks import GAP, ONE_STEP, clock_rounding, gaps_of


@dataclass(frozen=True)
class Repairs:
    """The samples that were replaced before a derivative was taken.

    Args:
        outliers: samples whose position or velocity was replaced.
        gaps: interruptions that no derivative was taken across.
        resampled: samples on even time steps that stand for those on uneven ones.
        longest_gap: [s], 0 where there is none.
    """

    outliers: int = 0
    gaps: int = 0
    resampled: int = 0
    longest_gap: float = 0.0

    @property
    def words(self) -> str:
        """The repairs in words; empty where there were none."""
        parts = (
            (self.outliers, "outlier", " replaced"),
            (self.gaps, "gap", f" of up to {self.longest_gap:.3g} s left open"),
            (self.resampled, "sample", " put on even time steps"),
        )
        return ", ".join(f"{n} {noun}{'s' * (n > 1)}{what}" for n, noun, what in parts if n)


@dataclass(frozen=True, eq=False)
class LogPieces:
    """The samples of a flight and its gaps."""

    time: Array  # [s], (m,)
    state: Array  # x, y [m], vx, vy [m/s], (m, 4)
    starts: IntArray  # the first rows of all pieces but the first, (pieces - 1,)
    velocity_measured: bool = True  # it tells more than the position

    @cached_property
    def slices(self) -> list[slice]:
        """The rows of each piece."""
        return [slice(*ends) for ends in pairwise([0, *self.starts.tolist(), len(self.time)])]

    @cached_property
    def step(self) -> float:
        """The mean time step [s] within the pieces."""
        within = sum(float(self.time[p.stop - 1] - self.time[p.start]) for p in self.slices)
        return within / max(len(self.time) - len(self.slices), 1)

    @property
    def away(self) -> Array:
        """The steps (m - 1,) less the mean one [s], 0 across a gap."""
        away: Array = np.diff(self.time) - self.step
        away[self.starts - 1] = 0.0
        return away

    @cached_property
    def even(self) -> bool:
        """Whether the steps within the pieces are one and the same."""
        return bool(np.abs(self.away).max() <= ONE_STEP * self.step + clock_rounding(self.time))

    def whole(self, width: int) -> BoolArray:
        """Which windows, the j-th of the samples j to j + width - 1, cross no gap."""
        inside = np.ones(max(len(self.time) - width + 1, 0), dtype=bool)
        for start in self.starts:
            inside[max(start - width + 1, 0) : start] = False
        return inside

    def resampled(self) -> LogPieces:
        """The pieces on even steps, the mean one; each begins with its own first sample.

        By the cubic Hermite polynomial of two neighbours; the slopes of the velocity are those of
        the parabola through three.
        """
        from scipy.interpolate import CubicHermiteSpline  # slow to import, rarely needed

        times = []
        for piece in self.slices:
            first, last = float(self.time[piece.start]), float(self.time[piece.stop - 1])
            count = int((last - first) / self.step + 1e-6) + 1
            times.append(np.minimum(first + self.step * np.arange(count), last))
        time = np.concatenate(times)
        slopes = np.gradient(self.state[:, 2:], self.time, axis=0)
        spline = CubicHermiteSpline(self.time, self.state, np.hstack([self.state[:, 2:], slopes]))
        starts = np.cumsum([len(part) for part in times[:-1]], dtype=np.intp)
        return replace(self, time=time, state=spline(time), starts=starts)


def pieces_of(flight: Flight, *, repair: bool, even: bool) -> tuple[LogPieces, Repairs]:
    """The samples of a flight, as they are or made fit for a filter, and the repairs.

    even: whether a repair makes uneven time steps even; outliers are sought on even steps alone.
    """
    state, steps = np.hstack([flight.position, flight.velocity]), np.diff(flight.time)
    starts = np.empty(0, dtype=np.intp)
    if repair and steps.max() > GAP * steps.min():
        starts = np.flatnonzero(gaps_of(flight.time)) + 1
    log = LogPieces(flight.time, state, starts, flight.velocity_measured)
    repairs = Repairs(gaps=len(starts), longest_gap=float(steps[starts - 1].max(initial=0.0)))
    if not repair or not (log.even or even):
        return log, repairs
    if not log.even:
        log = log.resampled()
        repairs = replace(repairs, resampled=len(log.time))
    state = log.state.copy()
    for piece in log.slices:
        for columns in (slice(0, 2), slice(2, 4))[: 1 + flight.velocity_measured]:
            state[piece, columns] = without_outliers(log.state[piece, columns])
    outliers = int(np.count_nonzero((state != log.state).any(axis=1)))
    if not outliers:
        return log, repairs
    return replace(log, state=state), replace(repairs, outliers=outliers)


def without_outliers(values: Array, window: int = 11, degree: int = 5) -> Array:
    """Positions or velocities (m, 2) on even steps, outliers replaced; the array itself if none.

    The residual of a sample is that of a polynomial through the others in a window: its own weight
    h in the fit taken out, the residual over 1 - h. An outlier is 6.5 robust standard deviations
    off, which white noise is once in 1e6 flights, 3 times the median of the 4 on either side, and
    a hundredth of the channel's rms deviation. Where they are a fifth of all, the others are no
    measure of them.
    """
    if len(values) < 3 * window:
        return values
    powers = np.vander(np.linspace(-1.0, 1.0, window), degree + 1, increasing=True)
    hat, half = powers @ np.linalg.pinv(powers), window // 2
    weight = np.full((len(values), 1), hat[half, half])
    weight[:half, 0], weight[-half:, 0] = np.diag(hat)[:half], np.diag(hat)[half + 1 :]
    scale = np.sqrt((1.0 - weight[:, 0]) / (1.0 - hat[half, half]))
    least = 0.01 * math.sqrt(float(np.var(values, axis=0).sum()))
    rayleigh = math.sqrt(2.0 * math.log(2.0))  # the median of a pair's length

    def outlying(predicted: Array, scale: Array | float) -> BoolArray:
        size = np.hypot(*(values - predicted).T)
        scaled = scale * size
        spread = max(float(np.median(scaled)) / rayleigh, 1e-300)
        outstanding: BoolArray = (scaled > 6.5 * spread) & (size > least)
        rows = np.flatnonzero(outstanding)
        around = scaled[np.clip(rows - 4, 0, len(size) - 9)[:, None] + np.arange(9)]
        outstanding[rows] = scaled[rows] > 3.0 * np.median(around, axis=1)
        return outstanding

    # The first look is by medians, which neighbours that are off too do not move.
    padded = np.pad(values, ((2, 2), (0, 0)), mode="edge")
    predicted = np.median(sliding_window_view(padded, 5, axis=0), axis=-1)
    outliers = outlying(predicted, 1.0)
    for _ in range(6):  # an outlier spoils the prediction of its neighbours too
        cleaned = np.where(outliers[:, None], predicted, values)
        inner = [np.correlate(column, hat[half], "valid") for column in cleaned.T]
        ends = hat[:half] @ cleaned[:window], hat[half + 1 :] @ cleaned[-window:]
        fitted = np.vstack([ends[0], np.column_stack(inner), ends[1]])
        predicted, before = (fitted - weight * cleaned) / (1.0 - weight), outliers
        outliers = outlying(predicted, scale)
        if not outliers.any() or outliers.mean() > 0.2:
            return values
        if np.array_equal(outliers, before):
            break
    return np.where(outliers[:, None], predicted, values)
