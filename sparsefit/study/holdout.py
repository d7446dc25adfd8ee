"""How well answers predict and recover: held-out rows, the support, and how alike two halves are.

    holdout_error = sum over folds |Y - Theta W|^2 / |Y - mean(Y_train)|^2   on the rows held out

A fold is a block of neighbouring rows, as neighbours in time are alike. The penalty of a fold is
chosen on the others.
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.columns import Value

FOLDS = 5  # blocks of neighbouring rows that are held out in turn
IN_USE = 1e-3  # share of the largest weight (of columns of unit rms), above which a column is used


def missed(theta: Array, target: Array, weights: Array) -> Array:
    """The squares (p,) that answers (p, k, n) leave of rows."""
    return np.array([float(((target - theta @ each) ** 2).sum()) for each in weights])


def cross_validated(errors: Array, bases: Array) -> dict[str, Value]:
    """The held-out share of the squares, and its standard error over the folds.

    errors (f, p): squares missed in each fold at each penalty; bases (f,): those about the mean.
    The penalty of a fold is chosen on the others, so that it has not been seen there.
    """
    others = errors.sum(axis=0) - errors
    chosen = others.argmin(axis=1) if len(errors) > 1 else np.zeros(len(errors), int)
    missed = errors[np.arange(len(errors)), chosen]
    shares = missed / np.maximum(bases, 1e-300)
    spread = float(shares.std(ddof=1) / math.sqrt(len(shares))) if len(shares) > 1 else math.nan
    total = float(missed.sum() / max(bases.sum(), 1e-300))
    return {"holdout_error": total, "holdout_error_se": spread}


def support(weights: Array, rms: Array) -> BoolArray:
    """Which columns (k,) are in use, of weights (k, n)."""
    sizes = np.sqrt((weights**2).sum(axis=1)) * rms
    used: BoolArray = sizes > IN_USE * sizes.max(initial=0.0)
    return used


def recovered(used: BoolArray, truth: BoolArray) -> dict[str, Value]:
    """Precision, recall and F1 of the columns in use against the true ones."""
    hits = float((used & truth).sum())
    precision = hits / used.sum() if used.any() else math.nan
    recall = hits / truth.sum() if truth.any() else math.nan
    f1 = 2.0 * hits / (used.sum() + truth.sum()) if used.any() or truth.any() else math.nan
    recovered = {"precision": float(precision), "recall": float(recall), "f1": float(f1)}
    return {"true_support": int(truth.sum()), **recovered}
