"""`sparsefit.fit` and `sparsefit.path`: those of `regression`, for back-ends named or made."""

from typing import Any

from sparsefit.backends import named
from sparsefit.regression import fit as certified
from sparsefit.regression.answer import Fit, Path
from sparsefit.regression.backend import Backend
from sparsefit.regression.fit import TOLERANCE
from sparsefit.regression.fit import path as certified_path
from sparsefit.regression.penalty_choice import FRACTIONS
from sparsefit.regression.problem import RegressionProblem


def fit(problem: RegressionProblem, backend: Backend | str, *, tolerance: float = TOLERANCE) -> Fit:
    """Solve one problem and certify the answer.

    backend: what ``backends.get(name, **settings)`` returns, or a name with default settings. A
    certificate above ``tolerance``, with all that rounding can hide of it, gives status
    ``inaccurate``, with the best solution found. An alpha_fraction of "auto" is chosen first: the
    fit is the chosen point of the path. Raises InputError on what is not a problem, a back-end or a
    tolerance >= 0.
    """
    return certified(problem, named(backend), tolerance=tolerance)


def path(
    problem: RegressionProblem,
    backend: Backend | str,
    alpha_fractions: Any = FRACTIONS,
    *,
    tolerance: float = TOLERANCE,
) -> Path:
    """Solve along a penalty grid, in any order given, and certify every point.

    backend: as in `fit`. alpha_fractions: numbers in (0, 1], the penalties as fractions of the
    smallest one whose solution is zero; by default 30 from 1 to 1e-3. Back-ends without a path
    of their own are run point by point. Raises InputError for back-ends that have no penalty, and
    as `fit` does.
    """
    return certified_path(problem, named(backend), alpha_fractions, tolerance=tolerance)
