"""Group MCP (Breheny and Huang 2015): the group-LASSO without its bias on large groups.

    1/(2m) |Y - Z V|^2 + sum_g p(|V_g|),   p'(t) = (alpha - t/gamma)_+,   p(0) = 0

p is not convex, and the answer is a fixed point of the local linear approximation (Zou and Li
2008): from the group-LASSO on, the group-LASSO with the weights p'(|V_g|) of the weights before.
Groups of |V_g| >= gamma alpha are free of penalty: they are projected out of Z'Z/m, and the
exact path of the group-LASSO solves for the others.

Sources: Zhang, Ann. Statist. 38 (2010) 894-942, for p; Breheny and Huang, Stat. Comput. 25 (2015)
173-187, for groups, which they orthonormalise and we do not; Zou and Li, Ann. Statist. 36 (2008)
1509-1533.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.backend import AlphaFraction, Checked, Solution, numeric_fraction, setting
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.kernels import path_on_gram

ROUNDS = 100


@dataclass(frozen=True)
class GroupMCP(Checked):
    """1/(2m) |Y - Z V|^2 + sum_g p(|V_g|), p'(t) = (alpha - t/gamma)_+ (Breheny and Huang 2015).

    alpha = alpha_fraction * alpha_max, that of the group-LASSO with omega_g = 1. gamma > 1: the
    penalty is constant from |V_g| = gamma alpha on; a large one is the group-LASSO.
    A group spans all targets. alpha_fraction ``auto``: chosen by `fit` by cross-validation, as an
    information criterion counts degrees of freedom of convex penalties.
    """

    name: ClassVar[str] = "group-mcp"
    certificate_kind: ClassVar[CertificateKind] = "fixed_point"
    alpha_fraction: AlphaFraction = 0.1
    gamma: float = setting(3.0, low=1.0, open_low=True)

    def penalty(self, problem: RegressionProblem) -> GroupNorms:
        """The group-LASSO's penalty, whose alpha_max is the unit of alpha_fraction."""
        return GroupNorms(problem.groups, np.ones(int(problem.groups.max()) + 1))

    def solve(self, problem: RegressionProblem) -> Solution:
        """The fixed point at ``alpha_fraction``. Raises InputError where that is "auto"."""
        return self.solve_path(problem, (numeric_fraction(self.name, self.alpha_fraction),))[0]

    def solve_path(
        self, problem: RegressionProblem, alpha_fractions: tuple[float, ...]
    ) -> tuple[Solution, ...]:
        """Fixed points at alpha_fractions, which descend, each from the group-LASSO's there."""
        penalty, solutions = self.penalty(problem), []
        unit = problem.alpha_max(penalty)
        for alpha in (unit * np.array(alpha_fractions)).tolist():
            slopes, count, settled = penalty.weights, 0, False
            values = _weighted(problem, slopes, alpha)
            while values.any() and not settled and count < ROUNDS - 1:
                count, before = count + 1, slopes
                slopes = self._slopes(penalty, values, alpha)
                settled = bool(np.all(np.abs(slopes - before) <= 1e-10))
                values = values if settled else _weighted(problem, slopes, alpha)
            weights = values / problem.design.rms[:, None]
            solution = Solution(weights, solver_status="fixed point", iterations=count)
            if values.any() and not settled:
                reason = f"the weights still move after {ROUNDS} approximations"
                solution = Solution(weights, "inaccurate", reason, "still moving", ROUNDS)
            solutions.append(solution)
        return tuple(solutions)

    def referee(self) -> None:
        """No referee: nothing else finds this fixed point."""
        return

    def next_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weights (k, n) after one more local linear approximation at these."""
        penalty, rms = self.penalty(problem), problem.design.rms[:, None]
        fraction = numeric_fraction(self.name, self.alpha_fraction)
        alpha = fraction * problem.alpha_max(penalty)
        if not alpha:
            return np.zeros(weights.shape)
        return _weighted(problem, self._slopes(penalty, weights * rms, alpha), alpha) / rms

    def _slopes(self, penalty: GroupNorms, values: Array, alpha: float) -> Array:
        """p'(|V_g|) / alpha (g,): the weights of the next group-LASSO."""
        norms = penalty.block_norms(values)[:, 0]
        slopes: Array = np.maximum(1.0 - norms / (self.gamma * alpha), 0.0)
        return slopes


def _weighted(problem: RegressionProblem, slopes: Array, alpha: float) -> Array:
    """The group-LASSO (k, n) with weights (g,) that may be zero."""
    gram, cross, groups = problem.design.gram, problem.cross, problem.groups
    free = slopes[groups] == 0.0
    loose, bound = np.flatnonzero(free), np.flatnonzero(~free)
    roots, vectors = np.linalg.eigh(gram[np.ix_(loose, loose)])
    on = roots > 1e-10 * roots.max(initial=0.0)  # others count as zero
    half = vectors[:, on] / np.sqrt(roots[on])  # H'GH = I on the range of the free groups' G
    shared, load = half.T @ gram[np.ix_(loose, bound)], half.T @ cross[loose]
    square = float(problem.target_square.sum() - np.sum(load**2))
    values = np.zeros(cross.shape)
    if len(bound) and square > 0.0 and alpha > 0.0:
        rest = gram[np.ix_(bound, bound)] - shared.T @ shared, cross[bound] - shared.T @ load
        numbers = np.unique(groups[bound], return_inverse=True)[1]
        penalty = GroupNorms(numbers, slopes[slopes > 0.0])
        path = path_on_gram(*rest, penalty, np.array([alpha]), square)
        values[bound] = path.weights[0]
    values[loose] = half @ (load - shared @ values[bound])
    return values
