"""Flows to fly through, and what a simulated flight takes beside one: classes to use and to derive.

A flow is anything with ``velocity(x, y, t)`` in m/s; those here are sums of waves of a stream
function.
"""

from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import CellularFlow, ShapedCells, SuperposedFlow
from sparsefit.flight.vehicle import ThrustSeries
from sparsefit.flight.waves import FlowField, Turbulence, WaveFlow

__all__ = ["CellularFlow", "FlowField", "LogFaults", "ShapedCells", "SuperposedFlow",
           "ThrustSeries", "Turbulence", "WaveFlow"]  # fmt: skip
