"""What every penalised back-end shares: its path, exact or by a conic solver, and its referee.

    minimise over V (k, n):   1/(2m) |Y - Z V|^2 + alpha * Omega(V)

A back-end of this kind is a penalty and the exact path that suits it (`ExactPath`); the settings
``alpha_fraction``, ``solver`` and ``selection`` mean the same in all of them.
"""

import dataclasses
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, Self, TypeAlias

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.backends.solvers import check_solver, solve_by
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
from sparsefit.regression.statistics import Statistics


@dataclass(frozen=True, eq=False)
class Points:
    """Scaled weights V (p, k, b) of b targets along a path of p penalties.

    complete (p,): whether each is a solution; iterations (p,); loop: which one ran, "compiled" or
    "python".
    """

    weights: Array
    complete: BoolArray
    iterations: IntArray
    loop: str


Solve: TypeAlias = Callable[[Statistics, Penalty, Array, slice], Points]
"""(statistics, penalty, descending alphas (p,), targets that are solved together) -> points."""


@dataclass(frozen=True)
class ExactPath:
    """An exact path as a choice of ``solver``: its name, how it solves, and how it reports.

    solved and unsolved: the solver's word on a point, with ``{loop}`` for the loop that ran;
    reason: why a point is not solved. quadratic: whether what it solves are quadratic programs,
    without cones of group norms.
    """

    name: str
    solve: Solve
    solved: str
    unsolved: str
    reason: str
    quadratic: bool


class PenalisedPath(ABC):
    """Base of the frozen back-ends of one penalty; their fields are their settings.

    solver: the name of the exact path (the default), ``clarabel-working-set``,
    ``clarabel-direct``, through cvxpy ``clarabel`` or any other that it finds installed, or a
    public package (see `solvers`).
    alpha_fraction: alpha / alpha_max, or ``auto``: chosen by `fit` by the rule ``selection``.
    """

    name: ClassVar[str]
    certificate_kind: ClassVar[CertificateKind] = "duality_gap"
    exact: ClassVar[ExactPath]
    plain: ClassVar[bool] = True  # nothing but norms of coefficients or of groups
    alpha_fraction: AlphaFraction
    solver: str
    selection: Selection

    def __post_init__(self) -> None:
        checked_alpha_fraction(self.name, self.alpha_fraction, auto=True)
        checked_selection(self.name, self.selection)
        self.check_settings()
        check_solver(
            self.name,
            self.solver,
            self.exact.name,
            quadratic=self.exact.quadratic,
            plain=self.plain,
        )

    def check_settings(self) -> None:  # noqa: B027 - a penalty may have no settings of its own
        """Raise InputError on a setting of this penalty alone that is out of range."""

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

        Targets that the penalty does not couple are separate problems. tolerance: where a solver
        that is not the exact path stops, in its own measure; None is what `solve_by` takes.
        """
        statistics, penalty = problem.statistics, self.penalty(problem)
        if self.solver != self.exact.name:
            return solve_by(self.solver, problem, penalty, alpha_fractions, tolerance)
        alphas = alpha_max(statistics.cross, penalty) * np.array(alpha_fractions)
        together = problem.together(penalty.coupled)
        paths = [self.exact.solve(statistics, penalty, alphas, targets) for targets in together]
        weights = np.concatenate([path.weights for path in paths], axis=2)
        complete = np.all([path.complete for path in paths], axis=0)
        iterations = np.sum([path.iterations for path in paths], axis=0)
        words = {True: self.exact.solved, False: self.exact.unsolved}
        return tuple(
            # A stop that rounding keeps it from is left for the certificate to judge.
            Solution(
                values,
                "ok" if done else "inaccurate",
                "" if done else self.exact.reason,
                words[bool(done)].format(loop=paths[0].loop),
                int(count),
            )
            for values, done, count in zip(
                weights / statistics.rms[:, None], complete, iterations, strict=True
            )
        )

    def referee(self) -> Self | None:
        """The same back-end solved by Clarabel, for points that the certificate rejects."""
        if self.solver != self.exact.name:
            return None
        return dataclasses.replace(self, solver="clarabel-working-set")  # type: ignore[type-var]
