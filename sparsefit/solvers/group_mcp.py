"""Group MCP (Breheny and Huang 2015): the group-LASSO without its bias on what is clearly there.

    1/(2m) |Y - Z V|^2 + sum_g p(|V_g|),   p'(t) = (alpha omega_g - t/gamma)_+,   p(0) = 0

p is not convex, and the answer is a fixed point of the local linear approximation (Zou and Li
2008): from the group-LASSO on, the group-LASSO with the weights p'(|V_g|) of the weights before.
Groups of |V_g| >= gamma alpha omega_g are free of penalty: they are projected out of Z'Z/m, and the
exact path of the group-LASSO solves for the others.

Sources: Zhang, Ann. Statist. 38 (2010) 894-942, for p; Breheny and Huang, Stat. Comput. 25 (2015)
173-187, for groups, which they orthonormalise and we do not; Zou and Li, Ann. Statist. 36 (2008)
1509-1533.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import number_setting, one_of
from sparsefit.regression.backend import (
    AlphaFraction,
    Selection,
    Solution,
    checked_alpha_fraction,
    numeric_fraction,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.kernels import path_on_gram
from sparsefit.solvers.penalised import GroupWeights, check_grouping, size_weights

ROUNDS = 100
SETTLED = 1e-10  # change of the weights p', relative to alpha omega_g, that ends the iteration
RANK = 1e-10  # eigenvalues of Z'Z/m of free groups below it, relative, count as zero


@dataclass(frozen=True)
class GroupMCP:
    """Group MCP at alpha = alpha_fraction * alpha_max, that of the group-LASSO.

    gamma > 1: how soon the penalty lets go, at |V_g| = gamma alpha omega_g; large, it is the
    group-LASSO. A group spans all targets, or each target has groups of its own (``separate``).
    group_weights: omega_g = 1 (``unit``) or the root of the number of columns (``sqrt-size``).
    alpha_fraction ``auto``: chosen by `fit` from the data, by the rule ``selection``.
    """

    name: ClassVar[str] = "group-mcp"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    alpha_fraction: AlphaFraction = 0.1
    gamma: float = 3.0
    separate: bool = False
    group_weights: GroupWeights = "unit"
    selection: Selection = "cross-validation"

    def __post_init__(self) -> None:
        checked_alpha_fraction(self.name, self.alpha_fraction, auto=True)
        number_setting(self.name, "gamma", self.gamma, low=1.0, open_low=True)
        check_grouping(self.name, self.separate, self.group_weights)
        # The information criteria count degrees of freedom of convex penalties.
        one_of(f"selection of {self.name}", self.selection, ("cross-validation", "stability"))

    def penalty(self, problem: RegressionProblem) -> GroupNorms:
        """The group-LASSO's penalty, whose alpha_max is the unit of alpha_fraction."""
        omega = size_weights(problem, self.group_weights)
        return GroupNorms(problem.groups, omega, not self.separate)

    def solve(self, problem: RegressionProblem) -> Solution:
        """The fixed point at ``alpha_fraction``. Raises InputError where that is "auto"."""
        return self.solve_path(problem, (numeric_fraction(self.name, self.alpha_fraction),))[0]

    def solve_path(
        self, problem: RegressionProblem, alpha_fractions: tuple[float, ...]
    ) -> tuple[Solution, ...]:
        """Fixed points at alpha_fractions, which descend, each from the group-LASSO's there."""
        unit = alpha_max(problem.statistics.cross, self.penalty(problem))
        systems = self._systems(problem)
        solutions = []
        for fraction in alpha_fractions:
            solved = [system.fixed_point(fraction * unit) for system in systems]
            weights = np.concatenate([values for values, _ in solved], axis=1)
            rounds = max(count for _, count in solved)
            scaled = weights / problem.statistics.rms[:, None]
            solution = Solution(scaled, solver_status="fixed point", iterations=rounds)
            if rounds == ROUNDS:
                reason = f"the weights still move after {ROUNDS} approximations"
                solution = Solution(scaled, "inaccurate", reason, "still moving", rounds)
            solutions.append(solution)
        return tuple(solutions)

    def referee(self) -> None:
        """None: nothing else finds this fixed point."""
        return

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) that one more approximation makes of these."""
        statistics, fraction = problem.statistics, numeric_fraction(self.name, self.alpha_fraction)
        alpha = fraction * alpha_max(statistics.cross, self.penalty(problem))
        following = np.zeros(weights.shape)
        for system in self._systems(problem) if alpha else []:
            scaled = weights[:, system.targets] * statistics.rms[:, None]
            slopes = system.slopes(scaled, alpha)
            following[:, system.targets] = system.weighted(slopes, alpha)
        return following / statistics.rms[:, None]

    def _systems(self, problem: RegressionProblem) -> "list[_System]":
        """All targets together, or one by one."""
        penalty, together = self.penalty(problem), problem.together(not self.separate)
        return [_System(problem, penalty, targets, self.gamma) for targets in together]


@dataclass(frozen=True, eq=False)
class _System:
    """The targets that share the norm of each group."""

    problem: RegressionProblem
    penalty: GroupNorms
    targets: slice
    gamma: float

    def slopes(self, values: Array, alpha: float) -> Array:
        """p'(|V_g|) / alpha (g,): the weights of the next group-LASSO."""
        joint = GroupNorms(self.penalty.groups, self.penalty.weights)
        norms = joint.block_norms(values)[:, 0]
        slopes: Array = np.maximum(self.penalty.weights - norms / (self.gamma * alpha), 0.0)
        return slopes

    def fixed_point(self, alpha: float) -> tuple[Array, int]:
        """Weights (k, n) whose slopes give them again, and the approximations it took."""
        slopes = self.penalty.weights
        values = self.weighted(slopes, alpha)
        if not values.any():
            return values, 0
        for count in range(1, ROUNDS):
            following = self.slopes(values, alpha)
            if np.all(np.abs(following - slopes) <= SETTLED * self.penalty.weights):
                return values, count
            slopes, values = following, self.weighted(following, alpha)
        return values, ROUNDS

    def weighted(self, slopes: Array, alpha: float) -> Array:
        """The group-LASSO (k, n) with these weights, which may be zero."""
        statistics, groups = self.problem.statistics, self.penalty.groups
        gram, cross = statistics.gram, statistics.cross[:, self.targets]
        free = slopes[groups] == 0.0
        loose, kept = np.flatnonzero(free), np.flatnonzero(~free)
        half = _whitened(gram[np.ix_(loose, loose)])
        shared, known = half.T @ gram[np.ix_(loose, kept)], half.T @ cross[loose]
        square = float(statistics.target_square[self.targets].sum() - np.sum(known**2))
        values = np.zeros(cross.shape)
        if len(kept) and square > 0.0 and alpha > 0.0:
            groups_left = np.unique(groups[kept], return_inverse=True)[1]
            path = path_on_gram(
                gram[np.ix_(kept, kept)] - shared.T @ shared,
                cross[kept] - shared.T @ known,
                GroupNorms(groups_left, slopes[slopes > 0.0]),
                np.array([alpha]),
                square,
            )
            values[kept] = path.values[0]
        values[loose] = half @ (known - shared @ values[kept])
        return values


def _whitened(gram: Array) -> Array:
    """H (k, r) with H'GH = I on the range of G (k, k), which may be empty."""
    roots, vectors = np.linalg.eigh(gram)
    on = roots > RANK * roots.max(initial=0.0)
    half: Array = vectors[:, on] / np.sqrt(roots[on])
    return half
