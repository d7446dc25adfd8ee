"""Adaptive group-LASSO (Wang and Leng 2008): groups weighted by what a first ridge fit found."""

from dataclasses import dataclass
from typing import ClassVar

from sparsefit.backends.exact_paths import VARIATIONAL
from sparsefit.backends.grouping import (
    GroupWeights,
    adapted,
    check_grouping,
    check_pilot,
    size_weights,
)
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class AdaptiveGroupLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_g omega_g |V_g|, alpha = alpha_fraction * alpha_max.

    omega_g = (|V0_g| / max |V0_g|)^-power, V0 the ridge fit (Z'Z/m + pilot_ridge I)^-1 Z'Y/m over
    all targets together, whose norms below 1e-3 of the largest count as that; with group_weights
    ``sqrt-size`` times the root of the number of columns. power 0 is the group-LASSO. A group
    spans all targets, or each target has groups of its own (``separate``), with common weights.
    solver: ``variational`` (exact path), ``clarabel-working-set``, ``clarabel-direct``, or through
    cvxpy ``clarabel`` or any other conic solver it finds installed. alpha_fraction ``auto``:
    chosen by `fit` from the data, by the rule ``selection``; the weights are learned in each fold.
    """

    name: ClassVar[str] = "adaptive-group-lasso"
    exact: ClassVar[ExactPath] = VARIATIONAL
    alpha_fraction: AlphaFraction = 0.1
    power: float = 1.0
    pilot_ridge: float = 0.05
    separate: bool = False
    group_weights: GroupWeights = "unit"
    solver: str = VARIATIONAL.name
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a setting of the first fit that is out of range."""
        check_pilot(self.name, self.pilot_ridge, self.power)
        check_grouping(self.name, self.separate, self.group_weights)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups, weighted by the first fit."""
        omega = size_weights(problem, self.group_weights)
        plain = Penalty(problem.groups, omega, joint=not self.separate)
        return adapted(problem, plain, ridge=self.pilot_ridge, power=self.power)
