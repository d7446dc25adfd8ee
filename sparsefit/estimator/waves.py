"""What the weights of a wave library say: the flow as a sum of waves, and its cells.

On the grid the flow is the sum of all waves in use, and the peaks of their strength, refitted by
least squares, give U0; off it the waves of the peaks that the flight bears out give both. Length
scale and heading are those of the cells that the two strongest waves make.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from sparsefit.arrays import Array
from sparsefit.estimator.doubt import Doubt, Verdict
from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight.flow import SuperposedFlow
from sparsefit.flight.waves import WaveFlow
from sparsefit.library.nuisance import Nuisance, VehicleEstimate
from sparsefit.library.scan import extent_of
from sparsefit.library.waves import WAVE, Waves
from sparsefit.modes.fitted_rows import Rows, middle
from sparsefit.modes.projection import Projection, project
from sparsefit.modes.readout import Readout
from sparsefit.modes.wave_peaks import (
    at_origin,
    heading_of_pair,
    length_scale_of_pair,
    strengths,
    wave_peaks,
)
from sparsefit.modes.wave_search import refined
from sparsefit.regression.backend import settings_of
from sparsefit.regression.fit import Fit

MOST = 12  # waves that are read off the grid: six flows of square cells


@dataclass(frozen=True, eq=False)
class WaveReading:
    """What the waves of a flight say.

    Args:
        verdict: of the fit, or the doubt against it.
        mean_velocity: U0 = sqrt(2 <|w|^2>) [m/s].
        length_scale: sqrt(2) pi / sqrt(mean |k|^2) [m] of the two strongest waves.
        heading: of the cells that these two make [rad], NaN of one wave.
        flow: the sum of all waves.
        vehicle: what was unknown of it.
    """

    verdict: Verdict
    mean_velocity: float = math.nan
    length_scale: float = math.nan
    heading: float = math.nan
    flow: WaveFlow | SuperposedFlow | None = None
    vehicle: VehicleEstimate | None = None


def estimate_of_waves(prepared: Prepared, fit: Fit, readout: Readout) -> Estimate:
    """The estimate of a fit whose columns are waves of a stream function."""
    start = perf_counter()
    reading, by_scale = WaveReading(Verdict(fit.status, fit.reason)), {}
    if np.isfinite(fit.weights).all():
        by_scale = _by_scale(fit)
        reading = _read(prepared, fit, readout)
    vehicle, verdict = reading.vehicle, reading.verdict
    speed, scale = reading.mean_velocity, reading.length_scale
    unknown = {name: getattr(vehicle, name) for name in vehicle.unknown} if vehicle else {}
    return Estimate(
        speed,
        scale,
        scale / speed if speed > 0 else math.nan,
        verdict.status,
        verdict.reason,
        fit.backend.name,
        settings_of(fit.backend),
        fit.certificate,
        max(by_scale, key=lambda ring: by_scale[ring], default=math.nan),
        by_scale,
        prepared.seconds + fit.seconds + perf_counter() - start,
        len(prepared.target),
        fit.problem.columns,
        doubt=verdict.doubt,
        heading=reading.heading,
        flow=reading.flow,
        repairs=prepared.samples.repairs,
        agreement=prepared.samples.agreement,
        **unknown,
    )


def _waves_of(fit: Fit) -> tuple[Array, Array]:
    """The wavevectors (w, 2) [1/m] of the columns and their weights a, b (w, 2) [m^2/s]."""
    assert fit.problem.parameters is not None
    return fit.problem.parameters, fit.weights.reshape(-1, 2)


def _by_scale(fit: Fit) -> dict[float, float]:
    """The norm of the strengths [m/s] of the waves of each length scale [m]."""
    k, weights = _waves_of(fit)
    scales = np.round(math.sqrt(2.0) * math.pi / np.linalg.norm(k, axis=1), 9)
    rings, ring = np.unique(scales, return_inverse=True)
    squares = np.bincount(ring, strengths(k, weights) ** 2, len(rings))
    return dict(zip(rings.tolist(), np.sqrt(squares).tolist(), strict=True))


def _read(prepared: Prepared, fit: Fit, readout: Readout) -> WaveReading:
    k, weights = _waves_of(fit)
    if not weights.any():
        words = "no wave: all weights are zero"
        return WaveReading(Verdict.against(Doubt.NO_WEIGHTS, words))
    extent = extent_of(prepared.samples.position)
    peaks = wave_peaks(k, weights, extent, MOST)
    if readout.refine == "none":
        found = project(Waves(WAVE), prepared.rows, k[peaks.top])
        used = weights.any(axis=1)
        return _reading(prepared, fit, found, (k[used], weights[used]))
    key = ("waves", tuple(peaks.wavevectors.ravel().tolist()))
    found = prepared.once(key, lambda: _refined(prepared, peaks.wavevectors))
    if not len(found.parameters):
        words = "no flow detected: the flight bears out none of the waves that were proposed"
        return WaveReading(Verdict.against(Doubt.NO_FLOW, words))
    return _reading(prepared, fit, found)


def _refined(prepared: Prepared, peaks: Array) -> Projection:
    """The waves off the grid, searched with samples half an errors' correlation apart."""
    space, rows = prepared.space, prepared.rows
    step = max(1, int(0.5 * space.correlation)) if rows.operator is None else 1
    thin = rows
    if step > 1:
        thin = Rows(rows.position[::step], rows.target[::step], rows.nuisance[:, ::step])
    worth = 2 * len(rows.target) / space.correlation
    return refined(rows, thin, peaks, worth)


def _reading(
    prepared: Prepared, fit: Fit, found: Projection, grid: tuple[Array, Array] | None = None
) -> WaveReading:
    """The reading of waves that were fitted; the flow is theirs, or that of the grid's (k, W)."""
    nuisance = Nuisance(prepared.library.unknown, prepared.vehicle)
    vehicle = nuisance.read(found.coefficients) if nuisance.unknown else None
    if vehicle is not None and not vehicle.possible:
        words = f"the response time that fits best is {vehicle.response_time:.3g} s"
        reason = f"{words}; fly longer, or give the response time"
        return WaveReading(Verdict.against(Doubt.VEHICLE, reason), vehicle=vehicle)
    ratio = nuisance.ratio(found.coefficients)
    k, weights = found.parameters, found.weights[:, :, 0] / ratio
    order = np.argsort(-strengths(k, weights), kind="stable")
    pair = k[order[:2]]
    if grid is None:
        flow = WaveFlow(
            k,
            *at_origin(k, weights, middle((prepared.samples.weak or prepared.samples).position)).T,
        )
    else:
        flow = WaveFlow(grid[0], *grid[1].T / ratio)
    return WaveReading(
        Verdict(fit.status, fit.reason),
        float(np.linalg.norm(strengths(k, weights))),
        length_scale_of_pair(pair),
        heading_of_pair(pair) if len(pair) > 1 else math.nan,
        SuperposedFlow((flow,), vehicle.wind) if vehicle and any(vehicle.wind) else flow,
        vehicle,
    )
