"""The rows that the refinement and the readout fit, where they are not plain samples of Phi.

Averages by weak test functions, C(k) -> Psi C(k); unknown parameters of the vehicle, whose columns
N join the 8 of one length scale; or both:

    Phi = C(k) W + N b + E,    RSS(k) = min over W, b of |Phi - C(k) W - N b|^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.nuisance import Nuisance, VehicleEstimate
from sparsefit.modes.refine import RANK, Projection, centred, columns

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True, eq=False)
class Rows:
    """What is fitted: q rows, averages of m positions or those themselves.

    position (m, 2) [m], centred; target (q, 2), Phi [m/s] of the believed vehicle; columns N
    (2, q, p); operator Psi (q, m) or None; scanned: N's series (j, m') at the samples that the
    refinement scans; correlation: rows over which errors correlate, None where it is that of the
    samples.
    """

    position: Array
    target: Array
    nuisance: Nuisance
    columns: Array
    scanned: Array
    operator: csr_array | None = None
    correlation: float | None = None

    @classmethod
    def of(
        cls, samples: Samples, vehicle: PointMassVehicle, unknown: tuple[str, ...]
    ) -> Rows | None:
        """The rows of a flight's samples; None where these are plain samples of Phi."""
        weak, nuisance = samples.weak, Nuisance(unknown, vehicle)
        if weak is None and not unknown:
            return None
        scanned, source = nuisance.series(samples.velocity), weak or samples
        return cls(
            centred(source.position),
            source.flow_velocity(vehicle),
            nuisance,
            nuisance.columns(source.velocity) if unknown else np.zeros((2, len(source.time), 0)),
            scanned,
            weak.operator if weak else None,
            weak.correlation if weak else None,
        )

    @property
    def remainder(self) -> Array:
        """What the nuisance columns leave of Phi, (q, 2)."""
        left = self._stacked - self._nuisance @ self._regressed(self._nuisance)
        return left.reshape(2, -1).T

    @property
    def null_residual(self) -> float:
        """RSS of a uniform wind and the nuisance columns."""
        one = np.kron(np.eye(2), np.ones((len(self.target), 1)))
        both = np.hstack([self._nuisance, one])
        return float(np.sum((self._stacked - both @ self._regressed(both)) ** 2))

    @property
    def _stacked(self) -> Array:
        return self.target.T.ravel()

    @property
    def _nuisance(self) -> Array:
        return self.columns.reshape(2 * len(self.target), -1)

    def _regressed(self, design: Array) -> Array:
        return _solved(design, self._stacked)

    def project(self, wavenumber: float) -> Projection:
        """The fit at one k, with the Gauss-Newton move in k, as `refine.project` makes it."""
        return self._fit(wavenumber)[0]

    def vehicle(self, length_scale: float) -> VehicleEstimate:
        """The vehicle and the wind that fit best at a length scale [m]."""
        return self.nuisance.read(self._fit(math.pi / length_scale)[1])

    def weights(self, length_scale: float) -> Array:
        """W (8, 2) [m/s] at a length scale [m], in units of the true Phi."""
        fit, found = self._fit(math.pi / length_scale)
        ratio = 1.0 - found[0] if self.nuisance.shared else 1.0
        return fit.weights / ratio

    def solved(self, wavenumber: float) -> tuple[Array, Array]:
        """W (8, 2) and b (p,) at one k [1/m], as fitted to Phi of the believed vehicle."""
        fit, found = self._fit(wavenumber)
        return fit.weights, found

    def _fit(self, wavenumber: float) -> tuple[Projection, Array]:
        value, slope = columns(self.position, wavenumber)
        if self.operator is not None:
            value, slope = self.operator @ value, self.operator @ slope
        scale = np.sqrt(np.einsum("ij,ij->j", value, value))
        scale[scale == 0] = 1.0
        roots, vectors = np.linalg.eigh(value.T @ value / np.outer(scale, scale))
        kept = roots > RANK * roots[-1]
        basis = vectors[:, kept] / np.sqrt(roots[kept]) / scale[:, None]  # value basis: orthonormal

        def loaded(columns: Array) -> Array:
            onto: Array = basis @ (basis.T @ (value.T @ columns))
            return onto

        def freed(columns: Array) -> Array:  # twice, as the basis is orthonormal to 1e-10 only
            once = columns - value @ loaded(columns)
            return once - value @ loaded(once)

        # Both components in one column: they share the coefficient of v.
        design = np.vstack([freed(one) for one in self.columns])
        rest = freed(self.target).T.ravel()
        found = _solved(design, rest)
        rest = rest - design @ found
        weights = loaded(self.target - (self.columns @ found).T)
        bend = freed(slope @ weights).T.ravel()
        bend = bend - design @ _solved(design, bend)
        curvature = float(np.sum(bend * bend))
        move = float(np.sum(rest * bend)) / curvature if curvature > 0 else 0.0
        return Projection(wavenumber, float(np.sum(rest * rest)), weights, move), found

    def reduced(self, products: Array) -> Array:
        """RSS (c,) from products (c, 2 + j, 2 + j) of Phi_x, Phi_y and `scanned`, freed of C(k)."""
        pairs = [[None if i is None else i + 2 for i in pair] for pair in self.nuisance.pairs]
        gram = np.zeros((len(products), len(pairs), len(pairs)))
        load = np.zeros((len(products), len(pairs), 1))
        for component in range(2):
            for row, one in enumerate(pair[component] for pair in pairs):
                if one is None:
                    continue
                load[:, row, 0] += products[:, one, component]
                for column, other in enumerate(pair[component] for pair in pairs):
                    if other is not None:
                        gram[:, row, column] += products[:, one, other]
        sizes = np.trace(gram, axis1=1, axis2=2)[:, None, None]
        gram += 1e-9 * sizes * np.eye(len(pairs))  # above the error of the sums
        explained = np.sum(load * np.linalg.solve(gram, load), axis=(1, 2))
        found: Array = products[:, 0, 0] + products[:, 1, 1] - explained
        return found


def _solved(design: Array, values: Array) -> Array:
    """Least squares of values (r,) on design (r, p)."""
    return np.linalg.lstsq(design, values, rcond=None)[0].astype(float, copy=False)
