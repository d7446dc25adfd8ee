"""The smoother that tunes itself: one polynomial through position and velocity together.

Over a window of n samples the path is a polynomial p of degree d + 1, fitted to both channels,

    min_p  sum_j |x_j - p(t_j)|^2 / sigma_x^2 + |v_j - p'(t_j)|^2 / sigma_v^2,

and read in the middle: x = p, v = p', v' = p''. It is the filter of Savitzky and Golay (1964) with
derivative data: velocity carries the position over the window, so position noise averages over all
n samples where position alone must bend. Errors of position matter most: they enter the candidate
functions and attenuate U0 by exp(-k^2 s^2).

The window is the one of least estimated risk (Mallows, 1973; Stein, 1981): with h the weights of
the middle sample in its own estimates, unbiased whatever the path,

    risk(n) = mean((x - x_n)^2 / sigma_x^2 + (v - v_n)^2 / sigma_v^2) + 2 (h_x + h_v).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.cached import cached_property
from sparsefit.derivative.kernels import coupled_kernels, polynomial_kernels
from sparsefit.derivative.pieces import straddling
from sparsefit.derivative.transform import Transformed

ORDER = 10  # of the velocity; 4 doubles the error of tau_w at 0.5 m/s of noise, 8 and 10 agree
SHORTEST = ORDER + 1  # either channel alone determines the polynomial
LONGEST = 1001
GROWTH = 1.25  # from window to window
SIDE_BY_SIDE = 5  # windows in a flight: longer ones lose more at the ends than they gain
FEWEST = SIDE_BY_SIDE * SHORTEST  # samples of a flight that can be smoothed
PATIENCE = 2  # windows of rising risk before the search ends
# v' may be noisy, as regression averages it, but what a window takes from it is missing from U0:
# its window is shorter. 1 costs twice the mean error of tau_w at 0.5 m/s, 0.35 to 0.6 agree.
RATE_SHARE = 0.6
DIFFERENCES = (2, 4, 6, 8, 10, 12)
# Of the largest sample: with less, rounding would choose the window, on each machine another.
ROUNDING = 64.0 * float(np.finfo(np.float64).eps)
SMALLEST = 1e-60  # of a noise level: its square must divide
LONG = 40  # samples of a window that a Fourier transform sums faster, where
NOISY = 1e-10  # of the largest sample is noise: below it the transform's rounding would count
NO_STARTS = np.empty(0, dtype=np.intp)


@dataclass(frozen=True)
class Smoothing:
    """How states and derivatives were smoothed, and how noisy the flight was found.

    Args:
        method: the method that was used; where ``auto`` cannot be, the one it fell back to.
        reason: of a fall-back; otherwise empty.
        window: samples in the window of position and velocity; 1 where nothing is smoothed.
        rate_window: the same of the derivatives.
        order: degree of the velocity's polynomial; 0 where there is none.
        coupled: whether position and velocity share one polynomial.
        sigma_position: standard deviation of the measured position's noise [m], NaN if not sought.
        sigma_velocity: of the measured velocity's [m/s].
        position_error: of the smoothed position [m], from that noise alone.
        velocity_error: of the smoothed velocity [m/s].
        acceleration_error: of the acceleration [m/s^2].
        positions_only: whether velocity, too, is that of the polynomial through the position.
    """

    method: str
    reason: str = ""
    window: int = 1
    rate_window: int = 1
    order: int = 0
    coupled: bool = False
    sigma_position: float = math.nan
    sigma_velocity: float = math.nan
    position_error: float = math.nan
    velocity_error: float = math.nan
    acceleration_error: float = math.nan
    positions_only: bool = False


@dataclass(frozen=True, eq=False)
class Channels:
    """Position [m] and velocity [m/s], (m, 2) each, every ``step`` [s], and their noise levels.

    starts: the first rows of all pieces but the first, where the log has gaps (`Pieces`).
    positions_only: the velocity is not measured, its noise level 0.
    """

    position: Array
    velocity: Array
    step: float
    sigma_position: float
    sigma_velocity: float
    starts: IntArray = field(default_factory=lambda: NO_STARTS)
    positions_only: bool = False

    @classmethod
    def measured(
        cls,
        position: Array,
        velocity: Array,
        step: float,
        starts: IntArray = NO_STARTS,
        *,
        positions_only: bool = False,
    ) -> Channels:
        """Channels with the noise levels that their own differences show."""
        of_velocity = 0.0 if positions_only else noise_level(velocity, starts)
        # Kernels of a limited ratio cannot use positions that are better than this.
        of_position = max(noise_level(position, starts), of_velocity * step / LONGEST)
        return cls(position, velocity, step, of_position, of_velocity, starts, positions_only)

    def within(self, window: int, rows: int) -> slice | BoolArray:
        """Which of so many filtered rows have a whole window in one piece."""
        return ~straddling(self.starts, window, rows) if len(self.starts) else slice(None)

    def room(self, window: int) -> bool:
        """Whether windows of this width leave 1 - 1 / `SIDE_BY_SIDE` of the flight."""
        count = len(self.position)
        lengths = np.diff(np.concatenate([[0], self.starts, [count]]))
        left = int(np.maximum(lengths - window, 0).sum())
        return SIDE_BY_SIDE * left >= (SIDE_BY_SIDE - 1) * count

    @property
    def ratio(self) -> float:
        """sigma_v / sigma_x [1/s], within what a window of `LONGEST` can tell from 0 and inf."""
        ratio = self.sigma_velocity / self.sigma_position * self.step
        return min(max(ratio, 1.0 / LONGEST), float(LONGEST)) / self.step

    def kernels(self, window: int, coupled: bool) -> Array:
        """Weights (4, 2n) of n positions, then n velocities, in x, x', v, v' at the middle.

        coupled: of one polynomial through both channels; otherwise of one through each.
        """
        if coupled:
            position, velocity, acceleration = coupled_kernels(window, ORDER, self.step, self.ratio)
            return np.stack([position, velocity, velocity, acceleration])
        value, slope, bend = polynomial_kernels(window, ORDER, self.step)
        none = np.zeros(window)
        if self.positions_only:
            return np.stack([np.concatenate([row, none]) for row in (value, slope, slope, bend)])
        rows = [(value, none), (slope, none), (none, value), (none, slope)]
        return np.stack([np.concatenate(row) for row in rows])

    @cached_property
    def rows(self) -> Array:
        """x, y, vx, vy (2, 2, m): a row for each."""
        columns = np.stack([self.position.T, self.velocity.T])
        return np.ascontiguousarray(columns)

    @cached_property
    def _transformed(self) -> Transformed | None:
        """The rows as long windows sum them; None where noise is too low for that."""
        levels = np.array([self.sigma_position, self.sigma_velocity])
        noisy = np.all(levels > NOISY * np.abs(self.rows).max(axis=(1, 2)))
        return Transformed.of(self.rows) if noisy else None

    def filtered(self, kernel: Array) -> Array:
        """The weighted sums (2, m - n + 1) of a kernel (2n,), of x and of y."""
        halves = kernel.reshape(2, -1)
        used = [channel for channel in range(2) if halves[channel].any()]
        if halves.shape[1] >= LONG and self._transformed is not None:
            return self._transformed.windows(halves, used)
        parts = [_correlated(halves[channel], self.rows[channel]) for channel in used]
        return parts[0] if len(parts) == 1 else parts[0] + parts[1]

    def spread(self, kernel: Array) -> float:
        """Standard deviation of what a kernel (2n,) gives, from the noise alone."""
        of_position, of_velocity = (float(np.linalg.norm(part)) for part in np.split(kernel, 2))
        return math.hypot(self.sigma_position * of_position, self.sigma_velocity * of_velocity)


def noise_level(values: Array, starts: IntArray = NO_STARTS) -> float:
    """Standard deviation of white noise on smooth columns (m, c), at least that of rounding.

    In the unit of the values; one for all columns. starts: of the pieces after the first.

    The q-th difference of white noise has the variance C(2q, q) sigma^2; what is left of the
    signal only adds to it, so the least over several q is taken (Rice, 1984; Gasser, Sroka and
    Jennen-Steinmetz, 1986).
    """
    variances = (
        float(np.mean(_differences(values, order, starts) ** 2)) / math.comb(2 * order, order)
        for order in DIFFERENCES
        if order < len(values)
    )
    return max(math.sqrt(min(variances)), ROUNDING * float(np.abs(values).max()), SMALLEST)


def _differences(values: Array, order: int, starts: IntArray) -> Array:
    """Differences (m - order, c), those across a gap left out."""
    differences: Array = np.diff(values, order, axis=0)
    if len(starts):
        differences = differences[~straddling(starts, order + 1, len(differences))]
    return differences


def window_sizes(channels: Channels) -> Iterator[int]:
    """Odd windows from `SHORTEST`, each `GROWTH` times the last; `SIDE_BY_SIDE` fit the flight."""
    window = SHORTEST
    while window <= LONGEST and channels.room(window):
        yield window
        window = max(window + 2, 2 * round(window * GROWTH / 2) + 1)


def choose(channels: Channels) -> tuple[int, bool]:
    """The window of least risk [samples], and whether position and velocity are coupled.

    Uncoupled filters win where the logged velocity is not the derivative of the logged position.
    """
    reference = _residuals(channels, SHORTEST, coupled=False)
    uncoupled_risk, uncoupled_window = _least_risk(channels, reference, coupled=False)
    if channels.positions_only:
        return uncoupled_window, False
    risk, window = _least_risk(channels, reference, coupled=True)
    return (window, True) if risk < uncoupled_risk else (uncoupled_window, False)


def _least_risk(
    channels: Channels, reference: tuple[Array, float], *, coupled: bool
) -> tuple[float, int]:
    """The least risk and its window; bias grows steeply, so a few rising risks end the search."""
    best, rising = (math.inf, SHORTEST), 0
    for window in window_sizes(channels):
        risk = _risk(channels, window, reference, coupled=coupled)
        rising = 0 if risk < best[0] else rising + 1
        best = min(best, (risk, window))
        if rising == PATIENCE:
            break
    return best


def _residuals(channels: Channels, window: int, *, coupled: bool) -> tuple[Array, float]:
    """Squared residuals (m - n + 1,) in units of the noise, and the sum of the own weights."""
    kernels, half = channels.kernels(window, coupled), window // 2
    position, velocity = channels.rows[:, :, half : channels.rows.shape[2] - half]
    x, y = (position - channels.filtered(kernels[0])) / channels.sigma_position
    if channels.positions_only:
        return 0.5 * (x * x + y * y), float(kernels[0, half])
    vx, vy = (velocity - channels.filtered(kernels[2])) / channels.sigma_velocity
    square = 0.5 * ((x * x + vx * vx) + (y * y + vy * vy))
    return square, float(kernels[0, half] + kernels[2, window + half])


def _risk(
    channels: Channels, window: int, reference: tuple[Array, float], *, coupled: bool
) -> float:
    """The risk less that of the reference on the same rows: the noise of both mostly cancels."""
    square, weight = _residuals(channels, window, coupled=coupled)
    trim = (len(reference[0]) - len(square)) // 2
    common = reference[0][trim : len(reference[0]) - trim]
    whole = channels.within(window, len(square))
    return float(np.mean((square - common)[whole])) + 2.0 * (weight - reference[1])


def smooth(channels: Channels) -> tuple[IntArray | slice, Array, Array, Smoothing]:
    """Smooth the channels by the window of least risk.

    Returns the rows that full windows reach, m' of them; there the states x, y, vx, vy (m', 4)
    [m, m/s]; their rates (m', 4) [m/s, m/s^2]; and what was chosen.
    """
    window, coupled = choose(channels)
    shorter = max(SHORTEST, 2 * int(RATE_SHARE * window / 2) + 1)
    state, rate = channels.kernels(window, coupled), channels.kernels(shorter, coupled)
    half = window // 2
    kept = slice(half, len(channels.position) - half)
    trim = half - shorter // 2
    states = [channels.filtered(kernel) for kernel in state[[0, 2]]]
    rates = [channels.filtered(kernel) for kernel in rate[[1, 3]]]
    rates = [values[:, trim : values.shape[1] - trim] for values in rates]
    smoothing = Smoothing(
        "auto",
        window=window,
        rate_window=shorter,
        order=ORDER,
        coupled=coupled,
        sigma_position=channels.sigma_position,
        sigma_velocity=channels.sigma_velocity,
        position_error=channels.spread(state[0]),
        velocity_error=channels.spread(state[2]),
        acceleration_error=channels.spread(rate[3]),
        positions_only=channels.positions_only,
    )
    if not len(channels.starts):
        return kept, _columns(states), _columns(rates), smoothing
    whole = ~straddling(channels.starts, window, states[0].shape[1])
    left, slopes = _columns(states)[whole], _columns(rates)[whole]
    return half + np.flatnonzero(whole), left, slopes, smoothing


def _columns(channels: list[Array]) -> Array:
    """Channels (2, m) as columns (m, 4)."""
    return np.ascontiguousarray(np.vstack(channels).T)


def _correlated(kernel: Array, rows: Array) -> Array:
    return np.stack([np.correlate(row, kernel, "valid") for row in rows])
