"""One point of the variational group-LASSO: objective, residual correlation and Hessian at eta.

Notation and source in `variational`: D holds eta, C = B - G W, W_g = eta_g C_g.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg.lapack import dpotrf, dpotrs, dtrtrs

from sparsefit.arrays import Array, IntArray

_LOST = 1e-14  # of the terms of a curvature, which may cancel: a negative one sends eta to infinity


@dataclass(frozen=True, eq=False)
class Problem:
    """Statistics with contiguous groups, unit penalty weights, |Y|^2/m = 1; power = tr G_gg."""

    gram: Array
    cross: Array
    starts: IntArray
    sizes: IntArray
    columns: tuple[IntArray, ...]
    power: Array

    def columns_of(self, groups: IntArray) -> IntArray:
        """Columns of the groups given, group by group."""
        if not groups.size:
            return np.zeros(0, np.intp)
        return np.concatenate([self.columns[g] for g in groups])

    def squares(self, matrix: Array) -> Array:
        """Squared Frobenius norm of every group's rows, (k, n) -> (g,)."""
        return np.add.reduceat(np.einsum("ij,ij->i", matrix, matrix), self.starts)


@dataclass(frozen=True, eq=False)
class Support:
    """The groups with eta > 0, their columns and the rows of the Gram matrix they need."""

    groups: IntArray
    columns: IntArray
    label: IntArray
    rows: Array
    block: Array


@dataclass(frozen=True, eq=False)
class Point:
    """Everything known at one eta: a factorisation of I + D^1/2 G D^1/2 and what follows."""

    eta: Array
    support: Support
    root: Array
    factor: Array
    inner: Array
    correlation: Array
    weights: Array
    half: Array
    hessian: Array
    value: float


def normalise(
    gram: ArrayLike, cross: Array, groups: ArrayLike, omega: ArrayLike
) -> tuple[Problem, IntArray, Array]:
    """Make groups contiguous and penalty weights one: z_j / omega_g has the weight w_j omega_g."""
    labels, square = np.asarray(groups), np.asarray(gram, dtype=float)
    order = np.argsort(labels, kind="stable")
    scale = np.asarray(omega, dtype=float)[labels[order]]
    if np.any(order[1:] < order[:-1]):
        square, cross = square[np.ix_(order, order)], cross[order]
    if np.any(scale != 1.0):
        square, cross = square / np.multiply.outer(scale, scale), cross / scale[:, None]
    sizes = np.bincount(labels)
    starts = np.cumsum(sizes) - sizes
    columns = tuple(np.arange(s, s + size) for s, size in zip(starts, sizes, strict=True))
    power = np.add.reduceat(square.diagonal(), starts)
    problem = Problem(square, np.asfortranarray(cross), starts, sizes, columns, power)
    return problem, order, scale


def evaluate(problem: Problem, eta: Array, previous: Support | None) -> Point | None:
    """Objective, residual correlation and Hessian at eta; None if the factorisation fails.

    With A = I + D^1/2 G D^1/2 = LL': C = D^-1/2 A^-1 D^1/2 B on the support, and its Hessian
    is that of K = D^-1/2 (I - A^-1) D^-1/2, which needs no product with G.
    """
    support = _support(problem, np.flatnonzero(eta > 0), previous)
    label, size = support.label, support.columns.size
    if not size:
        empty = np.zeros((0, problem.cross.shape[1]))
        none = np.zeros((0, 0))
        return Point(eta, support, np.zeros(0), none, empty, problem.cross, empty, none, none, 0.0)
    root = np.sqrt(eta[support.groups])[label]
    shifted = support.block * root
    shifted *= root[:, None]
    shifted.flat[:: size + 1] += 1.0
    factor, failed = dpotrf(shifted.T, lower=1, clean=0, overwrite_a=1)
    if failed:
        return None
    cross = problem.cross[support.columns]
    solved = dpotrs(factor, root[:, None] * cross, lower=1)[0]
    weights, inner = root[:, None] * solved, solved / root[:, None]
    half = _half(factor, _spread(inner, label))
    product = half.T @ half
    hessian = np.negative(product, out=product)
    hessian.flat[:: len(hessian) + 1] += (1.0 + _LOST) * group_squares(inner, label)
    width = np.sqrt(eta[support.groups])
    hessian /= np.multiply.outer(width, width)
    return Point(
        eta=eta,
        support=support,
        root=root,
        factor=factor,
        inner=inner,
        correlation=problem.cross - support.rows.T @ weights,
        weights=weights,
        half=half,
        hessian=hessian,
        value=-0.5 * float(np.vdot(cross, weights)),
    )


def _support(problem: Problem, groups: IntArray, previous: Support | None) -> Support:
    if previous is not None and np.array_equal(previous.groups, groups):
        return previous
    columns = problem.columns_of(groups)
    label = np.repeat(np.arange(groups.size), problem.sizes[groups])
    rows = problem.gram[columns]
    return Support(groups, columns, label, rows, rows[:, columns])


def bordered(problem: Problem, point: Point, new: IntArray) -> Array:
    """Hessian on support and new groups: K = G - V'V there, V = L^-1 D^1/2 G."""
    columns = problem.columns_of(new)
    label = np.repeat(np.arange(new.size), problem.sizes[new])
    spread = _spread(point.correlation[columns], label)
    flat = spread.reshape(columns.size, -1, order="F")
    inner = np.asfortranarray(problem.gram[np.ix_(columns, columns)] @ flat)
    corner = flat.reshape(-1, new.size, order="F").T @ inner.reshape(-1, new.size, order="F")
    old = point.support.groups.size
    if not old:
        return np.asarray(corner)
    coupling = np.asfortranarray(point.root[:, None] * (point.support.rows[:, columns] @ flat))
    half = _half(point.factor, coupling.reshape(coupling.shape[0], -1, new.size, order="F"))
    hessian = np.empty((old + new.size, old + new.size))
    hessian[:old, :old] = point.hessian
    cross = point.half.T @ half / np.sqrt(point.eta[point.support.groups])[:, None]
    hessian[:old, old:], hessian[old:, :old] = cross, cross.T
    hessian[old:, old:] = corner - half.T @ half
    return hessian


def _spread(matrix: Array, label: IntArray) -> Array:
    """Block-diagonal (c, n, groups) array of the rows of each group: one column a group."""
    spread = np.zeros((label.size, matrix.shape[1], int(label[-1]) + 1), order="F")
    spread[np.arange(label.size), :, label] = matrix
    return spread


def _half(factor: Array, columns: Array) -> Array:
    """L^-1 applied to (c, n, s), targets stacked below one another: (c n, s)."""
    flat = columns.reshape(columns.shape[0], -1, order="F")
    solved: Array = dtrtrs(factor, flat, lower=1, overwrite_b=1)[0]
    return solved.reshape(-1, columns.shape[2], order="F")


def group_squares(matrix: Array, label: IntArray) -> Array:
    """Squared norm of the rows of each label, which are ascending: (c, n) -> (labels,)."""
    sums: Array = np.bincount(label, np.einsum("ij,ij->i", matrix, matrix))  # type: ignore[assignment]
    return sums
