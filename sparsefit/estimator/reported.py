"""The fields of an estimate from a flow at the maximum of its likelihood."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.estimator.estimate import FlightEstimate, RungEstimate, ScaleEstimate
from sparsefit.estimator.intervals import (
    FlowUncertainty,
    ShapeUncertainty,
    Uncertainty,
    VehicleUncertainty,
    interval,
)
from sparsefit.estimator.measure import Measured
from sparsefit.estimator.prepare import Prepared
from sparsefit.flight.flow import SuperposedFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow
from sparsefit.likelihood.goodness import Constancy
from sparsefit.likelihood.posterior import Posterior

PAIRS = {
    "thrust_acceleration": ("thrust_bias_x", "thrust_bias_y"),
    "wind": ("wind_x", "wind_y"),
}


def scales_of(measured: Measured, grid: Sequence[float]) -> tuple[ScaleEstimate, ...]:
    """The flows of cells that were measured, fastest first; grid: the candidates [m] in use."""
    flows = measured.flows
    scales = []
    for values, errors in flows:
        speed, scale, timescale, *cells = values.tolist()
        sure = Uncertainty.around((speed, scale, timescale), errors[:3].tolist())
        heading = cells[2] if len(cells) > 2 else math.nan
        candidate = min(grid, key=lambda own: abs(own - scale))
        scales.append(ScaleEstimate(speed, scale, timescale, candidate, sure, heading))
    return tuple(sorted(scales, key=lambda scale: -scale.mean_velocity))


def of_measured(
    prepared: Prepared, measured: Measured, scales: Sequence[ScaleEstimate], *, several: bool
) -> dict[str, Any]:
    """The fields of an `Estimate`, by name."""
    first, pattern, posterior = scales[0], measured.posterior.model.pattern, measured.posterior
    values, errors = max(measured.flows, key=lambda flow: float(flow[0][0]))
    waves = measured.waves
    flow = WaveFlow(waves[:, :2], waves[:, 3], waves[:, 4], waves[:, 2])
    wind = (posterior.value("wind_x"), posterior.value("wind_y"))
    parts: dict[str, Any] = {
        name: getattr(first, name)
        for name in ("mean_velocity", "length_scale", "timescale", "uncertainty")
    }
    if several:
        parts["grid_length_scale"] = first.grid_length_scale
    parts |= {
        "scales": tuple(scales) if several or len(scales) > 1 else (),
        "shape": pattern.shape,
        "flow": SuperposedFlow((flow,), wind) if any(wind) else flow,
        "flow_uncertainty": FlowUncertainty(waves, measured.covariance),
        "goodness": measured.goodness,
        "freed": measured.freed,
        "constancy": constancy_of(measured),
        "rungs": rungs_of(measured),
    }
    if measured.rival is not None:
        parts["rival_length_scale"] = measured.rival.length_scale
    if len(values) > 3:
        parts |= shape_of(values, errors, drifting=pattern.drifting)
    if len(prepared.flights) == 1:
        return parts | vehicle_of(prepared.vehicle, posterior)
    tracks = zip(prepared.parts, posterior.models, strict=True)
    noises = [model.disturbance.velocity_noise for _, model in tracks]
    mean = math.sqrt(float(np.mean(np.square(noises)))) or 1.0
    parts["flights"] = tuple(
        FlightEstimate(
            len(own.time),
            noise / mean,
            goodness=goodness,
            repairs=own.repairs,
            **vehicle_of(vehicle, posterior, flight),
        )
        for flight, (own, vehicle, noise, goodness) in enumerate(
            zip(prepared.parts, prepared.vehicles, noises, measured.goodness.flights, strict=True)
        )
    )
    return parts


def shape_of(values: Array, errors: Array, *, drifting: bool) -> dict[str, Any]:
    """The sides, heading and drift of cells, and how sure they are."""
    own, spread = values[3:].tolist(), errors[3:].tolist()
    ends = [interval(*pair) for pair in zip(own, spread, strict=True)]
    moves = ((spread[3], spread[4]), (ends[3], ends[4])) if drifting else (None, None)
    sure = ShapeUncertainty((spread[0], spread[1]), (ends[0], ends[1]), spread[2], ends[2], *moves)
    return {
        "length_scales": (own[0], own[1]),
        "heading": own[2],
        "drift": (own[3], own[4]) if drifting else (0.0, 0.0),
        "shape_uncertainty": sure,
    }


def constancy_of(measured: Measured) -> Constancy | None:
    """How fast U0 changes, from the score of its growth; where it is freed, from its estimate."""
    posterior, speed = measured.posterior, measured.posterior.model.pattern.mean_velocity
    if "growth" in posterior.names:
        return Constancy.of(posterior.value("growth"), posterior.error("growth"), speed)
    gain = measured.diagnosis.growth
    return Constancy.of(float(gain.step[0]), float(gain.error[0]), speed) if gain else None


def rungs_of(measured: Measured) -> tuple[RungEstimate, ...]:
    """The shapes that the rows bore out."""
    least = min(proposal.bic for proposal in measured.proposals)
    return tuple(
        RungEstimate(own.shape, own.drifting, own.bic - least, own.residual)
        for own in measured.proposals
    )


def vehicle_of(believed: PointMassVehicle, posterior: Posterior, flight: int = 0) -> dict[str, Any]:
    """What was estimated of a flight's vehicle and the wind, and how sure it is.

    flight: its place among the flights.
    """
    values, suffix = posterior.models[flight].values, f"@{flight + 1}" if flight else ""
    tau = values["response_time"]
    measured = bool(np.ptp(posterior.legs[flight].nodes.push, axis=0).any())
    parts: dict[str, Any] = {}
    sure: dict[str, Any] = {}
    for name, (own, factor) in {
        "response_time": ("response_time", 1.0),
        "thrust_scale": ("thrust_scale", 1.0),
        "drag": ("quadratic_drag", 1.0 / tau),
    }.items():
        if own in posterior.models[0].names:
            parts[name] = factor * values[own]
            sure[name] = factor * posterior.error(own + suffix)
            sure[f"{name}_interval"] = interval(parts[name], sure[name])
    for name, pair in PAIRS.items():
        if pair[0] not in posterior.models[0].names:
            continue
        base = (0.0, 0.0)
        if (
            name != "wind" and not measured
        ):  # the constant thrust is in the log, its error beside it
            base = believed.thrust_acceleration
        both = [values[own] + start for own, start in zip(pair, base, strict=True)]
        spread = [posterior.error(own + suffix) for own in pair]
        parts[name], sure[name] = (both[0], both[1]), (spread[0], spread[1])
        sure[f"{name}_intervals"] = tuple(map(interval, both, spread))
    return parts | ({"vehicle_uncertainty": VehicleUncertainty(**sure)} if sure else {})


def of_vehicle(
    vehicle: PointMassVehicle, wind: tuple[float, float], unknown: Sequence[str]
) -> dict[str, Any]:
    """The unknowns of a vehicle on the grid."""
    values = {name: getattr(vehicle, name) for name in unknown if name != "wind"}
    return values | ({"wind": wind} if "wind" in unknown else {})
