"""One assessment of one refined scale: U0, L and tau_w less their bias, and how sure they are."""

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.derivative.filters import Filters
from sparsefit.library.nuisance import VehicleEstimate
from sparsefit.modes.refine import centred, project
from sparsefit.uncertainty import bias, noise
from sparsefit.uncertainty.model import LAGS, Fitted, uncertainty
from sparsefit.uncertainty.record import Uncertainty
from sparsefit.uncertainty.vehicle import VehicleUncertainty

PASSES = 2  # of the truncation: the flow it is computed from moves by it
# Of a correction, what counts as a standard error: terms of second order are left out.
DOUBT_OF_TRUNCATION, DOUBT_OF_NOISE = 0.2, 0.5
REACH = 1.0  # standard errors that noisy positions may move a value: beyond, it is ill determined
SHARE = 0.2  # of a value that truncation may move it: beyond it first order is no guide
EXACT = 1e-6  # residuals below this, relative: no noise but truncation, which adds up coherently


@dataclass(frozen=True)
class Assessment:
    """U0 [m/s], L [m] and tau_w [s], corrected where asked, and their uncertainty.

    vehicle: the one found, with its uncertainty, where something of it was unknown.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    uncertainty: Uncertainty
    vehicle: VehicleEstimate | None = None
    vehicle_uncertainty: VehicleUncertainty | None = None

    @property
    def wide(self) -> str:
        """Which value is known only to more than WIDE, in words; empty if none is."""
        return self.uncertainty.wide(self.values)

    @property
    def values(self) -> tuple[float, float, float]:
        """U0, L and tau_w."""
        return self.mean_velocity, self.length_scale, self.timescale


def assess(
    samples: Samples,
    flow_velocity: Array,
    wavenumber: float,
    response_time: float,
    *,
    correct: bool = True,
) -> Assessment | None:
    """Assess the 8-column fit of Phi (m, 2) where it is best in k [1/m]; None below 21 samples.

    The variance is that of the noise carried through the filters (`noise`), plus what is doubtful
    of each correction (`bias`), squared; of truncation that is left in, all of it. Where the
    residuals are no noise at all, the truncation that is left has one sign over many samples: half
    of what it could add up to is added.
    """
    if len(flow_velocity) <= LAGS:
        return None
    points = centred(samples.position)
    weights = project(points, flow_velocity, wavenumber).weights
    fitted, filters = Fitted(points, wavenumber, weights), Filters.of(samples)
    if filters is None:
        known = uncertainty(points, flow_velocity, np.pi / wavenumber)
        return _assessment(fitted.values, known)
    moved = fitted
    for _ in range(PASSES):
        base = moved
        lost, share = bias.truncation(base, samples.velocity, filters)
        moved = fitted.moved(-share * fitted.score(lost))
    limit = SHARE * np.abs(fitted.values)
    correction = np.clip(moved.values - fitted.values, -limit, limit)
    errors = flow_velocity - lost - base.flow
    variance = noise.variance(fitted, filters, response_time, errors)
    square = float(np.sum(errors**2))
    if square <= EXACT**2 * float(np.sum(fitted.flow**2)):
        variance = variance + 0.25 * square * np.sum(fitted.influence**2, axis=(0, 1))
    spread = np.sqrt(variance)
    doubt = (DOUBT_OF_TRUNCATION if correct else 1.0) * correction
    if np.isfinite(filters.sigma_position) and np.isfinite(filters.sigma_velocity):
        score = bias.noisy_positions(fitted, filters, response_time)
        step = fitted.moved(-score).values - fitted.values
        doubt = np.hypot(doubt, DOUBT_OF_NOISE * step)
        correction = correction + np.clip(step, -REACH * spread, REACH * spread)
    values = fitted.values + correct * correction
    if correct:  # tau_w is L / U0, whatever was cut
        values[2] = values[1] / values[0]
    spread = np.where(fitted.inverse[1], np.inf, np.hypot(spread, doubt))
    return _assessment(values, Uncertainty.around(values.tolist(), spread.tolist()))


def _assessment(values: Array, known: Uncertainty) -> Assessment:
    speed, scale, timescale = values.tolist()
    return Assessment(speed, scale, timescale, known)
