"""Least squares on a few groups of columns, safe where they are rank deficient."""

import numpy as np
from numpy.typing import NDArray

from sparsefit.library import RegressionProblem

Array = NDArray[np.float64]
Ints = NDArray[np.intp]
GRAM_RCOND = 1e-11  # of Z'Z: eigenvalues below it, relative, are rounding and dropped
DOUBT = 1e-6  # of |Y|^2: residuals this close in Gram space are settled on the rows


def explained(gram: Array, cross: Array, groups: Ints, rcond: float | None = None) -> Array:
    """|P_g Y|^2 / m (g,): what each group alone explains, from Z'Z/m (k, k) and Z'Y/m (k, n).

    Groups of one size go through one batched eigendecomposition. rcond: relative to the largest
    singular value of the group's scaled columns.
    """
    floor = GRAM_RCOND if rcond is None else max(rcond * rcond, GRAM_RCOND)
    order = np.argsort(groups, kind="stable")
    sizes = np.bincount(groups)
    starts = np.cumsum(sizes) - sizes
    gains = np.zeros(len(sizes))
    for size in np.unique(sizes):
        if size == 0:
            continue
        chosen = np.flatnonzero(sizes == size)
        index = order[starts[chosen][:, None] + np.arange(size)]
        roots, vectors = np.linalg.eigh(gram[index[:, :, None], index[:, None, :]])
        kept = roots > floor * roots[:, -1:]
        load = vectors.transpose(0, 2, 1) @ cross[index]
        inverse = np.where(kept, 1.0 / np.where(kept, roots, 1.0), 0.0)
        gains[chosen] = np.sum(np.sum(load * load, axis=2) * inverse, axis=1)
    return gains


def fit_on(problem: RegressionProblem, columns: Ints, rcond: float | None = None) -> Array:
    """Weights (k, n), the minimum-norm least squares on these columns in unit rms, by the rows."""
    rms = problem.statistics.rms[columns]
    values = np.linalg.lstsq(problem.theta[:, columns] / rms, problem.target, rcond=rcond)[0]
    weights = np.zeros((problem.columns, problem.targets))
    weights[columns] = values / rms[:, None]
    return weights


def residual_square(problem: RegressionProblem, weights: Array) -> float:
    """|Y - theta W|^2 / m, from the columns in use."""
    used = np.flatnonzero(np.any(weights != 0, axis=1))
    residual = problem.target - problem.theta[:, used] @ weights[used]
    return float(np.sum(residual * residual)) / problem.samples
