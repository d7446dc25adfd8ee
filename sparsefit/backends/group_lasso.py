"""Group-LASSO (Yuan & Lin 2006): the exact path by the variational form, or a conic solver."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args

import numpy as np

from sparsefit.backends.conic import check_solver, solve_conic
from sparsefit.backends.variational import GroupPath, group_path
from sparsefit.errors import flag_setting, one_of
from sparsefit.regression.backend import (
    AlphaFraction,
    Selection,
    Solution,
    checked_alpha_fraction,
    checked_selection,
    numeric_fraction,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.problem import RegressionProblem

GroupWeights = Literal["unit", "sqrt-size"]
EXACT = "variational"
STOP = 1e-11  # the solver's own stop, far below any tolerance the certificate is asked to meet


@dataclass(frozen=True)
class GroupLasso:
    """1/(2m) |Y - ZV|^2 + alpha sum_g omega_g |V_g|, alpha = alpha_fraction * alpha_max.

    A group spans the velocity components (joint), or each component has groups of its own
    (``separate``, the paper's n problems). group_weights: omega_g = 1 (``unit``) or the root of
    the number of columns (``sqrt-size``). solver: ``variational`` (exact path),
    ``clarabel-working-set``, ``clarabel-direct``, or through cvxpy ``clarabel`` or any other
    conic solver it finds installed. alpha_fraction ``auto``: chosen by `fit` from the data, by
    the rule ``selection``.
    """

    name: ClassVar[str] = "group-lasso"
    certificate_kind: ClassVar[CertificateKind] = "duality_gap"
    alpha_fraction: AlphaFraction = 0.1
    separate: bool = False
    group_weights: GroupWeights = "unit"
    solver: str = EXACT
    selection: Selection = "cross-validation"

    def __post_init__(self) -> None:
        checked_alpha_fraction(self.name, self.alpha_fraction, auto=True)
        checked_selection(self.name, self.selection)
        flag_setting(self.name, "separate", self.separate)
        one_of("group_weights of group-lasso", self.group_weights, get_args(GroupWeights))
        check_solver(self.name, self.solver, EXACT)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Blocks of the problem's groups."""
        sizes = np.bincount(problem.groups)
        omega = np.ones(len(sizes)) if self.group_weights == "unit" else np.sqrt(sizes)
        return Penalty(problem.groups, omega, joint=not self.separate)

    def solve(self, problem: RegressionProblem) -> Solution:
        """The solution at ``alpha_fraction``, a number."""
        return self.solve_path(problem, (numeric_fraction(self.name, self.alpha_fraction),))[0]

    def solve_path(
        self, problem: RegressionProblem, alpha_fractions: tuple[float, ...]
    ) -> tuple[Solution, ...]:
        """Solutions at descending penalties, each warm-started by the one before."""
        statistics, penalty = problem.statistics, self.penalty(problem)
        if self.solver != EXACT:
            return solve_conic(statistics, penalty, alpha_fractions, self.solver)
        alphas = alpha_max(statistics.cross, penalty) * np.array(alpha_fractions)
        blocks = (
            [slice(t, t + 1) for t in range(problem.targets)] if self.separate else [slice(None)]
        )
        paths: list[GroupPath] = [
            group_path(
                statistics.gram,
                statistics.cross[:, block],
                penalty.groups,
                penalty.weights,
                alphas,
                target_square=float(statistics.target_square[block].sum()),
                tolerance=STOP,
            )
            for block in blocks
        ]
        scaled = np.concatenate([path.weights for path in paths], axis=2)
        loop = f"{paths[0].loop} loop"
        complete = np.all([path.complete for path in paths], axis=0)
        iterations = np.sum([path.iterations for path in paths], axis=0)
        return tuple(
            # A stop that rounding keeps it from is left for the certificate to judge.
            Solution(
                values / statistics.rms[:, None],
                "ok" if done else "inaccurate",
                "" if done else "the Newton iteration stalled",
                f"{'converged' if done else 'stalled'} ({loop})",
                int(count),
            )
            for values, done, count in zip(scaled, complete, iterations, strict=True)
        )

    def referee(self) -> "GroupLasso | None":
        """Clarabel, for points that the certificate rejects."""
        return (
            dataclasses.replace(self, solver="clarabel-working-set")
            if self.solver == EXACT
            else None
        )
