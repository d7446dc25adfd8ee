"""LASSO (Tibshirani 1996): the exact path by homotopy, or any solver that cvxpy finds."""

import dataclasses
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.backends.conic import check_solver, solve_conic
from sparsefit.backends.homotopy import lasso_path
from sparsefit.regression.backend import (
    AlphaFraction,
    Selection,
    Solution,
    checked_alpha_fraction,
    checked_selection,
    numeric_fraction,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.objective import Penalty, alpha_max, lasso_penalty
from sparsefit.regression.problem import RegressionProblem

EXACT = "homotopy"


@dataclass(frozen=True)
class Lasso:
    """1/(2m) |Y - ZV|^2 + alpha sum |V_jt|, alpha = alpha_fraction * alpha_max.

    solver: ``homotopy`` (exact path), ``clarabel-working-set``, ``clarabel-direct``, or through
    cvxpy ``clarabel``, ``osqp`` or any other it finds installed. alpha_fraction ``auto``: chosen
    by `fit` from the data, by the rule ``selection``.
    """

    name: ClassVar[str] = "lasso"
    certificate_kind: ClassVar[CertificateKind] = "duality_gap"
    alpha_fraction: AlphaFraction = 0.1
    solver: str = EXACT
    selection: Selection = "cross-validation"

    def __post_init__(self) -> None:
        checked_alpha_fraction(self.name, self.alpha_fraction, auto=True)
        checked_selection(self.name, self.selection)
        check_solver(self.name, self.solver, EXACT)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own."""
        return lasso_penalty(problem.columns)

    def solve(self, problem: RegressionProblem) -> Solution:
        """The solution at ``alpha_fraction``, a number."""
        return self.solve_path(problem, (numeric_fraction(self.name, self.alpha_fraction),))[0]

    def solve_path(
        self, problem: RegressionProblem, alpha_fractions: tuple[float, ...]
    ) -> tuple[Solution, ...]:
        """Solutions at descending penalties; the targets are separate problems."""
        statistics, penalty = problem.statistics, self.penalty(problem)
        if self.solver != EXACT:
            return solve_conic(statistics, penalty, alpha_fractions, self.solver)
        alphas = alpha_max(statistics.cross, penalty) * np.array(alpha_fractions)
        paths = [
            lasso_path(statistics.gram, statistics.cross[:, t], alphas)
            for t in range(problem.targets)
        ]
        scaled = np.stack([path.weights for path in paths], axis=-1)
        complete = np.all([path.complete for path in paths], axis=0)
        steps, loop = sum(path.steps for path in paths), paths[0].loop
        return tuple(
            Solution(
                values / statistics.rms[:, None],
                "ok" if done else "inaccurate",
                "" if done else "the homotopy did not reach this penalty",
                f"path {'complete' if done else 'incomplete'}, {loop} loop",
                steps,
            )
            for values, done in zip(scaled, complete, strict=True)
        )

    def referee(self) -> "Lasso | None":
        """Clarabel, for points that the certificate rejects."""
        return (
            dataclasses.replace(self, solver="clarabel-working-set")
            if self.solver == EXACT
            else None
        )
