"""The weak form: the equation of motion averaged by test functions, no derivative ever taken.

With a bump psi_i(t) = c (1 - s^2)^p, s = (t - t_i) / reach, of unit integral, and zero with its
first p - 1 derivatives at both ends, integration by parts moves the derivative of v onto psi:

    int psi Phi dt = tau (-int psi' v dt - a) + int psi v dt = int psi C(x(t)) dt W

(Messenger and Bortz, 2021). A row is an average: Psi (q, m) holds the weights of the m samples, by
the trapezoid rule, which is spectrally accurate for such bumps on uniform steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.derivative.steps import clock_rounding
from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle

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
        time: centres of the windows [s], (q,).
        position: where the candidates are evaluated [m], (m, 2).
        velocity: int psi v dt [m/s], (q, 2).
        position_rate: -int psi' x dt [m/s], (q, 2).
        acceleration: -int psi' v dt [m/s^2], (q, 2).
        window: samples under a test function.
        order: p.
        correlation: rows over which errors of the velocity correlate, >= 1.
        rate: the weights (q, m) of -int psi' dt, each row of sum 0.
        thrust: int psi m dt [m/s^2], (q, 2), where a thrust was measured.
    """

    operator: csr_array
    time: Array
    position: Array
    velocity: Array
    position_rate: Array
    acceleration: Array
    window: int
    order: int
    correlation: float
    rate: csr_array
    thrust: Array | None = None

    def flow_velocity(self, vehicle: PointMassVehicle) -> Array:
        """The averages of Phi [m/s], (q, 2), for a vehicle."""
        if vehicle.drag:
            raise InputError(
                "the weak form averages the equation of motion, which quadratic drag does not "
                "allow: use the derivative 'auto'"
            )
        return vehicle.flow_velocity(self.velocity, self.acceleration, self.thrust)

    def blocks(self) -> Iterator[tuple[slice, csr_array, Array]]:
        """Rows of Psi in blocks: which, their weights, and the positions that these act on."""
        for start in range(0, len(self.time), BLOCK):
            rows = slice(start, min(start + BLOCK, len(self.time)))
            ends = self.operator.indptr[rows.start], self.operator.indptr[rows.stop]
            used = self.operator.indices[ends[0] : ends[1]]
            low, high = int(used.min()), int(used.max()) + 1
            yield rows, self.operator[rows, low:high], self.position[low:high]


def weak_rows(
    time: Array, position: Array, velocity: Array, window: int, order: int = ORDER
) -> WeakRows:
    """The weak form of states at ``time`` [s], (m,), by test functions ``window`` samples wide.

    position [m], velocity [m/s]: (m, 2). order: the exponent p of the test functions.

    Raises:
        InputError: if no test function fits into the flight.
    """
    from scipy.sparse import csr_array

    half, step = window // 2, float(time[-1] - time[0]) / (len(time) - 1)
    stride = max(1, window // OVERLAP)
    centres, low, counts = _placed(time, half * step, step, stride, PRESENT * window)
    if not len(centres):
        raise InputError(
            f"no weak test function of {window} samples fits into {len(time)} samples: use a "
            "smaller window, or central"
        )
    ends = np.concatenate([[0], np.cumsum(counts)])
    row = np.repeat(np.arange(len(centres)), counts)
    column = np.arange(ends[-1]) - (ends[:-1] - low)[row]
    weights = _weights(
        time[column] - centres[row], np.gradient(time)[column], row, half * step, order
    )
    shape = (len(centres), len(time))
    mean, rate = (csr_array((values, column, ends), shape=shape) for values in weights)
    return WeakRows(
        operator=mean,
        time=mean @ time,
        position=position,
        velocity=mean @ velocity,
        position_rate=rate @ position,
        acceleration=rate @ velocity,
        window=window,
        order=order,
        correlation=max(1.0, correlation(half, order) / stride),
        rate=rate,
    )


def _placed(
    time: Array, reach: float, step: float, stride: int, least: float
) -> tuple[Array, IntArray, IntArray]:
    """Centres [s] of the test functions, the first sample under each, and how many there are.

    Every stride-th sample that is ``reach`` [s] away from both ends, if ``least`` samples are
    there.
    """
    slack = 1e-9 * step + clock_rounding(time)
    inside = (time - time[0] >= reach - slack) & (time[-1] - time >= reach - slack)
    centres = time[inside][::stride]
    low = np.searchsorted(time, centres - reach - slack)
    counts = np.searchsorted(time, centres + reach + slack) - low
    kept = counts >= least
    return centres[kept], low[kept], counts[kept]


def _weights(
    away: Array, width: Array, row: IntArray, reach: float, order: int
) -> tuple[Array, Array]:
    """Weights of the samples in int psi dt and in -int psi' dt, one after another by row.

    away [s]: of a sample from the centre of its row; width [s]: of its trapezoid.
    """
    s = np.clip(away / reach, -1.0, 1.0)
    mass = width * (1 - s * s) ** order
    total = np.bincount(row, mass)[row]
    slope = width * 2 * order * s * (1 - s * s) ** (order - 1) / (reach * total)
    mass /= total
    # Uneven steps: the quadrature of -psi' is made exact for constant and linear velocities.
    slope -= np.bincount(row, slope)[row] * mass
    slope /= np.bincount(row, slope * away)[row]
    return mass, slope


def correlation(half: int, order: int) -> float:
    """Sum of the squared autocorrelations of white noise averaged by psi' [samples].

    half: samples on either side of the middle; order: p. Of m rows, m / this are independent.
    """
    s = np.linspace(-1.0, 1.0, 2 * half + 1)
    slope = s * (1 - s * s) ** (order - 1)
    lagged = np.correlate(slope, slope, "full")
    return float(np.sum(np.square(lagged / lagged.max())))


def automatic_window(samples: int, smoothed: int) -> int:
    """The width of test functions: the smoother's window, at least `SHORTEST`, that fits.

    Both face the same balance: wider takes from the flow what narrower leaves of the noise.
    """
    return max(5, min(max(smoothed, SHORTEST), 2 * (samples // 6) + 1))
