"""The compiled loop of the group-LASSO path, where it was built: no numbers differ, only the time.

`_variational` is C, optional at installation, and takes BLAS and LAPACK from scipy's capsules.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from types import ModuleType
from typing import Any

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.backends.variational_point import Problem


@cache
def compiled_loop() -> tuple[ModuleType | None, str]:
    """The extension module and "", or None and why there is none."""
    try:
        loop = import_module("sparsefit.backends._variational")
        loop.check(*_routines())
    except ImportError as error:
        return None, str(error)
    return loop, ""


def _routines() -> tuple[Any, Any]:
    """BLAS and LAPACK of scipy: name -> capsule. Imported here: `sparsefit --help` needs none."""
    modules = (import_module(f"scipy.linalg.cython_{name}") for name in ("blas", "lapack"))
    blas, lapack = (module.__pyx_capi__ for module in modules)
    return blas, lapack


def compiled_path(
    loop: ModuleType, problem: Problem, alphas: Array, tolerance: float
) -> tuple[Array, IntArray, Array]:
    """Weights (p, k, n) on the problem's columns, factorisations (p,), relative gaps (p,)."""
    columns, targets = problem.cross.shape
    weights = np.zeros((alphas.size, targets, columns))
    iterations, gaps = np.zeros(alphas.size, np.int64), np.zeros(alphas.size)
    loop.path(
        *_routines(),
        np.ascontiguousarray(problem.gram),
        np.ascontiguousarray(problem.cross.T),
        np.append(problem.starts, columns).astype(np.int64),
        np.ascontiguousarray(alphas),
        tolerance,
        weights,
        iterations,
        gaps,
    )
    return weights.transpose(0, 2, 1), iterations.astype(np.intp), gaps
