"""Norms of groups of columns: the penalties of the group-LASSO and of the sparse-group LASSO.

Sources: Yuan and Lin, J. R. Stat. Soc. B 68 (2006) 49-67; Simon, Friedman, Hastie and Tibshirani,
J. Comput. Graph. Stat. 22 (2013) 231-245; Ndiaye, Fercoq, Gramfort and Salmon, "GAP safe screening
rules for sparse-group Lasso" (NeurIPS 2016), for the dual norm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, Self

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.regression.penalties import AbsoluteValues, Penalty, Slope


@dataclass(frozen=True, eq=False)
class GroupNorms(Penalty):
    """The group-LASSO's norm, sum_g omega_g |V_g|.

    A block V_g has the rows of a group and all targets (``together``), or one target of each. The
    array groups (k,) holds the number of each column's group, 0..g-1; weights holds omega (g,) > 0.
    The prox shrinks a block U_g by the factor 1 - s, s = step omega_g/|U_g|, down to 0; its
    derivative is (1 - s) (I - u u') + u u', u = U_g/|U_g|, of which ``root`` is the square root.
    """

    groups: IntArray
    weights: Array
    together: bool = True

    @property
    def blocks(self) -> IntArray:
        return self.groups

    @property
    def coupled(self) -> bool:
        return self.together or self.loss.coupled

    @cached_property
    def _layout(self) -> tuple[IntArray | None, IntArray]:
        return in_order(self.groups, len(self.weights))

    def block_norms(self, values: Array) -> Array:
        """Norms |V_g| of values (..., k, n): shape (..., g, n), or (..., g, 1) when joint."""
        peak = float(np.abs(values).max(initial=0.0)) or 1.0  # squares of 1e-200 vanish
        square = np.square(values / peak)
        return peak * np.sqrt(sums(square, *self._layout, self.together))

    def norm(self, values: Array) -> Array:
        total: Array = (self.block_norms(values) * self.weights[:, None]).sum(axis=(-2, -1))
        return total

    def block_dual_norms(self, values: Array) -> Array:
        return self.block_norms(values) / self.weights[:, None]

    def restricted(self, index: IntArray) -> Self:
        used, groups = np.unique(self.groups[index], return_inverse=True)
        return replace(self, groups=groups, weights=self.weights[used])

    def prox(self, values: Array, step: float) -> Array:
        norms, limit = self.block_norms(values), step * self.weights[:, None]
        share = np.where(norms > limit, 1.0 - limit / np.where(norms > limit, norms, 1.0), 0.0)
        return values * share[self.groups]

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        live = (self.block_norms(origin) > step * self.weights[:, None])[self.groups]
        on = np.flatnonzero(np.broadcast_to(live, values.shape))
        return on, self.root(on, origin, step)

    def root(self, on: IntArray, origin: Array, step: float) -> Any:
        """The root N (c, c) of the derivative on the coefficients ``on``; None where it is I."""
        from scipy.sparse import csc_array, diags_array

        if not len(on):
            return None
        column, target = np.divmod(on, origin.shape[1])
        group, place = self.groups[column], 0 if self.together else target
        norms = self.block_norms(origin)[group, place]
        share = np.sqrt(1.0 - step * self.weights[group] / norms)
        block = np.unique(group * origin.shape[1] + place, return_inverse=True)[1]
        unit = csc_array((origin.ravel()[on] / norms, (np.arange(len(on)), block)))
        if len(on) == block.max(initial=-1) + 1:  # groups of one
            return None
        return (diags_array(share) + diags_array(1.0 - share) @ unit @ unit.T).tocsc()

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        sizes, order = np.bincount(self.groups), np.argsort(self.groups, kind="stable")
        terms = []
        for size in np.unique(sizes):  # one expression for all groups of a size: faster to compile
            index = order[sizes[self.groups[order]] == size]
            weights = self.weights[sizes == size]
            apart = [variable[index, t] for t in range(variable.shape[1])]
            for part in [variable[index]] if self.together else apart:
                blocks = cvxpy.reshape(part, (len(weights), part.size // len(weights)), order="C")
                terms.append(weights @ cvxpy.norm(blocks, 2, axis=1))
        return cvxpy.sum(cvxpy.hstack(terms)), []


@dataclass(frozen=True, eq=False)
class NestedNorms(Penalty):
    """The sparse-group LASSO's norm, sum_g omega_g |V_g| + sum_h lambda_h |V_h|.

    Each inner block h lies in one group g. The outer norms are of the groups, the inner ones of
    coefficients or of subgroups, which may be joint over targets only if the groups are. The prox
    is the inner one, then the outer one (Jenatton, Mairal, Obozinski and Bach, J. Mach. Learn. Res.
    12 (2011) 2297-2334); the roots of both derivatives commute, and N is their product. The dual
    norm of a group is the least tau with

        |u| <= tau omega_g,   u_h = (|C_h| - tau lambda_h)_+,   h in g,

    to which Newton's method rises as in `Penalty.dual_norm`, by the same products with this prox.
    """

    outer: GroupNorms
    inner: AbsoluteValues | GroupNorms

    @property
    def coupled(self) -> bool:
        return self.outer.together or self.loss.coupled

    @property
    def blocks(self) -> IntArray:
        return self.outer.groups

    def norm(self, values: Array) -> Array:
        return self.outer.norm(values) + self.inner.norm(values)

    def block_dual_norms(self, values: Array) -> Array:
        outer, inner = self.outer, self.inner
        home = np.zeros(len(inner.weights), dtype=np.intp)
        home[inner.blocks] = outer.groups
        order, starts = in_order(home, len(outer.weights))
        order = np.arange(len(home)) if order is None else order
        unit = float(np.abs(values).max(initial=0.0)) or 1.0  # squares of 1e-200 vanish
        sizes = (inner.block_dual_norms(values / unit) * inner.weights[:, None])[..., order, :]
        price, group, omega = inner.weights[order, None], home[order], outer.weights[:, None]

        def summed(parts: Array) -> Array:
            return sums(parts, None, starts, outer.together)

        rise = last = summed(0.0 * sizes)
        while True:
            excess = np.maximum(sizes - price * rise[..., group, :], 0.0)
            square, cost = summed(excess**2), summed(price * excess)
            length, last = np.sqrt(square), rise
            below = np.where(length > omega * last, cost + omega * length, np.inf)
            rise = np.maximum(last, (square + last * cost) / below)
            if not np.any(rise > last * (1.0 + 1e-15)):
                return unit * rise

    def restricted(self, index: IntArray) -> Self:
        return replace(self, outer=self.outer.restricted(index), inner=self.inner.restricted(index))

    def prox(self, values: Array, step: float) -> Array:
        return self.outer.prox(self.inner.prox(values, step), step)

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        on, between = np.flatnonzero(values), self.inner.prox(origin, step)
        first, second = None, self.outer.root(on, between, step)
        if isinstance(self.inner, GroupNorms):
            first = self.inner.root(on, origin, step)
        if first is None or second is None:
            return on, first if second is None else second
        return on, (second @ first).tocsc()

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        return self.outer.conic(variable, cvxpy)[0] + self.inner.conic(variable, cvxpy)[0], []


def in_order(groups: IntArray, count: int) -> tuple[IntArray | None, IntArray]:
    """The order that makes groups ascend (None where they do) and the start of each of them."""
    order = None
    if np.any(groups[1:] < groups[:-1]):
        order = np.argsort(groups, kind="stable")
        groups = groups[order]
    return order, np.searchsorted(groups, np.arange(count))


def sums(values: Array, order: IntArray | None, starts: IntArray, joint: bool) -> Array:
    """Sums over the blocks of values (..., k, n): (..., g, n), or (..., g, 1) when joint."""
    if order is not None:
        values = values[..., order, :]
    if joint:  # slice by slice, as numpy is slow along an axis of few entries
        values = reduce(np.add, np.moveaxis(values, -1, 0))[..., None]
    return np.add.reduceat(values, starts, axis=-2)
