"""Penalties of norms of groups of columns: the group-LASSO's, and the sparse-group LASSO's.

Sources: Yuan and Lin, J. R. Stat. Soc. B 68 (2006) 49-67; Simon, Friedman, Hastie and Tibshirani,
J. Comput. Graph. Stat. 22 (2013) 231-245; Ndiaye, Fercoq, Gramfort and Salmon, "GAP safe screening
rules for sparse-group Lasso" (NeurIPS 2016), for the dual norm.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.regression.penalties import AbsoluteValues, Penalty, Slope


@dataclass(frozen=True, eq=False)
class GroupNorms(Penalty):
    """sum_g omega_g |V_g| over groups of columns, over all targets together (``together``) or each.

    groups (k,) numbers the group of each column, 0..g-1; weights omega (g,) > 0. With U_g the
    values before the prox, u = U_g/|U_g| and s = step omega_g/|U_g|, the factor of the prox's
    derivative is the root of (1 - s) (I - u u') + u u'.
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
        # Scaled by the largest entry: squares of 1e-200 would vanish.
        peak = float(max(values.max(initial=0.0), -values.min(initial=0.0))) or 1.0
        scaled = values / peak
        scaled *= scaled
        norms: Array = peak * np.sqrt(block_sums(scaled, *self._layout, self.together))
        return norms

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
        """N (c, c) on the coefficients ``on`` of groups that are not zero."""
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
        terms = []
        for group, weight in enumerate(self.weights):
            block = variable[np.flatnonzero(self.groups == group), :]
            apart = [block[:, t] for t in range(block.shape[1])]
            each = [cvxpy.vec(block, order="C")] if self.together else apart
            terms += [weight * cvxpy.norm(part, 2) for part in each]
        return cvxpy.sum(cvxpy.hstack(terms)), []


@dataclass(frozen=True, eq=False)
class NestedNorms(Penalty):
    """sum_g omega_g |V_g| + sum_h lambda_h |V_h|, a block h in one group g.

    outer: groups g; inner: blocks h, coefficients or groups that are joint only if the outer
    ones are. For one group the dual norm is the tau > 0 with

        sum_{h in g} (|C_h| - tau lambda_h)_+^2 = (tau omega_g)^2,

    found in x = 1/tau by Newton's method on |(x |C_h| - lambda_h)_+| - omega_g, which is convex and
    increasing: from above it falls to the root, and the chord to where it is -omega_g gives a tau
    that is proven not to be too small. The prox is the inner one, then the outer one (Jenatton,
    Mairal, Obozinski and Bach, J. Mach. Learn. Res. 12 (2011) 2297-2334); the roots of both
    derivatives commute, and the factor is their product.
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
        outer, joint = self.outer, self.outer.together
        home = np.zeros(len(self.inner.weights), dtype=np.intp)
        home[self.inner.blocks] = outer.groups
        order, starts = in_order(home, len(outer.weights))
        sizes = self.inner.block_dual_norms(values) * self.inner.weights[:, None]
        member, inner = np.sort(home), self.inner.weights[:, None]
        if order is not None:
            sizes, inner = sizes[..., order, :], inner[order]
        omega = outer.weights[:, None]

        def highest(parts: Array) -> Array:
            peaks: Array = np.maximum.reduceat(parts, starts, axis=-2)
            return peaks.max(axis=-1, keepdims=True) if joint else peaks

        with np.errstate(over="ignore"):  # lambda near 0: the bound is of no use then
            largest, floor = highest(sizes / (inner + omega[member])), highest(sizes / inner)
        live = largest > 0
        x = np.where(live, 1.0 / np.where(live, largest, 1.0), 0.0)
        for _ in range(60):
            excess = np.maximum(sizes * x[..., member, :] - inner, 0.0)
            length = np.sqrt(block_sums(excess**2, None, starts, joint))
            slope = block_sums(sizes * excess, None, starts, joint) / np.where(
                length > 0, length, 1
            )
            step = np.where(length > omega, (length - omega) / np.where(slope > 0, slope, 1.0), 0.0)
            if not np.any(step > 1e-15 * x):
                break
            x = x - step
        least = np.where(live, 1.0 / np.where(live, floor, 1.0), 0.0)
        below = least + (x - least) * omega / np.maximum(omega, length)
        return np.where(live, 1.0 / np.where(live, below, 1.0), 0.0)

    def restricted(self, index: IntArray) -> Self:
        return replace(self, outer=self.outer.restricted(index), inner=self.inner.restricted(index))

    def prox(self, values: Array, step: float) -> Array:
        return self.outer.prox(self.inner.prox(values, step), step)

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        between = self.inner.prox(origin, step)
        on = np.flatnonzero(values)
        first = None
        if isinstance(self.inner, GroupNorms):
            first = self.inner.root(on, origin, step)
        second = self.outer.root(on, between, step)
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


def block_sums(values: Array, order: IntArray | None, starts: IntArray, joint: bool) -> Array:
    """Sums over blocks of values (..., k, n): shape (..., g, n), or (..., g, 1) when joint."""
    if order is not None:
        values = values[..., order, :]
    sums = np.add.reduceat(values, starts, axis=-2)
    return sums.sum(axis=-1, keepdims=True) if joint else sums
