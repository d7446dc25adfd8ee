"""The vehicle: a thrust-driven point mass with linear drag (Eqs. 10-12), quadratic drag, or both.

    v' = F(w - v) + a,    F(r) = (1/tau + c |r|) r,    a = a_0 + s m(t)

With c = 0 this is the paper's. Solved for the flow, Phi = v + r with F(r) = f = v' - a: r points
along f, and its length is the root of c |r|^2 + |r|/tau = |f|. a_0 is the constant thrust; m(t) the
thrust that the flight has measured, if any, a_0 then its constant error and s its scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.errors import finite, is_real, non_negative, pair, positive


@dataclass(frozen=True)
class PointMassVehicle:
    """A point mass under drag and thrust: ``v' = (1/tau + c |w - v|) (w - v) + a``.

    Args:
        response_time: tau = m / (3 pi L mu) [s] (Eq. 11), > 0; ``math.inf`` for drag that is
            quadratic only.
        thrust_acceleration: a = T/m [m/s^2], (x, y); beside a measured series (`Flight.thrust`)
            what is added to it.
        drag: c [1/m], >= 0, of quadratic drag: rho C_D A / (2 m). 0: the paper's linear drag.
        thrust_scale: s, by which a measured series is multiplied.

    Raises:
        InputError: if tau is not a number above 0 (infinite only with drag), a is not two finite
            numbers, or c or s is out of its range.
    """

    response_time: float
    thrust_acceleration: tuple[float, float] = (0.0, 0.0)
    drag: float = 0.0
    thrust_scale: float = 1.0

    def __post_init__(self) -> None:
        """Check the parameters and store them as floats."""
        drag = non_negative("drag", self.drag, "1/m")
        response = self.response_time
        if not (drag > 0 and is_real(response) and float(response) == math.inf):
            response = positive("response_time", response, "s")
        thrust = pair("thrust_acceleration", self.thrust_acceleration, "m/s^2")
        object.__setattr__(self, "response_time", float(response))
        object.__setattr__(self, "thrust_acceleration", thrust)
        object.__setattr__(self, "drag", drag)
        object.__setattr__(self, "thrust_scale", finite("thrust_scale", self.thrust_scale))

    @property
    def rate(self) -> float:
        """1/tau [1/s], 0 where drag is quadratic only."""
        return 1.0 / self.response_time

    def thrust(self, measured: ArrayLike | None = None) -> Array:
        """a = a_0 + s m [m/s^2], (..., 2), from a measured m (..., 2), or a_0 (2,) without one."""
        constant: Array = np.array(self.thrust_acceleration)
        if measured is None:
            return constant
        changing: Array = constant + self.thrust_scale * np.asarray(measured, np.float64)
        return changing

    def acceleration(
        self, velocity: ArrayLike, flow_velocity: ArrayLike, thrust: ArrayLike | None = None
    ) -> Array:
        """Return v' [m/s^2], shape (..., 2), from v and w [m/s], shape (..., 2) (Eq. 12).

        thrust: m [m/s^2], (..., 2), where it was measured.
        """
        relative = np.asarray(flow_velocity, np.float64) - np.asarray(velocity, np.float64)
        rate: Array = self.drag_of(relative) + self.thrust(thrust)
        return rate

    def drag_of(self, relative: Array) -> Array:
        """F(r) [m/s^2], (..., 2), of r = w - v [m/s], (..., 2)."""
        linear: Array = relative / self.response_time
        if not self.drag:
            return linear
        return linear + self.drag * _length(relative) * relative

    def flow_velocity(
        self, velocity: ArrayLike, acceleration: ArrayLike, thrust: ArrayLike | None = None
    ) -> Array:
        """Return Phi [m/s], shape (..., 2): the equation of motion solved for the flow.

        With linear drag Phi = tau (v' - a) + v.

        Args:
            velocity: v [m/s], shape (..., 2).
            acceleration: v' [m/s^2], shape (..., 2).
            thrust: m [m/s^2], shape (..., 2), where it was measured.
        """
        excess = np.asarray(acceleration, np.float64) - self.thrust(thrust)
        flow: Array = self.relative_of(excess) + np.asarray(velocity, np.float64)
        return flow

    def relative_of(self, force: Array) -> Array:
        """The relative velocity r = w - v [m/s], (..., 2), that drags with F(r) = force [m/s^2]."""
        if not self.drag:
            linear: Array = self.response_time * force
            return linear
        root = np.sqrt(self.rate**2 + 4.0 * self.drag * _length(force))
        reach: Array = 2.0 * force / np.where(root > 0, self.rate + root, 1.0)
        return reach

    def response(self, force: Array, least: float) -> Array:
        """dr/dF [s], (2, 2, m), symmetric, where F = force (m, 2) [m/s^2] drags.

        1/(1/tau + 2 c |r|) along r and 1/(1/tau + c |r|) across it. least [m/s^2] > 0 adds to |F|
        in squares: where noise is larger than F, no error is magnified by more than it allows.
        """
        size = _length(force)
        size[size == 0] = least
        floored = self.relative_of(force * np.sqrt(1.0 + (least / size) ** 2))
        speed = _length(floored)[:, 0]
        along = 1.0 / (self.rate + 2.0 * self.drag * speed)
        across = 1.0 / (self.rate + self.drag * speed)
        unit = (force / size).T
        turned: Array = across * np.eye(2)[:, :, None] + (along - across) * unit[:, None] * unit
        return turned

    def slope(self, relative: Array) -> Array:
        """dF/dr [1/s], (2, 2, m), symmetric, at r = relative (m, 2) [m/s]: 1/tau of linear drag."""
        speed = _length(relative)[:, 0]
        unit = (relative / np.where(speed > 0, speed, 1.0)[:, None]).T
        along: Array = self.drag * speed * unit[:, None] * unit
        return (self.rate + self.drag * speed) * np.eye(2)[:, :, None] + along


def _length(vectors: Array) -> Array:
    """|r| (..., 1) of vectors (..., 2)."""
    length: Array = np.hypot(vectors[..., :1], vectors[..., 1:])
    return length
