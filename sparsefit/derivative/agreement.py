"""Whether the logged position is the integral of the logged velocity, or wanders away from it.

What a step of the position leaves of the integral of the velocity is, for white noise of both,

    d_i = x_{i+1} - x_i - int v dt,    spectrum  E(w) = dt^2 sigma_v^2 + 4 sigma_x^2 sin^2(w/2),

flat at low frequencies. A position whose error is correlated (a first-order autoregression of rms s
and time T, as of a satellite receiver) adds s^2 (1 - r^2) 4 sin^2(w/2) / |1 - r e^{-iw}|^2,
r = exp(-dt/T); s and T are those of the largest likelihood (Whittle, 1953). A velocity in another
unit, other axes or late adds a share of the motion itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array

FEWEST, BAND = 8, 0.125  # frequencies at least, and of all of them at most
FELT, BROKEN = 1e-3, 0.2  # of the motion
ENDS = 20  # samples
TIMES = 12  # correlation times that are tried, from ten steps to the flight
LEVELS = np.geomspace(1e-3, 1e3, 61)  # of the variance that the excess itself suggests


@dataclass(frozen=True)
class Agreement:
    """How far position and velocity come apart at low frequencies, beyond their white noise.

    Args:
        excess: power of what is left, over that of white noise: near 1 where they agree.
        frequencies: that this is a mean over, twice as many pairs of normals.
        apart: rms of what is left, less the noise, over that of the motion, at those frequencies.
        wander: rms of a correlated error of the position that explains it [m].
        wander_time: its correlation time [s].
        expected: rms [m] and time [s] with the mean power, over Whittle's likelihood (flat in the
            logarithms of both), at either end of the spectrum. A flight of a few T tells s^2/T, as
            at high frequencies, but hardly s^2 T, as at low ones: intervals rest on this.
    """

    excess: float
    frequencies: int
    apart: float
    wander: float = 0.0
    wander_time: float = math.nan
    expected: tuple[float, float] = (0.0, math.nan)

    @property
    def sure(self) -> bool:
        """Whether white noise leaves so much in less than one of 1e6 flights.

        Of 4 n degrees of freedom, by the cube-root rule (Wilson and Hilferty, 1931).
        """
        spread = 2.0 / (9.0 * 4 * self.frequencies)
        return bool((self.excess ** (1 / 3) - (1 - spread)) / math.sqrt(spread) > 4.75)

    @property
    def wanders(self) -> bool:
        """Whether there is more between them than noise, and than an integral over steps errs."""
        return self.sure and self.apart > FELT

    @property
    def broken(self) -> bool:
        """Whether the velocity is not that of the position at all."""
        return self.sure and self.apart > BROKEN


def agreement_of(
    left: Array, moved: Array, step: float, sigma_position: float, sigma_velocity: float
) -> Agreement | None:
    """Compare position and velocity of one piece on even steps; None where it is too short.

    Args:
        left: what the integral of the velocity leaves of each step of the position [m], (m, 2).
        moved: that integral [m], (m, 2).
        step: [s].
        sigma_position, sigma_velocity: of the white noise [m], [m/s].
    """
    if len(left) < 4 * ENDS:
        return None
    left, count = _with_even_ends(left), len(left)
    low = (step * sigma_velocity / max(2.0 * sigma_position, 1e-300)) * count / (2 * math.pi)
    used = int(max(FEWEST, min(low, BAND * count)))
    if used >= count // 2:
        return None
    angle = 2.0 * math.pi * np.arange(1, used + 1) / count
    bent = 4.0 * np.sin(angle / 2.0) ** 2
    white = (step * sigma_velocity) ** 2 + sigma_position**2 * (bent + 2.0 / (ENDS * count))
    seen, motion = (_power(values)[1 : used + 1] for values in (left, moved))
    excess = float(np.mean(seen / white))
    extra = max(float(np.sum(seen - white)), 0.0)
    apart = math.sqrt(extra / max(float(np.sum(motion)), 1e-300))
    agreement = Agreement(excess, used, apart)
    if not agreement.sure:
        return agreement
    return Agreement(excess, used, apart, *_wander(seen, white, angle, bent, step))


def _with_even_ends(left: Array) -> Array:
    """The same steps between the mean places at either end: one noisy end is in all frequencies."""
    apart = np.cumsum(left, axis=0)
    apart[:ENDS], apart[-ENDS:] = apart[:ENDS].mean(axis=0), apart[-ENDS:].mean(axis=0)
    return np.diff(apart, axis=0, prepend=apart[:1])


def _power(values: Array) -> Array:
    """Mean periodogram (f,) of the two columns."""
    transformed = np.fft.rfft(values, axis=0)
    power: Array = np.mean(np.abs(transformed) ** 2, axis=1) / len(values)
    return power


def _wander(
    seen: Array, white: Array, angle: Array, bent: Array, step: float
) -> tuple[float, float, tuple[float, float]]:
    """s [m] and T [s] of the largest Whittle likelihood, and the same of the mean power."""
    times = np.geomspace(10.0, 2.0 * math.pi / angle[0], TIMES)
    r = np.exp(-1.0 / times)[:, None]
    shape = (1 - r**2) * bent / (1 - 2 * r * np.cos(angle) + r**2)
    guess = np.mean(np.maximum(seen - white, 0.0) / shape, axis=1)
    variance = guess[:, None] * LEVELS
    total = white + variance[:, :, None] * shape[:, None]
    cost = np.sum(np.log(total) + seen / total, axis=2)
    time, level = np.unravel_index(int(np.argmin(cost)), cost.shape)
    likely = np.exp(-2.0 * (cost - cost.min()))  # of two components
    likely /= likely.sum()
    low = float(np.sum(likely * variance * times[:, None]))
    high = float(np.sum(likely * variance / times[:, None]))
    expected = (low * high) ** 0.25, math.sqrt(low / high) * step
    return math.sqrt(float(variance[time, level])), float(times[time] * step), expected
