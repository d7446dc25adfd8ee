"""Losses that a penalty is added to: their value, derivative and dual.

With R = Y - Z V, u the loss's derivative by R (times m), and for each target t

    r_t = |u_t|^2/m,   q_t = <u_t, Y_t>/m,   f_t = <u_t, R_t>/m,

    Squares:      P = sum_t |R_t|^2/2m,        u = R            D(s) = sum_t s_t q_t - s_t^2 r_t/2
    Huber:        P = sum h(R)/m,              u = clip(R, c)   the same, |s_t| <= 1
    RootSquares:  P = y |R|_F/sqrt(m),         u = R            D(s) = s sum_t q_t,  s <= y/sqrt(r)

are P and the dual value at the point s u/m, feasible for the s that the penalty admits. The factor
y = |Y|_F/sqrt(m), a constant, gives alpha one unit and one alpha_max in all of them.

Sources: Huber, Ann. Math. Statist. 35 (1964) 73-101; Belloni, Chernozhukov and Wang, Biometrika 98
(2011) 791-806, for the root.
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array


@dataclass(frozen=True)
class Squares:
    """Half the mean square, |R|^2/2m; with a finite ``clip`` Huber's loss.

    clip: c, in units of the size s_t = 1.48 median |Y_t| of each target, the standard deviation of
    normal values, which a few outliers do not change: residuals beyond c s_t count linearly.
    roots (m,): of the sample weights that rows of R and Y are multiplied by, where there are any;
    the knot and the median are those of the rows without them. direction e (m,), |e| = 1: the
    intercept's column beside Huber's loss, which is min over b of sum h(R - b e)/m then;
    u = clip(R - b e), e'u = 0, and Y_t in s_t is less its median along e. Squares need none of
    these: their columns and targets are weighted, and projected off e.
    """

    clip: float = np.inf
    roots: Array | None = field(default=None, compare=False, repr=False)
    direction: Array | None = field(default=None, compare=False, repr=False)
    coupled: ClassVar[bool] = False

    def _median(self, target: Array) -> Array:
        """The weighted medians (n,) of targets (m, n) without the roots of the weights."""
        roots = np.ones(len(target)) if self.roots is None else self.roots
        on = roots > 0
        values, weight = target[on] / roots[on, None], roots[on] ** 2
        order = np.argsort(values, axis=0)
        share = np.cumsum(weight[order], axis=0) / weight.sum()
        ends = [np.argmax(share > 0.5 + side, axis=0) for side in (-1e-12, 1e-12)]
        places = np.take_along_axis(order, np.stack(ends), axis=0)
        middle: Array = 0.5 * np.take_along_axis(values, places, axis=0).sum(axis=0)
        return middle

    def centred(self, target: Array) -> Array:
        """Targets (m, n) less their median in units of the direction, where there is one."""
        if self.direction is None:
            return target
        along = np.ones(len(target)) if self.roots is None else self.roots
        return target - np.multiply.outer(along, self._median(target))

    def bound(self, target: Array) -> Array:
        """The largest |u| (1, n), or (m, n) with weights, for targets (m, n).

        By the rms of the target where more than half of it are 0.
        """
        if np.isinf(self.clip):
            return np.full((1, target.shape[1]), np.inf)
        rounding = 64.0 * np.finfo(float).eps * np.abs(target).max(axis=0, initial=0.0)
        target = self.centred(target)
        size = 1.4826 * self._median(np.abs(target))
        size = np.where(size > rounding, size, np.sqrt(np.mean(np.square(target), axis=0)))
        knot = self.clip * np.where(size > 0, size, 1.0)[None]
        if self.roots is None:
            return knot
        return knot * np.where(self.roots > 0, self.roots, 1.0)[:, None]

    def level(self, residual: Array, reach: Array) -> Array:
        """The b (q,) at which e'clip(R - b e) = 0, R (m, q), reach as of `bound`; 0 without e."""
        if self.direction is None:
            return np.zeros(residual.shape[1])
        on = self.direction > 0
        rows, along = residual[on], self.direction[on, None]
        reach = np.broadcast_to(reach, residual.shape)[on]
        low, high = (rows / along).min(axis=0), (rows / along).max(axis=0)
        level = np.median(rows / along, axis=0)
        for _ in range(100):  # Newton's method in a bracket: the function is piecewise linear
            rest = rows - along * level
            pull = (along * np.clip(rest, -reach, reach)).sum(axis=0)
            slope = (along * along * (np.abs(rest) < reach)).sum(axis=0)
            low, high = np.where(pull >= 0, level, low), np.where(pull <= 0, level, high)
            newton = level + pull / np.where(slope > 0, slope, 1.0)
            inside = (slope > 0) & (newton >= low) & (newton <= high)
            last, level = level, np.where(inside, newton, 0.5 * (low + high))
            if np.all(np.abs(level - last) <= 1e-16 * np.abs(last)):
                break
        return level

    def pull(self, residual: Array, target: Array) -> Array:
        """The u (m, n) of a residual R (m, n), with targets (m, n)."""
        return self.clipped(residual, self.bound(target))[1]

    def clipped(self, residual: Array, reach: Array) -> tuple[Array, Array]:
        """R - b e and u (m, q) of a residual R (m, q), |u| <= reach (1, q) or (m, q)."""
        if self.direction is not None:
            residual = residual - np.multiply.outer(self.direction, self.level(residual, reach))
        return residual, np.clip(residual, -reach, reach)

    def primal(self, square: Array, overlap: Array, level: Array) -> Array:
        """P (p,) from r, f (p, n) and y (n,)."""
        total: Array = (overlap - 0.5 * square).sum(axis=1)
        return total

    def factor(self, square: Array, product: Array, limit: Array, level: Array) -> Array:
        """The s (..., p, n), or (..., p, 1), that maximises D where |s| <= limit."""
        most = limit if np.isinf(self.clip) else np.minimum(limit, 1.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            best = np.where(square > 0, product / square, 0.0)
        return np.clip(best, -most, most)

    def dual(self, s: Array, square: Array, product: Array) -> Array:
        """D by target (..., p, n) at s."""
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
            reach = np.sqrt(np.sum(level**2)) / np.sqrt(square.sum(axis=-1, keepdims=True))
        least = np.minimum(limit.min(axis=-1, keepdims=True), reach)
        return np.where(np.isfinite(least), least, 0.0)  # a target of zero, too

    def dual(self, s: Array, square: Array, product: Array) -> Array:
        return s * product


SQUARES = Squares()
