"""The one objective, its dual and its certificate: numpy only, one convention for every back-end.

In scaled columns z_j = theta_j / rms(theta_j), with m samples, k columns and n targets:

    minimise over V (k, n):   P(V) = 1/(2m) |Y - Z V|_F^2 + alpha * sum_g omega_g |V_g|

Weights in the original units of theta are W = V / rms.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property

Products: TypeAlias = Callable[[Array, Array], tuple[Array, Array, Array]]
CertificateKind = Literal["duality_gap", "normal_equations", "fixed_point"]

ROW_BLOCK = 8192  # rows per pass: the block of theta stays in cache for both products


@dataclass(frozen=True)
class Certificate:
    """What the caller verified about a fit.

    ``duality_gap``: (primal - dual) / (|Y|^2 / 2m), an upper bound of the relative suboptimality.
    ``normal_equations``: largest |v'theta'R| / (s_max |Y|) over the retained right singular
    vectors v of theta.
    ``fixed_point``: share of the coefficients whose membership of the support one more iteration
    would change; it claims no optimum.
    """

    kind: CertificateKind
    value: float
    primal: float = float("nan")
    dual: float = float("nan")


@dataclass(frozen=True, eq=False)
class Statistics:
    """Sufficient statistics of a regression problem in scaled columns.

    gram = Z'Z/m (k, k), cross = Z'Y/m (k, n), target_square = |y_t|^2/m (n,), rms (k,).
    Forming Z'Z squares the condition number; the certificate does not use it, so what that costs
    is seen in the gap and never hidden.
    """

    samples: int
    rms: Array
    gram: Array
    cross: Array
    target_square: Array

    @property
    def null_objective(self) -> float:
        """The objective at zero weights, |Y|^2 / 2m."""
        return 0.5 * float(self.target_square.sum())

    @cached_property
    def rank(self) -> int:
        """Numerical rank of Z (singular values above k * eps^(1/2) would be lost in Z'Z)."""
        eigenvalues = np.linalg.eigvalsh(self.gram)
        floor = len(eigenvalues) * np.finfo(float).eps * max(float(eigenvalues[-1]), 0.0)
        return int(np.count_nonzero(eigenvalues > floor))


def row_blocks(*arrays: Array, size: int = ROW_BLOCK) -> Iterator[tuple[Array, ...]]:
    """The same rows of every array, ``size`` at a time."""
    for start in range(0, len(arrays[0]), size):
        yield tuple(array[start : start + size] for array in arrays)


def block_products(theta: Array, target: Array) -> tuple[Array, Array, Array]:
    """Z'Z (k, k), Z'Y (k, n) and |y_t|^2 (n,) of a block of rows, by numpy."""
    return theta.T @ theta, theta.T @ target, np.einsum("ij,ij->j", target, target)


def accumulate(
    blocks: Iterator[tuple[Array, ...]],
    *,
    count: int | None = None,
    products: Products = block_products,
) -> Statistics:
    """Statistics from blocks of rows (theta, target), in memory of order k^2.

    ``count``: the number of samples m, where the rows are the compressed ones of more samples.
    ``products``: what sums up a block.
    """
    gram: Array | None = None
    for theta, target in blocks:
        if gram is None:
            gram, cross, square = products(theta, target)
            samples = len(theta)
        else:
            more = products(theta, target)
            gram += more[0]
            cross += more[1]
            square += more[2]
            samples += len(theta)
    if gram is None:
        raise ValueError("no rows: a regression problem needs at least one block of samples")
    samples = count or samples
    rms = np.sqrt(np.diagonal(gram) / samples)
    scale = np.where(rms > 0, rms, 1.0)
    gram /= scale[:, None] * samples
    gram /= scale
    return Statistics(samples, scale, gram, cross / (scale[:, None] * samples), square / samples)


@dataclass(frozen=True, eq=False)
class Penalty:
    """sum_g omega_g |V_g| over blocks of coefficients.

    groups (k,) gives the block of each column, 0..g-1; weights omega (g,) > 0. ``joint``: a block
    spans all n targets; otherwise each target has blocks of its own. Groups of one column and
    not joint: the LASSO.
    """

    groups: IntArray
    weights: Array
    joint: bool

    @cached_property
    def _layout(self) -> tuple[IntArray | None, IntArray]:
        """Columns in group order (None where they are already) and the start of each group."""
        order = np.argsort(self.groups, kind="stable")
        starts = np.searchsorted(self.groups[order], np.arange(len(self.weights)))
        in_order = bool(np.array_equal(order, np.arange(len(order))))
        return (None if in_order else order), starts

    @property
    def elementwise(self) -> bool:
        """Whether each coefficient is a block of its own (the LASSO)."""
        return not self.joint and len(self.weights) == len(self.groups)

    def block_norms(self, values: Array) -> Array:
        """Norms |V_g| of values (..., k, n): shape (..., g, n), or (..., g, 1) when joint."""
        order, starts = self._layout
        if order is not None:
            values = values[..., order, :]
        if self.elementwise:
            return np.abs(values)
        # Blocks are scaled by their largest entry: squares of 1e-200 would vanish.
        peak = float(np.max(np.abs(values), initial=0.0)) or 1.0
        squares = np.square(values / peak)
        if self.joint:
            squares = squares.sum(axis=-1, keepdims=True)
        norms: Array = peak * np.sqrt(np.add.reduceat(squares, starts, axis=-2))
        return norms

    def norm(self, values: Array) -> Array:
        """Omega(V) for values (..., k, n): shape (...)."""
        total: Array = (self.block_norms(values) * self.weights[:, None]).sum(axis=(-2, -1))
        return total

    def dual_norms(self, values: Array) -> Array:
        """max_g |V_g| / omega_g: shape (..., n), or (..., 1) when joint."""
        peaks: Array = (self.block_norms(values) / self.weights[:, None]).max(axis=-2)
        return peaks


def lasso_penalty(columns: int) -> Penalty:
    """The LASSO: every coefficient its own block."""
    return Penalty(np.arange(columns), np.ones(columns), joint=False)


def alpha_max(cross: Array, penalty: Penalty) -> float:
    """The smallest alpha whose solution is zero: max_g |Z_g'Y / m| / omega_g."""
    return float(penalty.dual_norms(cross).max(initial=0.0))


def duality_gaps(
    theta: Array,
    target: Array,
    rms: Array,
    weights: Array,
    alphas: Array,
    penalty: Penalty,
    *,
    samples: int | None = None,
) -> tuple[Certificate, ...]:
    """Certificates of the weights (p, k, n), in original units, at the penalties alphas (p,).

    With R = Y - theta W on the original rows, the dual point is s R/m with
    s = clip(<R, Y>/|R|^2, +-alpha / max_g(|Z_g'R/m| / omega_g)), feasible by construction, and
    D = (s <R, Y> - s^2 |R|^2 / 2) / m. Targets that the penalty does not couple have an s each.
    ``samples``: m, where the rows are the compressed ones of more samples.
    A difference rounded below zero is reported as 0.
    """
    points, columns, targets = weights.shape
    flat = np.ascontiguousarray(weights.transpose(1, 0, 2)).reshape(columns, points * targets)
    used = np.flatnonzero(np.any(flat != 0, axis=1))
    sparse = 2 * len(used) < columns  # gathering columns costs a copy: worth it when few are used
    correlation = np.zeros((columns, points * targets))
    residual_square = np.zeros((points, targets))
    residual_target = np.zeros((points, targets))
    for rows, values in row_blocks(theta, target):
        fitted = rows[:, used] @ flat[used] if sparse else rows @ flat
        residual = values[:, None, :] - fitted.reshape(len(rows), points, targets)
        residual_square += np.einsum("ipt,ipt->pt", residual, residual)
        residual_target += np.einsum("ipt,it->pt", residual, values)
        correlation += rows.T @ residual.reshape(len(rows), points * targets)
    m = samples or len(theta)
    correlation = (correlation / (rms[:, None] * m)).reshape(columns, points, targets)
    peaks = penalty.dual_norms(correlation.transpose(1, 0, 2))
    primal = residual_square.sum(axis=1) / (2 * m) + alphas * penalty.norm(weights * rms[:, None])
    if penalty.joint:
        residual_square = residual_square.sum(axis=1, keepdims=True)
        residual_target = residual_target.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(peaks > 0, alphas[:, None] / peaks, np.inf)
        best = np.where(residual_square > 0, residual_target / residual_square, 0.0)
    s = np.clip(best, -limit, limit)
    dual = ((s * residual_target - 0.5 * s**2 * residual_square) / m).sum(axis=1)
    null = float(np.einsum("ij,ij->", target, target)) / (2 * m)
    gaps = np.maximum(primal - dual, 0.0) / (null or 1.0)
    return tuple(
        Certificate("duality_gap", float(g), float(p), float(d))
        for g, p, d in zip(gaps, primal, dual, strict=True)
    )
