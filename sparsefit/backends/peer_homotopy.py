"""Public homotopy solvers of the LASSO on Z'Z: scikit-learn's LARS and SPAMS.

Both return the breakpoints of the path; between two of them the solution is linear in the penalty.
"""

from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.peer_forms import Part

STEPS_PER_COLUMN = 10


def scikit_lars(part: Part, fractions: Array, tolerance: float | None) -> Array:
    """``lars_path_gram`` with method "lasso"; it has no tolerance to set."""
    linear_model: Any = import_module("sklearn.linear_model")
    knots, _, coefficients = linear_model.lars_path_gram(
        part.cross * part.samples,
        part.gram * part.samples,
        n_samples=part.samples,
        method="lasso",
        alpha_min=float(fractions[-1]),
        max_iter=STEPS_PER_COLUMN * len(part.omega),
        copy_Gram=False,
    )
    return interpolated(knots, coefficients, fractions).T


def spams_lars(part: Part, fractions: Array, tolerance: float | None) -> Array:
    """``spams.lasso`` on Q = G, q = c with its regularisation path; it has no tolerance to set."""
    spams: Any = import_module("spams")
    gram, cross = np.asfortranarray(part.gram), np.asfortranarray(part.cross[:, None])
    target = np.asfortranarray(part.target[:, None] / np.sqrt(part.samples))
    _, steps = spams.lasso(
        target,
        Q=gram,
        q=cross,
        return_reg_path=True,
        lambda1=float(fractions[-1]),
        mode=spams.PENALTY,
        max_length_path=STEPS_PER_COLUMN * len(gram),
        numThreads=1,
    )
    coefficients = np.hstack([np.zeros((len(gram), 1)), np.asarray(steps)])
    # It returns the breakpoints without their penalties: the largest correlation there is one.
    knots = np.minimum.accumulate(np.abs(cross - gram @ coefficients).max(axis=0))
    return interpolated(knots, coefficients, fractions).T


def interpolated(knots: Array, coefficients: Array, alphas: Array) -> Array:
    """A piecewise linear path at alphas (p,): knots (b,) descending, coefficients (k, b) -> (k, p).

    Below the last knot, where a path broke off, its last coefficients are all there is.
    """
    if len(knots) == 1:
        return np.repeat(coefficients, len(alphas), axis=1)
    alphas = np.clip(alphas, knots[-1], knots[0])
    upper = np.clip(np.searchsorted(-knots, -alphas, side="left"), 1, len(knots) - 1)
    width = knots[upper - 1] - knots[upper]
    share = np.where(width > 0, (knots[upper - 1] - alphas) / np.where(width > 0, width, 1.0), 1.0)
    between: Array = coefficients[:, upper - 1] * (1 - share) + coefficients[:, upper] * share
    return between
