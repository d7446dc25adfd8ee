"""Public homotopy solvers: scikit-learn's LARS and SPAMS, both on the Gram matrix."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.bench.contender import Contender, gram_form, interpolated
from sparsefit.bench.problems import Task

STEPS_PER_COLUMN = 10


def _lars(task: Task, fractions: Array, _: float) -> Array:
    """lars_path_gram, method 'lasso', its breakpoints interpolated at the asked penalties."""
    linear_model: Any = import_module("sklearn.linear_model")
    s = gram_form(task)
    alphas = task.unit * fractions
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # dropped regressors: the certificate shows what they cost
        knots, _active, coefficients = linear_model.lars_path_gram(
            s.cross[:, 0] * s.samples,
            s.gram * s.samples,
            n_samples=s.samples,
            method="lasso",
            alpha_min=float(alphas[-1]),
            max_iter=STEPS_PER_COLUMN * len(s.gram),
            copy_Gram=False,
        )
    found: Array = interpolated(knots, coefficients, alphas).T[..., None] / s.rms[:, None]
    return found


def _spams(task: Task, fractions: Array, _: float) -> Array:
    """spams.lasso on Q = G, q = c: its regularisation path, interpolated."""
    spams: Any = import_module("spams")
    s = gram_form(task)
    alphas = task.unit * fractions
    target = np.asfortranarray(task.problem.target / np.sqrt(s.samples))
    gram, cross = np.asfortranarray(s.gram), np.asfortranarray(s.cross)
    _last, steps = spams.lasso(
        target,
        Q=gram,
        q=cross,
        return_reg_path=True,
        lambda1=float(alphas[-1]),
        mode=spams.PENALTY,
        max_length_path=STEPS_PER_COLUMN * len(gram),
        numThreads=1,
    )
    steps = np.asarray(steps)
    coefficients = np.hstack([np.zeros((len(gram), 1)), steps])
    # It returns the breakpoints without their penalties: alpha is the largest correlation there.
    knots = np.minimum.accumulate(np.abs(cross - gram @ coefficients).max(axis=0))
    found: Array = interpolated(knots, coefficients, alphas).T[..., None] / s.rms[:, None]
    return found


CONTENDERS = (
    Contender("scikit-learn LARS", _lars, "sklearn", "lars_path_gram", kinds=("lasso",)),
    Contender("SPAMS", _spams, "spams", "lasso on Q, q (LARS)", kinds=("lasso",)),
)
