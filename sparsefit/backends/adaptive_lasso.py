"""Adaptive LASSO (Zou 2006): the LASSO, weighted by what a first ridge fit found."""

from dataclasses import dataclass
from typing import ClassVar

from sparsefit.backends.exact_paths import HOMOTOPY
from sparsefit.backends.grouping import adapted, check_pilot
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty, lasso_penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class AdaptiveLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_j omega_j sum_t |V_jt|, alpha = alpha_fraction * alpha_max.

    omega_j = (|V0_j| / max |V0_j|)^-power, V0 the ridge fit (Z'Z/m + pilot_ridge I)^-1 Z'Y/m over
    all targets together, whose norms below 1e-3 of the largest count as that. power 0 is the
    LASSO. solver: ``homotopy`` (exact path), ``clarabel-working-set``, ``clarabel-direct``, or
    through cvxpy ``clarabel``, ``osqp`` or any other it finds installed. alpha_fraction ``auto``:
    chosen by `fit` from the data, by the rule ``selection``; the weights are learned in each fold.
    """

    name: ClassVar[str] = "adaptive-lasso"
    exact: ClassVar[ExactPath] = HOMOTOPY
    alpha_fraction: AlphaFraction = 0.1
    power: float = 1.0
    pilot_ridge: float = 0.05
    solver: str = HOMOTOPY.name
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a setting of the first fit that is out of range."""
        check_pilot(self.name, self.pilot_ridge, self.power)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own, weighted by the first fit."""
        plain = lasso_penalty(problem.columns)
        return adapted(problem, plain, ridge=self.pilot_ridge, power=self.power)
