"""The best one, two or three groups of all: exact, by enumeration with a bound.

    min over sets S of s groups of min over W_S of |Y - theta_S W_S|^2,    s = 1, 2, 3

Every set of s groups is worked out, or excluded by a bound on what it can explain (`group_spans`):
that is the proof that no set is better. Sets that differ by less than 1e-6 of |Y|^2 are settled on
the rows. One group more is taken while it is worth its weights. What the caller verifies beside is
a fixed point: that no exchange of one group for another fits better.

Sources: Furnival and Wilson, Technometrics 16 (1974) 499-511, for subsets by bounds; Bertsimas,
King and Mazumder, Ann. Statist. 44 (2016) 813-852, for what they are worth.
"""

from dataclasses import dataclass, replace
from math import comb
from typing import ClassVar, get_args

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.backends.group_fit import DOUBT, Stop, fit_on, is_worth, residual_square
from sparsefit.backends.group_spans import GroupSpans
from sparsefit.errors import flag_setting, integer_setting, number_setting, one_of
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.problem import RegressionProblem

FEW = 64  # sets nearly alike that are settled on the rows
MOST = 2_000_000  # sets of one size: of three groups of 8 columns, 20 us each


@dataclass(frozen=True)
class BestSubset:
    """Least squares on the set of at most ``scales`` groups that leaves the smallest residual.

    scales: 1, 2 or 3. stop and tolerance: whether s + 1 groups are worth it, as in `GroupOMP`;
    ``decrease`` with a tolerance of 0 always takes ``scales`` of them. separate: each target has a
    set of its own; otherwise all share one.
    """

    name: ClassVar[str] = "best-subset"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    scales: int = 3
    tolerance: float = 0.01
    stop: Stop = "decrease"
    separate: bool = False

    def __post_init__(self) -> None:
        integer_setting(self.name, "scales", self.scales, least=1)
        number_setting(self.name, "scales", self.scales, low=1, high=3, meaning="all are tried")
        number_setting(self.name, "tolerance", self.tolerance, low=0.0, high=1.0)
        one_of(f"stop of {self.name}", self.stop, get_args(Stop))
        flag_setting(self.name, "separate", self.separate)

    def solve(self, problem: RegressionProblem) -> Solution:
        """Weights on the best set; ``solver_status`` says of how many, and how many were fitted."""
        groups, size = int(problem.groups.max()) + 1, self._largest(problem)
        if (many := comb(groups, size)) > MOST:
            reason = f"{many} sets of {size} of {groups} groups are too many; lower scales"
            return Solution(None, "error", f"{self.name}: {reason}")
        if not problem.target.any():
            return Solution(None, "unidentifiable", f"{self.name}: the target is zero throughout")
        solved = [self._solved(part) for part in self._parts(problem)]
        weights = np.concatenate([values for values, _, _ in solved], axis=1)
        tried, worked = sum(count for _, count, _ in solved), sum(count for *_, count in solved)
        words = f"the best of {tried} sets, {tried - worked} excluded by their bound"
        return Solution(weights, solver_status=words, iterations=worked)

    def next_support(self, problem: RegressionProblem, weights: Array) -> BoolArray:
        """The support (k, n) after the best exchange of one group of the weights (k, n), if any."""
        parts, support = self._parts(problem), np.zeros(weights.shape, dtype=bool)
        for part, targets in zip(parts, problem.together(not self.separate), strict=True):
            support[:, targets] = _exchanged(part, weights[:, targets]) != 0
        return support

    def _parts(self, problem: RegressionProblem) -> list[RegressionProblem]:
        """The targets that share a set."""
        if not self.separate or problem.targets == 1:
            return [problem]
        alone = replace(problem, sums=None)
        each = enumerate(problem.target_names)
        return [replace(alone, target=problem.target[:, [t]], target_names=(n,)) for t, n in each]

    def _largest(self, problem: RegressionProblem) -> int:
        return min(self.scales, int(problem.groups.max()) + 1)

    def _solved(self, problem: RegressionProblem) -> tuple[Array, int, int]:
        """Weights (k, n), the sets there were and those that were worked out."""
        weights = np.zeros((problem.columns, problem.targets))
        if not problem.target.any():
            return weights, 0, 0
        spans, sets, worked = GroupSpans.of(problem), 0, 0
        for size in range(1, self._largest(problem) + 1):
            if size > 1 and self._done(problem, weights):
                break
            best, count = spans.best(size, DOUBT)
            larger = _settled(problem, best)
            sets, worked = sets + comb(len(spans.alone), size), worked + count
            if size > 1 and not is_worth(problem, weights, larger, self.stop, self.tolerance):
                break
            weights = larger
        return weights, sets, worked

    def _done(self, problem: RegressionProblem, weights: Array) -> bool:
        """Whether no group more can be worth it, or leaves any freedom to the next fit."""
        left = residual_square(problem, weights) / float(problem.statistics.target_square.sum())
        least = np.bincount(problem.groups).min() + np.count_nonzero(weights.any(axis=1))
        return (self.stop == "decrease" and left <= self.tolerance) or least >= problem.samples


def _settled(problem: RegressionProblem, sets: IntArray) -> Array:
    """The weights (k, n) of the set (c, s), of the first few, of the smallest residual by rows."""
    fits = (fit_on(problem, np.flatnonzero(np.isin(problem.groups, one))) for one in sets[:FEW])
    return min(fits, key=lambda weights: residual_square(problem, weights))


def _exchanged(problem: RegressionProblem, weights: Array) -> Array:
    """The best weights (k, n) on sets of groups that differ from these in one group at most."""
    used = np.unique(problem.groups[np.any(weights != 0, axis=1)])
    others = np.setdiff1d(np.arange(problem.groups.max() + 1), used)
    if not len(used):
        return weights
    swapped = [np.where(used == old, new, used) for old in used for new in others]
    sets, spans = np.array([used, *swapped]), GroupSpans.of(problem)
    explained = spans.explained(sets)
    order = np.argsort(-explained, kind="stable")
    near = explained[order] >= explained.max() - DOUBT * spans.total
    return _settled(problem, sets[order[near]])
