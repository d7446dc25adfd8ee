"""The rows that a derivative gives: states and their rates at samples, or averages of them.

Averages are the weak form (Messenger and Bortz, 2021). With a bump psi_i(t) = c (1 - s^2)^p,
s = (t - t_i) / reach, of unit integral, integration by parts moves the derivative of v onto psi:

    int psi Phi dt = tau (-int psi' v dt - a) + int psi v dt = int psi C(x(t)) dt W

A row of Psi (q, m) holds the weights of the m samples, by the trapezoid rule, which is spectrally
accurate for such bumps on even steps.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

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


@dataclass(frozen=True, eq=False)
class Samples:
    """States and their derivatives on m rows (Eq. 16): samples, or averages of samples.

    Args:
        time: t [s], (m,).
        position: [m], (m, 2); of averages that of the samples under them.
        velocity: [m/s], (m, 2).
        position_rate: the derivative of the position [m/s], (m, 2); the measured velocity is
            another one.
        acceleration: the derivative of the velocity [m/s^2], (m, 2).
        smoothing: the filter that made them; None where it was no `Derivative`.
        averages: the weak form, which the regression and the readout take in place of the
            samples; these, by ``auto``, then only serve the search.
        repairs: the samples that were replaced or dropped before.
        push: the measured acceleration by the vehicle's engines [m/s^2], (m, 2), or None.
        operator: Psi of averages, each row of sum 1; None of samples.
    """

    time: Array
    position: Array
    velocity: Array
    position_rate: Array
    acceleration: Array
    smoothing: Smoothing | None = None
    averages: Samples | None = None
    repairs: Repairs = Repairs()
    push: Array | None = None
    operator: csr_array | None = None

    @property
    def source(self) -> Samples:
        """The rows of the regression: averages where there are any, else the samples."""
        return self.averages or self

    def flow_velocity(self, vehicle: PointMassVehicle) -> Array:
        """Return the flow velocity Phi [m/s], (m, 2), that moved ``vehicle`` so (Eqs. 12-13).

        Raises InputError on averages where the vehicle's response is not linear.
        """
        if not vehicle.linear and self.operator is not None:
            raise InputError(
                "the weak form averages the equation of motion, which this vehicle's quadratic "
                "response does not allow: use the derivative 'auto'"
            )
        return vehicle.flow_velocity(self.velocity, self.acceleration, self.push)

    def averaged(self, values: Array) -> Array:
        """Psi times values of one row or more per sample, (r m, k); the values of samples."""
        if self.operator is None:
            return values
        flat = values.reshape(len(self.position), -1)
        return np.asarray(self.operator @ flat).reshape(-1, values.shape[1])

    def blocks(self, size: int) -> Iterator[tuple[slice, csr_array | None, Array]]:
        """Rows in blocks: which they are, their rows of Psi, and the positions of the samples.

        size: of samples at once; of averages 256, as they stand for many samples.
        """
        psi, count = self.operator, len(self.velocity)
        size = size if psi is None else 256
        for start in range(0, count, size):
            rows = slice(start, min(start + size, count))
            if psi is None:
                yield rows, None, self.position[rows]
                continue
            used = psi.indices[psi.indptr[rows.start] : psi.indptr[rows.stop]]
            span = slice(int(used.min()), int(used.max()) + 1)
            yield rows, psi[rows, span], self.position[span]

    def every(self, step: int) -> Samples:
        """Every so many-th of the samples."""
        return replace(self, **{name: part[::step] for name, part in self._arrays().items()})

    def _arrays(self) -> dict[str, Any]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}

    @classmethod
    def joined(cls, flights: Sequence[Samples]) -> Samples:
        """The samples of several flights one after another."""
        parts = [flight._arrays() for flight in flights]
        names = [name for name in parts[0] if all(name in part for part in parts)]
        both: dict[str, Any] = {
            name: np.concatenate([part[name] for part in parts]) for name in names
        }
        return cls(**both)


def weak_form(
    time: Array, state: Array, window: int, order: int = ORDER, push: Array | None = None
) -> Samples:
    """The weak form of states x, y, vx, vy (m, 4) [m], [m/s] at times (m,) [s], as q averages.

    window: samples under a test function. order: the exponent p. push: measured thrust (m, 2).
    Raises InputError where no test function fits into the flight.
    """
    from scipy.sparse import csr_array

    samples = len(time)
    step = float(time[-1] - time[0]) / (samples - 1)
    reach, slack = window // 2 * step, 1e-9 * step + clock_rounding(time)
    inside = (time - time[0] >= reach - slack) & (time[-1] - time >= reach - slack)
    # Ten test functions over any sample: twice as many change nothing.
    centres = time[inside][:: max(1, window // 10)]
    low = np.searchsorted(time, centres - reach - slack)
    counts = np.searchsorted(time, centres + reach + slack) - low
    present = counts >= 0.5 * window  # an integral over a gap in the log is none
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
    rates = rate @ state
    return Samples(
        centres,
        state[:, :2],
        mean @ state[:, 2:],
        rates[:, :2],
        rates[:, 2:],
        Smoothing("weak", window=window),
        push=None if push is None else mean @ push,
        operator=mean,
    )
