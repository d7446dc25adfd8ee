"""The one objective: numpy only, one convention for every back-end.

In scaled columns z_j = theta_j / rms(theta_j), with m samples, k columns and n targets:

    minimise over V (k, n):   P(V) = 1/(2m) |Y - Z V|_F^2 + alpha * sum_g omega_g |V_g|

Weights in the original units of theta are W = V / rms.
"""

from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property


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
        groups, order = self.groups, None
        if np.any(groups[1:] < groups[:-1]):
            order = np.argsort(groups, kind="stable")
            groups = groups[order]
        return order, np.searchsorted(groups, np.arange(len(self.weights)))

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
