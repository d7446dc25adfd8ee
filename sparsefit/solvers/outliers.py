"""Paths with Huber's loss: an outlier for each row, which is penalised by its absolute value.

    h_c(r) = min over o of (r - o)^2/2 + c |o|

makes the LASSO with Huber's loss one with the squares, on [Z, sqrt(m) I] with the outliers
o/sqrt(m) as further weights, of penalty c/(sqrt(m) alpha): both are solved by proximal points.
Source: She and Owen, J. Am. Stat. Assoc. 106 (2011) 626-639.
"""

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.solvers.kernels import STOP, Points
from sparsefit.solvers.newton import Columns, settled

MOST = 20_000  # rows and columns together, whose squares are formed


def outlier_path(
    design: Design, target: Array, cross: Array, penalty: Penalty, alphas: Array
) -> Points:
    """The optimum at descending penalties alphas (p,) of Huber's loss, for targets (m, n).

    cross Z'Y/m (k, n). Raises InputError where rows and columns are too many for the sums of their
    squares, or the penalty is not the LASSO's.
    """
    m, k = design.shape
    if m + k > MOST:
        raise InputError(f"Huber's loss takes {MOST} rows and columns together, not {m + k}")
    if type(penalty) is not AbsoluteValues or penalty.ridge:
        name = type(penalty).__name__
        raise InputError(f"Huber's loss takes absolute values as the penalty, not {name}")
    root, points = np.sqrt(m), Points.zeros(len(alphas), cross, "newton, an outlier for each row")
    wide = np.hstack([design.columns(np.arange(k)), np.eye(m) * root])
    levels = np.sqrt(np.square(target).sum(axis=0) / design.samples)
    reach = penalty.loss.bound(target)
    for t in np.flatnonzero(levels):
        y = target[:, [t]] / levels[t]
        pull, values = wide.T @ y / design.samples, np.zeros((k + m, 1))
        for i, alpha in enumerate((alphas / levels[t]).tolist()):
            price = float(reach[t] / levels[t]) * root / (design.samples * alpha)
            weights = np.concatenate([penalty.weights, np.full(m, price)])
            on = Columns(AbsoluteValues(weights), pull, design.samples, None, wide)
            values, gap, steps = settled(on, alpha, values, STOP)
            points.weights[i, :, t] = values[:k, 0] * levels[t]
            points.complete[i] &= gap <= STOP
            points.steps[i] += steps
    return points
