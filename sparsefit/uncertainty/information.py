"""What rows tell of parameters theta: J'J, its pseudo-inverse, and the directions it is silent on.

One rule says which directions are not told, for the fit (`sparsefit.modes.projection`), for
standard errors and for their bound: with columns of J scaled to unit length, an eigenvalue of J'J
below RANK = 1e-12 of the largest is null. Rounding leaves some 1e-15 in J'J, so that what is kept
is known to 0.1 %; the fit drops the same directions, and a bound that kept more would be that of
another estimator.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.cached import cached_property
from sparsefit.modes.projection import RANK

LOST = 1e-6  # a gradient with more than this, relative, in the null space: not told


@dataclass(frozen=True, eq=False)
class Information:
    """The eigenvalues and eigenvectors of J'J (n, n) in scaled columns.

    Args:
        roots: eigenvalues (n,), rising.
        vectors: their eigenvectors (n, n), in columns.
        kept: which of them are no null directions (n,).
        scale: lengths of the columns of J (n,), 1 for a column of zeros.
        tangent: the directions (N, n) that parameters (N,) can move along; None: all.

    With a tangent J is that of steps along it, and n its columns.
    """

    roots: Array
    vectors: Array
    kept: BoolArray
    scale: Array
    tangent: Array | None = None

    @classmethod
    def of(cls, gram: Array, tangent: Array | None = None) -> Information:
        """The information of J'J (N, N), of steps along a tangent (N, n)."""
        if tangent is not None:
            gram = tangent.T @ gram @ tangent
        scale = np.sqrt(np.diagonal(gram))
        scale = np.where(scale > 0, scale, 1.0)
        roots, vectors = np.linalg.eigh(gram / np.outer(scale, scale))
        return cls(roots, vectors, roots > RANK * roots[-1], scale, tangent)

    @property
    def whole(self) -> bool:
        """Whether the rows tell every direction of theta."""
        return bool(self.kept.all())

    @cached_property
    def basis(self) -> Array:
        """B (n, rank) with J B orthonormal: (J'J)^+ = B B'."""
        kept = self.kept
        basis: Array = self.vectors[:, kept] / self.scale[:, None] / np.sqrt(self.roots[kept])
        return basis if self.tangent is None else self.tangent @ basis

    def solved(self, values: Array) -> Array:
        """(J'J)^+ values, of values (n,) or (n, f)."""
        solved: Array = self.basis @ (self.basis.T @ values)
        return solved

    def lost(self, gradients: Array) -> BoolArray:
        """Which functions of theta, by their gradients (f, n), the rows do not tell."""
        own = gradients if self.tangent is None else gradients @ self.tangent
        turned = self.vectors.T @ (own / self.scale).T
        hidden, whole = (np.linalg.norm(part, axis=0) for part in (turned[~self.kept], turned))
        lost: BoolArray = ~(hidden <= LOST * whole)
        return lost
