"""LASSO (Tibshirani 1996): the exact path by homotopy, or any solver that cvxpy finds."""

from dataclasses import dataclass
from typing import ClassVar

from sparsefit.backends.exact_paths import HOMOTOPY
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty, lasso_penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class Lasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum |V_jt|, alpha = alpha_fraction * alpha_max.

    solver: ``homotopy`` (exact path), ``clarabel-working-set``, ``clarabel-direct``, or through
    cvxpy ``clarabel``, ``osqp`` or any other it finds installed. alpha_fraction ``auto``: chosen
    by `fit` from the data, by the rule ``selection``.
    """

    name: ClassVar[str] = "lasso"
    exact: ClassVar[ExactPath] = HOMOTOPY
    alpha_fraction: AlphaFraction = 0.1
    solver: str = HOMOTOPY.name
    selection: Selection = "cross-validation"

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own."""
        return lasso_penalty(problem.columns)
