"""The rows that are fitted: samples of the flow velocity, or averages, with nuisance columns.

    Psi Phi = Psi sum_j C(q_j) W_j + N b + E

Psi averages samples by the test functions of the weak form, or does nothing; the columns N of what
is unknown beside the flow (`sparsefit.library.nuisance`) join without a penalty.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples, WeakRows
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.family import Columns
from sparsefit.library.nuisance import Nuisance

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Rows:
    """What is fitted: q rows, averages of m samples or those themselves.

    Args:
        position: where columns are evaluated, from the middle of the flight's box (m, 2) [m], or
            (m, 3) with the time from its middle [s].
        target: Psi Phi of the vehicle as it is believed to be, (q, 2) [m/s].
        nuisance: N (2, q, j), the columns of j coefficients in either velocity component.
        operator: Psi (q, m), or None where the rows are the samples.
    """

    position: Array
    target: Array
    nuisance: Array
    operator: csr_array | None = None

    @classmethod
    def of(
        cls, source: Samples | WeakRows, vehicle: PointMassVehicle, unknown: tuple[str, ...] = ()
    ) -> Rows:
        """The rows of samples, or of their weak form, for a vehicle partly unknown."""
        return cls(
            centred(source.position),
            source.flow_velocity(vehicle),
            Nuisance(unknown, vehicle).columns(source.velocity, source.thrust),
            source.operator if isinstance(source, WeakRows) else None,
        )

    def timed(self, time: Array) -> Rows:
        """The same rows, their positions with the time (m,) [s] of the samples from its middle."""
        from_middle = time - 0.5 * (time[0] + time[-1])
        return replace(self, position=np.column_stack([self.position[:, :2], from_middle]))

    def thinned(self, step: int) -> Rows:
        """Every so many-th of rows that are samples."""
        position, target = self.position[::step], self.target[::step]
        return Rows(position, target, self.nuisance[:, ::step])

    @classmethod
    def plain(cls, position: Array, flow_velocity: Array) -> Rows:
        """Samples of Phi (m, 2) [m/s] at positions (m, 2) [m], nothing unknown beside the flow."""
        return cls(centred(position), flow_velocity, np.zeros((2, len(position), 0)))

    def averaged(self, values: Array) -> Array:
        """Psi applied to values at the samples (k, r), r = m or, x before y, 2m: (k, q) or 2q."""
        if self.operator is None:
            return values
        halves = values.reshape(-1, len(self.position))
        averages: Array = (self.operator @ halves.T).T
        return np.ascontiguousarray(averages).reshape(
            len(values), values.shape[1] // halves.shape[1] * len(self.target)
        )

    def stacked(self, family: Columns) -> tuple[Array, Array]:
        """The target (r, n) and the nuisance columns (n, r, j), as a family's columns need them."""
        if family.targets == 2:
            return self.target, self.nuisance
        both, unknown = self.target.size, self.nuisance.shape[2]
        return self.target.T.reshape(both, 1), self.nuisance.reshape(1, both, unknown)

    def unstacked(self, values: Array) -> Array:
        """Values (r, n) of `stacked` as one row for both velocity components, (q, 2)."""
        return values if values.shape[1] == 2 else values.reshape(2, -1).T


def centred(position: Array) -> Array:
    """Positions (m, 2) from the middle of their bounding box."""
    return position - middle(position)


def middle(position: Array) -> Array:
    """The middle of the bounding box of positions (m, 2)."""
    centre: Array = 0.5 * (position.max(axis=0) + position.min(axis=0))
    return centre
