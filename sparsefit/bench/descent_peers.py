"""Public coordinate descent: scikit-learn on the Gram matrix, celer and skglm on QR rows."""

from __future__ import annotations

import warnings
from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.bench.contender import LADDER, Contender, gram_form, rows_form
from sparsefit.bench.problems import Task

EPOCHS = 100_000  # a solver may stop by its tolerance, not by its patience


def _scikit(task: Task, fractions: Array, tolerance: float) -> Array:
    """lasso_path with a precomputed Gram matrix."""
    linear_model: Any = import_module("sklearn.linear_model")
    s = gram_form(task)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # ConvergenceWarning: our gap says by how much
        _, coefficients, _gaps = linear_model.lasso_path(
            task.problem.theta,  # not read: the Gram matrix stands for it
            task.problem.target[:, 0],
            alphas=task.unit * fractions,
            precompute=s.gram * s.samples,
            Xy=s.cross[:, 0] * s.samples,
            tol=tolerance,
            max_iter=EPOCHS,
            check_input=False,
        )
    found: Array = coefficients.T[..., None] / s.rms[:, None]
    return found


def _celer(task: Task, fractions: Array, tolerance: float) -> Array:
    """celer_path; several targets are one long target with a block-diagonal design."""
    celer: Any = import_module("celer")
    rows = rows_form(task)
    lasso = task.kind == "lasso"
    groups = None if lasso else [block.tolist() for block in _blocks(task)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        _, coefficients, _gaps = celer.celer_path(
            rows.design,
            rows.target,
            "lasso" if lasso else "grouplasso",
            alphas=task.unit * fractions,
            groups=groups,
            tol=tolerance,
        )
    return rows.weights(coefficients)


def _skglm(task: Task, fractions: Array, tolerance: float) -> Array:
    """AndersonCD.path, or GroupBCD warm-started by hand (it has no path of its own)."""
    rows = rows_form(task)
    peak = float(np.abs(rows.target).max()) or 1.0  # its tolerance is absolute
    alphas = task.unit * fractions / peak
    target = rows.target / peak
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if task.kind == "lasso":
            coefficients = _anderson(rows.design, target, alphas, tolerance)
        else:
            coefficients = _group_descent(rows.design, target, alphas, tolerance, _blocks(task))
    return rows.weights(coefficients * peak)


def _anderson(design: Array, target: Array, alphas: Array, tolerance: float) -> Array:
    solvers, penalties, datafits = _skglm_parts()
    solver = solvers.AndersonCD(tol=tolerance, fit_intercept=False)
    datafit = _jitted(datafits.Quadratic())
    found: Array = solver.path(
        design, target, datafit, _jitted(penalties.L1(float(alphas[0]))), alphas
    )[1]
    return found


def _group_descent(
    design: Array, target: Array, alphas: Array, tolerance: float, blocks: list[Any]
) -> Array:
    solvers, penalties, datafits = _skglm_parts()
    indices = np.concatenate(blocks).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum([len(b) for b in blocks])]).astype(np.int32)
    datafit = _jitted(datafits.QuadraticGroup(starts, indices))
    penalty = _jitted(penalties.WeightedGroupL2(1.0, np.ones(len(blocks)), starts, indices))
    solver = solvers.GroupBCD(tol=tolerance, warm_start=True)
    weights, fitted = np.zeros(design.shape[1]), np.zeros(len(target))  # both worked on in place
    found = []
    for alpha in alphas:
        penalty.alpha = alpha
        weights = solver.solve(design, target, datafit, penalty, weights.copy(), fitted)[0]
        fitted = design @ weights
        found.append(weights)
    return np.stack(found, axis=1)


def _skglm_parts() -> tuple[Any, Any, Any]:
    names = ("solvers", "penalties", "datafits")
    solvers, penalties, datafits = (import_module(f"skglm.{name}") for name in names)
    return solvers, penalties, datafits


def _jitted(part: Any) -> Any:
    return import_module("skglm.utils.jit_compilation").compiled_clone(part)


def _blocks(task: Task) -> list[Any]:
    """The coefficients (k n, target by target) of each group."""
    groups = np.tile(task.penalty.groups, task.problem.targets)
    return [np.flatnonzero(groups == g) for g in range(len(task.penalty.weights))]


CONTENDERS = (
    Contender(
        "scikit-learn CD",
        _scikit,
        "sklearn",
        "lasso_path, precomputed Gram",
        kinds=("lasso",),
        settings=LADDER,
    ),
    Contender("celer", _celer, "celer", "celer_path on QR rows", settings=LADDER),
    Contender(
        "skglm", _skglm, "skglm", "AndersonCD, GroupBCD on QR rows", settings=LADDER, compiles=True
    ),
)
