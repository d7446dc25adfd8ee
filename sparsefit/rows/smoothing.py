"""The smoother that tunes itself: a polynomial through each channel, its window by risk.

Position and velocity are each fitted over a window of n samples by a polynomial of one degree, read
in the middle with its derivatives (Savitzky and Golay, 1964, Anal. Chem. 36, 1627). The window is
the one of least estimated risk (Mallows, 1973; Stein, 1981): with h the weight of the middle sample
in its own estimate, unbiased whatever the path,

    risk(n) = mean((v - v_n)^2) / sigma^2 + 2 h.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from sparsefit.arrays import Array
from sparsefit.rows.clean import LogPieces

ORDER = 10  # of the polynomial; 4 doubles the error of tau_w at 0.5 m/s of noise, 8 and 10 agree
SHORTEST = ORDER + 1  # samples of a window
SIDE_BY_SIDE = 5  # windows in a flight: longer ones lose more at the ends than they gain
FEWEST = SIDE_BY_SIDE * SHORTEST  # samples of a flight that can be smoothed
Rates = tuple[Array, Array, Array, "Smoothing"]  # time (q,), state (q, 4), rate (q, 4), the filter


@dataclass(frozen=True)
class Smoothing:
    """The filter of states and derivatives, and the noise levels of the flight.

    Args:
        method: the method that was used; where ``auto`` cannot be, the one it fell back to.
        reason: of a fall-back; otherwise empty.
        window: samples under the filters of position and velocity; 1 where nothing is smoothed.
        rate_window: samples in the window of the acceleration.
        order: degree of the polynomial; 0 where there is none.
        sigma_position: standard deviation of the measured position's noise [m], NaN if not sought.
        sigma_velocity: of the measured velocity's [m/s], 0 where it was not measured.
    """

    method: str
    reason: str = ""
    window: int = 1
    rate_window: int = 1
    order: int = 0
    sigma_position: float = math.nan
    sigma_velocity: float = math.nan

    @property
    def correlation(self) -> float:
        """Rows over which errors of the acceleration correlate: a window per coefficient."""
        return self.rate_window / (self.order + 1)


@lru_cache(maxsize=128)
def polynomial_kernels(window: int, order: int, step: float) -> Array:
    """Weights (3, n) of n even samples in p, p' and p'' at their middle, step [s]. Read-only."""
    powers = np.vander(np.linspace(-1.0, 1.0, window), order + 1, increasing=True)
    kernels, reach = np.zeros((3, window)), window // 2 * step
    kernels[: order + 1] = np.linalg.pinv(powers)[:3]
    kernels *= np.array([1.0, 1.0 / reach, 2.0 / reach**2])[:, None]
    kernels.flags.writeable = False
    return kernels


def filtered(values: Array, kernel: Array) -> Array:
    """The weighted sums (m - n + 1, c) of columns (m, c) with a kernel (n,)."""
    return np.stack([np.correlate(column, kernel, "valid") for column in values.T], axis=1)


def noise_level(values: Array, log: LogPieces) -> float:
    """Standard deviation of white noise on smooth columns (m, c), at least that of rounding.

    The q-th difference of white noise has the variance C(2q, q) sigma^2; what is left of the
    signal only adds to it, so the least over several q is taken (Rice, 1984; Gasser, Sroka and
    Jennen-Steinmetz, 1986).
    """
    variances = []
    for order in range(2, min(13, len(values)), 2):
        differences = np.diff(values, order, axis=0)[log.whole(order + 1)]
        if len(differences):
            variances.append(float(np.mean(differences**2)) / math.comb(2 * order, order))
    # With less than rounding, that would choose the window, on each machine another; the square
    # of a level must divide.
    rounding = 64.0 * float(np.finfo(np.float64).eps) * float(np.abs(values).max())
    return max(math.sqrt(min(variances)), rounding, 1e-60)


def least_risk(values: Array, sigma: float, log: LogPieces) -> int:
    """The window [samples] of least risk for columns (m, c) with white noise sigma.

    Windows are odd, from `SHORTEST` to 1001, each 1.25 times the last, as long as they leave
    1 - 1/`SIDE_BY_SIDE` of the flight. Bias grows steeply: a few rising risks end the search.
    """

    def residuals(window: int) -> tuple[Array, float]:
        kernel, half = polynomial_kernels(window, ORDER, log.step)[0], window // 2
        errors = values[half : len(values) - half] - filtered(values, kernel)
        return np.mean(errors**2, axis=1) / sigma**2, float(kernel[half])

    reference, own = residuals(SHORTEST)  # on the same rows: what is noise there is here
    least, rising, window = (math.inf, SHORTEST), 0, SHORTEST
    while window <= 1001 and rising < 2:
        whole = log.whole(window)
        if SIDE_BY_SIDE * np.count_nonzero(whole) < (SIDE_BY_SIDE - 1) * len(values):
            break
        square, weight = residuals(window)
        trim = (len(reference) - len(square)) // 2
        excess = square - reference[trim : len(reference) - trim]
        risk = float(np.mean(excess[whole])) + 2.0 * (weight - own)
        rising = 0 if risk < least[0] else rising + 1
        least = min(least, (risk, window))
        window = max(window + 2, 2 * round(window * 1.25 / 2) + 1)
    return least[1]


def smooth(log: LogPieces, judged_rows: int = 20_000) -> Rates:
    """Smooth a log on even steps by the windows of least risk, where whole windows are there.

    judged_rows: samples, from the middle of the flight, that choose the windows.

    Returns the times (q,) [s], the states x, y, vx, vy (q, 4) [m, m/s], their rates (q, 4)
    [m/s, m/s^2] and the filter. A velocity that was not measured is the slope of the position.
    """
    origin = log.state[:, :2].mean(axis=0)  # positions from their mean keep their digits
    channels = [log.state[:, :2] - origin, log.state[:, 2:]][: 1 + log.velocity_measured]
    levels = [noise_level(values, log) for values in channels]
    first = max(0, (len(log.time) - judged_rows) // 2)
    rows = slice(first, first + judged_rows)
    starts = log.starts[(log.starts > rows.start) & (log.starts < rows.stop)] - first
    judged = replace(log, time=log.time[rows], state=log.state[rows], starts=starts)
    pairs = zip(channels, levels, strict=True)
    windows = [least_risk(values[rows], level, judged) for values, level in pairs]
    widest = max(windows)
    # v' may be noisy, as regression averages it, but what a window takes from it is missing from
    # U0: its window is shorter. 1 costs twice the mean error of tau_w at .5 m/s, .35 to .6 agree.
    shorter = [max(SHORTEST, 2 * int(0.6 * n / 2) + 1) for n in windows]

    def read(channel: int, window: int, derivative: int) -> Array:
        kernel, trim = polynomial_kernels(window, ORDER, log.step)[derivative], widest - window
        return filtered(channels[channel], kernel)[trim // 2 :][: len(log.time) - widest + 1]

    # The last channel gives velocity and acceleration: by one derivative more of a position.
    more = 1 - log.velocity_measured
    position, rate = read(0, windows[0], 0) + origin, read(0, shorter[0], 1)
    velocity, acceleration = read(-1, windows[-1], more), read(-1, shorter[-1], more + 1)
    whole = log.whole(widest)
    states, rates = np.hstack([position, velocity])[whole], np.hstack([rate, acceleration])[whole]
    level = levels[1] if log.velocity_measured else 0.0
    own = Smoothing("auto", "", widest, shorter[-1], ORDER, levels[0], level)
    return log.time[widest // 2 :][: len(whole)][whole], states, rates, own
