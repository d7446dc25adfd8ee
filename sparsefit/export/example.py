"""A flight for the test of an export where none was recorded: simulated, amid the grid."""

from __future__ import annotations

import math

from sparsefit.export.plan import Plan
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle

SAMPLES, LONGER = 1000, 4  # at least, and at least so many windows
SPEED = 15.43  # U0 [m/s]
CROSSED = 36.0  # timescales that the flight lasts
RESPONSE, THRUST = 1.8, (0.16, 0.1)  # tau and a in units of the timescale and of U0/tau
NOISE = 0.005  # of the velocity in U0, of the position in a tenth of L


def example_flight(plan: Plan, seed: int = 7) -> Flight:
    """A flight of 1001 samples or more, some whole microseconds apart, with noise that is usual."""
    scale = math.sqrt(float(plan.scales[0] * plan.scales[-1]))
    flow = CellularFlow(mean_velocity=SPEED, length_scale=scale)
    tau = RESPONSE * flow.timescale
    thrust = (THRUST[0] * SPEED / tau, THRUST[1] * SPEED / tau)
    samples = max(SAMPLES, LONGER * plan.window)
    step = max(1, round(1e6 * CROSSED * flow.timescale / samples))
    return simulate_flight(
        flow,
        PointMassVehicle(tau, thrust),
        duration=samples * step * 1e-6,
        sample_rate=1e6 / step,
        seed=seed,
        position_noise=0.1 * NOISE * scale,
        velocity_noise=NOISE * SPEED,
    )
