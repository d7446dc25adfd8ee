"""Preparation of a log for the search: gaps, uneven steps and outliers.

A step much longer than the others is a gap, which no filter crosses; a log with uneven steps is
resampled for filters that need even ones. An outlier is a position or velocity far from what a
polynomial through its neighbours predicts (Hampel, 1974). A clean log is returned unchanged. The
likelihood uses the raw log.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.flight import Flight
from sparsefit.logs.checks import ONE_STEP, clock_rounding, gaps_of


@dataclass(frozen=True)
class Repairs:
    """The repairs of a log before its derivatives were taken."""

    outliers: int = 0  # samples whose position or velocity was replaced
    gaps: int = 0  # gaps, across which no derivative is taken
    resampled: int = 0  # samples after resampling to even time steps
    longest_gap: float = 0.0  # [s], 0 without gaps

    @property
    def words(self) -> str:
        """The repairs in words; empty without repairs."""
        parts = (
            (self.outliers, "outlier", " replaced"),
            (self.gaps, "gap", f" of up to {self.longest_gap:.3g} s left open"),
            (self.resampled, "sample", " put on even time steps"),
        )
        return ", ".join(f"{n} {noun}{'s' * (n > 1)}{what}" for n, noun, what in parts if n)


@dataclass(frozen=True, eq=False)
class LogPieces:
    """The samples of a flight, in the pieces between its gaps."""

    time: Array  # [s], (m,)
    state: Array  # x, y [m], vx, vy [m/s], (m, 4)
    piece: IntArray  # the number of each sample's piece, ascending, (m,)
    velocity_measured: bool = True  # else it is the derivative of the position

    def windows(self, width: int) -> IntArray:
        """The first rows of all windows of ``width`` samples that cross no gap."""
        count = max(len(self.piece) - width + 1, 0)
        return np.flatnonzero(self.piece[width - 1 :] == self.piece[:count])

    @cached_property
    def steps(self) -> Array:
        """The time steps within the pieces [s]."""
        return np.asarray(np.diff(self.time)[self.windows(2)])

    @cached_property
    def step(self) -> float:
        """The mean time step [s] within the pieces."""
        return float(self.steps.mean())

    @cached_property
    def even(self) -> bool:
        """Whether all steps within the pieces are equal."""
        slack = ONE_STEP * self.step + clock_rounding(self.time)
        return bool(np.abs(self.steps - self.step).max() <= slack)

    def resampled(self) -> LogPieces:
        """The pieces resampled to the mean step, each from its first sample on.

        By cubic Hermite interpolation; the slopes of the velocity are those of parabolas through
        three samples.
        """
        from scipy.interpolate import CubicHermiteSpline  # slow to import, rarely needed

        times, pieces = [], []
        for number, rows in enumerate(self.slices):
            first, last = float(self.time[rows.start]), float(self.time[rows.stop - 1])
            count = int((last - first) / self.step + 1e-6) + 1
            times.append(np.minimum(first + self.step * np.arange(count), last))
            pieces.append(np.full(count, number))
        slopes = np.gradient(self.state[:, 2:], self.time, axis=0)
        spline = CubicHermiteSpline(self.time, self.state, np.hstack([self.state[:, 2:], slopes]))
        time = np.concatenate(times)
        return replace(self, time=time, state=spline(time), piece=np.concatenate(pieces))

    @property
    def slices(self) -> list[slice]:
        """The rows of each piece."""
        ends = np.cumsum(np.bincount(self.piece)).tolist()
        return [slice(*pair) for pair in zip([0, *ends], ends, strict=False)]


def filtered(values: Array, kernel: Array) -> Array:
    """The weighted sums (m - n + 1, c) of columns (m, c) with a kernel (n,)."""
    return np.stack([np.correlate(column, kernel, "valid") for column in values.T], axis=1)


def pieces_of(flight: Flight, *, repair: bool, even: bool) -> tuple[LogPieces, Repairs]:
    """The samples of a flight, repaired if requested, and the repairs.

    even: whether a repair resamples uneven time steps; outliers are sought on even steps only.
    """
    state, gaps = np.hstack([flight.position, flight.velocity]), bool(repair) & gaps_of(flight.time)
    piece = np.concatenate([[0], np.cumsum(gaps)])
    log = LogPieces(flight.time, state, piece, flight.velocity_measured)
    longest = float(np.diff(flight.time)[gaps].max(initial=0.0))
    repairs = Repairs(gaps=int(piece[-1]), longest_gap=longest)
    if not repair or not (log.even or even):
        return log, repairs
    if not log.even:
        log = log.resampled()
        repairs = replace(repairs, resampled=len(log.time))
    state = log.state.copy()
    for rows in log.slices:
        for columns in (slice(0, 2), slice(2, 4))[: 1 + flight.velocity_measured]:
            state[rows, columns] = without_outliers(log.state[rows, columns])
    outliers = int(np.count_nonzero((state != log.state).any(axis=1)))
    if not outliers:
        return log, repairs
    return replace(log, state=state), replace(repairs, outliers=outliers)


def without_outliers(values: Array, window: int = 11, degree: int = 5) -> Array:
    """Positions or velocities (m, 2) on even steps, outliers replaced; the array itself if none.

    The residual of a sample is that of a polynomial through the other samples of its window: the
    residual of the fit over 1 - h, h the weight of the sample in its own fit. An outlier exceeds
    6.5 robust standard deviations (white noise does so once in 1e6 flights), 3 times the median of
    the 4 residuals on either side, and 0.01 of the channel's rms deviation. If more than a fifth of
    the samples are outliers nothing is replaced: the others do not determine the noise level.
    """
    if len(values) < 3 * window:
        return values
    powers = np.vander(np.linspace(-1.0, 1.0, window), degree + 1, increasing=True)
    hat, half = powers @ np.linalg.pinv(powers), window // 2
    own = np.diag(hat)
    others = (hat - np.diag(own)) / (1.0 - own)[:, None]  # a sample by those around it
    counts = np.where(np.arange(window) == half, len(values) - window + 1, 1)
    scale = np.sqrt(np.repeat((1.0 - own) / (1.0 - own[half]), counts))
    least = 0.01 * math.sqrt(float(np.var(values, axis=0).sum()))
    rayleigh = math.sqrt(2.0 * math.log(2.0))  # the median of a pair's length
    # The first pass predicts by medians of 5, robust against two outliers among them.
    padded = np.pad(values, ((2, 2), (0, 0)), mode="edge")
    a, b, c, d, e = (padded[j : j + len(values)] for j in range(5))
    low = np.maximum(np.minimum(a, b), np.minimum(d, e))
    high = np.minimum(np.maximum(a, b), np.maximum(d, e))
    predicted = np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), c))
    outliers = np.zeros(len(values), dtype=bool)
    for look in range(7):
        if look:  # an outlier spoils the prediction of its neighbours too
            cleaned = np.where(outliers[:, None], predicted, values)
            ends = others[:half] @ cleaned[:window], others[half + 1 :] @ cleaned[-window:]
            predicted = np.vstack([ends[0], filtered(cleaned, others[half]), ends[1]])
        size = np.hypot(*(values - predicted).T)
        scaled = scale * size if look else size
        spread = max(float(np.median(scaled)) / rayleigh, 1e-300)
        before, outliers = outliers, (scaled > 6.5 * spread) & (size > least)
        rows = np.flatnonzero(outliers)
        around = scaled[np.clip(rows - 4, 0, len(size) - 9)[:, None] + np.arange(9)]
        outliers[rows] = scaled[rows] > 3.0 * np.median(around, axis=1)
        if look and (not outliers.any() or outliers.mean() > 0.2):
            return values
        if look and np.array_equal(outliers, before):
            break
    return np.where(outliers[:, None], predicted, values)
