"""Exact paths on the columns in play, which go on from weights at some penalties.

A kernel solves at descending penalties on the sums of the columns in play. Where a column outside
objects to a point, the path goes on from the penalty before, with that column beside the others and
what was solved meanwhile as a start. ``homotopy``, ``variances`` and ``sweeps`` are compiled; where
they are not built, the generic Newton's method runs in their place, slower.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.newton import (
    Normal,
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
    words: str


@dataclass(frozen=True, eq=False)
class Stretch:
    """A stretch of a path: values (p, j, q), which are optimal (p,), and steps taken (p,)."""

    values: Array
    complete: BoolArray
    steps: IntArray


@dataclass(frozen=True)
class Units:
    """The rms of the target, and powers of two near the largest of G's diagonal and of Z'Y/m.

    Both of columns that are divided by their penalty's weight.
    """

    level: float
    square: float = 1.0
    height: float = 1.0

    @classmethod
    def of(cls, penalty: Penalty, cross: Array, level: float) -> Units:
        """Those of a penalty and Z'Y/m (k, q)."""
        if not isinstance(penalty, AbsoluteValues):
            return cls(level)
        largest = float((np.abs(cross) / penalty.weights[:, None]).max())
        return cls(level, binary_unit(float(penalty.weights.min()) ** -2), binary_unit(largest))


@dataclass(frozen=True, eq=False)
class OnColumns:
    """A problem on the columns in play: their sums, B (j, q), the penalty on them, and units."""

    normal: Normal
    cross: Array
    penalty: Penalty
    units: Units
    stop: float = STOP


Attempts = dict[float, Array]
"""V (j, q) by penalty: the last that was accepted, whose penalty is the largest, and later ones."""
Kernel = Callable[[OnColumns, Array, Attempts], Stretch]
"""A path at further penalties (p,), descending, from attempts."""
BEGIN: float = np.inf
"""The penalty of an attempt of zeros: the start of a path."""


def compiled(name: str) -> Any:
    """The compiled source of that name; None where it was not built."""
    try:
        return import_module(f"sparsefit.solvers.{name}")
    except ImportError:
        return None


def _nearest(attempts: Attempts, alpha: float) -> tuple[float, Array]:
    at = min(attempts, key=lambda each: abs(each - alpha))
    return at, attempts[at]


def homotopy(on: OnColumns, alphas: Array, attempts: Attempts) -> Stretch:
    """The LASSO or elastic net of one target, from event to event; z_j/omega_j has omega_j v_j."""
    assert isinstance(on.penalty, AbsoluteValues)
    assert on.normal.gram is not None
    units, omega = on.units, on.penalty.weights
    gram, pull = on.normal.gram, on.cross[:, 0]
    if np.any(omega != 1.0):
        gram, pull = gram / np.multiply.outer(omega, omega), pull / omega
    gram = np.ascontiguousarray(gram / units.square if units.square != 1.0 else gram)
    ridge = on.penalty.ridge * units.height / (units.square * omega**2)
    walk = compiled("homotopy").Homotopy(gram, pull / units.height, ridge)
    scale = units.height / units.square / omega
    last = max(attempts)
    if last < BEGIN:
        walk.start(attempts[last][:, 0] / scale, last / units.height)
    values, complete = np.zeros((len(alphas), len(omega))), np.zeros(len(alphas), bool)
    with np.errstate(all="ignore"):
        walk.advance(alphas / units.height, values, complete)
    steps, solved = np.zeros(len(alphas), np.intp), (values * scale)[:, :, None]
    steps[-1] = walk.steps
    level = units.level
    for i in np.flatnonzero(~complete):  # on columns that nearly depend on each other
        point = on.normal, on.cross / level, on.penalty.in_units(level), alphas[i] / level
        at, gap, _ = settled(*point, solved[i] / level, on.stop)
        solved[i], complete[i] = at * level, gap <= on.stop
    return Stretch(solved, complete, steps)


def newton(on: OnColumns, alphas: Array, attempts: Attempts) -> Stretch:
    """Any penalty, by proximal points, each started from the penalty before."""
    level, values = on.units.level, attempts[max(attempts)] / on.units.level
    # In units of the target's rms y the ridge of y V is y rho, that of alpha and V being one.
    cross, penalty = on.cross / level, on.penalty.in_units(level)
    solved, gaps = np.zeros((len(alphas), *cross.shape)), np.zeros(len(alphas))
    steps = np.zeros(len(alphas), np.intp)
    for i, alpha in enumerate((alphas / level).tolist()):
        problem = on.normal, cross, penalty, alpha
        values, gaps[i], steps[i] = settled(*problem, values, on.stop)
        solved[i] = values * level
    return Stretch(solved, gaps <= on.stop, steps)


def variational(on: OnColumns, alphas: Array, attempts: Attempts) -> Stretch:
    """Group norms over all targets at hand, by Newton's method on the groups' variances."""
    assert isinstance(on.penalty, GroupNorms)
    assert on.normal.gram is not None
    level, groups = on.units.level, on.penalty.groups
    order = np.argsort(groups, kind="stable")
    scale, starts = (
        on.penalty.weights[groups[order]],
        np.searchsorted(groups[order], _count(groups)),
    )
    gram, pull = on.normal.gram, on.cross / level
    if np.any(order[1:] < order[:-1]):
        pull, gram = pull[order], gram[np.ix_(order, order)]
    if np.any(scale != 1.0):
        pull, gram = pull / scale[:, None], gram / np.multiply.outer(scale, scale)
    at, start = _nearest(attempts, float(alphas[0]))
    start = start[order] * scale[:, None]  # |W_g| = eta_g alpha at an optimum
    eta = np.sqrt(np.add.reduceat(np.square(start).sum(axis=1), starts[:-1])) / at
    sources = compiled("variances")
    problem = sources.Groups(np.ascontiguousarray(gram), np.ascontiguousarray(pull.T), starts)
    search = sources.Search(problem, eta, on.stop)
    values, gaps = np.zeros((len(alphas), *on.cross.shape)), np.zeros(len(alphas))
    steps = np.zeros(len(alphas), np.intp)
    with np.errstate(all="ignore"):  # what breaks is caught by the gap, not by warnings
        for i, alpha in enumerate((alphas / level).tolist()):
            solved, gaps[i], steps[i] = search.minimised(alpha)
            values[i, order] = solved.T * (level / scale)[:, None]
    return Stretch(values, gaps <= on.stop, steps)


def _count(groups: IntArray) -> IntArray:
    return np.arange(int(groups.max()) + 2)


def block_descent(on: OnColumns, alphas: Array, attempts: Attempts) -> Stretch:
    """Group norms by block descent with extrapolation, for many columns in use beside the rows.

    The columns of a group are neighbours, and orthogonal. Source: Bertrand and Massias, "Anderson
    acceleration of coordinate descent" (AISTATS 2021).
    """
    descent, level, attempts = _Descent(on), on.units.level, dict(attempts)
    solved, gaps = np.empty((len(alphas), *on.cross.shape)), np.zeros(len(alphas))
    steps = np.zeros(len(alphas), np.intp)
    for i, alpha in enumerate(alphas.tolist()):
        start = _nearest(attempts, alpha)[1] / level
        values, gaps[i], steps[i] = descent.settled(start, alpha / level)
        attempts[alpha] = solved[i] = values * level
        if gaps[i] > DESCENDED:  # columns are too much alike
            gram = descent.rows.T @ descent.rows / descent.samples
            rest = variational(
                replace(on, normal=replace(on.normal, gram=gram)), alphas[i:], attempts
            )
            return Stretch(
                np.concatenate([solved[:i], rest.values]),
                np.concatenate([gaps[:i] <= DESCENDED, rest.complete]),
                np.concatenate([steps[:i], rest.steps]),
            )
    return Stretch(solved, gaps <= DESCENDED, steps)


class _Descent:
    """Sweeps over neighbouring groups of orthogonal columns, in units of the target.

    rows Z (m, j), square (j,): the mean squares of its columns; starts (g + 1,) of the groups.
    """

    def __init__(self, on: OnColumns) -> None:
        assert isinstance(on.penalty, GroupNorms)
        assert on.normal.rows is not None
        assert on.normal.target is not None
        self.samples, self.rows, level = on.normal.samples, on.normal.rows, on.units.level
        self.target, self.cross = on.normal.target.T / level, on.cross / level
        groups = on.penalty.groups
        self.starts = np.flatnonzero(np.diff(groups, prepend=-1, append=-1))
        weights = on.penalty.weights[groups[self.starts[:-1]]]
        groups = np.repeat(np.arange(len(weights)), np.diff(self.starts))
        self.penalty = replace(on.penalty, groups=groups, weights=weights)
        self.square = np.einsum("ij,ij->j", self.rows, self.rows) / self.samples

    def settled(self, start: Array, alpha: float) -> tuple[Array, float, int]:
        """The optimum (j, q) from another point, its gap, and sweeps."""
        values, penalty, steps = start.T.copy(), self.penalty, 0
        residual = self.target - values @ self.rows.T
        limits = alpha * penalty.weights

        def swept(groups: IntArray) -> tuple[Array, Array]:
            compiled("sweeps").descend_groups(
                *(self.rows, self.starts, groups, limits, self.square, float(self.samples)),
                *(residual, values),
            )
            return values.copy(), residual.copy()

        def height(values: Array, residual: Array) -> float:
            square = float(np.vdot(residual, residual)) / self.samples
            return 0.5 * square + alpha * float(penalty.value(values.T))

        while True:
            correlation = (residual @ self.rows).T / self.samples
            gap = relative_gap(values.T, correlation, self.cross, penalty, alpha)
            if gap <= DESCENDED or steps >= MOST:
                return values.T, gap, steps
            steps += 1 + EXTRAPOLATED
            trail = [swept(np.arange(len(limits)))]
            used = np.flatnonzero(penalty.block_norms(values.T).any(axis=1))
            trail += [swept(used) for _ in range(EXTRAPOLATED)]
            moves = np.stack([(after[0] - before[0]).ravel() for before, after in pairwise(trail)])
            square = moves @ moves.T
            square.flat[:: EXTRAPOLATED + 1] += 1e-12 * np.trace(square) + 1e-300
            share = np.linalg.solve(square, np.ones(EXTRAPOLATED))
            share /= share.sum()
            point, rest = (
                np.tensordot(share, list(part)[1:], 1) for part in zip(*trail, strict=True)
            )
            if height(point, rest) < height(values, residual):
                values, residual = point, rest


def cluster_descent(on: OnColumns, alphas: Array, attempts: Attempts) -> Stretch:
    """SLOPE of one target: proximal gradients split clusters of equal |v|, and sweeps move them.

    Where a round of sweeps leaves the clusters as they were, their optimum is taken at once.
    Source: Larsson, Klopfenstein, Massias and Wallin, "Coordinate descent for SLOPE" (2023).
    """
    assert isinstance(on.penalty, SortedNorm)
    assert on.normal.gram is not None
    level, penalty = on.units.level, on.penalty
    gram, cross = np.ascontiguousarray(on.normal.gram), on.cross / level
    attempts, step = dict(attempts), 1.0 / _largest_eigenvalue(gram)
    solved, gaps = np.zeros((len(alphas), *cross.shape)), np.zeros(len(alphas))
    steps = np.zeros(len(alphas), np.intp)
    for i, alpha in enumerate((alphas / level).tolist()):
        values = _nearest(attempts, alphas[i])[1] / level
        price = alpha * np.concatenate([[0.0], np.cumsum(penalty.weights)])
        for steps[i] in range(CLUSTERED):
            pull = cross - on.normal.times(values)
            gaps[i] = relative_gap(values, pull, cross, penalty, alpha)
            if gaps[i] <= on.stop:
                break
            values = penalty.prox(values + step * pull, step * alpha)
            pull = cross - on.normal.times(values)
            sweep = compiled("sweeps").descend_clusters
            going = sweep(gram, price, pull[:, 0], values[:, 0], SWEEPS) or steps[i] >= ALIKE
            while going:
                values, met = towards_clusters_optimum(gram, cross, penalty, alpha, values)
                going = met and steps[i] >= ALIKE
        if gaps[i] > on.stop:
            problem = on.normal, cross, penalty, alpha
            values, gaps[i], taken = settled(*problem, values, on.stop)
            steps[i] += taken
        attempts[alphas[i]] = solved[i] = values * level
    return Stretch(solved, gaps <= on.stop, steps)


def _largest_eigenvalue(gram: Array) -> float:
    """A little more than it, by the power method."""
    x = np.cos(np.arange(len(gram)))  # not orthogonal to what columns of opposite signs share
    for _ in range(POWERS):
        x = gram @ (x / np.linalg.norm(x))
    return 1.05 * float(np.linalg.norm(x))


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
    gram: Array, cross: Array, penalty: Penalty, alphas: Array, square: float, stop: float = STOP
) -> Stretch:
    """The path of targets that are solved together, on all columns: G (k, k), B (k, q), |Y|^2/m.

    stop: the relative gap that is enough.
    """
    units = Units.of(penalty, cross, float(np.sqrt(square)) or 1.0)
    on = OnColumns(Normal(gram, None, 0), cross, penalty, units, stop)
    kernel = KERNELS[kernel_for(penalty, cross.shape[1])]
    return kernel(on, np.asarray(alphas, dtype=float), {BEGIN: np.zeros(cross.shape)})


def binary_unit(largest: float) -> float:
    """Power of two next to a number: dividing by it rounds nothing."""
    if not 0.0 < largest < np.inf:
        return 1.0
    return float(2.0 ** (np.frexp(largest)[1] - 1)) if not 0.99 < largest < 1.01 else 1.0
