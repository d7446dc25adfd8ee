"""Flights: the record, the vehicle, the flows, and their simulation.

The simulation is imported when it is first asked for: an estimator does not need it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sparsefit.flight.record import Flight

if TYPE_CHECKING:
    from sparsefit.flight.simulation import simulate_flight

__all__ = ["Flight", "simulate_flight"]


def __getattr__(name: str) -> Any:
    if name != "simulate_flight":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return import_module(f"{__name__}.simulation").simulate_flight
