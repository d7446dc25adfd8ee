"""Group-LASSO (Yuan & Lin 2006): the exact path by the variational form, or a conic solver."""

from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.penalised import ExactPath, PenalisedPath, Points
from sparsefit.backends.variational import group_path
from sparsefit.errors import flag_setting, one_of
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem
from sparsefit.regression.statistics import Statistics

GroupWeights = Literal["unit", "sqrt-size"]
STOP = 1e-11  # the solver's own stop, far below any tolerance the certificate is asked to meet


def _variational(statistics: Statistics, penalty: Penalty, alphas: Array, targets: slice) -> Points:
    """The path of targets that share the norm of each group."""
    path = group_path(
        statistics.gram,
        statistics.cross[:, targets],
        penalty.groups,
        penalty.weights,
        alphas,
        target_square=float(statistics.target_square[targets].sum()),
        tolerance=STOP,
    )
    return Points(path.weights, path.complete, path.iterations, path.loop)


VARIATIONAL = ExactPath(
    "variational",
    _variational,
    solved="converged ({loop} loop)",
    unsolved="stalled ({loop} loop)",
    reason="the Newton iteration stalled",
)


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
        flag_setting(self.name, "separate", self.separate)
        one_of("group_weights of group-lasso", self.group_weights, get_args(GroupWeights))

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups."""
        sizes = np.bincount(problem.groups)
        omega = np.ones(len(sizes)) if self.group_weights == "unit" else np.sqrt(sizes)
        return Penalty(problem.groups, omega, joint=not self.separate)
