"""`sparsefit.fit` and `sparsefit.path`: those of `regression`, for back-ends named or made."""

import warnings
from typing import Any

import numpy as np

from sparsefit.backends import get, named
from sparsefit.errors import InputError, is_integer
from sparsefit.regression import fit as certified
from sparsefit.regression.answer import Fit, Path
from sparsefit.regression.backend import Backend
from sparsefit.regression.fit import TOLERANCE
from sparsefit.regression.fit import path as certified_path
from sparsefit.regression.penalty_choice import FRACTIONS
from sparsefit.regression.problem import RegressionProblem

FEWEST_CLASSES = 20  # samples of 0 and 1 from which these are taken for classes


def fit(
    problem: Any,
    target: Any = None,
    backend: Backend | str | None = None,
    *,
    groups: Any = None,
    tolerance: float = TOLERANCE,
    **settings: Any,
) -> Fit:
    """Solve one problem and certify the answer.

    ``fit(problem, backend)``, or ``fit(theta, target, backend)`` with arrays, a frame or a sparse
    matrix and ``groups``, k labels, as of `RegressionProblem.from_arrays`. backend: what
    ``backends.get(name, **settings)`` returns, or a name, with ``settings`` in place of defaults. A
    certificate above ``tolerance``, with all that rounding can hide of it, gives status
    ``inaccurate``, with the best solution found. An alpha_fraction of "auto" is chosen first: the
    fit is the chosen point of the path. Raises InputError on what is not a problem, a back-end or a
    tolerance >= 0.
    """
    posed, chosen = _posed("fit", problem, target, backend, groups, settings)
    return certified(posed, chosen, tolerance=tolerance)


def path(
    problem: Any,
    target: Any = None,
    backend: Any = None,
    alpha_fractions: Any = FRACTIONS,
    *,
    groups: Any = None,
    tolerance: float = TOLERANCE,
    **settings: Any,
) -> Path:
    """Solve along a penalty grid, in any order given, and certify every point.

    ``path(problem, backend, alpha_fractions)``, or ``path(theta, target, backend,
    alpha_fractions)``; the rest as in `fit`. alpha_fractions: numbers in (0, 1], the penalties as
    fractions of the smallest one whose solution is zero, or how many of them from 1 to 1e-3; 30 by
    default. Back-ends without a path of their own are run point by point. Raises InputError for
    back-ends that have no penalty, and as `fit` does.
    """
    if isinstance(problem, RegressionProblem) and backend is not None:
        alpha_fractions, backend = backend, None
    posed, chosen = _posed("path", problem, target, backend, groups, settings)
    if is_integer(alpha_fractions, 2):
        alpha_fractions = np.geomspace(1.0, FRACTIONS[-1], int(alpha_fractions))
    return certified_path(posed, chosen, alpha_fractions, tolerance=tolerance)


def _posed(
    verb: str, problem: Any, target: Any, backend: Any, groups: Any, settings: dict[str, Any]
) -> tuple[RegressionProblem, Backend]:
    """The problem and the back-end of a call in either form."""
    if isinstance(problem, RegressionProblem):
        if groups is not None:
            raise InputError(f"{verb}: the problem has its groups: from_arrays takes others")
        if backend is not None:
            raise InputError(f"{verb} takes a problem and a back-end: {verb}(problem, backend)")
        backend = target
    elif isinstance(target, str) or target is None or backend is None:
        raise InputError(
            f"{verb} needs a RegressionProblem and a back-end, or arrays: "
            f'{verb}(theta, target, "lasso", alpha_fraction=0.1)'
        )
    else:
        problem = RegressionProblem.from_arrays(problem, target, groups)
    if settings and not isinstance(backend, str):
        raise InputError(f'{verb}: settings go with a back-end\'s name: {verb}(..., "lasso", ...)')
    values = np.unique(problem.target[:1000])
    if np.array_equal(values, [0.0, 1.0]) and len(problem.target) >= FEWEST_CLASSES:
        warnings.warn(
            "the target holds 0 and 1 only: it is fitted by squares, as numbers, not as classes",
            UserWarning,
            stacklevel=3,
        )
    return problem, get(backend, **settings) if isinstance(backend, str) else named(backend)
