"""Public first-order solvers: coordinate descent by scikit-learn, celer and skglm, and FISTA.

Each stops at a tolerance of its own meaning: scikit-learn and celer by their duality gap relative
to the target, skglm by the largest violation of its optimality conditions, group-lasso by the
change of its coefficients. None is believed: the caller's certificate says what was reached.
"""

from importlib import import_module
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.backends.peer_forms import Part

TOLERANCE = 1e-8  # where none is asked for
EPOCHS = 100_000  # a solver may stop by its tolerance, not by its patience


def scikit_descent(part: Part, fractions: Array, tolerance: float | None) -> Array:
    """scikit-learn's ``lasso_path`` with a precomputed Gram matrix."""
    linear_model: Any = import_module("sklearn.linear_model")
    _, coefficients, _ = linear_model.lasso_path(
        part.problem.theta,  # not read: the Gram matrix stands for it
        part.target,
        alphas=fractions,
        precompute=part.gram * part.samples,
        Xy=part.cross * part.samples,
        tol=tolerance or TOLERANCE,
        max_iter=EPOCHS,
        check_input=False,
    )
    found: Array = coefficients.T
    return found


def celer(part: Part, fractions: Array, tolerance: float | None) -> Array:
    """``celer_path`` of celer (Massias, Gramfort and Salmon 2018), LASSO or groups."""
    package: Any = import_module("celer")
    rows = part.rows()
    lasso = part.penalty.elementwise
    groups = None if lasso else [block.tolist() for block in rows.blocks]
    kind = "lasso" if lasso else "grouplasso"
    _, coefficients, _ = package.celer_path(
        rows.design, rows.target, kind, alphas=fractions, groups=groups, tol=tolerance or TOLERANCE
    )
    found: Array = coefficients.T
    return found


def skglm(part: Part, fractions: Array, tolerance: float | None) -> Array:
    """AndersonCD or GroupBCD of skglm (Bertrand et al. 2022), each point from the last one."""
    rows = part.rows()
    peak = float(np.abs(rows.target).max()) or 1.0  # its tolerance is absolute
    target, alphas = rows.target / peak, fractions / peak
    stop = tolerance or TOLERANCE
    if part.penalty.elementwise:
        return peak * _anderson(rows.design, target, alphas, stop)
    return peak * _group_descent(rows.design, target, alphas, stop, rows.blocks)


def _anderson(design: Array, target: Array, alphas: Array, tolerance: float) -> Array:
    solvers, penalties, datafits = _skglm_parts()
    solver = solvers.AndersonCD(tol=tolerance, fit_intercept=False)
    datafit = _jitted(datafits.Quadratic())
    penalty = _jitted(penalties.L1(float(alphas[0])))
    found: Array = solver.path(design, target, datafit, penalty, alphas)[1].T
    return found


def _group_descent(
    design: Array, target: Array, alphas: Array, tolerance: float, blocks: list[IntArray]
) -> Array:
    solvers, penalties, datafits = _skglm_parts()
    indices = np.concatenate(blocks).astype(np.int32)
    starts = np.concatenate([[0], np.cumsum([len(b) for b in blocks])]).astype(np.int32)
    datafit = _jitted(datafits.QuadraticGroup(starts, indices))
    penalty = _jitted(penalties.WeightedGroupL2(1.0, np.ones(len(blocks)), starts, indices))
    solver = solvers.GroupBCD(tol=tolerance, warm_start=True)
    weights, fitted = np.zeros(design.shape[1]), np.zeros(len(target))  # both worked on in place
    found = []
    for alpha in alphas.tolist():
        penalty.alpha = alpha
        weights = solver.solve(design, target, datafit, penalty, weights.copy(), fitted)[0]
        fitted = design @ weights
        found.append(weights)
    return np.stack(found)


def _skglm_parts() -> tuple[Any, Any, Any]:
    names = ("solvers", "penalties", "datafits")
    solvers, penalties, datafits = (import_module(f"skglm.{name}") for name in names)
    return solvers, penalties, datafits


def _jitted(part: Any) -> Any:
    return import_module("skglm.utils.jit_compilation").compiled_clone(part)


def fista(part: Part, fractions: Array, tolerance: float | None) -> Array:
    """The FISTA of the package group-lasso (Moe 2020), each point from the last one."""
    package: Any = import_module("group_lasso")
    rows = part.rows()
    model = package.GroupLasso(
        groups=rows.groups,
        l1_reg=0.0,
        n_iter=EPOCHS // 10,
        tol=tolerance or TOLERANCE,
        scale_reg="none",
        fit_intercept=False,
        frobenius_lipschitz=True,
        warm_start=True,
        supress_warning=True,
    )
    found = []
    for fraction in fractions.tolist():
        # Version 1.5 steps along half its gradient and shrinks in full: what it solves has twice
        # the penalty that it is given.
        model.set_params(group_reg=0.5 * fraction)
        model.fit(rows.design, rows.target[:, None])
        found.append(np.asarray(model.coef_)[:, 0].copy())
    return np.stack(found)
