"""What a measured thrust alone does to a vehicle, taken out before a derivative and put back after.

With V(t) the integral of the thrust s m(t), and X(t) that of V, the states less (X, V) move by
v' - s m: what the flow does. Every rule is linear, so the mean P over which it takes a derivative
then acts on v' - s m, as it does where the thrust is constant, and no smoothing takes anything
from a thrust that is known. White noise of the thrust passes as kicks of the vehicle do.

The thrust is a straight line from sample to sample: V and X are exact.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative.pieces import Pieces, hermite
from sparsefit.derivative.weak import WeakRows
from sparsefit.flight import Flight


@dataclass(frozen=True, eq=False)
class Carried:
    """The path of a vehicle that only its measured thrust moves, from rest in every piece.

    Args:
        time: [s], (m,).
        measured: m [m/s^2], (m, 2).
        thrust: s m [m/s^2], (m, 2).
        velocity: V [m/s], (m, 2).
        position: X [m], (m, 2).
    """

    time: Array
    measured: Array
    thrust: Array
    velocity: Array
    position: Array

    @classmethod
    def of(cls, flight: Flight, log: Pieces) -> Carried | None:
        """The path on the samples of a log; None where the flight measured no thrust."""
        if flight.thrust is None:
            return None
        measured = at_times(log.time, flight.time, flight.thrust)
        thrust = flight.vehicle.thrust_scale * measured
        parts = [_integrated(log.time[piece], thrust[piece]) for piece in log.slices]
        velocity, position = (np.concatenate(part) for part in zip(*parts, strict=True))
        return cls(log.time, measured, thrust, velocity, position)

    def without(self, log: Pieces) -> Pieces:
        """The samples of the log less this path."""
        left = log.position - self.position, log.velocity - self.velocity
        return replace(log, position=left[0], velocity=left[1])

    def restored(self, time: Array, state: Array, rate: Array) -> tuple[Array, Array, Array]:
        """States and rates (q, 4) of `without`, with this path again, and m (q, 2), at times."""
        position = hermite(self.time, self.position, self.velocity, time)
        velocity = hermite(self.time, self.velocity, self.thrust, time)
        thrust, measured = (at_times(time, self.time, one) for one in (self.thrust, self.measured))
        whole = state + np.hstack([position, velocity])
        return whole, rate + np.hstack([velocity, thrust]), measured

    def averaged(self, rows: WeakRows, time: Array) -> WeakRows:
        """Weak rows of states at times (m,), this path averaged as the thrust that makes it."""
        velocity = hermite(self.time, self.velocity, self.thrust, time)
        thrust, measured = (at_times(time, self.time, one) for one in (self.thrust, self.measured))
        left = rows.acceleration - rows.rate @ velocity
        return replace(
            rows, acceleration=left + rows.operator @ thrust, thrust=rows.operator @ measured
        )


def at_times(time: Array, known: Array, values: Array) -> Array:
    """Values (k, 2) at known times (k,) on the straight lines between them, (q, 2)."""
    return np.stack([np.interp(time, known, one) for one in values.T], axis=1)


def _integrated(time: Array, thrust: Array) -> tuple[Array, Array]:
    """V and X (m, 2) of a thrust (m, 2) that is linear between the times (m,)."""
    step = np.diff(time)[:, None]
    here, there = thrust[:-1], thrust[1:]
    velocity = _summed(step * (here + there) / 2.0)
    position = _summed(step * velocity[:-1] + step**2 * (2.0 * here + there) / 6.0)
    return velocity, position


def _summed(increments: Array) -> Array:
    """Sums (m, 2) from 0 on of increments (m - 1, 2)."""
    sums: Array = np.concatenate([np.zeros((1, 2)), np.cumsum(increments, axis=0)])
    return sums
