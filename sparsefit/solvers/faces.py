"""Optima of penalties that are piecewise linear, on the face of the penalty where they lie.

Near its optimum V such a penalty p = alpha norm is linear on a face, V = F + N z, N'N = I: of the
LASSO the coefficients that are not zero, of SLOPE clusters of equal ones, of bounds those inside.
From U = V + s (C - mu V), C = B - G V, mu the ridge, the prox P of U tells F and N and the slope
S = (U - P)/s, and the next V is the optimum of the face,

    N'(G + mu I) N z = N'(B - S - (G + mu I) F),

which is the primal-dual active set method; from a point nearby it ends in a few steps. For the
LASSO, and where that goes round in circles, signs are followed downhill: towards the optimum for
the signs at hand, as far as the objective falls, in one exact search over all changes of sign.

Sources: Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888; Lee, Battle, Raina and
Ng, "Efficient sparse coding algorithms" (NeurIPS 2006).
"""

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.ordered_penalties import FusedNorm, SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, BoundedValues, Penalty
from sparsefit.solvers.newton import Normal, definite, relative_gap

LINEAR = (AbsoluteValues, BoundedValues, SortedNorm, FusedNorm)
"""The penalties that are linear on faces, with a `slope` that is a projection."""
FACES, SIGNS = 25, 15  # the most steps of each method
PATIENCE = 4  # faces without half the gap; one where signs can be followed instead
EXACT = 1e-11  # relative: a correlation that near to its limit is at it
SHIFT = 1e-13  # of unit columns, where a face has more directions than samples


def on_a_face(
    normal: Normal, cross: Array, penalty: Penalty, alpha: float, values: Array, goal: float
) -> tuple[Array, float, int] | None:
    """The optimum (j, q) near ``values``, its relative gap <= goal, and steps; None if not found.

    cross B (j, q), for a target of |Y|^2/m = 1.
    """
    if type(penalty) not in LINEAR:
        return None
    signs = type(penalty) is AbsoluteValues and normal.gram is not None
    found = _by_faces(normal, cross, penalty, alpha, values, goal, 1 if signs else PATIENCE)
    if found is None and signs:
        assert isinstance(penalty, AbsoluteValues)
        columns = [
            _Signs(normal, cross[:, t], alpha * penalty.weights, alpha * penalty.ridge)
            for t in range(cross.shape[1])
        ]
        parts = [part.followed(values[:, t]) for t, part in enumerate(columns)]
        after = np.stack([part[0] for part in parts], axis=1)
        gap = relative_gap(after, cross - normal.times(after), cross, penalty, alpha)
        found = (after, gap, sum(part[1] for part in parts)) if gap <= goal else None
    return found


def _by_faces(
    normal: Normal,
    cross: Array,
    penalty: Penalty,
    alpha: float,
    values: Array,
    goal: float,
    patience: int,
) -> tuple[Array, float, int] | None:
    mu, step, waited, least = alpha * penalty.ridge, 1.0, 0, np.inf
    correlation = cross - normal.times(values)
    for count in range(1, FACES + 1):
        pull = values + step * (correlation - mu * values)
        point = penalty.prox(pull, step * alpha)
        after = _optimum_of_face(normal, cross, penalty, (pull, point), step, (alpha, mu))
        if after is None:
            return None
        values, correlation = after, cross - normal.times(after)
        gap = relative_gap(values, correlation, cross, penalty, alpha)
        if gap <= goal:
            return values, gap, count
        waited = 0 if gap < 0.5 * least else waited + 1
        least = min(gap, least)
        if waited > patience:
            return None
        if waited % 2:  # a shorter step breaks a circle
            step *= 0.5
    return None


def _optimum_of_face(
    normal: Normal,
    cross: Array,
    penalty: Penalty,
    points: tuple[Array, Array],
    step: float,
    strengths: tuple[float, float],
) -> Array | None:
    """F + N z of the face of P, ``points`` being U and P, ``strengths`` alpha and mu."""
    (pull, point), (alpha, mu) = points, strengths
    if not point.any():
        return point
    on, factor = penalty.slope(pull, point, step * alpha)
    fixed: Array = point.ravel().copy()
    fixed[on] -= fixed[on] if factor is None else factor @ (factor.T @ fixed[on])
    fixed = fixed.reshape(point.shape)
    right = cross - (pull - point) / step
    if fixed.any():
        right = right - normal.times(fixed) - mu * fixed
    column, target = np.divmod(on, point.shape[1])
    flat = right.ravel()[on]
    flat = flat if factor is None else factor.T @ flat
    if not len(flat):
        return fixed.reshape(point.shape)
    if normal.gram is None and len(flat) > normal.samples * point.shape[1]:
        return None  # more directions than rows hold
    square = normal.among(column)
    if point.shape[1] > 1:
        square = np.where(target[:, None] == target, square, 0.0)
    if factor is not None:
        square = factor.T @ (factor.T @ square).T
    square.flat[:: len(square) + 1] += mu + SHIFT
    z = definite(square, flat)
    if z is None:
        return None
    out = fixed.ravel()
    out[on] += z if factor is None else factor @ z
    return out.reshape(point.shape)


@dataclass(frozen=True, eq=False)
class _Signs:
    """1/2 v'(G + mu I)v - b'v + sum_j w_j |v_j| of one target: limits w (j,), the ridge mu."""

    normal: Normal
    cross: Array
    limits: Array
    ridge: float

    def followed(self, values: Array) -> tuple[Array, int]:
        """The optimum v (j,), or how far `SIGNS` steps went, and the steps."""
        v, fitted = values.copy(), self._times(values)
        for count in range(SIGNS):
            pull = self.cross - fitted - self.ridge * v
            used = v != 0
            joining = ~used & (np.abs(pull) > self.limits * (1.0 + EXACT))
            sign = np.where(used, np.sign(v), np.sign(pull))
            off = np.abs(pull - self.limits * sign)[used].max(initial=0.0)
            if not joining.any() and off < EXACT * self.limits.max():
                return v, count
            move = self._towards(v, used, joining, sign)
            if move is None:
                return v, count
            moved = self._times(move)
            share, zero = self._lowest(v, move, moved, pull, sign)
            v, fitted = v + share * move, fitted + share * moved
            v[zero] = 0.0
        return v, SIGNS

    def _times(self, values: Array) -> Array:
        return self.normal.times(values[:, None])[:, 0]

    def _towards(self, v: Array, used: BoolArray, joining: BoolArray, sign: Array) -> Array | None:
        """The move (j,) to the optimum for these signs; columns on the wrong side do not join."""
        index, x, move = np.flatnonzero(used | joining), v, -v
        for _ in range(4):
            square = self.normal.among(index)
            square.flat[:: len(square) + 1] += self.ridge
            solved = definite(square, self.cross[index] - self.limits[index] * sign[index])
            if solved is None:
                return None
            wrong = joining[index] & (solved * sign[index] <= 0)
            index, x = index[~wrong], solved[~wrong]
            if not wrong.any():
                break
        move[index] += x
        return move

    def _lowest(
        self, v: Array, move: Array, moved: Array, pull: Array, sign: Array
    ) -> tuple[float, IntArray]:
        """The share of a move at which the objective is least, and what is zero there."""
        flips = np.flatnonzero((v != 0) & (v * (v + move) <= 0))
        times = -v[flips] / move[flips]
        order = np.argsort(times)
        flips, times = flips[order], times[order]
        curvature = float(move @ moved) + self.ridge * float(move @ move)
        first = float(-(pull @ move) + (self.limits * move * sign).sum())
        jumps = 2.0 * self.limits[flips] * np.abs(move[flips])
        slopes = first + np.concatenate([[0.0], np.cumsum(jumps)])
        ends = np.append(times[times < 1.0], 1.0)
        rising = np.flatnonzero(slopes[: len(ends)] + curvature * ends >= 0)
        if not len(rising) or curvature <= 0:
            return 1.0, flips[:0]
        at = int(rising[0])
        begin = ends[at - 1] if at else 0.0
        share = float(np.clip(-slopes[at] / curvature, begin, ends[at]))
        return share, flips[np.abs(times - share) <= EXACT * share]
