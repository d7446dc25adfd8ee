"""The one objective: numpy only, one convention for every back-end.

In scaled columns z_j = theta_j / rms(theta_j), with m samples, k columns and n targets:

    minimise over V (k, n):   P(V) = 1/(2m) |Y - Z V|_F^2 + alpha * Omega(V)

    Omega(V) = sum_g omega_g |V_g| + sum_h lambda_h |V_h| + rho/2 |V|_F^2

g are blocks of coefficients, h blocks within them (sparse-group LASSO), rho a ridge (elastic net);
most back-ends have the first term alone. Weights in the original units of theta are W = V / rms.

The square-root LASSO has y |Y - Z V|_F/sqrt(m) in place of the first term of P, y = |Y|_F/sqrt(m).
The factor y, a constant, gives alpha the same unit and the same alpha_max in both.

The dual norm of the first two terms together, for one block g, is the tau > 0 with

    sum_{h in g} (|C_h| - tau lambda_h)_+^2 = (tau omega_g)^2,

found in x = 1/tau by Newton's method on |(x |C_h| - lambda_h)_+| - omega_g, which is convex and
increasing: from above it falls to the root, and the chord to where it is -omega_g gives a tau that
is proven not to be too small.

Sources: Zou and Hastie, J. R. Stat. Soc. B 67 (2005) 301-320; Simon, Friedman, Hastie and
Tibshirani, J. Comput. Graph. Stat. 22 (2013) 231-245; for the dual norm, Ndiaye, Fercoq, Gramfort
and Salmon, "GAP safe screening rules for sparse-group Lasso" (NeurIPS 2016).
"""

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property

NEWTON_STEPS = 60  # of the dual norm; about five are taken


@dataclass(frozen=True, eq=False)
class Penalty:
    """sum_g omega_g |V_g| over blocks of coefficients, and what is added to it.

    groups (k,) gives the block of each column, 0..g-1; weights omega (g,) > 0, or all zero for a
    ridge alone. ``joint``: a block spans all n targets; otherwise each target has blocks of its
    own. Groups of one column and not joint: the LASSO. ``within``: the same on blocks that lie
    within these, and are joint only if these are. ``ridge``: rho of rho/2 |V|^2. ``root``: it is
    added to the root of the mean square, and not to half the mean square.
    """

    groups: IntArray
    weights: Array
    joint: bool
    within: "Penalty | None" = None
    ridge: float = 0.0
    root: bool = False

    @cached_property
    def _layout(self) -> tuple[IntArray | None, IntArray]:
        """Columns in group order (None where they are already) and the start of each group."""
        return _in_order(self.groups, len(self.weights))

    @property
    def elementwise(self) -> bool:
        """Whether each coefficient is a block of its own (the LASSO)."""
        return not self.joint and len(self.weights) == len(self.groups) and self.within is None

    @property
    def coupled(self) -> bool:
        """Whether the targets of a problem are one problem, and not one each."""
        return self.joint or self.root

    @cached_property
    def smooth(self) -> bool:
        """Whether there is no norm in it, but a ridge alone."""
        return self.within is None and not self.weights.any()

    def block_norms(self, values: Array) -> Array:
        """Norms |V_g| of values (..., k, n): shape (..., g, n), or (..., g, 1) when joint."""
        if self.elementwise:
            order = self._layout[0]
            return np.abs(values if order is None else values[..., order, :])
        # Blocks are scaled by their largest entry: squares of 1e-200 would vanish.
        peak = float(np.max(np.abs(values), initial=0.0)) or 1.0
        norms: Array = peak * np.sqrt(self._block_sums(np.square(values / peak)))
        return norms

    def _block_sums(self, values: Array) -> Array:
        return _sums(values, *self._layout, self.joint)

    def norm(self, values: Array) -> Array:
        """The norms of Omega(V), without its ridge, for values (..., k, n): shape (...)."""
        total: Array = (self.block_norms(values) * self.weights[:, None]).sum(axis=(-2, -1))
        return total if self.within is None else total + self.within.norm(values)

    def value(self, values: Array) -> Array:
        """Omega(V) for values (..., k, n): shape (...)."""
        total: Array = self.norm(values) + 0.5 * self.ridge * np.square(values).sum(axis=(-2, -1))
        return total

    def block_dual_norms(self, values: Array) -> Array:
        """The dual norm of each block of values (..., k, n): shape (..., g, n), or (..., g, 1)."""
        if self.within is None:
            duals: Array = self.block_norms(values) / self.weights[:, None]
            return duals
        return self._nested_dual_norms(self.within, values)

    def dual_norms(self, values: Array) -> Array:
        """The dual norm max_g |V_g| / omega_g: shape (..., n), or (..., 1) when joint."""
        peaks: Array = self.block_dual_norms(values).max(axis=-2)
        return peaks

    def _nested_dual_norms(self, within: "Penalty", values: Array) -> Array:
        """tau of each block, from above, as in the head of this file."""
        outer = np.zeros(len(within.weights), dtype=np.intp)
        outer[within.groups] = self.groups
        order, starts = _in_order(outer, len(self.weights))
        sizes, member = within.block_norms(values), np.sort(outer)
        sizes = sizes if order is None else sizes[..., order, :]
        inner = (within.weights if order is None else within.weights[order])[:, None]
        omega = self.weights[:, None]

        def total(parts: Array) -> Array:
            return _sums(parts, None, starts, self.joint)

        def highest(parts: Array) -> Array:
            peaks: Array = np.maximum.reduceat(parts, starts, axis=-2)
            return peaks.max(axis=-1, keepdims=True) if self.joint else peaks

        with np.errstate(over="ignore"):  # an l1_ratio near 0: the bound is of no use then
            largest, floor = highest(sizes / (inner + omega[member])), highest(sizes / inner)
        live = largest > 0
        x = np.where(live, 1.0 / np.where(live, largest, 1.0), 0.0)
        for _ in range(NEWTON_STEPS):
            excess = np.maximum(sizes * x[..., member, :] - inner, 0.0)
            length = np.sqrt(total(excess**2))
            slope = total(sizes * excess) / np.where(length > 0, length, 1.0)
            step = np.where(length > omega, (length - omega) / np.where(slope > 0, slope, 1.0), 0.0)
            if not np.any(step > 1e-15 * x):
                break
            x = x - step
        least = np.where(live, 1.0 / np.where(live, floor, 1.0), 0.0)
        below = least + (x - least) * omega / np.maximum(omega, length)
        return np.where(live, 1.0 / np.where(live, below, 1.0), 0.0)


def _in_order(groups: IntArray, count: int) -> tuple[IntArray | None, IntArray]:
    """The order that makes groups ascend (None where they do) and the start of each of them."""
    order = None
    if np.any(groups[1:] < groups[:-1]):
        order = np.argsort(groups, kind="stable")
        groups = groups[order]
    return order, np.searchsorted(groups, np.arange(count))


def _sums(values: Array, order: IntArray | None, starts: IntArray, joint: bool) -> Array:
    """Sums over blocks of values (..., k, n): shape (..., g, n), or (..., g, 1) when joint."""
    if order is not None:
        values = values[..., order, :]
    if joint:
        values = values.sum(axis=-1, keepdims=True)
    sums: Array = np.add.reduceat(values, starts, axis=-2)
    return sums


def lasso_penalty(columns: int) -> Penalty:
    """The LASSO: every coefficient its own block."""
    return Penalty(np.arange(columns), np.ones(columns), joint=False)


def alpha_max(cross: Array, penalty: Penalty) -> float:
    """The smallest alpha whose solution is zero: max_g |Z_g'Y/m| / omega_g, cross (k, n) = Z'Y/m.

    A ridge alone has none. Its unit is k, the trace of Z'Z/m and a bound of its largest eigenvalue:
    there every weight is at most half of what least squares gives its principal component.
    """
    if penalty.smooth:
        return float(len(penalty.groups))
    return float(penalty.dual_norms(cross).max(initial=0.0))
