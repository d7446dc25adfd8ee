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
from itertools import pairwise, starmap
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms, in_order
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.newton import Columns, relative_gap, settled, towards_clusters_optimum

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
Improved = Callable[[float, Array], tuple[Array, float, int]]
"""Weights (j, q) nearer to the optimum at a penalty than a start, their relative gap, and steps."""
BEGIN: float = np.inf
"""The penalty of an attempt of zeros: the start of a path."""


def compiled(name: str) -> Any:
    """The compiled source of that name; None where it was not built."""
    try:
        return import_module(f"sparsefit.solvers.{name}")
    except ImportError:
        return None


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


def _each(
    on: Columns, alphas: Array, attempts: Attempts, stop: float, improved: Improved
) -> Points:
    """The points from the nearest attempts; Newton's method ends what ``improved`` leaves."""
    attempts, points = dict(attempts), Points.zeros(len(alphas), on.cross)
    for i, alpha in enumerate(alphas.tolist()):
        start = attempts[min(attempts, key=lambda each: abs(each - alpha))]
        values, gap, points.steps[i] = improved(alpha, start)
        if gap > stop:
            values, gap, taken = settled(on, alpha, values, stop)
            points.steps[i] += taken
        attempts[alpha] = points.weights[i] = values
        points.complete[i] = gap <= stop
    return points


def newton(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """Any penalty, by proximal points."""
    return _each(on, alphas, attempts, stop, lambda alpha, start: (start, np.inf, 0))


def variational(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """Group norms over all targets at hand, by Newton's method on the groups' variances."""
    assert on.gram is not None
    outer, starts, weights = _groups(on.penalty)
    scale = outer.weights[outer.groups, None]
    unit = np.any(outer.weights != 1.0)
    gram, pull = (on.gram / (scale * scale.T), on.cross / scale) if unit else (on.gram, on.cross)
    alpha = min(attempts, key=lambda each: abs(each - alphas[0]))
    norms = np.sqrt(np.add.reduceat(np.square(attempts[alpha]).sum(axis=1), starts[:-1]))
    sources = compiled("variances")
    problem = sources.Groups(np.ascontiguousarray(gram), np.ascontiguousarray(pull.T), starts)
    search = sources.Search(problem, norms * weights / alpha, stop)  # |W_g| = eta_g alpha there

    def improved(alpha: float, start: Array) -> tuple[Array, float, int]:
        with np.errstate(all="ignore"):  # what breaks is caught by the gap, not by warnings
            values, gap, spent = search.minimised(alpha)
        return values.T / scale, gap, spent

    return _each(on, alphas, attempts, stop, improved)


def _groups(penalty: Penalty) -> tuple[GroupNorms, IntArray, Array]:
    """The norms of groups whose columns are neighbours, where each starts, and its weight."""
    outer = penalty.outer if isinstance(penalty, NestedNorms) else penalty
    assert isinstance(outer, GroupNorms)
    starts = np.flatnonzero(np.diff(outer.groups, prepend=-1, append=-1))
    return outer, starts, outer.weights[outer.groups[starts[:-1]]]


def block_descent(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """Norms of groups, and of coefficients within them, by block descent with extrapolation.

    The columns of a group are neighbours; without a norm within they are orthogonal. Sums have rows
    of their own, G = R'R. Newton's method ends what takes too many sweeps, as columns are alike.
    Source: Bertrand and Massias, "Anderson acceleration of coordinate descent" (AISTATS 2021).
    """
    penalty, inner = on.penalty, np.zeros(len(on.cross))
    (_, starts, weights), (rows, target, samples) = _groups(penalty), on.roots()
    square, sizes = np.einsum("ij,ij->j", rows, rows) / samples, np.diff(starts)
    if isinstance(penalty, NestedNorms):
        inner = penalty.inner.weights
        parts = [rows[:, part] for part in starmap(slice, pairwise(starts))]
        steepest = [np.linalg.eigvalsh(part.T @ part)[-1] for part in parts]
        square = np.repeat(np.array(steepest) / samples, sizes)
    trail = [np.empty((EXTRAPOLATED + 2, *part.shape)) for part in (on.cross.T, target)]
    sweep, blocks = compiled("sweeps").descend_groups, np.repeat(np.arange(len(sizes)), sizes)
    most = MOST

    def height_of(values: Array, residual: Array, alpha: float) -> float:
        square = float(np.vdot(residual, residual)) / samples
        return 0.5 * square + alpha * float(penalty.value(values.T))

    def improved(alpha: float, start: Array) -> tuple[Array, float, int]:
        nonlocal most
        values, residual, steps = start.T, target - start.T @ rows.T, 0
        limits = alpha * weights, alpha * inner
        while True:
            pull = (residual @ rows).T / samples
            if on.gram is not None:  # of which R may have lost digits
                pull = on.cross - on.times(values.T)
            gap = relative_gap(on, alpha, values.T, pull)
            if gap <= stop or steps >= most:
                most = MOST if gap <= stop else 0
                return values.T, gap, steps
            steps += 1 + EXTRAPOLATED
            trail[0][0], trail[1][0] = values, residual
            used = (values.T != 0.0) | (penalty.prox(values.T + pull, alpha) != 0.0)
            used = np.unique(blocks[used.any(axis=1)])
            sweep(rows, starts, used, *limits, square, samples, *trail)
            moves = np.diff(trail[0][1:], axis=0).reshape(EXTRAPOLATED, -1)
            products = moves @ moves.T
            products.flat[:: EXTRAPOLATED + 1] += 1e-12 * np.trace(products) + 1e-300
            share = np.linalg.solve(products, np.ones(EXTRAPOLATED))
            values, residual = (np.tensordot(share / share.sum(), part[2:], 1) for part in trail)
            if height_of(values, residual, alpha) > height_of(trail[0][-1], trail[1][-1], alpha):
                values, residual = (part[-1].copy() for part in trail)

    return _each(on, alphas, attempts, stop, improved)


def cluster_descent(on: Columns, alphas: Array, attempts: Attempts, stop: float) -> Points:
    """SLOPE of one target: proximal gradients split clusters of equal |v|, and sweeps move them.

    Where a round of sweeps leaves the clusters as they were, their optimum is taken at once.
    Source: Larsson, Klopfenstein, Massias and Wallin, "Coordinate descent for SLOPE" (2023).
    """
    assert isinstance(on.penalty, SortedNorm)
    assert on.gram is not None
    gram, x = np.ascontiguousarray(on.gram), np.cos(np.arange(len(on.gram)))
    for _ in range(POWERS):  # of an x that is not orthogonal to what opposite columns share
        x = gram @ (x / np.linalg.norm(x))
    step, sweep = 1.0 / (1.05 * float(np.linalg.norm(x))), compiled("sweeps").descend_clusters
    penalty, sums = on.penalty, np.concatenate([[0.0], np.cumsum(on.penalty.weights)])

    def improved(alpha: float, values: Array) -> tuple[Array, float, int]:
        gap, rounds = np.inf, 0
        for rounds in range(CLUSTERED):
            pull = on.cross - on.times(values)
            gap = relative_gap(on, alpha, values, pull)
            if gap <= stop:
                break
            values = penalty.prox(values + step * pull, step * alpha)
            pull = on.cross - on.times(values)
            going = sweep(gram, alpha * sums, pull[:, 0], values[:, 0], SWEEPS) or rounds >= ALIKE
            while going:
                values, met = towards_clusters_optimum(on, alpha, values)
                going = met and rounds >= ALIKE
        return values, gap, rounds

    return _each(on, alphas, attempts, stop, improved)


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
    nested = isinstance(penalty, NestedNorms) and isinstance(penalty.inner, AbsoluteValues)
    if nested and not penalty.ridge and compiled("sweeps"):
        return "block descent"
    slope = type(penalty) is SortedNorm and not penalty.ridge
    return "cluster descent" if slope and targets == 1 and compiled("sweeps") else "newton"


def path_on_gram(
    gram: Array, cross: Array, penalty: Penalty, alphas: Array, square: float
) -> Points:
    """The path of targets that are solved together, on all columns: G (k, k), B (k, q), |Y|^2/m."""
    level, name = float(np.sqrt(square)), kernel_for(penalty, cross.shape[1])
    order = in_order(penalty.blocks, 0)[0]
    if order is not None and (ordered := penalty.restricted(order)) is not None:
        points = path_on_gram(gram[np.ix_(order, order)], cross[order], ordered, alphas, square)
        return replace(points, weights=points.weights[:, np.argsort(order)])
    on = Columns(penalty.in_units(level), cross / level, 0, gram)
    goal = DESCENDED if name == "block descent" else STOP
    points = KERNELS[name](on, alphas / level, {BEGIN: np.zeros(cross.shape)}, goal)
    return replace(points, weights=points.weights * level, words=f"{name}, all columns")
