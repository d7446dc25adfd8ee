"""The vehicle: a thrust-driven point mass with linear drag (Eqs. 10-12), quadratic drag, or both.

    v' = F(w - v) + a,    F(r) = (1/tau + c |r|) r,    a = a_0 + s m(t)

With c = 0 this is the paper's. Solved for the flow, Phi = v + r with F(r) = f = v' - a: r points
along f, and its length is the root of c |r|^2 + |r|/tau = |f|. a_0 is the constant thrust and m(t)
the measured thrust of the flight, if any; a_0 is then its constant error and s its scale.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, frozen
from sparsefit.errors import InputError, finite, is_real, non_negative, pair, positive, store


@dataclass(frozen=True)
class PointMassVehicle:
    """A point mass under drag and thrust: ``v' = (1/tau + c |w - v|) (w - v) + a``.

    Args:
        response_time: tau = m / (3 pi L mu) [s] (Eq. 11), > 0; ``math.inf`` for drag that is
            quadratic only.
        thrust_acceleration: a = T/m [m/s^2], (x, y); added to a measured series (`Flight.thrust`)
            if there is one.
        drag: c [1/m], >= 0, of quadratic drag: rho C_D A / (2 m). 0: the paper's linear drag.
        thrust_scale: s, the factor of a measured series.

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
        store(self, non_negative, "1/m", "drag")
        if not (self.drag and is_real(self.response_time) and self.response_time == math.inf):
            store(self, positive, "s", "response_time")
        store(self, pair, "m/s^2", "thrust_acceleration")
        store(self, finite, "", "thrust_scale")

    @property
    def linear(self) -> bool:
        """Whether the flow velocity is linear in the vehicle's acceleration: c is 0."""
        return not self.drag

    @property
    def rate(self) -> float:
        """1/tau [1/s], 0 where drag is quadratic only."""
        return 1.0 / self.response_time

    @property
    def parameters(self) -> tuple[float, float, float, float, float]:
        """tau [s], c [1/m], a_0 (x, y) [m/s^2] and s, as the equation of motion has them."""
        return (self.response_time, self.drag, *self.thrust_acceleration, self.thrust_scale)

    def thrust(self, measured: ArrayLike | None = None) -> Array:
        """a = a_0 + s m [m/s^2], (..., 2), from a measured m (..., 2), or a_0 (2,) without one."""
        constant: Array = np.array(self.thrust_acceleration)
        if measured is None:
            return constant
        return constant + self.thrust_scale * np.asarray(measured, np.float64)

    def flow_velocity(
        self, velocity: ArrayLike, acceleration: ArrayLike, thrust: ArrayLike | None = None
    ) -> Array:
        """Return Phi [m/s], shape (..., 2): the equation of motion solved for the flow.

        With linear drag Phi = tau (v' - a) + v.

        Args:
            velocity: v [m/s], shape (..., 2).
            acceleration: v' [m/s^2], shape (..., 2).
            thrust: m [m/s^2], shape (..., 2), if it was measured.
        """
        force = np.asarray(acceleration, np.float64) - self.thrust(thrust)
        if self.drag:
            length = np.hypot(force[..., :1], force[..., 1:])
            root = np.sqrt(self.rate**2 + 4.0 * self.drag * length)
            relative: Array = 2.0 * force / np.where(root > 0, self.rate + root, 1.0)
        else:
            relative = self.response_time * force
        return relative + np.asarray(velocity, np.float64)


@dataclass(frozen=True, eq=False)
class ThrustSeries:
    """A thrust acceleration over the flight's time in its axes, interpolated linearly.

    Args:
        time: t [s], (k,), strictly increasing, k >= 2.
        acceleration: a = T/m [m/s^2], (k, 2).

    Raises:
        InputError: if the shapes differ, a value is not finite or the time does not increase.
    """

    time: Array
    acceleration: Array

    def __post_init__(self) -> None:
        """Check both and freeze them."""
        store(self, frozen, ("m",), "time")
        if len(self.time) < 2 or not (np.diff(self.time) > 0).all():
            raise InputError("the thrust needs two times or more, increasing strictly")
        store(self, frozen, (len(self.time), 2), "acceleration")

    def at(self, time: object) -> Array:
        """The acceleration [m/s^2] at times (m,) [s], (m, 2).

        Raises:
            InputError: for a time outside the series.
        """
        sought = frozen("time", time, ("m",))
        first, last = float(self.time[0]), float(self.time[-1])
        slack = 1e-6 * (last - first) / (len(self.time) - 1)  # of the mean step: rounding
        if sought.min() < first - slack or sought.max() > last + slack:
            raise InputError(
                f"the thrust is known from {first:g} to {last:g} s, the flight is from "
                f"{sought.min():g} to {sought.max():g} s: log it for all of the flight"
            )
        return np.column_stack([np.interp(sought, self.time, axis) for axis in self.acceleration.T])

    def pointwise(self) -> Callable[[float], tuple[float, float]]:
        """Return the function of one time [s] that gives (a_x, a_y) [m/s^2], in plain floats.

        It is constant beyond the ends.
        """
        times, rows = self.time.tolist(), self.acceleration.tolist()

        def at(t: float) -> tuple[float, float]:
            after = min(max(bisect_right(times, t), 1), len(times) - 1)
            start, (x, y), (far_x, far_y) = times[after - 1], rows[after - 1], rows[after]
            share = min(max((t - start) / (times[after] - start), 0.0), 1.0)
            return x + share * (far_x - x), y + share * (far_y - y)

        return at


def turning(
    time: Array, constant: tuple[float, float], size: float, period: float, phase: float
) -> ThrustSeries:
    """A constant thrust (x, y) plus one that rotates counter-clockwise, both [m/s^2].

    At times [s], (k,); the rotating one has the heading ``phase`` [rad] at t = 0 and its ``period``
    [s].
    """
    turned = 2.0 * np.pi * time / period + phase
    circle = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    return ThrustSeries(time, np.array(constant) + size * circle)
