"""How well a model explains a log: the whiteness of its innovations, and what it calls noise.

Innovations of the right model, each over its standard deviation, are white with variance 1.
Bartlett's test (1954) holds the cumulative periodogram of each channel against a straight line: its
largest distance is that of an empirical distribution (Kolmogorov). Levels are fitted, so that the
variance is 1 whatever is wrong, and the colour tells.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.likelihood.causes import Suspect

FEWEST = 16  # innovations of a channel that are tested
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Goodness:
    """How well a model explains what a flight says of the flow; NaN where nothing is told.

    Args:
        r_squared: the share of the variance of the air's velocity along the track, within the
            band of the flow, that the flow explains; process noise and turbulence are the rest.
        whiteness: the probability that white innovations show as much structure in time: below
            0.01 there is more than noise.
        likelihood_ratio: 2 ln(likelihood ratio) of turbulence against none.
        turbulence: the turbulence along the path, rms of a component [m/s]; 0 where there is none.
        turbulence_share: the same over the mean velocity U0 of the fastest flow.
        suspect: what explains the flight beside its flow, where something does.
        flight: of several flights the number of the one that says so, from 1; else 0.
        flights: the same of each of several flights.
    """

    r_squared: float
    whiteness: float = math.nan
    likelihood_ratio: float = math.nan
    turbulence: float = math.nan
    turbulence_share: float = math.nan
    suspect: Suspect | None = None
    flight: int = 0
    flights: tuple[Goodness, ...] = ()


@dataclass(frozen=True)
class Constancy:
    """How fast the mean velocity changes, to first order; of several flows all at one rate.

    Args:
        rate: dU0/dt [m/s^2], 0 of a flow that is constant.
        standard_error: of it [m/s^2].
        interval: that holds it in 95 % of flights [m/s^2].
        p_value: how likely a constant flow shows a rate as large, of either sign.
    """

    rate: float
    standard_error: float
    interval: tuple[float, float]
    p_value: float

    @classmethod
    def of(cls, growth: float, error: float, mean_velocity: float) -> Constancy | None:
        """From the relative rate of growth [1/s], its standard error, and U0 [m/s]."""
        rate, spread = growth * mean_velocity, error * mean_velocity
        if not (math.isfinite(rate) and 0.0 < spread < math.inf):
            return None
        half = NORMAL_95 * spread
        chance = math.erfc(abs(rate / spread) / math.sqrt(2.0))
        return cls(rate, spread, (rate - half, rate + half), chance)


def whiteness(innovations: Array) -> float:
    """The p-value of Bartlett's test of standardised innovations (m, c), the least of c channels.

    Missing ones are NaN; the p-value counts the channels. NaN where too few were read.
    """
    from scipy.special import kolmogorov

    chances = []
    for channel in innovations.T:
        values = channel[np.isfinite(channel)]
        if len(values) < FEWEST:
            continue
        power = np.abs(np.fft.rfft(values - values.mean())[1 : (len(values) + 1) // 2]) ** 2
        if not power.sum() > 0.0:
            continue
        steps = np.cumsum(power) / power.sum()
        line = np.arange(1, len(power) + 1) / len(power)
        away = float(np.abs(steps - line).max())
        chances.append(float(kolmogorov(away * math.sqrt(len(power)))))
    return 1.0 - (1.0 - min(chances)) ** len(chances) if chances else math.nan


def explained(flow: float, turbulence: float, noise: float) -> float:
    """The share of the variance of the air's velocity that a flow explains.

    Args:
        flow: mean square of a component of the flow along the track [m^2/s^2].
        turbulence: of the turbulence [m^2/s^2].
        noise: of process noise within the band of the flow [m^2/s^2].
    """
    whole = flow + turbulence + noise
    return flow / whole if whole > 0.0 else math.nan
