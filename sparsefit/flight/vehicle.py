"""The vehicle: a thrust-driven point mass with linear drag (Eqs. 10-12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.errors import pair, positive


@dataclass(frozen=True)
class PointMassVehicle:
    """A point mass under Stokes drag and constant thrust: ``v' = (w - v)/tau + a`` (Eq. 12).

    Args:
        response_time: tau = m / (3 pi L mu) [s] (Eq. 11), > 0.
        thrust_acceleration: a = T/m [m/s^2], (x, y).

    Raises:
        InputError: if tau is not a finite number above 0, or a is not two finite numbers.
    """

    response_time: float
    thrust_acceleration: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check both parameters and store them as floats."""
        response = positive("response_time", self.response_time, "s")
        thrust = pair("thrust_acceleration", self.thrust_acceleration, "m/s^2")
        object.__setattr__(self, "response_time", response)
        object.__setattr__(self, "thrust_acceleration", thrust)

    def acceleration(self, velocity: ArrayLike, flow_velocity: ArrayLike) -> Array:
        """Return v' [m/s^2], shape (..., 2), from v and w [m/s], shape (..., 2) (Eq. 12)."""
        drift = np.asarray(flow_velocity, np.float64) - np.asarray(velocity, np.float64)
        rate: Array = drift / self.response_time + np.array(self.thrust_acceleration)
        return rate

    def flow_velocity(self, velocity: ArrayLike, acceleration: ArrayLike) -> Array:
        """Return Phi = tau (v' - a) + v [m/s], shape (..., 2): Eq. 12 solved for the flow.

        Args:
            velocity: v [m/s], shape (..., 2).
            acceleration: v' [m/s^2], shape (..., 2).
        """
        excess = np.asarray(acceleration, np.float64) - np.array(self.thrust_acceleration)
        flow: Array = self.response_time * excess + np.asarray(velocity, np.float64)
        return flow
