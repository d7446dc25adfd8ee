"""How sure a fit is of rows that are not plain samples of Phi: weak, an unknown vehicle, or both.

And of several scales at once. Values are those of the fit; what bias is known to first order
(`left_in`) is left in them, and counts as a standard error in full.
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.derivative.filters import Filters
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.nuisance import VehicleEstimate
from sparsefit.modes.joint import fit_at
from sparsefit.modes.refine import centred
from sparsefit.modes.rows import Rows
from sparsefit.uncertainty import carried, left_in
from sparsefit.uncertainty.assess import EXACT, Assessment
from sparsefit.uncertainty.model import LAGS
from sparsefit.uncertainty.record import Uncertainty
from sparsefit.uncertainty.superposed import Superposed
from sparsefit.uncertainty.vehicle import VehicleUncertainty

QUADRATURE = 2.0  # of what residuals could add up to: most of a test function's error is fitted


def assess_rows(samples: Samples, rows: Rows, wavenumber: float) -> Assessment | None:
    """Assess the fit of `Rows` where it is best in k [1/m]; None where it cannot be.

    That is below 21 samples or too few rows, or where the vehicle that fits best is impossible.
    The rows are taken anew for the vehicle found: the coefficient of v is 0 for it, and noise of v
    in that column no error to first order.
    """
    vehicle = rows.vehicle(math.pi / wavenumber)
    if not vehicle.possible:
        return None
    tau = vehicle.response_time
    believed = PointMassVehicle(tau, vehicle.thrust_acceleration)
    own = Rows.of(samples, believed, vehicle.unknown)
    if own is None:
        return None
    weights, loose = own.solved(wavenumber)
    k = np.array([wavenumber])
    model = Superposed(own.position, k, weights[None], own.columns, own.operator)
    parts = _parts(vehicle)
    speed, scale, timescale = values = model.values[0].tolist()
    gradients = _gradients(model, vehicle)
    rest = own.target - model.averaged(model.flow) - (own.columns @ loose).T
    wind = np.array(vehicle.wind)
    plain = model
    if samples.weak is not None:
        free = np.zeros((2, len(samples.time), 0))
        if vehicle.unknown:
            free = own.nuisance.columns(samples.velocity)
        plain = Superposed(centred(samples.position), k, weights[None], free)
    at_samples = samples.flow_velocity(believed) - plain.flow - wind
    found = spreads(model, plain, samples, tau, gradients, rest, at_samples)
    if found is None:
        return None
    if not model.whole:
        found[[0, 2]] = math.inf
    ends = np.cumsum([3, *(len(one) for one in parts.values())]).tolist()
    by_name = {
        name: tuple(found[first : first + len(own)].tolist())
        for (name, own), first in zip(parts.items(), ends, strict=False)
    }
    return Assessment(
        speed,
        scale,
        timescale,
        Uncertainty.around(values, found[:3].tolist()),
        vehicle if parts else None,
        VehicleUncertainty.around(parts, by_name) if parts else None,
    )


def assess_scales(
    samples: Samples, flow_velocity: Array, wavenumbers: Array, response_time: float
) -> tuple[Uncertainty | None, ...]:
    """Of every scale of a joint fit of Phi (m, 2) where it is best in k (s,) [1/m].

    None where the samples are too few; response_time tau [s].
    """
    points, s = centred(samples.position), len(wavenumbers)
    fit = fit_at(points, flow_velocity, wavenumbers)
    none = np.zeros((2, len(points), 0))
    model = Superposed(points, np.asarray(wavenumbers, dtype=float), fit.weights, none)
    rest = fit.rest
    found = spreads(model, model, samples, response_time, model.gradients, rest, rest)
    if found is None:
        return (None,) * s
    each = found.reshape(s, 3)
    if not model.whole:
        each[:, [0, 2]] = math.inf
    return tuple(
        Uncertainty.around(own.tolist(), error.tolist())
        for own, error in zip(model.values, each, strict=True)
    )


def spreads(
    model: Superposed,
    plain: Superposed,
    samples: Samples,
    response_time: float,
    gradients: Array,
    errors: Array,
    at_samples: Array,
) -> Array | None:
    """Standard errors (f,) of functions of theta, gradients (f, n); None with too few rows.

    plain: the model of the samples; errors (q, 2): residuals of the rows; at_samples (m, 2):
    those of Phi at the samples [m/s].
    """
    weak, filters = samples.weak, Filters.of(samples)
    if weak is not None and len(samples.time) != len(model.position):
        filters = None  # the states as they were measured: no filter made them
    influence, lags = model.influence(gradients), carried.overlap(samples)
    used = model.parameters / 2
    if len(samples.time) <= LAGS or len(errors) <= used:
        return None
    doubt = np.zeros(len(gradients))
    if filters is None:
        if len(errors) <= lags:
            return None
        variance = carried.lagged(influence, errors, lags, used)
    else:
        levels = carried.noise_levels(plain, filters, response_time, at_samples)
        variance = levels @ carried.powers(model, samples, filters, response_time, influence)
        kicks = float(levels[2])
        for score in left_in.scores(model, samples, filters, response_time, kicks):
            doubt = np.hypot(doubt, gradients @ model.solved(score))
    square = float(np.sum(errors**2))
    if square <= EXACT**2 * float(np.sum(model.flow**2)):  # truncation adds up coherently
        share = 0.25 if weak is None else QUADRATURE**2
        variance = variance + share * square * np.sum(influence**2, axis=(0, 1))
    return np.where(model.lost(gradients), np.inf, np.sqrt(variance + doubt**2))


def _parts(vehicle: VehicleEstimate) -> dict[str, tuple[float, ...]]:
    """What was estimated of the vehicle and the wind, by name, in the order of the coefficients."""
    every = {
        "response_time": (vehicle.response_time,),
        "thrust_acceleration": vehicle.thrust_acceleration,
        "wind": vehicle.wind,
    }
    return {name: every[name] for name in vehicle.unknown}


def _gradients(model: Superposed, vehicle: VehicleEstimate) -> Array:
    """Of U0, L and tau_w, and of what was estimated of the vehicle, in theta, where b_v = 0.

    With b_v that of v and b_c the constants, all weights are 1 - b_v of the true ones, and so is
    the wind; the response time is tau / (1 - b_v) and the thrust a + b_c / tau.
    """
    first, tau, every = 17 * model.scales, vehicle.response_time, model.parameters
    found = [*model.gradients]
    shared = "response_time" in vehicle.unknown
    if shared:
        speed, _, timescale = model.values[0].tolist()
        found[0][first], found[2][first] = speed, -timescale
        row = np.zeros(every)
        row[first] = tau
        found.append(row)
    for name, step in (("thrust_acceleration", 1 / tau), ("wind", 1.0)):
        if name in vehicle.unknown:
            for axis in range(2):
                row = np.zeros(every)
                row[first + shared + axis] = step
                if shared and name == "wind":
                    row[first] = vehicle.wind[axis]
                found.append(row)
    return np.stack(found)
