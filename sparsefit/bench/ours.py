"""Our own solvers as contenders: the exact paths, and the conic referees of the same back-ends."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.bench.contender import Contender, gram_form
from sparsefit.bench.problems import Task
from sparsefit.regression.fit import path

OURS = "sparsefit"
CERTIFIED = "sparsefit, with certificates"
NUMPY_GRAM = "sparsefit, Z'Z by numpy"
VARIANTS = (OURS, CERTIFIED, NUMPY_GRAM)


def _solve(
    task: Task, fractions: Array, _: float, *, solver: str = "", numpy_gram: bool = False
) -> Array:
    """The solve alone, Gram matrix included: what the peers do, who certify nothing."""
    backend: Any = task.backend
    if solver:
        backend = dataclasses.replace(backend, solver=solver)
    problem = task.fresh()
    if numpy_gram:
        problem.__dict__["statistics"] = gram_form(task)  # where the cached property keeps it
    solutions = backend.solve_path(problem, tuple(fractions.tolist()))
    missing = np.full((problem.columns, problem.targets), np.nan)
    return np.stack([missing if s.weights is None else s.weights for s in solutions])


def _numpy_gram(task: Task, fractions: Array, setting: float) -> Array:
    """Z'Z as the peers get it, where ours may be a compiled product."""
    return _solve(task, fractions, setting, numpy_gram=True)


def _certified(task: Task, fractions: Array, _: float) -> Array:
    """The front door: solved, certified, repaired where the certificate says so."""
    return path(task.fresh(), task.backend, fractions).weights


def _working_set(task: Task, fractions: Array, setting: float) -> Array:
    return _solve(task, fractions, setting, solver="clarabel-working-set")


def _cvxpy_gram(task: Task, fractions: Array, setting: float) -> Array:
    return _solve(task, fractions, setting, solver="clarabel")


CONTENDERS = (
    Contender(OURS, _solve, "sparsefit", "exact path on the Gram matrix", peer=False),
    Contender(CERTIFIED, _certified, "sparsefit", "sparsefit.path: certified", peer=False),
    Contender(NUMPY_GRAM, _numpy_gram, "sparsefit", "the same, Z'Z as the peers'", peer=False),
    Contender(
        "Clarabel on working sets",
        _working_set,
        "clarabel",
        "sparsefit's referee, solver='clarabel-working-set'",
        timed=4,
        peer=False,
    ),
    Contender(
        "cvxpy on Gram, Clarabel",
        _cvxpy_gram,
        "cvxpy",
        "psd_wrap(G), alpha a parameter: solver='clarabel'",
        timed=3,
    ),
)
