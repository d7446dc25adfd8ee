"""What was estimated of a vehicle and of the air around it, beside the flow."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.likelihood.goodness import Uncertainty

if TYPE_CHECKING:
    from sparsefit.flight.vehicle import PointMassVehicle
    from sparsefit.likelihood.posterior import Posterior

Pair = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class VehicleEstimate:
    """The quantities of a vehicle that were unknown; NaN and None for those that were not.

    Args:
        response_time: [s].
        drag: the coefficient of quadratic drag [1/m].
        thrust_scale: of the measured acceleration.
        thrust_acceleration: [m/s^2], (x, y).
        wind: [m/s], (x, y).
        vehicle_uncertainty: of those that were estimated.
    """

    response_time: float = math.nan
    drag: float = math.nan
    thrust_scale: float = math.nan
    thrust_acceleration: Pair | None = None
    wind: Pair | None = None
    vehicle_uncertainty: Uncertainty | None = None


def vehicle_of(posterior: Posterior, believed: PointMassVehicle, flight: int = 0) -> dict[str, Any]:
    """The fields of `VehicleEstimate` that are free in a posterior.

    Args:
        posterior: of one flight or several.
        believed: the vehicle of the flight.
        flight: its place among the flights.
    """
    elements, suffix = posterior.models[flight].values, f"@{flight + 1}" if flight else ""
    steady = not np.ptp(posterior.legs[flight].nodes.push, axis=0).any()
    push = believed.thrust_acceleration if steady else (0.0, 0.0)  # it is in the log: see b
    pairs = {"thrust_acceleration": ("thrust_bias", push), "wind": ("wind", (0.0, 0.0))}
    values: dict[str, Any] = {}
    errors: dict[str, Any] = {}
    for name, own, factor in (
        ("response_time", "response_time", 1.0),
        ("thrust_scale", "thrust_scale", 1.0),
        ("drag", "quadratic_drag", 1.0 / elements["response_time"]),
    ):
        if own in posterior.models[0].names:
            values[name] = factor * elements[own]
            errors[name] = factor * posterior.error(own + suffix)
    for name, (stem, base) in pairs.items():
        x, y = f"{stem}_x", f"{stem}_y"
        if x in posterior.models[0].names:
            values[name] = (base[0] + elements[x], base[1] + elements[y])
            errors[name] = posterior.error(x + suffix), posterior.error(y + suffix)
    if not values:
        return values
    absent: dict[str, Any] = {}  # of what was known there is an entry, without a value
    for name in ("response_time", "drag", "thrust_scale", *pairs):
        absent |= {name: None, f"{name}_interval{'s' * (name in pairs)}": None}
    return values | {"vehicle_uncertainty": Uncertainty(absent | Uncertainty.of(values, errors))}
