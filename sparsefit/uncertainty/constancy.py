"""Whether U0 kept its value while it was flown through: the rate at which it changes.

With w the fitted flow and t the time, a flow that grows by the share c in a second leaves, to first
order, c z of the flow velocity, z = t w. Beside all that was fitted, of any flights,

    c = z'W (I - P) e / z'W (I - P) z,    P the projection onto what was fitted, W the weights,

is the estimate of least squares, and its rate dU0/dt = c U0. Its variance is that of any other
function of the errors (`corrected`): noise through the filters, and turbulence where it is found.
Terms of second order, (c T/2)^2 of c over a time T, are left out, and count as a standard error.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.influence import Influence
from sparsefit.uncertainty.information import Information
from sparsefit.uncertainty.record import interval
from sparsefit.uncertainty.turbulence import Turbulence

FREED = 1e-6  # of z, less of it is left: the fit has it already


@dataclass(frozen=True)
class Constancy:
    """How fast the mean velocity changes, to first order; of several flows the fastest's.

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
    def of(cls, share: Share, mean_velocity: float) -> Constancy:
        """From the share [1/s] by which the flow changes, and U0 [m/s]."""
        rate, error = share.value * mean_velocity, share.error * mean_velocity
        ends = interval(rate, error, share.freedom)
        return cls(rate, error, ends, _chance(share.value / share.error, share.freedom))


@dataclass(frozen=True)
class Share:
    """The share of the flow by which it changes [1/s], its standard error, degrees of freedom."""

    value: float
    error: float
    freedom: float = math.inf


@dataclass(frozen=True, eq=False)
class Growth:
    """The column z of a flow that grows, of several flights, and what a fit leaves of it.

    Args:
        freed: (I - P) z of each flight, (2, m).
        square: z'W (I - P) z of all of them.
        half: half the time from the first sample to the last [s].
    """

    freed: tuple[Array, ...]
    square: float
    half: float

    @classmethod
    def of(cls, fits: Sequence[Filtered]) -> Growth | None:
        """The column of fits of flights on one clock; None where the fit has it already."""
        times = [fit.samples.time for fit in fits]
        first, last = float(min(map(np.min, times))), float(max(map(np.max, times)))
        middle, half = 0.5 * (first + last), 0.5 * (last - first)
        columns = [
            (time - middle) * fit.plain.flow.T for time, fit in zip(times, fits, strict=True)
        ]
        gram = np.sum([fit.weight**2 * fit.plain.jacobian.gram for fit in fits], axis=0)
        score = np.sum(
            [
                fit.weight**2 * fit.plain.jacobian.score(column.T)
                for fit, column in zip(fits, columns, strict=True)
            ],
            axis=0,
        )
        taken = Information.of(gram, fits[0].plain.tangent).solved(score)[:, None]
        freed = [
            column - fit.plain.jacobian.times(taken)[0]
            for fit, column in zip(fits, columns, strict=True)
        ]
        whole, left = (
            sum(fit.weight**2 * float(np.sum(one**2)) for fit, one in zip(fits, some, strict=True))
            for some in (columns, freed)
        )
        return cls(tuple(freed), left, half) if left > FREED**2 * whole else None

    def share(self, errors: Sequence[Array], fits: Sequence[Filtered]) -> float:
        """c [1/s], from what the fit of all flights leaves of each (m, 2) [m/s]."""
        pairs = zip(self.freed, errors, fits, strict=True)
        products = [fit.weight**2 * float(np.sum(own * rest.T)) for own, rest, fit in pairs]
        return sum(products) / self.square

    def doubt(self, share: float) -> float:
        """The terms of second order of a share [1/s]."""
        return share * (share * self.half) ** 2

    def without(self, place: int, left: Turbulence, share: float) -> Turbulence:
        """What is left of one flight, by its place, without a share [1/s] of growth."""
        observed = left.observed
        own = observed.fit.plain.freed(self.freed[place][None])[0]
        return Turbulence(replace(observed, errors=observed.errors - share * own.T))

    def influence(self, place: int, left: Turbulence) -> Influence:
        """How errors of the samples of one flight, by its place, move c."""
        fit, passage = left.observed.fit, left.observed.passage
        rows = (fit.weight**2 / self.square) * self.freed[place][None]
        samples = replace(fit.samples, weak=None)
        plain = replace(fit, samples=samples, model=fit.plain)
        return Influence(plain, passage, rows, np.fft.rfft(rows, passage.size))


def _chance(ratio: float, freedom: float) -> float:
    """The two-sided p-value of a ratio to its standard error (Student's t, or normal)."""
    from scipy.special import ndtr, stdtr

    away = -abs(ratio)
    return 2 * float(ndtr(away) if math.isinf(freedom) else stdtr(freedom, away))
