"""Norms of weights in an order: SLOPE's by their size, the fused LASSO's by their place.

Sources: Bogdan, van den Berg, Sabatti, Su and Candes, Ann. Appl. Stat. 9 (2015) 1103-1140;
Tibshirani, Saunders, Rosset, Zhu and Knight, J. R. Stat. Soc. B 67 (2005) 91-108; Friedman,
Hastie, Hoefling and Tibshirani, Ann. Appl. Stat. 1 (2007) 302-332, for the prox of both terms.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.penalties import Penalty, Slope, soft


@dataclass(frozen=True, eq=False)
class SortedNorm(Penalty):
    """SLOPE's norm of each target, sum_i lambda_i |V|_(i), |V|_(1) >= |V|_(2) >= ...

    The array weights holds lambda (k,) > 0, which descends; j columns of the k have the j largest.
    The dual norm is max_i (|C|_(1) + ... + |C|_(i)) / (lambda_1 + ... + lambda_i). The prox is the
    isotonic regression of the sorted |V| less step lambda; its derivative is the mean over each
    cluster of equal |V|.
    """

    weights: Array

    @property
    def columns(self) -> int:
        return len(self.weights)

    def norm(self, values: Array) -> Array:
        ordered = -np.sort(-np.abs(values), axis=-2)
        total: Array = (ordered * self.weights[:, None]).sum(axis=(-2, -1))
        return total

    def dual_norm(self, values: Array) -> Array:
        sums = np.cumsum(-np.sort(-np.abs(values), axis=-2), axis=-2)
        peaks: Array = (sums / np.cumsum(self.weights)[:, None]).max(axis=-2)
        return peaks

    @property
    def units(self) -> IntArray:
        return np.arange(self.columns)

    def violations(self, correlation: Array, values: Array, alpha: float | Array) -> Array:
        out = np.full(self.columns, -1.0)
        for pull, weight in zip(np.abs(correlation).T, values.T, strict=True):
            # What is below the least limit adds to no sum.
            off = np.flatnonzero((weight == 0) & (pull > alpha * self.weights[-1]))
            order = off[np.argsort(-pull[off])]
            used = np.count_nonzero(weight)
            excess = np.cumsum(pull[order] - alpha * self.weights[used : used + len(off)])
            count = int(np.argmax(excess)) + 1 if len(off) and excess.max() > 0 else 0
            out[order[:count]] = np.maximum(out[order[:count]], pull[order[:count]] / alpha)
        return out

    def restricted(self, index: IntArray) -> Self:
        return replace(self, weights=self.weights[: len(index)])

    def prox(self, values: Array, step: float) -> Array:
        from scipy.optimize import isotonic_regression

        out = np.empty_like(values)
        for t, column in enumerate(values.T):
            order = np.argsort(-np.abs(column), kind="stable")
            reduced = np.abs(column)[order] - step * self.weights
            fitted = isotonic_regression(reduced, increasing=False).x
            out[order, t] = np.sign(column[order]) * np.maximum(fitted, 0.0)
        return out

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        on = np.flatnonzero(values)
        keys = np.stack([(on % values.shape[1]).astype(float), np.abs(values.ravel()[on])])
        block = np.unique(keys, axis=1, return_inverse=True)[1].ravel()
        return on, _means(block, np.sign(values.ravel()[on]))

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        steps = self.weights - np.append(self.weights[1:], 0.0)
        terms = []
        for t, i in np.ndindex(variable.shape[1], self.columns):
            sizes = cvxpy.abs(variable[:, t])
            largest = cvxpy.sum(sizes) if i + 1 == self.columns else cvxpy.sum_largest(sizes, i + 1)
            terms += [float(steps[i]) * largest] if steps[i] > 0 else []
        return cvxpy.sum(cvxpy.hstack(terms)), []


@dataclass(frozen=True, eq=False)
class FusedNorm(Penalty):
    """The fused LASSO's norm of each target, r sum_j |V_j| + (1 - r) sum_j |V_(j+1) - V_j|.

    The number ``count`` is k, the ratio r in (0, 1]. The prox is that of the total variation, then
    soft thresholding; its derivative is the mean over each run of equal weights.
    """

    count: int
    ratio: float

    @property
    def columns(self) -> int:
        return self.count

    def norm(self, values: Array) -> Array:
        jumps = np.abs(np.diff(values, axis=-2)).sum(axis=(-2, -1))
        total: Array = self.ratio * np.abs(values).sum(axis=(-2, -1)) + (1.0 - self.ratio) * jumps
        return total

    def rough(self, values: Array) -> Array:
        signs = np.where(np.arange(self.count) % 2, -1.0, 1.0)
        return self.norm(np.abs(values) * signs[:, None])

    def prox(self, values: Array, step: float) -> Array:
        flat = np.stack([_taut(column, step * (1.0 - self.ratio)) for column in values.T], axis=1)
        return soft(flat, np.full((1, 1), step * self.ratio))

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        on = np.flatnonzero(values)
        change = np.diff(values, axis=0, prepend=np.nan) != 0
        run = (np.cumsum(change, axis=0) + self.count * np.arange(values.shape[1])).ravel()[on]
        return on, _means(np.unique(run, return_inverse=True)[1], np.ones(len(on)))

    def conic(self, variable: Any, cvxpy: Any) -> tuple[Any, list[Any]]:
        jumps = cvxpy.sum(cvxpy.abs(variable[1:] - variable[:-1])) if self.count > 1 else 0.0
        return self.ratio * cvxpy.sum(cvxpy.abs(variable)) + (1.0 - self.ratio) * jumps, []


def _means(block: IntArray, signs: Array) -> Any:
    """The factor N (c, d) of means over blocks: a block of b entries has their signs / sqrt(b)."""
    from scipy.sparse import csc_array

    size = np.sqrt(np.bincount(block))
    entries = (signs / size[block], (np.arange(len(block)), block))
    return csc_array(entries, shape=(len(block), len(size)))


def _taut(y: Array, limit: float) -> Array:
    """The argmin of |x - y|^2/2 + limit sum |x_(i+1) - x_i|: a taut string in a tube."""
    sums, x = np.concatenate([[0.0], np.cumsum(y)]).tolist(), np.empty(len(y))
    k, start, height = len(y), 0, 0.0
    while start < k:
        low, high, low_at, high_at = -np.inf, np.inf, start, start
        for i in range(start + 1, k + 1):
            radius = limit if i < k else 0.0
            rise, fall = sums[i] + radius - height, sums[i] - radius - height
            upper, lower = rise / (i - start), fall / (i - start)
            if lower > high:  # the tube rises above the string's upper bound: it bends there
                end, value = high_at, high
                break
            if upper < low:
                end, value = low_at, low
                break
            if upper <= high:
                high, high_at = upper, i
            if lower >= low:
                low, low_at = lower, i
        else:
            end, value = k, (sums[k] - height) / (k - start)
        x[start:end] = value
        height, start = height + value * (end - start), end
    return x
