"""Group-LASSO (Yuan & Lin 2006): the exact path by the variational form, or a conic solver."""

from dataclasses import dataclass
from typing import ClassVar

from sparsefit.backends.exact_paths import VARIATIONAL
from sparsefit.backends.grouping import GroupWeights, check_grouping, size_weights
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class GroupLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_g omega_g |V_g|, alpha = alpha_fraction * alpha_max.

    A group spans all targets (joint), for a flight its velocity components, or each target has
    groups of its own (``separate``, the paper's n problems). group_weights: omega_g = 1 (``unit``)
    or the root of the number of columns (``sqrt-size``). solver: ``variational`` (exact path),
    ``clarabel-working-set``, ``clarabel-direct``, or through cvxpy ``clarabel`` or any other
    conic solver it finds installed. alpha_fraction ``auto``: chosen by `fit` from the data, by
    the rule ``selection``.
    """

    name: ClassVar[str] = "group-lasso"
    exact: ClassVar[ExactPath] = VARIATIONAL
    alpha_fraction: AlphaFraction = 0.1
    separate: bool = False
    group_weights: GroupWeights = "unit"
    solver: str = VARIATIONAL.name
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on group settings that are out of range."""
        check_grouping(self.name, self.separate, self.group_weights)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups."""
        omega = size_weights(problem, self.group_weights)
        return Penalty(problem.groups, omega, joint=not self.separate)
