"""The rows that are fitted: samples of the flow velocity, or averages, with nuisance columns.

    Psi Phi = Psi sum_j C(q_j) W_j + N b + E

Psi averages samples by the test functions of the weak form, or does nothing; the columns N of what
is unknown beside the flow (`sparsefit.library.nuisance`) join without a penalty.

Several flights through one flow are these rows one flight after another, those of each times its
weight, one over the level of its noise. W is that of all, and every flight has columns of its own
in N.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples, WeakRows
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.family import Columns
from sparsefit.library.nuisance import Nuisance
from sparsefit.library.scan import middle

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
        scale: the weight of every row (q,), already in target and nuisance; None: all are 1.
        weights: of the flights.
        parts: of several flights, the rows of each without its weight, N with the columns of all.
    """

    position: Array
    target: Array
    nuisance: Array
    operator: csr_array | None = None
    scale: Array | None = None
    weights: tuple[float, ...] = (1.0,)
    parts: tuple[Rows, ...] = ()

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

    @classmethod
    def of_flights(
        cls,
        sources: Sequence[Samples | WeakRows],
        nuisances: Sequence[Nuisance],
        weights: Sequence[float],
        moving: Sequence[Array],
    ) -> Rows:
        """The rows of several flights, each with nuisance columns and a weight of its own.

        moving: the velocity (q, 2) [m/s] that the nuisance columns of each are made of.
        """
        if len(sources) == 1:
            return cls.of(sources[0], nuisances[0].believed, nuisances[0].unknown)
        from scipy.sparse import block_diag

        centre = middle(np.concatenate([source.position for source in sources]))
        each = zip(nuisances, sources, moving, strict=True)
        own = [one.columns(velocity, source.thrust) for one, source, velocity in each]
        ends = np.cumsum([0, *(columns.shape[2] for columns in own)])
        parts = tuple(
            cls(
                source.position - centre,
                source.flow_velocity(nuisance.believed),
                np.pad(columns, ((0, 0), (0, 0), (first, ends[-1] - last))),
                source.operator if isinstance(source, WeakRows) else None,
            )
            for source, nuisance, columns, first, last in zip(
                sources, nuisances, own, ends[:-1].tolist(), ends[1:].tolist(), strict=True
            )
        )
        weighted = list(zip(parts, weights, strict=True))
        operators = [part.operator for part in parts if part.operator is not None]
        return cls(
            np.concatenate([part.position for part in parts]),
            np.concatenate([weight * part.target for part, weight in weighted]),
            np.concatenate([weight * part.nuisance for part, weight in weighted], axis=1),
            block_diag(operators, format="csr") if operators else None,
            np.repeat(weights, [len(part.target) for part in parts]),
            tuple(weights),
            parts,
        )

    def fading(self, scale: Array) -> Rows:
        """The rows of one flight, each with a weight (q,) of its own."""
        target, nuisance = scale[:, None] * self.target, scale[:, None] * self.nuisance
        return replace(self, target=target, nuisance=nuisance, scale=scale, parts=(self,))

    @property
    def flights(self) -> tuple[Rows, ...]:
        """The rows of each flight without its weight; of one flight these are they."""
        return self.parts or (self,)

    def timed(self, time: Array) -> Rows:
        """The same rows, their positions with the time (m,) [s] of the samples from its middle."""
        from_middle = time - 0.5 * (time.min() + time.max())
        ends = np.cumsum([len(part.position) for part in self.parts])[:-1]
        own = np.split(from_middle, ends) if self.parts else []
        parts = [part._at(moment) for part, moment in zip(self.parts, own, strict=True)]
        return replace(self._at(from_middle), parts=tuple(parts))

    def _at(self, moments: Array) -> Rows:
        return replace(self, position=np.column_stack([self.position[:, :2], moments]))

    def thinned(self, step: int) -> Rows:
        """Every so many-th of rows that are samples."""
        position, target = self.position[::step], self.target[::step]
        scale = None if self.scale is None else self.scale[::step]
        return Rows(position, target, self.nuisance[:, ::step], scale=scale)

    @classmethod
    def plain(cls, position: Array, flow_velocity: Array) -> Rows:
        """Samples of Phi (m, 2) [m/s] at positions (m, 2) [m], nothing unknown beside the flow."""
        return cls(centred(position), flow_velocity, np.zeros((2, len(position), 0)))

    def averaged(self, values: Array) -> Array:
        """Values at the samples (k, r), r = m or, x before y, 2m, as the rows are: (k, q) or 2q."""
        if self.operator is None and self.scale is None:
            return values
        halves = values.reshape(-1, len(self.position))
        averages: Array = halves if self.operator is None else (self.operator @ halves.T).T
        if self.scale is not None:
            averages = averages * self.scale
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
