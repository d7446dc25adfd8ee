"""A log made fit for the search: gaps, uneven steps, repeated samples, outliers and jumps.

Rows that only repeat the one before are dropped; a step much longer than the others cuts the flight
into pieces, none of which a filter crosses; uneven steps are made even for filters that need it.
An outlier is a velocity far from what a polynomial through its neighbours predicts, a jump a step
of the position far from the integral of the velocity: by robust standard deviations and beside the
samples around it (Hampel, 1974). A clean log comes out as the very arrays that went in.
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
from sparsefit.flight.record import MINIMUM_SAMPLES
from sparsefit.logs.checks import GAP, ONE_STEP, clock_rounding


@dataclass(frozen=True)
class CleaningRules:
    """The thresholds by which a sample of a log is replaced or dropped."""

    rest: float = 2.0  # least increments of the log: who moves farther cannot stay where he was
    sure: float = 6.5  # robust standard deviations: white noise goes beyond it once in 1e6 flights
    alone: float = 3.0  # times the median of the samples around
    around: int = 4  # samples on either side
    felt: float = 0.01  # of the rms speed: less moves no parameter
    felt_step: float = 0.1  # of the way in a step at that speed
    rounds: int = 6  # an outlier spoils the prediction of its neighbours too
    window: int = 11  # samples of the polynomial that predicts a velocity
    degree: int = 5  # of that polynomial
    most_outliers: float = 0.2  # of the samples: more, and the others are no measure of them
    most_jumps: float = 0.02  # of the samples
    jump_side: int = 30  # samples on either side that the size of a jump is read from


RULES = CleaningRules()


@dataclass(frozen=True)
class Repairs:
    """The samples that were replaced or dropped before a derivative was taken.

    Args:
        outliers: velocities that were replaced.
        jumps: steps of the position that were taken out.
        gaps: interruptions that no derivative was taken across.
        resampled: samples on even time steps that stand for those on uneven ones.
        repeated: samples that were dropped as they repeat the position of the one before.
        dropped: samples between gaps that were too few to be smoothed.
        largest_outlier: [m/s], 0 where there is none.
        largest_jump: [m].
        longest_gap: [s].
    """

    outliers: int = 0
    jumps: int = 0
    gaps: int = 0
    resampled: int = 0
    repeated: int = 0
    dropped: int = 0
    largest_outlier: float = 0.0
    largest_jump: float = 0.0
    longest_gap: float = 0.0

    @property
    def words(self) -> str:
        """The repairs in words; empty where there were none."""
        parts = (
            (self.outliers, "outlier", f" of up to {self.largest_outlier:.3g} m/s replaced"),
            (self.jumps, "jump", f" of up to {self.largest_jump:.3g} m taken out"),
            (self.gaps, "gap", f" of up to {self.longest_gap:.3g} s left open"),
            (self.resampled, "sample", " put on even time steps"),
            (self.repeated, "repeated sample", " dropped"),
            (self.dropped, "sample", " between gaps dropped"),
        )
        return ", ".join(f"{n} {noun}{'s' * (n > 1)}{what}" for n, noun, what in parts if n)


@dataclass(frozen=True, eq=False)
class Pieces:
    """The samples of a flight and its gaps.

    Args:
        time: [s], (m,).
        state: x, y [m], vx, vy [m/s], (m, 4).
        starts: the first rows of all pieces but the first, (pieces - 1,).
        velocity_measured: whether the velocity tells more than the position.
    """

    time: Array
    state: Array
    starts: IntArray
    velocity_measured: bool = True

    @classmethod
    def of(cls, flight: Flight) -> Pieces:
        """The samples of a flight as they are, in one piece."""
        state = np.hstack([flight.position, flight.velocity])
        return cls(flight.time, state, np.empty(0, dtype=np.intp), flight.velocity_measured)

    @cached_property
    def slices(self) -> list[slice]:
        """The rows of each piece."""
        return [slice(*ends) for ends in pairwise([0, *self.starts.tolist(), len(self.time)])]

    @property
    def lengths(self) -> IntArray:
        """The samples of each piece."""
        return np.array([piece.stop - piece.start for piece in self.slices], dtype=np.intp)

    @cached_property
    def step(self) -> float:
        """The mean time step [s] within the pieces."""
        within = sum(float(self.time[p.stop - 1] - self.time[p.start]) for p in self.slices)
        return within / (len(self.time) - len(self.slices))

    @cached_property
    def even(self) -> bool:
        """Whether the steps within the pieces are one and the same."""
        away = np.abs(np.diff(self.time) - self.step)
        away[self.starts - 1] = 0.0
        return bool(away.max() <= ONE_STEP * self.step + clock_rounding(self.time))

    def cut(self, shortest: int) -> Pieces:
        """The samples cut at their gaps, without pieces of fewer samples if there are longer."""
        steps = np.diff(self.time)
        if steps.max() <= GAP * steps.min():
            return self
        whole = replace(self, starts=np.flatnonzero(steps > GAP * np.median(steps)) + 1)
        long = [piece for piece in whole.slices if piece.stop - piece.start >= shortest]
        if len(long) in (0, len(whole.slices)):
            return whole
        return self._joined([(self.time[piece], self.state[piece]) for piece in long])

    def resampled(self) -> Pieces:
        """The pieces on even steps, the mean one; each begins with its own first sample.

        By the cubic Hermite polynomial of two neighbours; the slopes of the velocity are those of
        the parabola through three.
        """
        from scipy.interpolate import CubicHermiteSpline  # slow to import, rarely needed

        parts = []
        for piece in self.slices:
            time, state = self.time[piece], self.state[piece]
            count = int((time[-1] - time[0]) / self.step + 1e-6) + 1
            even = np.minimum(time[0] + self.step * np.arange(count), time[-1])
            slopes = np.hstack([state[:, 2:], np.gradient(state[:, 2:], time, axis=0)])
            parts.append((even, CubicHermiteSpline(time, state, slopes)(even)))
        return self._joined(parts)

    def _joined(self, parts: list[tuple[Array, Array]]) -> Pieces:
        times, states = zip(*parts, strict=True)
        starts = np.cumsum([len(time) for time in times[:-1]], dtype=np.intp)
        return replace(self, time=np.concatenate(times), state=np.vstack(states), starts=starts)


def repaired(flight: Flight, *, even: bool, shortest: int) -> tuple[Pieces, Repairs]:
    """The samples of a flight made fit for a filter, and the repairs.

    even: whether uneven time steps are made even; shortest: samples that a piece needs.
    """
    log = Pieces.of(flight)
    rows = _fresh(log)
    fresh = replace(log, time=log.time[rows], state=log.state[rows])
    pieces = fresh.cut(shortest)
    steps = np.diff(pieces.time)[pieces.starts - 1]
    repairs = Repairs(
        gaps=len(steps),
        longest_gap=float(steps.max(initial=0.0)),
        repeated=len(log.time) - len(fresh.time),
        dropped=len(fresh.time) - len(pieces.time),
    )
    if not pieces.even:
        if not even:
            return pieces, repairs
        pieces = pieces.resampled()
        repairs = replace(repairs, resampled=len(pieces.time))
    if not flight.velocity_measured:
        return pieces, repairs
    clean = pieces.state.copy()
    for piece in pieces.slices:
        clean[piece, 2:] = clean_velocity(pieces.state[piece, 2:])
        clean[piece, :2] = clean_position(pieces.state[piece, :2], clean[piece, 2:], pieces.step)
    change = clean - pieces.state
    off, moved = np.hypot(*change[:, 2:].T), np.hypot(*np.diff(change[:, :2], axis=0).T)
    jumps = moved > 1e-12 * np.abs(clean[:, :2]).max()
    jumps[pieces.starts - 1] = False
    if not off.any() and not jumps.any():
        return pieces, repairs
    return replace(pieces, state=clean), replace(
        repairs,
        outliers=int(np.count_nonzero(off)),
        jumps=int(jumps.sum()),
        largest_outlier=float(off.max()),
        largest_jump=float(moved[jumps].max(initial=0.0)),
    )


def _fresh(log: Pieces) -> BoolArray:
    """The rows (m,) that repeat no position, if the vehicle moved on at most of those that do."""
    moved, every = np.abs(np.diff(log.state[:, :2], axis=0)), np.ones(len(log.time), dtype=bool)
    repeats = ~moved.any(axis=1)
    if not repeats.any() or not moved.any():
        return every
    way = np.abs(log.state[1:, 2:]).max(axis=1) * np.diff(log.time)
    flown = repeats & (way > RULES.rest * float(moved[moved > 0].min()))
    rows = np.concatenate([[True], ~repeats])
    few = 2 * flown.sum() <= repeats.sum() or rows.sum() < MINIMUM_SAMPLES
    return every if few else rows


def clean_velocity(velocity: Array) -> Array:
    """The velocity (m, 2) [m/s] on even steps with its outliers replaced; the array itself if none.

    The residual of a sample is that of a polynomial through the others: its own weight h in the
    fit taken out, the residual over 1 - h.
    """
    window = RULES.window
    if len(velocity) < 3 * window:
        return velocity
    powers = np.vander(np.linspace(-1.0, 1.0, window), RULES.degree + 1, increasing=True)
    hat, half = powers @ np.linalg.pinv(powers), window // 2
    weight = np.full((len(velocity), 1), hat[half, half])
    weight[:half, 0], weight[-half:, 0] = np.diag(hat)[:half], np.diag(hat)[half + 1 :]
    scale = np.sqrt((1.0 - weight[:, 0]) / (1.0 - hat[half, half]))
    least = RULES.felt * math.sqrt(float(np.mean(velocity**2)))
    # The first look is by medians, which neighbours that are off too do not move.
    padded = np.pad(velocity, ((2, 2), (0, 0)), mode="edge")
    predicted = np.median(sliding_window_view(padded, 5, axis=0), axis=-1)
    size = np.hypot(*(velocity - predicted).T)
    outliers = _isolated(size, np.ones_like(size), least)
    cleaned = np.where(outliers[:, None], predicted, velocity)
    for _ in range(RULES.rounds):
        inner = [np.correlate(column, hat[half], "valid") for column in cleaned.T]
        ends = hat[:half] @ cleaned[:window], hat[half + 1 :] @ cleaned[-window:]
        fitted = np.vstack([ends[0], np.column_stack(inner), ends[1]])
        predicted = (fitted - weight * cleaned) / (1.0 - weight)
        before = outliers
        outliers = _isolated(np.hypot(*(velocity - predicted).T), scale, least)
        if not outliers.any() or outliers.mean() > RULES.most_outliers:
            return velocity
        cleaned = np.where(outliers[:, None], predicted, velocity)
        if np.array_equal(outliers, before):
            break
    return cleaned


def clean_position(position: Array, velocity: Array, step: float) -> Array:
    """The position (m, 2) [m] on even steps without its jumps; the array itself if none.

    The size of a jump is the change of the mean, on either side, of what the integral of the
    velocity (m, 2) [m/s] leaves of the position.
    """
    if len(position) < 3 * RULES.window:
        return position
    mean = 0.5 * (velocity[1:] + velocity[:-1])
    mean[1:-1] = (13.0 * (velocity[1:-2] + velocity[2:-1]) - velocity[:-3] - velocity[3:]) / 24.0
    apart = np.diff(position, axis=0) - step * mean
    least = RULES.felt_step * step * math.sqrt(float(np.mean(velocity**2)))
    size = np.hypot(*apart.T)
    jumps = np.flatnonzero(_isolated(size, np.ones_like(size), least)).tolist()
    if not 0 < len(jumps) <= RULES.most_jumps * len(position):
        return position
    beside = np.vstack([[0.0, 0.0], np.cumsum(apart, axis=0)])
    shift, ends = np.zeros_like(position), [-1, *jumps, len(apart)]
    for before, jump, after in zip(ends[:-2], jumps, ends[2:], strict=True):
        here = beside[max(before, jump - RULES.jump_side) + 1 : jump + 1]
        there = beside[jump + 1 : min(after, jump + RULES.jump_side) + 1]
        shift[jump + 1] = there.mean(axis=0) - here.mean(axis=0)
    return position - np.cumsum(shift, axis=0)


def _isolated(size: Array, scale: Array, least: float) -> BoolArray:
    """Which errors (m,) stand out from all others, and from those around them, beyond ``least``."""
    scaled, rayleigh = scale * size, math.sqrt(2.0 * math.log(2.0))  # median of a pair's length
    spread = max(float(np.median(scaled)) / rayleigh, 1e-300)
    outstanding: BoolArray = (scaled > RULES.sure * spread) & (size > least)
    rows = np.flatnonzero(outstanding)
    first = np.clip(rows - RULES.around, 0, len(size) - 2 * RULES.around - 1)
    around = scaled[first[:, None] + np.arange(2 * RULES.around + 1)]
    outstanding[rows] = scaled[rows] > RULES.alone * np.median(around, axis=1)
    return outstanding


def straddling(starts: IntArray, width: int, rows: int) -> BoolArray:
    """Which of ``rows`` windows, the j-th of the samples j to j + width - 1, cross a gap."""
    crossing = np.zeros(rows, dtype=bool)
    for start in starts:
        crossing[max(start - width + 1, 0) : start] = True
    return crossing
