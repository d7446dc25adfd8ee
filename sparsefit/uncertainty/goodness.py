"""How well a fit explains a flight: R^2, the whiteness of what is left, turbulence, and a cause.

Whiteness is Bartlett's test (1954): over the spectrum that noise of the sensors and kicks would
leave, the periodogram of what is left is flat, and its cumulative sum keeps to a straight line as
an empirical distribution does (Kolmogorov's statistic).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.library.scan import extent_of
from sparsefit.uncertainty.causes import CHANCE, SLIGHT, Cause, Suspect, suspected
from sparsefit.uncertainty.concord import Apart
from sparsefit.uncertainty.corrected import Known
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.turbulence import TRUNCATION, Turbulence

LAST = {Cause.ANOTHER_FLOW: 1, Cause.TURBULENCE: 2}  # of causes: what others may look like


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

    @property
    def exact(self) -> bool:
        """Whether the fit leaves less than a filter's truncation may be."""
        return 1 - self.r_squared <= TRUNCATION


def goodness_of(model: Model, known: Known, mean_velocity: float, length_scale: float) -> Goodness:
    """The goodness of a fit, of what it leaves; U0 [m/s] and L [m] of the fastest flow.

    Of several flights R^2 is that of all weighted rows, turbulence the root mean square over all
    samples, the whiteness the least of a flight for as many as there are, the ratio the largest;
    and a cause must be as unlikely for as many, of those that cover a period of the flow.
    """
    left = known.left
    if not left:
        return Goodness(_r_squared(model))
    if len(left) == 1:
        return _of_flight(left[0], mean_velocity)
    each = [_of_flight(one, mean_velocity, len(left)) for one in left]
    samples = [len(one.observed.errors) for one in left]
    squares = [one.turbulence**2 for one in each]
    turbulence = math.sqrt(float(np.average(squares, weights=samples)))
    covers = [extent_of(one.observed.fit.samples.position) >= 2 * length_scale for one in left]
    found = [one.suspect if whole else None for one, whole in zip(each, covers, strict=True)]
    suspects = [(suspect, number) for number, suspect in enumerate(found, 1) if suspect]
    suspects += _others(known.apart)
    suspects.sort(key=lambda pair: (LAST.get(pair[0].cause, 0), pair[0].p_value))
    suspect, flight = suspects[0] if suspects else (None, 0)
    return Goodness(
        _r_squared(model),
        1 - (1 - min(one.whiteness for one in each)) ** len(each),
        max(one.likelihood_ratio for one in each),
        turbulence,
        turbulence / mean_velocity,
        suspect,
        flight,
        tuple(each),
    )


def _others(apart: Sequence[Apart]) -> list[tuple[Suspect, int]]:
    """The flights, by their number, that tell a flow of their own.

    It has to take more than it takes of white noise: the level of slow noise may be found too low.
    """
    found = []
    for number, one in enumerate(apart, 1):
        chance = min(1.0, len(apart) * one.p_value)
        if one.share > SLIGHT and one.taken > one.by_chance and chance < CHANCE:
            found.append((Suspect(Cause.ANOTHER_FLOW, (one.share,), chance, one.taken), number))
    return found


def _of_flight(left: Turbulence, mean_velocity: float, flights: int = 1) -> Goodness:
    return Goodness(
        1 - left.observed.unexplained,
        whiteness(left),
        left.ratio,
        left.speed,
        left.speed / mean_velocity,
        suspected(left, mean_velocity, flights),
    )


def _r_squared(model: Model) -> float:
    """The share of the variance of all rows that a model explains, each flight about its mean."""
    rows, spread = model.rows, 0.0
    for weight, own in zip(rows.weights, rows.flights, strict=True):
        spread += weight**2 * float(np.sum((own.target - own.target.mean(axis=0)) ** 2))
    return 1 - float(np.sum(model.residual**2)) / spread if spread else math.nan


def whiteness(left: Turbulence) -> float:
    """The p-value of Bartlett's test of what is left, against noise of the sensors and kicks."""
    from scipy.special import kolmogorov

    observed = left.observed
    spectrum = observed.amounts @ observed.remaining
    flat = (observed.seen / spectrum)[observed.passed]
    line = np.arange(1, len(flat) + 1) / len(flat)
    away = float(np.abs(np.cumsum(flat) / flat.sum() - line).max())
    return float(kolmogorov(away * math.sqrt(left.weight * len(flat))))
