"""Flights: the record, and the two places it comes from, a simulation or a file."""

from sparsefit.flight.files import read_flight, write_flight
from sparsefit.flight.record import Flight
from sparsefit.flight.simulation import simulate_flight

__all__ = ["Flight", "read_flight", "simulate_flight", "write_flight"]
