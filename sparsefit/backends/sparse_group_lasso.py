"""Sparse-group LASSO (Simon, Friedman, Hastie and Tibshirani 2013): few groups, few in each."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sparsefit.backends.exact_paths import BLOCK_NEWTON
from sparsefit.backends.grouping import GroupWeights, check_grouping, size_weights
from sparsefit.backends.penalised import ExactPath, PenalisedPath
from sparsefit.errors import number_setting
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.objective import Penalty, lasso_penalty
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class SparseGroupLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha [(1 - r) sum_g omega_g |V_g| + r sum_h |V_h|], alpha as elsewhere.

    g are the groups of columns, over all targets together or each target by itself
    (``separate``); h the problem's subgroups within them (the waves of a ring), where it has them,
    and single coefficients elsewhere. l1_ratio: r in [0, 1]; 0 is the group-LASSO, 1 the LASSO.
    group_weights: omega_g = 1 (``unit``) or the root of the number of columns (``sqrt-size``).
    solver: ``block-newton`` (to the certificate's tolerance), ``clarabel-working-set``,
    ``clarabel-direct``, or through cvxpy ``clarabel`` or any other conic solver it finds
    installed. alpha_fraction ``auto``: chosen by `fit` from the data, by the rule ``selection``.
    """

    name: ClassVar[str] = "sparse-group-lasso"
    exact: ClassVar[ExactPath] = BLOCK_NEWTON
    plain: ClassVar[bool] = False
    alpha_fraction: AlphaFraction = 0.1
    l1_ratio: float = 0.5
    separate: bool = False
    group_weights: GroupWeights = "unit"
    solver: str = BLOCK_NEWTON.name
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on an l1_ratio or group settings that are out of range."""
        meaning = "it is the share of the absolute values in the penalty"
        number_setting(self.name, "l1_ratio", self.l1_ratio, low=0.0, high=1.0, meaning=meaning)
        check_grouping(self.name, self.separate, self.group_weights)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups, and those within them."""
        ratio, joint = self.l1_ratio, not self.separate
        omega = size_weights(problem, self.group_weights)
        groups = Penalty(problem.groups, (1.0 - ratio) * omega, joint)
        if ratio == 0.0:
            return groups
        inner = lasso_penalty(problem.columns)
        if problem.subgroups is not None:
            inner = Penalty(problem.subgroups, np.ones(int(problem.subgroups.max()) + 1), joint)
        within = replace(inner, weights=ratio * inner.weights)
        return within if ratio == 1.0 else replace(groups, within=within)
