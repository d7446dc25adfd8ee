"""Penalties Omega(V) on the weights V (k, n) of columns of unit rms, one class each.

    minimise over V:   loss(Y - Z V) + alpha * Omega(V),   Omega(V) = norm(V) + ridge/2 |V|_F^2

A class defines its ``norm`` and its ``prox``

    argmin over V of  |V - U|^2/2 + step * norm(V).

The ``dual_norm`` max {<C, V> : norm(V) <= 1} follows, if a closed form is not faster, and with it
certificate, alpha_max, working sets and paths. ``slope`` is a factor N of the derivative of
the prox, N N', and makes the generic solver Newton's method; without it the derivative is taken
coefficient by coefficient. ``conic`` is the norm as an expression of cvxpy.

Penalties of groups are in `group_penalties`, those of an order in `ordered_penalties`.
Sources: Tibshirani (1996); Zou (2006), weights; Zou and Hastie (2005), ridge.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.errors import InputError
from sparsefit.regression.losses import SQUARES, Squares

Slope = tuple[IntArray, Any]
"""Flat indices (c,) into V.ravel() and N (c, d), sparse; None in its place is the identity."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Penalty(ABC):
    """A penalty on k columns; a subclass defines ``norm`` and ``prox``.

    ridge: rho of the additional term rho/2 |V|^2; loss: the loss that the penalty is added to.
    """

    ridge: float = 0.0
    loss: Squares = SQUARES

    @property
    def columns(self) -> int:
        """The number k of columns; a subclass defines it or its blocks."""
        if type(self).blocks is Penalty.blocks:
            raise InputError(f"{type(self).__name__} defines neither `columns` nor `blocks`")
        return len(self.blocks)

    @abstractmethod
    def norm(self, values: Array) -> Array:
        """The norm of values (..., k, n): shape (...)."""

    @abstractmethod
    def prox(self, values: Array, step: float) -> Array:
        """The minimiser over V of |V - values|^2/2 + step * norm(V), values (k, n)."""

    @property
    def coupled(self) -> bool:
        """Whether blocks span all targets, which are then one problem and not n separate ones."""
        return self.loss.coupled

    @property
    def blocks(self) -> IntArray:
        """The block (k,) of each column; all columns are one block by default."""
        return np.zeros(self.columns, dtype=np.intp)

    def value(self, values: Array) -> Array:
        """Omega of values (..., k, n): shape (...)."""
        square = np.square(values).sum(axis=(-2, -1)) if self.ridge else 0.0
        return self.norm(values) + 0.5 * self.ridge * square

    def rough(self, values: Array) -> Array | float:
        """The largest norm of dV, |dV_jt| <= |V_jt|, shape (...); 0 where it is norm(V)."""
        return 0.0

    def block_dual_norms(self, values: Array) -> Array:
        """The dual norm of each block of values (..., k, n): (..., g, n), or (..., g, 1)."""
        return self.dual_norm(values)[..., None, :]

    def dual_norm(self, values: Array) -> Array:
        """The dual norm of values (..., k, n), the largest of all blocks: (..., n) or (..., 1).

        Where |C| <= e in every entry it is at most that of C = e. By default it is the least s at
        which prox(C, s) is zero, by Newton's method: with P = prox(C, s), <C, P> = s norm(P) +
        |P|^2, so that s rises to <C, P> / norm(P), and ends in few steps.
        """
        if type(self).block_dual_norms is not Penalty.block_dual_norms:
            return np.asarray(self.block_dual_norms(values).max(axis=-2))
        apart = values[..., None, :, :] if self.coupled else np.swapaxes(values, -1, -2)[..., None]
        peaks = np.zeros(apart.shape[:-2])
        for place in np.ndindex(peaks.shape):
            size = float(np.abs(apart[place]).max(initial=0.0)) or 1.0
            part, last, rise = apart[place] / size, -1.0, 0.0
            while rise > last:
                point, last = self.prox(part, rise), rise
                rise = float(np.vdot(part, point) / self.norm(point)) if point.any() else last
            peaks[place] = size * last
        return peaks

    def conjugate(self, values: Array, alpha: Array | float) -> Array:
        """max over V of <C, V> - alpha norm(V) for values C (..., k, n): (..., n), where finite.

        Of a norm it is 0 where its dual norm is <= alpha, and need not be overridden. Of bounded
        weights it is finite; the norm is infinite beyond the bounds, and `in_units` divides these.
        """
        return np.zeros((*values.shape[:-2], values.shape[-1]))

    def beyond(self, values: Array, alpha: Array, error: Array) -> Array:
        """An upper bound of the conjugate where each entry has an error of up to (..., 1, n).

        <E, V> <= e |V|_1 <= e d norm(V), d the dual norm of entries of 1: alpha may be less by e d.
        """
        ones = np.ones(values.shape[-2:])
        unit = np.maximum(self.dual_norm(ones), self.dual_norm(-ones))
        return self.conjugate(values, alpha - error * unit)

    @property
    def is_bounded(self) -> bool:
        """Whether weights have bounds, so that the conjugate is finite everywhere."""
        return type(self).conjugate is not Penalty.conjugate

    def constraint(self, values: Array) -> Array:
        """The gauge (..., n) that a feasible dual point bounds by alpha: the dual norm.

        0 where the conjugate is finite.
        """
        if self.is_bounded:
            return np.zeros((*values.shape[:-2], values.shape[-1]))
        peaks, ours = self.dual_norm(values), type(self).__module__.startswith("sparsefit.")
        return peaks if ours else np.maximum(peaks, self._along_axes(values, peaks.shape[-1]))

    def _along_axes(self, values: Array, parts: int) -> Array:
        """The largest <C, V>/norm(V) of V on 64 axes of the largest C, (..., n) or (..., 1).

        A dual norm is no less, and this rests on the norm alone: a penalty of others may have a
        wrong one, while those of the package are tested.
        """
        index = np.argsort(-np.abs(values).reshape(-1, *values.shape[-2:]).max(axis=(0, 2)))[:64]
        axes, part = np.eye(self.columns)[index, :, None], values[..., index, :]
        with np.errstate(divide="ignore", invalid="ignore"):  # of no price
            pulls = np.fmax(part / self.norm(axes)[:, None], -part / self.norm(-axes)[:, None])
        peaks: Array = np.fmax(pulls, 0.0).max(axis=-2)
        return peaks if parts > 1 else peaks.max(axis=-1, keepdims=True)

    def raised(self, values: Array, peaks: Array, error: Array) -> Array:
        """A bound of the gauge where each entry has an error of up to (..., n); peaks: without."""
        unit = self.constraint(np.ones(values.shape[-2:]))
        return peaks + error * np.maximum(unit, self.constraint(-np.ones(values.shape[-2:])))

    @property
    def units(self) -> IntArray:
        """The unit (k,) of each column: units join a working set as a whole, and are its blocks."""
        return self.blocks

    def violations(self, correlation: Array, values: Array, alpha: float | Array) -> Array:
        """The excess of each unit's dual norm over alpha (...), relative to alpha: (..., u).

        <= 0: a unit whose weights are zero meets the optimality conditions. correlation Z'R/m and
        values (..., k, n): at the optimum of a working set.
        """
        dual = self.block_dual_norms(correlation).max(axis=-1)
        excess: Array = dual / np.maximum(alpha, 1e-150)[..., None] - 1.0  # alpha_max may be 0
        return excess

    def restricted(self, index: IntArray) -> Self | None:
        """The penalty on some of the columns, in whole blocks; None where it has no such form."""
        return None

    def in_units(self, level: float) -> Self:
        """The penalty of which V/level is the minimiser at alpha/level, for targets Y/level."""
        return replace(self, ridge=self.ridge * level) if self.ridge else self

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        """The factor N of the prox's derivative at ``origin`` (k, n), values = prox(origin).

        By finite differences, coefficient by coefficient: exact where these are separate.
        """
        from scipy.sparse import diags_array

        small = 1e-7 * (float(np.abs(origin).max()) or 1.0)
        rate = (self.prox(origin + small, step) - values).ravel() / small
        on = np.flatnonzero(rate > 1e-6)
        return on, diags_array(np.sqrt(np.minimum(rate[on], 1.0))).tocsc()

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        """The norm of a variable (k, n) of cvxpy as an expression, and a list of constraints."""
        raise InputError(f"{type(self).__name__} has no method `conic`: use solver 'exact'")


def alpha_max(cross: Array, penalty: Penalty) -> float:
    """The smallest alpha whose solution is zero: the dual norm of Z'Y/m (k, n)."""
    return float(penalty.dual_norm(cross).max(initial=0.0))


@dataclass(frozen=True, eq=False)
class AbsoluteValues(Penalty):
    """sum_j omega_j sum_t |V_jt|: the LASSO, adaptive where the weights omega (k,) > 0 differ."""

    weights: Array

    @property
    def blocks(self) -> IntArray:
        return np.arange(len(self.weights))

    def norm(self, values: Array) -> Array:
        total: Array = (np.abs(values) * self.weights[:, None]).sum(axis=(-2, -1))
        return total

    def block_dual_norms(self, values: Array) -> Array:
        return abs(values) / self.weights[:, None]

    def restricted(self, index: IntArray) -> Self:
        return replace(self, weights=self.weights[index])

    def prox(self, values: Array, step: float) -> Array:
        return soft(values, step * self.weights[:, None])

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        return np.flatnonzero(values), None

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        return cvxpy.sum(cvxpy.multiply(self.weights[:, None], cvxpy.abs(variable))), []


def lasso_penalty(columns: int) -> AbsoluteValues:
    """The LASSO's penalty on k columns."""
    return AbsoluteValues(np.ones(columns))


@dataclass(frozen=True, eq=False)
class BoundedValues(AbsoluteValues):
    """sum_j omega_j |V_jt| where lower_j <= V_jt <= upper_j, and infinite elsewhere.

    lower <= 0 <= upper (k,), in columns of unit rms; 0 and infinity: the non-negative LASSO. Only
    directions without a bound constrain a dual point; in the others the conjugate is the bound
    times what exceeds alpha omega_j.
    """

    lower: Array
    upper: Array

    def norm(self, values: Array) -> Array:
        slack = 1e-12 * np.abs(values)
        within = (values >= self.lower[:, None] - slack) & (values <= self.upper[:, None] + slack)
        return np.where(within.all(axis=(-2, -1)), super().norm(values), np.inf)

    def block_dual_norms(self, values: Array) -> Array:
        return self._pull(values, 0.0, self.upper > 0, self.lower < 0)

    @property
    def is_bounded(self) -> bool:
        edges = np.concatenate([self.lower, self.upper])
        return bool(np.any(np.isfinite(edges) & (edges != 0)))

    def constraint(self, values: Array) -> Array:
        return self.raised(values, values, np.zeros(values.shape[-1]))

    def raised(self, values: Array, peaks: Array, error: Array) -> Array:
        # Not as of a norm: where C < -error everywhere, the gauge is 0, and so is alpha_max.
        free = np.isinf(self.upper), np.isinf(self.lower)
        pull: Array = self._pull(values, error[..., None, :], *free).max(axis=-2)
        return pull

    def _pull(self, values: Array, error: Array | float, up: BoolArray, down: BoolArray) -> Array:
        """(C_jt + error) / omega_j up and down, where each (k,) is allowed; 0 elsewhere."""
        rise = np.where(up[:, None], values + error, 0.0)
        fall = np.where(down[:, None], error - values, 0.0)
        return np.maximum(np.maximum(rise, fall), 0.0) / self.weights[:, None]

    def conjugate(self, values: Array, alpha: Array | float) -> Array:
        limit, over = alpha * self.weights[:, None], np.zeros(())
        for bound, sign in ((self.upper, 1.0), (-self.lower, -1.0)):
            reach = np.where(np.isinf(bound), 0.0, bound)[:, None]
            over = over + reach * np.maximum(sign * values - limit, 0.0)
        total: Array = over.sum(axis=-2)
        return total

    def in_units(self, level: float) -> Self:
        return replace(super().in_units(level), lower=self.lower / level, upper=self.upper / level)

    def restricted(self, index: IntArray) -> Self:
        return replace(super().restricted(index), lower=self.lower[index], upper=self.upper[index])

    def prox(self, values: Array, step: float) -> Array:
        return np.clip(super().prox(values, step), self.lower[:, None], self.upper[:, None])

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        free = (values > self.lower[:, None]) & (values < self.upper[:, None])
        return np.flatnonzero(free & (values != 0)), None

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        bounds = []
        for bound, sign in ((self.upper, 1.0), (-self.lower, -1.0)):
            if len(on := np.flatnonzero(np.isfinite(bound))):
                bounds.append(sign * variable[on] <= bound[on, None])
        return super().conic(variable, cvxpy)[0], bounds


@dataclass(frozen=True, eq=False)
class SquaredNorm(Penalty):
    """A ridge alone, |V|^2/2, which has no norm and no finite alpha whose solution is zero.

    Its unit of alpha is k, the trace of Z'Z/m, a bound of the largest eigenvalue.
    """

    count: int
    ridge: float = field(default=1.0, kw_only=True)

    @property
    def columns(self) -> int:
        return self.count

    @property
    def coupled(self) -> bool:
        return True

    def norm(self, values: Array) -> Array:
        return np.zeros(values.shape[:-2])

    def dual_norm(self, values: Array) -> Array:
        return np.full((*values.shape[:-2], 1), float(self.count))

    def constraint(self, values: Array) -> Array:
        return np.zeros((*values.shape[:-2], 1))

    def prox(self, values: Array, step: float) -> Array:
        return values

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        return 0.0, []


def soft(values: Array, limit: Array) -> Array:
    """Soft thresholding, sign(x) max(|x| - limit, 0)."""
    return np.sign(values) * np.maximum(abs(values) - limit, 0.0)
