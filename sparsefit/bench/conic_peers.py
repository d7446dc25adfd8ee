"""Conic solvers as users write them with cvxpy, and Clarabel itself on the Gram problem."""

from __future__ import annotations

import contextlib
import warnings
from importlib import import_module
from typing import Any

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array
from sparsefit.bench.contender import Contender, gram_form
from sparsefit.bench.problems import Task

TIME_LIMIT = 60.0  # s per point: OSQP would otherwise take minutes on a long flight
DIRECT_SETTINGS: dict[str, Any] = {
    "verbose": False,
    "max_threads": 1,
    "direct_solve_method": "faer",
    "presolve_enable": False,  # or q cannot be updated along the path
    "tol_gap_abs": 1e-11,
    "tol_gap_rel": 1e-11,
    "tol_feas": 1e-11,
}


def _as_written(task: Task, fractions: Array, *, solver: str, limit: str) -> Array:
    """sum_squares of the residual and a norm per group, a problem per penalty."""
    cvxpy: Any = import_module("cvxpy")
    problem = task.problem
    rms = problem.statistics.rms
    scaled = problem.theta / rms
    found = []
    for alpha in task.unit * fractions:
        weights = cvxpy.Variable((problem.columns, problem.targets))
        loss = cvxpy.sum_squares(scaled @ weights - problem.target) / (2 * problem.samples)
        objective = cvxpy.Minimize(loss + alpha * _norm(cvxpy, weights, task))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # "may be inaccurate": our gap says by how much
            with contextlib.suppress(cvxpy.error.SolverError):
                cvxpy.Problem(objective).solve(solver=solver, **{limit: TIME_LIMIT})
        value = np.full(weights.shape, np.nan) if weights.value is None else weights.value
        found.append(value / rms[:, None])
    return np.stack(found)


def _norm(cvxpy: Any, weights: Any, task: Task) -> Any:
    if task.kind == "lasso":
        return cvxpy.norm1(weights)
    groups = task.problem.groups
    blocks = (weights[np.flatnonzero(groups == g), :] for g in range(groups.max() + 1))
    return sum(cvxpy.norm(cvxpy.vec(block, order="C"), 2) for block in blocks)


def _written_clarabel(task: Task, fractions: Array, _: float) -> Array:
    return _as_written(task, fractions, solver="CLARABEL", limit="time_limit")


def _written_osqp(task: Task, fractions: Array, _: float) -> Array:
    return _as_written(task, fractions, solver="OSQP", limit="time_limit")


def _direct(task: Task, fractions: Array, _: float) -> Array:
    """Clarabel itself, (v, t) in Gram form, set up once; only the penalty in q changes."""
    clarabel: Any = import_module("clarabel")
    statistics = gram_form(task)
    n, blocks = task.problem.targets, len(task.penalty.weights)
    size = len(statistics.gram) * n
    hessian = sparse.block_diag([statistics.gram] * n + [sparse.csc_matrix((blocks, blocks))])
    cross = (statistics.cross / task.unit).T.ravel()
    matrix, cones = _cones(clarabel, task, size)
    settings = clarabel.DefaultSettings()
    for name, value in DIRECT_SETTINGS.items():
        setattr(settings, name, value)
    penalties = [np.concatenate([-cross, f * task.penalty.weights]) for f in fractions]
    upper, zero = sparse.triu(hessian, format="csc"), np.zeros(matrix.shape[0])
    solver = clarabel.DefaultSolver(upper, penalties[0], matrix, zero, cones, settings)
    found = []
    for linear in penalties:
        solver.update(q=linear)
        found.append(np.array(solver.solve().x)[:size].reshape(n, -1).T)
    scale = task.unit / statistics.rms[:, None]
    return np.stack(found) * scale


def _cones(clarabel: Any, task: Task, size: int) -> tuple[Any, list[Any]]:
    """A and the cones of |v_j| <= t_j (two half-spaces) or |V_g| <= t_g (a second-order cone)."""
    groups = np.tile(task.penalty.groups, task.problem.targets)
    blocks = len(task.penalty.weights)
    identity = sparse.identity(size, format="csc")
    if task.kind == "lasso":
        bound = -sparse.identity(size, format="csc")
        matrix = sparse.bmat([[identity, bound], [-identity, bound]], format="csc")
        return matrix, [clarabel.NonnegativeConeT(2 * size)]
    # For each block its bound, then its coefficients.
    order = np.argsort(np.concatenate([groups, np.arange(blocks) - 0.5]), kind="stable")
    matrix = -sparse.identity(size + blocks, format="csr")[order]
    cones = [clarabel.SecondOrderConeT(1 + int(count)) for count in np.bincount(groups)]
    return sparse.csc_matrix(matrix), cones


CONTENDERS = (
    Contender(
        "cvxpy as written, Clarabel",
        _written_clarabel,
        "cvxpy",
        "sum_squares(Z w - y), a problem per penalty",
        timed=1,
    ),
    Contender(
        "cvxpy as written, OSQP",
        _written_osqp,
        "osqp",
        f"sum_squares(Z w - y); at most {TIME_LIMIT:.0f} s a point",
        kinds=("lasso",),
        timed=1,
    ),
    Contender(
        "Clarabel direct on Gram",
        _direct,
        "clarabel",
        "(v, t) in Gram form, faer, q updated along the path",
        timed=4,
    ),
)
