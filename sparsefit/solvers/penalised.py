"""What every penalised back-end shares: its penalty, its exact path and its referee.

    minimise over V (k, n):   loss(Y - Z V) + alpha * Omega(V),   alpha = alpha_fraction * alpha_max

A back-end of this kind is a penalty; the settings ``alpha_fraction``, ``solver`` and ``selection``
mean the same in all of them.
"""

import dataclasses
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, unknown
from sparsefit.regression.backend import (
    AlphaFraction,
    Checked,
    Selection,
    Solution,
    numeric_fraction,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.penalties import Penalty
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.exact import exact_path


@dataclass(frozen=True)
class PenalisedPath(Checked, ABC):
    """Base of the back-ends of one convex penalty; their fields are their settings.

    alpha_fraction: alpha / alpha_max, or ``auto``: chosen by `fit` from the data by the rule
    ``selection``. solver: ``exact``, or the name of the exact path, or ``clarabel``, the
    independent referee; for studies, any registered solver.
    """

    certificate_kind: ClassVar[CertificateKind] = "duality_gap"
    alpha_fraction: AlphaFraction = 0.1
    solver: str = "exact"
    selection: Selection = "cross-validation"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.solver, str):
            raise InputError(f"{self.name}: solver must be a name, not {self.solver!r}")
        if self._is_exact or self.solver == "clarabel":
            return
        from sparsefit.solvers.registry import solver, solver_names

        try:
            solver(self.solver)
        except InputError as error:
            if not str(error).startswith("unknown solver"):
                raise
            valid = (type(self).solver, "exact", *solver_names())
            raise unknown(f"solver of {self.name}", self.solver, valid) from None

    @property
    def _is_exact(self) -> bool:
        return self.solver in (type(self).solver, "exact")

    @abstractmethod
    def penalty(self, problem: RegressionProblem) -> Penalty:
        """The penalty on the columns of the problem."""

    def solve(self, problem: RegressionProblem) -> Solution:
        """The solution at ``alpha_fraction``. Raises InputError where that is "auto"."""
        return self.solve_path(problem, (numeric_fraction(self.name, self.alpha_fraction),))[0]

    def solve_path(
        self,
        problem: RegressionProblem,
        alpha_fractions: tuple[float, ...],
        *,
        tolerance: float | None = None,
    ) -> tuple[Solution, ...]:
        """Solutions at descending penalties, each warm-started by the one before.

        tolerance: where a solver that is not the exact path stops, in its own measure; None leaves
        the choice to it.
        """
        penalty = self.penalty(problem)
        if not self._is_exact:
            from sparsefit.solvers.registry import answers, solver

            chosen = solver(self.solver)
            return answers(chosen, problem, penalty, alpha_fractions, tolerance).solutions
        alphas = problem.alpha_max(penalty) * np.array(alpha_fractions)
        statistics = problem.statistics
        points = exact_path(problem.design, problem.target, penalty, alphas, statistics=statistics)
        return tuple(
            # A stop that rounding keeps it from is left for the certificate to judge.
            Solution(
                values,
                "ok" if done else "inaccurate",
                "" if done else "the path is incomplete at this penalty",
                points.words,
                int(count),
            )
            for values, done, count in zip(
                points.weights / statistics.rms[:, None], points.complete, points.steps, strict=True
            )
        )

    def referee(self) -> Self | None:
        """The back-end solved by Clarabel, for points that the certificate rejects."""
        return dataclasses.replace(self, solver="clarabel") if self._is_exact else None


def without_small(norms: Array, power: float) -> Array:
    """(norm / largest)^-power (g,); norms below 1e-3 of the largest count as that, and 0 as 1."""
    largest = float(norms.max())
    if largest == 0.0:
        return np.ones(len(norms))
    factors: Array = np.maximum(norms / largest, 1e-3) ** -power
    return factors
