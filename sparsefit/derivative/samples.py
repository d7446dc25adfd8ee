"""What a derivative gives: states and their derivatives on the same samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative.agreement import Agreement
from sparsefit.derivative.repair import Repairs
from sparsefit.derivative.smoothing import Smoothing
from sparsefit.derivative.weak import WeakRows
from sparsefit.flight.vehicle import PointMassVehicle


@dataclass(frozen=True, eq=False)
class Samples:
    """States and their derivatives on the same m samples (Eq. 16).

    Args:
        time: t [s], (m,).
        position: [m], (m, 2).
        velocity: [m/s], (m, 2).
        position_rate: the derivative of the position [m/s], (m, 2); the measured velocity is
            ``velocity``.
        acceleration: the derivative of the velocity [m/s^2], (m, 2).
        smoothing: the filter that was used, and with ``auto`` the noise it found.
        weak: with ``weak`` the rows of the regression, which the library and the readout take in
            place of the samples; these, by ``auto``, then only say where a scan has to look.
        repairs: what was mended in the flight before.
        agreement: of position and velocity in the longest piece, where ``auto`` smoothed both.
        thrust: that was measured [m/s^2], (m, 2), or None.

    ``smoothing`` is None where the samples were not made by a `Derivative`.
    """

    time: Array
    position: Array
    velocity: Array
    position_rate: Array
    acceleration: Array
    smoothing: Smoothing | None = None
    weak: WeakRows | None = None
    repairs: Repairs = Repairs()
    agreement: Agreement | None = None
    thrust: Array | None = None

    def flow_velocity(self, vehicle: PointMassVehicle) -> Array:
        """Return the flow velocity Phi [m/s], (m, 2), that moved ``vehicle`` so (Eqs. 12-13)."""
        return vehicle.flow_velocity(self.velocity, self.acceleration, self.thrust)

    def every(self, step: int) -> Samples:
        """Every so many-th of the samples, and of what stands beside them."""
        thin = slice(None, None, step)
        return replace(
            self,
            time=self.time[thin],
            position=self.position[thin],
            velocity=self.velocity[thin],
            position_rate=self.position_rate[thin],
            acceleration=self.acceleration[thin],
            thrust=None if self.thrust is None else self.thrust[thin],
        )

    @classmethod
    def joined(cls, flights: Sequence[Samples]) -> Samples:
        """Those of several flights one after another, less what is known of one flight only."""
        pushed = [own.thrust for own in flights if own.thrust is not None]
        return cls(
            np.concatenate([own.time for own in flights]),
            np.concatenate([own.position for own in flights]),
            np.concatenate([own.velocity for own in flights]),
            np.concatenate([own.position_rate for own in flights]),
            np.concatenate([own.acceleration for own in flights]),
            thrust=np.concatenate(pushed) if len(pushed) == len(flights) else None,
        )
