"""Paths with Huber's loss: an outlier for each row, which is penalised by its absolute value.

    h_c(r) = min over o of (r - o)^2/2 + c |o|

makes a penalty added to Huber's loss one added to the squares, on [Z, sqrt(m) I] with the outliers
o/sqrt(m) as further weights, of penalty c/(sqrt(m) alpha): both are solved by proximal points.
Source: She and Owen, J. Am. Stat. Assoc. 106 (2011) 626-639.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.regression.design import Design
from sparsefit.regression.losses import SQUARES
from sparsefit.regression.penalties import Penalty, Slope, soft
from sparsefit.solvers.kernels import STOP, Points
from sparsefit.solvers.newton import Columns, settled

MOST = 20_000  # rows and columns together, whose squares are formed


@dataclass(frozen=True, eq=False)
class WithOutliers(Penalty):
    """The penalty on the leading weights, ``price`` times the absolute values on the m others."""

    inner: Penalty
    rows: int
    price: float

    @property
    def columns(self) -> int:
        """Columns and rows."""
        return self.inner.columns + self.rows

    def norm(self, values: Array) -> Array:
        """The sum of both, the ridge's included."""
        k = self.inner.columns
        outliers = np.abs(values[..., k:, :]).sum(axis=(-2, -1))
        total: Array = self.inner.value(values[..., :k, :]) + self.price * outliers
        return total

    def dual_norm(self, values: Array) -> Array:
        """The larger of both."""
        k = self.inner.columns
        outliers = np.abs(values[..., k:, :]).max(axis=-2) / self.price
        peaks: Array = np.maximum(self.inner.constraint(values[..., :k, :]), outliers)
        return peaks

    def prox(self, values: Array, step: float) -> Array:
        """Each by itself."""
        k, shrink = self.inner.columns, 1.0 / (1.0 + step * self.inner.ridge)
        first = self.inner.prox(values[:k] * shrink, step * shrink)
        return np.concatenate([first, soft(values[k:], np.full((1, 1), step * self.price))])

    def slope(self, origin: Array, values: Array, step: float) -> Slope:
        """Each by itself, one for an outlier that is not zero."""
        from scipy.sparse import block_diag, eye_array

        k, shrink = self.inner.columns, 1.0 / (1.0 + step * self.inner.ridge)
        on, factor = self.inner.slope(origin[:k] * shrink, values[:k], step * shrink)
        others = k * values.shape[1] + np.flatnonzero(values[k:])
        root = float(np.sqrt(shrink))
        first = root * (eye_array(len(on)) if factor is None else factor)
        both = np.concatenate([on, others])
        return both, block_diag([first, eye_array(len(others))], format="csc")


def outlier_path(design: Design, target: Array, penalty: Penalty, alphas: Array) -> Points:
    """The optimum at descending penalties alphas (p,) of Huber's loss, for targets (m, n).

    Raises InputError where rows and columns are too many for the sums of their squares.
    """
    (m, k), targets = design.shape, target.shape[1]
    if m + k > MOST:
        raise InputError(f"Huber's loss takes {MOST} rows and columns together, not {m + k}")
    root, samples = np.sqrt(m), design.samples
    z = design.columns(np.arange(k))
    wide = np.hstack([z, np.eye(m) * root])
    level = np.sqrt(np.einsum("it,it->t", target, target) / samples)
    bounds, plain = penalty.loss.bound(level), replace(penalty, loss=SQUARES)
    weights, complete = np.zeros((len(alphas), k, targets)), np.ones(len(alphas), bool)
    steps = np.zeros(len(alphas), np.intp)
    parts = [slice(None)] if penalty.coupled else [slice(t, t + 1) for t in range(targets)]
    for part in parts:
        unit = float(np.sqrt(np.sum(level[part] ** 2)))
        if unit == 0.0:
            continue
        cross = wide.T @ target[:, part] / samples / unit
        values = np.zeros(cross.shape)
        inner, bound = plain.in_units(unit), float(bounds[part].min())
        for i, alpha in enumerate((alphas / unit).tolist()):
            price = bound * root / (samples * unit * alpha)
            on = Columns(WithOutliers(inner, m, price), cross, samples, None, wide)
            values, gap, count = settled(on, alpha, values, STOP)
            weights[i, :, part] = values[:k] * unit
            complete[i] &= gap <= STOP
            steps[i] += count
    return Points(weights, complete, steps, "newton, an outlier for each row")
