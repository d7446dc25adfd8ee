"""Flights: the record, the vehicle, the flows, and their simulation."""

from sparsefit.flight.record import Flight
from sparsefit.flight.simulation import simulate_flight

__all__ = ["Flight", "simulate_flight"]
