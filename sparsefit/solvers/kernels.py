"""Exact paths on the columns in play, which go on from weights at some penalties.

A kernel solves at descending penalties on the sums of the columns in play, in units of the target.
Where a column outside objects to a point, the path goes on from the penalty before, with that
column beside the others and what was solved meanwhile as a start. ``homotopy``, ``variances`` and
``sweeps`` are compiled; where they are not built, the generic Newton's method runs in their place,
slower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.group_penalties import GroupNorms, in_order
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.newton import (
    Columns,
    dual_share,
    relative_gap,
    settled,
    towards_clusters_optimum,
)

STOP = 1e-11  # relative gap, far below any tolerance that a certificate is asked to meet
DESCENDED = 1e-9  # that of descent, which converges linearly
EXTRAPOLATED = 5  # sweeps that descent extrapolates from
MOST = 300  # sweeps at one penalty, before the variances take over
CLUSTERED, SWEEPS = 500, 30  # rounds for clusters at one penalty, and the most sweeps of one
ALIKE = 20  # rounds, after which the optimum of each face is taken, as columns are too much alike
POWERS = 20  # of G, for the length of a gradient's step


@dataclass(frozen=True, eq=False)
class Points:
    """Weights V (p, k, n) of columns of unit rms along a path of p penalties.

    complete (p,): whether each is a solution; steps (p,) taken; words: by what, for a status.
    """

    weights: Array
    complete: BoolArray
    steps: IntArray
    words: str = ""

    @classmethod
    def zeros(cls, count: int, cross: Array, words: str = "") -> Points:
        """Those where all weights are zero, and solutions; cross Z'Y/m (k, n)."""
        shape = (count, *cross.shape)
        return cls(np.zeros(shape), np.ones(count, bool), np.zeros(count, np.intp), words)


Attempts = dict[float, Array]
"""V (j, q) by penalty: the last that was accepted, whose penalty is the largest, and later ones."""
Kernel = Callable[[Columns, Array, Attempts, float], Points]
"""A path at further penalties (p,), descending, from attempts, to a relative gap."""
BEGIN: float = np.inf
"""The penalty of an attempt of zeros: the start of a path."""


def compiled(name: str) -> Any:
    """The compiled source of that name; None where it was not built."""
    try:
        return import_module(f"sparsefit.solvers.{name}")
    except ImportError:
        return None


def _nearest(attempts: Attempts, alpha: float) -> Array:
    return attempts[min(attempts, key=lambda each: abs(each - alpha))]


def homotopy(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """The LASSO or elastic net of one target, from event to event; z_j/omega_j has omega_j v_j."""
    assert isinstance(on.penalty, AbsoluteValues)
    assert on.gram is not None
    least = float(on.penalty.weights.min())
    omega, gram, pull = on.penalty.weights / least, on.gram, on.cross[:, 0]
    if np.any(omega != 1.0):
        gram, pull = gram / np.multiply.outer(omega, omega), pull / omega
    height = float(np.abs(pull).max()) or 1.0
    unit, scale = height / least, height / omega
    ridge = on.penalty.ridge * unit / omega**2
    walk = compiled("homotopy").Homotopy(np.ascontiguousarray(gram), pull / height, ridge)
    last = max(attempts)
    if last < BEGIN:
        walk.start(attempts[last][:, 0] / scale, last / unit)
    values, complete = np.zeros((len(alphas), len(omega))), np.zeros(len(alphas), bool)
    with np.errstate(all="ignore"):
        # Rounding must let no column in at alpha_max.
        walk.advance(alphas / unit * (1.0 + 1e-15), values, complete)
    steps, values = np.zeros(len(alphas), np.intp), (values * scale)[:, :, None]
    steps[-1] = walk.steps
    for i in np.flatnonzero(~complete):  # on columns that nearly depend on each other
        values[i], gap, _ = settled(on, float(alphas[i]), values[i], stop)
        complete[i] = gap <= stop
    return Points(values, complete, steps)


def newton(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """Any penalty, by proximal points, each started from the penalty before."""
    values, points = attempts[max(attempts)], Points.zeros(len(alphas), on.cross)
    for i, alpha in enumerate(alphas.tolist()):
        values, gap, points.steps[i] = settled(on, alpha, values, stop)
        points.weights[i], points.complete[i] = values, gap <= stop
    return points


def variational(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """Group norms over all targets at hand, by Newton's method on the groups' variances."""
    assert isinstance(on.penalty, GroupNorms)
    assert on.gram is not None
    groups, weights, gram, pull = on.penalty.groups, on.penalty.weights, on.gram, on.cross
    order, starts = in_order(groups, len(weights))
    if order is not None:
        groups, pull, gram = groups[order], pull[order], gram[np.ix_(order, order)]
    scale = weights[groups, None]
    if np.any(weights != 1.0):
        pull, gram = pull / scale, gram / (scale * scale.T)
    alpha = min(attempts, key=lambda each: abs(each - alphas[0]))
    start = on.penalty.block_norms(attempts[alpha]).max(axis=1)  # |W_g| = eta_g alpha there
    sources, ends = compiled("variances"), np.append(starts, len(groups))
    problem = sources.Groups(np.ascontiguousarray(gram), np.ascontiguousarray(pull.T), ends)
    search = sources.Search(problem, start * weights / alpha, stop)
    points = Points.zeros(len(alphas), on.cross)
    place = slice(None) if order is None else order
    with np.errstate(all="ignore"):  # what breaks is caught by the gap, not by warnings
        for i, alpha in enumerate(alphas.tolist()):
            solved, gap, points.steps[i] = search.minimised(alpha)
            points.weights[i, place], points.complete[i] = solved.T / scale, gap <= stop
    return points


def block_descent(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """Group norms by block descent with extrapolation, for many columns in use beside the rows.

    The columns of a group are neighbours, and orthogonal. Source: Bertrand and Massias, "Anderson
    acceleration of coordinate descent" (AISTATS 2021).
    """
    assert isinstance(on.penalty, GroupNorms)
    assert on.rows is not None
    assert on.target is not None
    rows, target, samples = on.rows, on.target.T, float(on.samples)
    starts = np.flatnonzero(np.diff(on.penalty.groups, prepend=-1, append=-1))
    weights = on.penalty.weights[on.penalty.groups[starts[:-1]]]
    square, attempts = np.einsum("ij,ij->j", rows, rows) / samples, dict(attempts)
    points = Points.zeros(len(alphas), on.cross)
    trail = [np.empty((EXTRAPOLATED + 2, *part.shape)) for part in (on.cross.T, target)]
    sweep = compiled("sweeps").descend_groups

    def norms(values: Array) -> Array:
        sizes: Array = np.sqrt(np.add.reduceat(np.square(values).sum(axis=0), starts[:-1]))
        return sizes

    def height_of(values: Array, residual: Array, alpha: float) -> float:
        square = float(np.vdot(residual, residual)) / samples
        return 0.5 * square + alpha * float(weights @ norms(values))

    for i, alpha in enumerate(alphas.tolist()):
        values = _nearest(attempts, alpha).T
        residual = target - values @ rows.T
        while True:
            sizes, pull = norms(values), norms(residual @ rows) / (samples * weights)
            product, left = (float(np.vdot(residual, y)) / samples for y in (target, residual))
            s = dual_share(product, left, float(pull.max()), alpha)
            gap = 2.0 * (height_of(values, residual, alpha) - s * product + 0.5 * s * s * left)
            if gap <= stop or points.steps[i] >= MOST:
                break
            points.steps[i] += 1 + EXTRAPOLATED
            trail[0][0], trail[1][0] = values, residual
            used = np.flatnonzero((sizes > 0.0) | (pull > alpha))
            sweep(rows, starts, used, alpha * weights, square, samples, *trail)
            moves = np.diff(trail[0][1:], axis=0).reshape(EXTRAPOLATED, -1)
            inner = moves @ moves.T
            inner.flat[:: EXTRAPOLATED + 1] += 1e-12 * np.trace(inner) + 1e-300
            share = np.linalg.solve(inner, np.ones(EXTRAPOLATED))
            values, residual = (np.tensordot(share / share.sum(), part[2:], 1) for part in trail)
            if height_of(values, residual, alpha) > height_of(trail[0][-1], trail[1][-1], alpha):
                values, residual = (part[-1].copy() for part in trail)
        attempts[alpha] = points.weights[i] = values.T
        points.complete[i] = gap <= stop
        if gap > stop == DESCENDED:  # columns are too much alike
            whole = replace(on, gram=rows.T @ rows / samples)
            rest = variational(whole, alphas[i:], attempts, STOP)
            for part, other in zip(
                (points.weights, points.complete, points.steps),
                (rest.weights, rest.complete, rest.steps),
                strict=True,
            ):
                part[i:] = other
            break
    return points


def cluster_descent(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """SLOPE of one target: proximal gradients split clusters of equal |v|, and sweeps move them.

    Where a round of sweeps leaves the clusters as they were, their optimum is taken at once.
    Source: Larsson, Klopfenstein, Massias and Wallin, "Coordinate descent for SLOPE" (2023).
    """
    assert isinstance(on.penalty, SortedNorm)
    assert on.gram is not None
    gram, attempts, x = (
        np.ascontiguousarray(on.gram),
        dict(attempts),
        np.cos(np.arange(len(on.gram))),
    )
    for _ in range(POWERS):  # of an x that is not orthogonal to what opposite columns share
        x = gram @ (x / np.linalg.norm(x))
    step, sweep = 1.0 / (1.05 * np.linalg.norm(x)), compiled("sweeps").descend_clusters
    points = Points.zeros(len(alphas), on.cross)
    for i, alpha in enumerate(alphas.tolist()):
        values, gap = _nearest(attempts, alpha), np.inf
        price = alpha * np.concatenate([[0.0], np.cumsum(on.penalty.weights)])
        for rounds in range(CLUSTERED):
            points.steps[i] = rounds
            pull = on.cross - on.times(values)
            gap = relative_gap(on, alpha, values, pull)
            if gap <= stop:
                break
            values = on.penalty.prox(values + step * pull, step * alpha)
            pull = on.cross - on.times(values)
            going = sweep(gram, price, pull[:, 0], values[:, 0], SWEEPS) or rounds >= ALIKE
            while going:
                values, met = towards_clusters_optimum(on, alpha, values)
                going = met and rounds >= ALIKE
        if gap > stop:
            values, gap, taken = settled(on, alpha, values, stop)
            points.steps[i] += taken
        attempts[alpha] = points.weights[i] = values
        points.complete[i] = gap <= stop
    return points


KERNELS: dict[str, Kernel] = {
    "homotopy": homotopy,
    "newton": newton,
    "variational": variational,
    "block descent": block_descent,
    "cluster descent": cluster_descent,
}


def kernel_for(penalty: Penalty, targets: int) -> str:
    """The fastest kernel for a penalty on so many targets, whose groups in use are few."""
    if type(penalty) is AbsoluteValues and targets == 1 and compiled("homotopy"):
        return "homotopy"
    if not penalty.ridge and isinstance(penalty, GroupNorms) and compiled("variances"):
        return "variational"
    slope = type(penalty) is SortedNorm and not penalty.ridge
    return "cluster descent" if slope and targets == 1 and compiled("sweeps") else "newton"


def path_on_gram(
    gram: Array, cross: Array, penalty: Penalty, alphas: Array, square: float
) -> Points:
    """The path of targets that are solved together, on all columns: G (k, k), B (k, q), |Y|^2/m."""
    level, name = float(np.sqrt(square)), kernel_for(penalty, cross.shape[1])
    on = Columns(penalty.in_units(level), cross / level, 0, gram)
    points = KERNELS[name](on, alphas / level, {BEGIN: np.zeros(cross.shape)}, STOP)
    return replace(points, weights=points.weights * level, words=f"{name}, all columns")
