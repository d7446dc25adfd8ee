"""Flights: the record, and the two places it comes from, a simulation or a file.

Readers and the simulation are imported when they are first asked for: an estimator needs neither.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sparsefit.flight.record import Flight

if TYPE_CHECKING:
    from sparsefit.flight.files import read_flight, write_flight
    from sparsefit.flight.simulation import simulate_flight

__all__ = ["Flight", "read_flight", "simulate_flight", "write_flight"]

_HOMES = {"read_flight": "files", "write_flight": "files", "simulate_flight": "simulation"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
