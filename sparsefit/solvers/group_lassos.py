"""Back-ends whose penalties are of groups of columns: the group-LASSO and its kin.

A group spans all targets (joint), for a flight its velocity components, or each target has groups
of its own (``separate``, the paper's n problems). group_weights: omega_g = 1 (``unit``) or the root
of the number of columns (``sqrt-size``). In all of them alpha = alpha_fraction * alpha_max, and
with ``auto`` it is chosen by `fit` from the data, by the rule ``selection``; solver: ``exact`` or
``clarabel``, the referee.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.penalties import AbsoluteValues, Penalty
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.penalised import (
    GroupWeights,
    PenalisedPath,
    adapted,
    check_grouping,
    check_pilot,
    check_ratio,
    size_weights,
)


@dataclass(frozen=True)
class GroupLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_g omega_g |V_g| (Yuan and Lin 2006)."""

    name: ClassVar[str] = "group-lasso"
    exact: ClassVar[str] = "variational"
    alpha_fraction: AlphaFraction = 0.1
    separate: bool = False
    group_weights: GroupWeights = "unit"
    solver: str = "variational"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on group settings that are out of range."""
        check_grouping(self.name, self.separate, self.group_weights)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups."""
        omega = size_weights(problem, self.group_weights)
        return GroupNorms(problem.groups, omega, not self.separate)


@dataclass(frozen=True)
class AdaptiveGroupLasso(PenalisedPath):
    """The group-LASSO with omega_g = (|V0_g| / max |V0_g|)^-power (Wang and Leng 2008).

    V0 is the ridge fit (Z'Z/m + pilot_ridge I)^-1 Z'Y/m over all targets together, whose norms
    below 1e-3 of the largest count as that; with group_weights ``sqrt-size`` omega_g is larger by
    the root of the number of columns. power 0 is the group-LASSO. Where alpha_fraction is chosen,
    the weights are learned in each fold.
    """

    name: ClassVar[str] = "adaptive-group-lasso"
    exact: ClassVar[str] = "variational"
    alpha_fraction: AlphaFraction = 0.1
    power: float = 1.0
    pilot_ridge: float = 0.05
    separate: bool = False
    group_weights: GroupWeights = "unit"
    solver: str = "variational"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a setting of the first fit that is out of range."""
        check_pilot(self.name, self.pilot_ridge, self.power)
        check_grouping(self.name, self.separate, self.group_weights)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups, weighted by the first fit."""
        factors = adapted(problem, problem.groups, self.pilot_ridge, self.power)
        omega = size_weights(problem, self.group_weights) * factors
        return GroupNorms(problem.groups, omega, not self.separate)


@dataclass(frozen=True)
class SparseGroupLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha [(1 - r) sum_g omega_g |V_g| + r sum_h |V_h|] (Simon et al. 2013).

    h are the problem's subgroups within its groups g (the waves of a ring), where it has them, and
    single coefficients elsewhere. l1_ratio: r in [0, 1]; 0 is the group-LASSO, 1 the LASSO.
    """

    name: ClassVar[str] = "sparse-group-lasso"
    exact: ClassVar[str] = "block-newton"
    alpha_fraction: AlphaFraction = 0.1
    l1_ratio: float = 0.5
    separate: bool = False
    group_weights: GroupWeights = "unit"
    solver: str = "block-newton"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on an l1_ratio or group settings that are out of range."""
        check_ratio(self.name, self.l1_ratio)
        check_grouping(self.name, self.separate, self.group_weights)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups, and those within them."""
        ratio, joint = self.l1_ratio, not self.separate
        omega = size_weights(problem, self.group_weights)
        outer = GroupNorms(problem.groups, (1.0 - ratio) * omega, joint)
        inner: AbsoluteValues | GroupNorms = AbsoluteValues(np.full(problem.columns, ratio))
        if problem.subgroups is not None:
            count = int(problem.subgroups.max()) + 1
            inner = GroupNorms(problem.subgroups, np.full(count, ratio), joint)
        if ratio in (0.0, 1.0):
            return inner if ratio else outer
        return NestedNorms(outer, inner)
