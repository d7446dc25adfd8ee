"""Group orthogonal matching pursuit: one group at a time, all weights fitted again.

    g* = argmax over g of |P_g R|^2,    W = least squares on all groups so far,    R = Y - theta W

P_g projects on the span of a group's columns, so neither their scale nor their correlation counts.
Source: Lozano, Swirszcz and Abe, "Group orthogonal matching pursuit for variable selection and
prediction" (NeurIPS 2009).
"""

from dataclasses import dataclass
from typing import ClassVar, get_args

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.backends.group_fit import Stop, explained, fit_on, is_worth
from sparsefit.errors import integer_setting, number_setting, one_of
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

MOST = 64  # groups, whatever the rule says


@dataclass(frozen=True)
class GroupOMP:
    """Greedy groups until one more is not worth it.

    stop: ``decrease``: a group must lower the residual sum of squares by ``tolerance`` * |Y|^2;
    ``bic``: it must lower m n ln(RSS) + parameters ln(m n). ``scales``: stop at so many groups at
    the latest; None has no such limit but 64 groups. The first group is always taken.
    """

    name: ClassVar[str] = "group-omp"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    scales: int | None = None
    tolerance: float = 0.01
    stop: Stop = "decrease"

    def __post_init__(self) -> None:
        if self.scales is not None:
            integer_setting(self.name, "scales", self.scales, least=1)
        number_setting(self.name, "tolerance", self.tolerance, low=0.0, high=1.0)
        one_of(f"stop of {self.name}", self.stop, get_args(Stop))

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights on the groups that the greedy choice takes."""
        if not problem.target.any():
            return Solution(None, "unidentifiable", f"{self.name}: the target is zero throughout")
        weights = np.zeros((problem.columns, problem.targets))
        steps = 0
        while (larger := self._step(problem, weights)) is not None:
            weights, steps = larger, steps + 1
        return Solution(weights, iterations=steps)

    def next_support(self, problem: RegressionProblem, weights: Array) -> BoolArray:
        """The support (k, n) after one more step from weights (k, n)."""
        following = self._step(problem, weights)
        support: BoolArray = (weights if following is None else following) != 0
        return support

    def _step(self, problem: RegressionProblem, weights: Array) -> Array | None:
        """Weights with one more group, or None where the rule says stop."""
        used = np.unique(problem.groups[np.any(weights != 0, axis=1)])
        if len(used) >= min(self.scales or MOST, int(problem.groups.max()) + 1):
            return None
        gains = explained(problem, weights)
        gains[used] = -1.0
        taken = np.flatnonzero(np.isin(problem.groups, [*used, int(np.argmax(gains))]))
        if len(used) and len(taken) >= problem.samples:
            return None  # no freedom is left: the next fit would be exact
        larger = fit_on(problem, taken)
        if not len(used):
            return larger if larger.any() else None  # the target may be orthogonal to all columns
        worth = is_worth(problem, weights, larger, self.stop, self.tolerance)
        return larger if worth else None
