"""Optima of penalties that are piecewise linear, on the face of the penalty where they lie.

Near its optimum V such a penalty p = alpha norm is linear on a face, V = F + N z, N'N = I: of the
LASSO the coefficients that are not zero, of SLOPE clusters of equal ones, of bounds those inside.
From U = V + s (C - mu V), C = B - G V, mu the ridge, the prox P of U tells F and N and the slope
S = (U - P)/s, and the next V is the optimum of the face,

    N'(G + mu I) N z = N'(B - S - (G + mu I) F),

which is the primal-dual active set method; from a point nearby it ends in a few steps.

Source: Hintermueller, Ito and Kunisch, SIAM J. Optim. 13 (2003) 865-888.
"""

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.ordered_penalties import FusedNorm, SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, BoundedValues, Penalty
from sparsefit.solvers.newton import Normal, definite, relative_gap

LINEAR = (AbsoluteValues, BoundedValues, SortedNorm, FusedNorm)
"""The penalties that are linear on faces, with a `slope` that is a projection."""
FACES, PATIENCE = 25, 4  # the most steps, and those without half the gap
SHIFT = 1e-13  # of unit columns, where a face has more directions than samples


def on_a_face(
    normal: Normal, cross: Array, penalty: Penalty, alpha: float, values: Array, goal: float
) -> tuple[Array, float, int]:
    """The optimum (j, q) near ``values``, or what came nearest to it, its relative gap, and steps.

    cross B (j, q), for a target of |Y|^2/m = 1; the gap is infinite where no face was solved.
    """
    mu, step, waited, best, least = alpha * penalty.ridge, 1.0, 0, values, np.inf
    correlation, count = cross - normal.times(values), 0
    while type(penalty) in LINEAR and least > goal and waited <= PATIENCE and count < FACES:
        pull = values + step * (correlation - mu * values)
        point = penalty.prox(pull, step * alpha)
        after = _optimum_of_face(normal, cross, penalty, (pull, point), step, (alpha, mu))
        if after is None:
            break
        values, correlation, count = after, cross - normal.times(after), count + 1
        gap = relative_gap(values, correlation, cross, penalty, alpha)
        waited = 0 if gap < 0.5 * least else waited + 1
        if gap < least:
            best, least = values, gap
        if waited % 2:  # a shorter step breaks a circle
            step *= 0.5
    return best, least, count


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
    flat = right.ravel()[on]
    flat = flat if factor is None else factor.T @ flat
    if not len(flat):
        return fixed.reshape(point.shape)
    if normal.rows is not None and len(flat) > normal.samples * point.shape[1]:
        return None  # more directions than rows hold
    square = normal.within(on, factor, point.shape[1])
    square.flat[:: len(square) + 1] += mu + SHIFT
    z = definite(square, flat)
    if z is None:
        return None
    out = fixed.ravel()
    out[on] += z if factor is None else factor @ z
    return out.reshape(point.shape)
