"""Losses that a penalty may be added to, each by its value and its dual.

With R = Y - Z V, u the loss's derivative by R (times m), and for each target t

    r_t = |u_t|^2/m,   q_t = <u_t, Y_t>/m,   f_t = <u_t, R_t>/m,

    Squares:      P = sum_t |R_t|^2/2m,        u = R            D(s) = sum_t s_t q_t - s_t^2 r_t/2
    Huber:        P = sum h(R)/m,              u = clip(R, c)   the same, |s_t| <= 1
    RootSquares:  P = y |R|_F/sqrt(m),         u = R            D(s) = s sum_t q_t,  s <= y/sqrt(r)

are P and the dual value at the point s u/m, which is feasible as far as the penalty lets s be. The
factor y = |Y|_F/sqrt(m), a constant, gives alpha one unit and one alpha_max in all of them.

Sources: Huber, Ann. Math. Statist. 35 (1964) 73-101; Belloni, Chernozhukov and Wang, Biometrika 98
(2011) 791-806, for the root.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array


@dataclass(frozen=True)
class Squares:
    """Half the mean square, |R|^2/2m; with a finite ``clip`` Huber's loss.

    clip: c, in units of the size s_t = 1.48 median |Y_t| of each target, the standard deviation of
    normal values, which a few outliers do not change: residuals beyond c s_t count linearly.
    """

    clip: float = np.inf
    coupled: ClassVar[bool] = False

    def bound(self, target: Array) -> Array:
        """The largest |u| (n,) for targets (m, n); by their rms where more than half are 0."""
        if np.isinf(self.clip):
            return np.full(target.shape[1], np.inf)
        size = 1.4826 * np.median(np.abs(target), axis=0)
        size = np.where(size > 0, size, np.sqrt(np.mean(np.square(target), axis=0)))
        return np.where(size > 0, self.clip * size, np.inf)

    def pull(self, residual: Array, target: Array) -> Array:
        """The u (m, n) of a residual R (m, n), with targets (m, n)."""
        reach = self.bound(target)
        return np.clip(residual, -reach, reach)

    def primal(self, square: Array, overlap: Array, level: Array) -> Array:
        """P (p,) from r, f (p, n) and y (n,)."""
        total: Array = (overlap - 0.5 * square).sum(axis=1)
        return total

    def factor(self, square: Array, product: Array, limit: Array, level: Array) -> Array:
        """The s (p, n), or (p, 1), that maximises D where |s| <= limit."""
        most = limit if np.isinf(self.clip) else np.minimum(limit, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            best = np.where(square > 0, product / square, 0.0)
        return np.clip(best, -most, most)

    def dual(self, s: Array, square: Array, product: Array) -> Array:
        """D by target (p, n) at s."""
        return s * product - 0.5 * s**2 * square


@dataclass(frozen=True)
class RootSquares(Squares):
    """The root of the mean square over all targets, y |R|_F/sqrt(m)."""

    coupled: ClassVar[bool] = True

    def pull(self, residual: Array, target: Array) -> Array:
        size = float(np.linalg.norm(residual)) or 1.0
        return residual * (float(np.linalg.norm(target)) / size)

    def primal(self, square: Array, overlap: Array, level: Array) -> Array:
        value: Array = np.sqrt(np.sum(level**2)) * np.sqrt(square.sum(axis=1))
        return value

    def factor(self, square: Array, product: Array, limit: Array, level: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.sqrt(np.sum(level**2)) / np.sqrt(square.sum(axis=1, keepdims=True))
        least = np.minimum(limit.min(axis=1, keepdims=True), reach)
        return np.where(np.isfinite(least), least, 0.0)  # a target of zero, too

    def dual(self, s: Array, square: Array, product: Array) -> Array:
        return s * product


SQUARES = Squares()
