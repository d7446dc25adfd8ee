"""What an estimate from several flights says of each of them."""

from __future__ import annotations

from typing import Any

from sparsefit.estimator.assess import Reading
from sparsefit.estimator.estimate import FlightEstimate
from sparsefit.estimator.prepare import Prepared


def told_of(prepared: Prepared, reading: Reading) -> tuple[FlightEstimate, ...]:
    """What is of each flight; nothing where there is one alone."""
    parts = prepared.parts
    if len(parts) == 1:
        return ()
    goodness = reading.goodness.flights if reading.goodness else ()
    vehicles: list[dict[str, Any]] = [{} for _ in parts]
    for told, (vehicle, sure) in zip(vehicles, reading.vehicles, strict=False):
        told.update({name: getattr(vehicle, name) for name in vehicle.unknown})
        told["vehicle_uncertainty"] = sure
    return tuple(
        FlightEstimate(
            len(part.samples.time),
            1 / part.weight,
            goodness=goodness[place] if goodness else None,
            repairs=part.samples.repairs,
            agreement=part.samples.agreement,
            **vehicles[place],
        )
        for place, part in enumerate(parts)
    )
