"""How well a fit explains a flight: R^2, the whiteness of what is left, turbulence, and a cause.

Whiteness is Bartlett's test (1954): over the spectrum that noise of the sensors and kicks would
leave, the periodogram of what is left is flat, and its cumulative sum keeps to a straight line as
an empirical distribution does (Kolmogorov's statistic).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.uncertainty.causes import Suspect, suspected
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.turbulence import TRUNCATION, Turbulence


@dataclass(frozen=True)
class Goodness:
    """How well a fit explains what a flight says of the flow; NaN where no filters are known.

    Args:
        r_squared: the share of the variance of the flow velocity that the fit explains.
        whiteness: the probability that noise of the sensors and kicks alone leaves as much
            structure in time: below 0.01 there is more than those.
        likelihood_ratio: 2 ln(likelihood ratio) of such noise with turbulence against without.
        turbulence: the turbulence along the path, rms of a component [m/s]; 0 where noise of the
            sensors and kicks explains what is left.
        turbulence_share: the same over the mean velocity U0 of the fastest flow.
        suspect: what the flow seems to be instead, where it seems so.
    """

    r_squared: float
    whiteness: float = math.nan
    likelihood_ratio: float = math.nan
    turbulence: float = math.nan
    turbulence_share: float = math.nan
    suspect: Suspect | None = None

    @property
    def exact(self) -> bool:
        """Whether the fit leaves less than a filter's truncation may be."""
        return 1 - self.r_squared <= TRUNCATION


def goodness_of(model: Model, left: Turbulence | None, mean_velocity: float) -> Goodness:
    """The goodness of a fit, of what it leaves; mean_velocity U0 [m/s] of the fastest flow."""
    if left is None:
        target = model.rows.target
        spread = float(np.sum((target - target.mean(axis=0)) ** 2))
        return Goodness(1 - float(np.sum(model.residual**2)) / spread if spread else math.nan)
    return Goodness(
        1 - left.observed.unexplained,
        whiteness(left),
        left.ratio,
        left.speed,
        left.speed / mean_velocity,
        suspected(left, mean_velocity),
    )


def whiteness(left: Turbulence) -> float:
    """The p-value of Bartlett's test of what is left, against noise of the sensors and kicks."""
    from scipy.special import kolmogorov

    observed = left.observed
    spectrum = observed.amounts @ observed.remaining
    flat = (observed.seen / spectrum)[observed.passed]
    line = np.arange(1, len(flat) + 1) / len(flat)
    away = float(np.abs(np.cumsum(flat) / flat.sum() - line).max())
    return float(kolmogorov(away * math.sqrt(left.weight * len(flat))))
