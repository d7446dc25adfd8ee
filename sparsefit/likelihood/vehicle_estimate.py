"""What was estimated of a vehicle and of the air around it, beside the flow."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.likelihood.causes import FREEDOMS
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
    logged = {"thrust_acceleration": believed.thrust_acceleration} if steady else {}
    shares = {"drag": 1.0 / elements["response_time"]}
    values, errors = dict[str, Any](), dict[str, Any]()
    absent: dict[str, Any] = {}  # of what was known there is an entry, without a value
    for name in (item.name for item in fields(VehicleEstimate) if item.name in FREEDOMS):
        own, share = FREEDOMS[name].elements, shares.get(name, 1.0)
        absent |= {name: None, f"{name}_interval{'s' * (len(own) > 1)}": None}
        if own[0] in posterior.models[0].names:
            base = logged.get(name, (0.0,) * len(own))
            value = tuple(b + share * elements[e] for b, e in zip(base, own, strict=True))
            error = tuple(share * posterior.error(e + suffix) for e in own)
            values[name], errors[name] = (value, error) if len(own) > 1 else (value[0], error[0])
    if not values:
        return values
    return values | {"vehicle_uncertainty": Uncertainty(absent | Uncertainty.of(values, errors))}
