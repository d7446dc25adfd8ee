"""The rows that a derivative gives: states and their rates at samples, or averages of them.

Averages are the weak form (Messenger and Bortz, 2021). With a bump psi_i(t) = c (1 - s^2)^p,
s = (t - t_i) / reach, of unit integral, integration by parts moves the derivative of v onto psi:

    int psi Phi dt = tau (-int psi' v dt - a) + int psi v dt = int psi C(x(t)) dt W

A row of Psi (q, m) holds the weights of the m samples, by the trapezoid rule, which is spectrally
accurate for such bumps on even steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs.checks import clock_rounding
from sparsefit.rows.clean import Repairs
from sparsefit.rows.smoothing import Smoothing

if TYPE_CHECKING:
    from scipy.sparse import csr_array

ORDER = 8  # p; 4 needs windows of 60 samples for an error of tau_w of 1e-4 %, 8 of 21
SHORTEST = 21  # samples: below it, the quadrature errs by more than 1e-5 % of tau_w
OVERLAP = 10  # test functions over any sample: twice as many change nothing
PRESENT = 0.5  # of a window's samples must be there: an integral over a gap in the log is none
BLOCK = 256  # rows of Psi applied at once: bounds the memory


@dataclass(frozen=True, eq=False)
class WeakRows:
    """The weak form of a flight: q rows, each an average over the samples of one window.

    Args:
        operator: Psi (q, m), each row of sum 1.
        position: where the candidates are evaluated [m], (m, 2).
        velocity: int psi v dt [m/s], (q, 2).
        position_rate: -int psi' x dt [m/s], (q, 2).
        acceleration: -int psi' v dt [m/s^2], (q, 2).
        window: samples under a test function.
        thrust: int psi m dt [m/s^2], (q, 2), where a thrust was measured.
    """

    operator: csr_array
    position: Array
    velocity: Array
    position_rate: Array
    acceleration: Array
    window: int
    thrust: Array | None = None

    @classmethod
    def of(
        cls,
        time: Array,
        state: Array,
        window: int | None,
        order: int = ORDER,
        thrust: Array | None = None,
        *,
        smoothed: int = 1,
    ) -> WeakRows:
        """The weak form of states x, y, vx, vy (m, 4) [m], [m/s] at times (m,) [s].

        window: samples under a test function; None: the smoother's window ``smoothed``, at least
        `SHORTEST`, that fits the flight. order: the exponent p. Raises InputError where no test
        function fits into the flight.
        """
        from scipy.sparse import csr_array

        samples = len(time)
        if window is None:
            window = max(5, min(max(smoothed, SHORTEST), 2 * (samples // 6) + 1))
        step = float(time[-1] - time[0]) / (samples - 1)
        reach, slack = window // 2 * step, 1e-9 * step + clock_rounding(time)
        inside = (time - time[0] >= reach - slack) & (time[-1] - time >= reach - slack)
        centres = time[inside][:: max(1, window // OVERLAP)]
        low = np.searchsorted(time, centres - reach - slack)
        counts = np.searchsorted(time, centres + reach + slack) - low
        present = counts >= PRESENT * window
        centres, low, counts = centres[present], low[present], counts[present]
        if not len(centres):
            raise InputError(
                f"no weak test function of {window} samples fits into {samples} samples: use a "
                "smaller window, or central"
            )
        ends = np.concatenate([[0], np.cumsum(counts)])
        row = np.repeat(np.arange(len(centres)), counts)
        column = np.arange(ends[-1]) - (ends[:-1] - low)[row]
        away, width = time[column] - centres[row], np.gradient(time)[column]
        s = np.clip(away / reach, -1.0, 1.0)
        mass = width * (1 - s * s) ** order
        total = np.bincount(row, mass)[row]
        slope = width * 2 * order * s * (1 - s * s) ** (order - 1) / (reach * total)
        mass /= total
        # Uneven steps: the quadrature of -psi' is made exact for constant and linear velocities.
        slope -= np.bincount(row, slope)[row] * mass
        slope /= np.bincount(row, slope * away)[row]
        shape = (len(centres), samples)
        mean, rate = (csr_array((values, column, ends), shape=shape) for values in (mass, slope))
        velocity, rates = mean @ state[:, 2:], rate @ state
        pushed = None if thrust is None else mean @ thrust
        return cls(mean, state[:, :2], velocity, rates[:, :2], rates[:, 2:], window, pushed)

    def flow_velocity(self, vehicle: PointMassVehicle) -> Array:
        """The averages of Phi [m/s], (q, 2), for a vehicle; InputError under quadratic drag."""
        if vehicle.drag:
            raise InputError(
                "the weak form averages the equation of motion, which quadratic drag does not "
                "allow: use the derivative 'auto'"
            )
        return vehicle.flow_velocity(self.velocity, self.acceleration, self.thrust)

    def blocks(self) -> Iterator[tuple[slice, csr_array, Array]]:
        """Rows of Psi in blocks: which, their weights, and the positions that these act on."""
        count = len(self.velocity)
        for start in range(0, count, BLOCK):
            rows = slice(start, min(start + BLOCK, count))
            ends = self.operator.indptr[rows.start], self.operator.indptr[rows.stop]
            used = self.operator.indices[ends[0] : ends[1]]
            low, high = int(used.min()), int(used.max()) + 1
            yield rows, self.operator[rows, low:high], self.position[low:high]


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
        smoothing: the filter that was used, and with ``auto`` the noise levels that it estimated.
        weak: with ``weak`` the rows of the regression, which the library and the readout take in
            place of the samples; these, by ``auto``, then only serve the search.
        repairs: the samples that were replaced or dropped before.
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
    thrust: Array | None = None

    @property
    def source(self) -> Samples | WeakRows:
        """The rows of the regression: averages where there are any, else the samples."""
        return self.weak or self

    def flow_velocity(self, vehicle: PointMassVehicle) -> Array:
        """Return the flow velocity Phi [m/s], (m, 2), that moved ``vehicle`` so (Eqs. 12-13)."""
        return vehicle.flow_velocity(self.velocity, self.acceleration, self.thrust)

    def every(self, step: int) -> Samples:
        """Every so many-th of the samples."""
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
        """The samples of several flights one after another."""
        if len(flights) == 1:
            return flights[0]
        thrusts = [flight.thrust for flight in flights if flight.thrust is not None]
        return cls(
            np.concatenate([flight.time for flight in flights]),
            np.concatenate([flight.position for flight in flights]),
            np.concatenate([flight.velocity for flight in flights]),
            np.concatenate([flight.position_rate for flight in flights]),
            np.concatenate([flight.acceleration for flight in flights]),
            thrust=np.concatenate(thrusts) if len(thrusts) == len(flights) else None,
        )
