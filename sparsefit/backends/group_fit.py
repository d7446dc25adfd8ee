"""Least squares on a few groups of columns, safe where they are rank deficient."""

import math
from typing import Literal

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.problem import RegressionProblem

UNSAFE = 1e-9  # of Z'Z: a group with an eigenvalue below it, relative, is projected on by its rows
Stop = Literal["decrease", "bic"]
"""The rules by which one more group is worth its weights."""
DOUBT = 1e-6  # of |Y|^2: residuals this close in Gram space are settled on the rows


def explained(
    problem: RegressionProblem, weights: Array | None = None, rcond: float | None = None
) -> Array:
    """|P_g R|^2 / m (g,): what each group alone explains of R = Y - theta W (W = 0 without).

    From Z'Z/m and Z'R/m, groups of one size in one batch; from the rows where Z'Z has lost a
    group's rank. rcond: relative to the largest singular value of the group's scaled columns.
    """
    statistics = problem.statistics
    cross = statistics.cross
    if weights is not None:
        cross = cross - statistics.gram @ (weights * statistics.rms[:, None])
    order = np.argsort(problem.groups, kind="stable")
    sizes = np.bincount(problem.groups)
    starts = np.cumsum(sizes) - sizes
    gains = np.zeros(len(sizes))
    floor = max(rcond or 0.0, 0.0) ** 2
    for size in np.unique(sizes[sizes > 0]):
        chosen = np.flatnonzero(sizes == size)
        index = order[starts[chosen][:, None] + np.arange(size)]
        roots, vectors = np.linalg.eigh(statistics.gram[index[:, :, None], index[:, None, :]])
        load = np.sum((vectors.transpose(0, 2, 1) @ cross[index]) ** 2, axis=2)
        kept = roots > max(floor, UNSAFE) * roots[:, -1:]
        gains[chosen] = np.sum(np.where(kept, load / np.where(kept, roots, 1.0), 0.0), axis=1)
        if floor < UNSAFE:  # a coarser rcond drops what rounding could have touched
            for i in np.flatnonzero(~kept.all(axis=1)):
                gains[chosen[i]] = _explained_by_rows(problem, index[i], weights, rcond)
    return gains


def _explained_by_rows(
    problem: RegressionProblem, columns: IntArray, weights: Array | None, rcond: float | None
) -> float:
    """|P_g R|^2 / m by the singular value decomposition of the group's scaled columns."""
    residual = problem.target if weights is None else residual_of(problem, weights)
    z = problem.theta[:, columns] / problem.statistics.rms[columns]
    left, values, _ = np.linalg.svd(z, full_matrices=False)
    rounding = float(np.finfo(float).eps) * max(z.shape)
    left = left[:, values > (rounding if rcond is None else rcond) * values[0]]
    return float(np.sum((left.T @ residual) ** 2)) / problem.samples


def fit_on(problem: RegressionProblem, columns: IntArray, rcond: float | None = None) -> Array:
    """Weights (k, n), the minimum-norm least squares on these columns in unit rms, by the rows."""
    rms = problem.statistics.rms[columns]
    values = np.linalg.lstsq(problem.theta[:, columns] / rms, problem.target, rcond=rcond)[0]
    weights = np.zeros((problem.columns, problem.targets))
    weights[columns] = values / rms[:, None]
    return weights


def residual_of(problem: RegressionProblem, weights: Array) -> Array:
    """R = Y - theta W (rows, n), from the columns in use."""
    used = np.flatnonzero(np.any(weights != 0, axis=1))
    residual: Array = problem.target - problem.theta[:, used] @ weights[used]
    return residual


def residual_square(problem: RegressionProblem, weights: Array) -> float:
    """|R|^2 / m of weights (k, n)."""
    residual = residual_of(problem, weights)
    return float(np.sum(residual * residual)) / problem.samples


def is_worth(
    problem: RegressionProblem, weights: Array, larger: Array, stop: Stop, tolerance: float
) -> bool:
    """Whether ``larger`` weights lower the residual sum of squares by more than they cost.

    ``decrease``: by tolerance * |Y|^2; ``bic``: m n ln(RSS) by ln(m n) for each weight more.
    """
    before, after = residual_square(problem, weights), residual_square(problem, larger)
    total = float(problem.statistics.target_square.sum())
    if stop == "decrease":
        return before - after > tolerance * total
    if before <= 1e-28 * total:
        return False  # rounding
    added = int(np.sum(larger != 0) - np.sum(weights != 0))
    count = problem.samples * problem.targets
    return count * math.log(before / max(after, 1e-300)) > added * math.log(count)
