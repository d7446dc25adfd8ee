"""What every penalised back-end shares: its penalty, its exact path and its referee.

    minimise over V (k, n):   loss(Y - Z V) + alpha * Omega(V)

A back-end of this kind is a penalty; the settings ``alpha_fraction``, ``solver`` and ``selection``
mean the same in all of them.
"""

import dataclasses
from abc import ABC, abstractmethod
from typing import Any, ClassVar, Literal, Self, get_args

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, MissingExtra, flag_setting, number_setting, one_of, unknown
from sparsefit.regression.backend import (
    AlphaFraction,
    Selection,
    Solution,
    checked_alpha_fraction,
    checked_selection,
    numeric_fraction,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.penalties import Penalty, SquaredNorm
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.exact import exact_path

GroupWeights = Literal["unit", "sqrt-size"]
FAINT = 1e-3  # of the largest norm of a first fit: the least that a norm counts as


class PenalisedPath(ABC):
    """Base of the frozen back-ends of one penalty; their fields are their settings.

    solver: ``exact``, or the name of the exact path, or ``clarabel``, the independent referee.
    alpha_fraction: alpha / alpha_max, or ``auto``: chosen by `fit` by the rule ``selection``.
    """

    name: ClassVar[str]
    certificate_kind: ClassVar[CertificateKind] = "duality_gap"
    exact: ClassVar[str]
    alpha_fraction: AlphaFraction
    solver: str
    selection: Selection

    def __post_init__(self) -> None:
        checked_alpha_fraction(self.name, self.alpha_fraction, auto=True)
        checked_selection(self.name, self.selection)
        self.check_settings()
        if not isinstance(self.solver, str):
            raise InputError(f"{self.name}: solver must be a name, not {self.solver!r}")
        if self.solver not in (self.exact, "exact", "clarabel"):
            _check_other(self.name, self.solver, self.exact)

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

        tolerance: where a solver that is not the exact path stops, in its own measure; None leaves
        the choice to it.
        """
        penalty = self.penalty(problem)
        if self.solver not in (self.exact, "exact"):
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
        """The same back-end solved by Clarabel, for points that the certificate rejects."""
        if self.solver not in (self.exact, "exact"):
            return None
        return dataclasses.replace(self, solver="clarabel")  # type: ignore[type-var]


def _check_other(owner: str, name: str, exact: str) -> None:
    """Raise InputError on a name that is no registered solver, MissingExtra on one not installed.

    Studies compare such solvers; an estimator needs none.
    """
    from sparsefit.solvers.registry import solver, solver_names

    if name == "adelie":
        words = "adelie pins numpy < 2: run it as a command, in an environment of its own"
        raise MissingExtra(f"{owner}: {words}")
    try:
        solver(name)
    except InputError as error:
        if not str(error).startswith("unknown solver"):
            raise
        raise unknown(f"solver of {owner}", name, (exact, "exact", *solver_names())) from None


def check_grouping(owner: str, separate: Any, group_weights: Any) -> None:
    """Raise InputError on group settings that are out of range."""
    flag_setting(owner, "separate", separate)
    one_of(f"group_weights of {owner}", group_weights, get_args(GroupWeights))


def check_pilot(owner: str, ridge: Any, power: Any) -> None:
    """Raise InputError on a setting of an adaptive back-end's first fit that is out of range."""
    number_setting(owner, "power", power, low=0.0, high=4.0)
    number_setting(owner, "pilot_ridge", ridge, low=0.0, open_low=True)


def check_ratio(owner: str, ratio: Any, *, open_low: bool = False) -> None:
    """Raise InputError on an l1_ratio outside [0, 1], or (0, 1]."""
    meaning = "it is the share of the absolute values in the penalty"
    meaning += "; for none of them use ridge" if open_low else ""
    number_setting(owner, "l1_ratio", ratio, low=0.0, high=1.0, open_low=open_low, meaning=meaning)


def size_weights(problem: RegressionProblem, group_weights: GroupWeights) -> Array:
    """omega (g,): 1, or the root of the number of columns of each group."""
    sizes = np.bincount(problem.groups)
    return np.ones(len(sizes)) if group_weights == "unit" else np.sqrt(sizes)


def adapted(problem: RegressionProblem, groups: IntArray, ridge: float, power: float) -> Array:
    """(|V0_g| / max |V0_g|)^-power (g,), by which weights of groups (k,) are multiplied.

    V0 = (Z'Z/m + ridge I)^-1 Z'Y/m is the first fit, its norms over all targets together; those
    below `FAINT` times the largest count as that. Where V0 is zero, all are 1.
    """
    pilot = SquaredNorm(problem.columns)
    points = exact_path(
        problem.design, problem.target, pilot, np.array([ridge]), statistics=problem.statistics
    )
    norms = np.sqrt(np.bincount(groups, np.square(points.weights[0]).sum(axis=1)))
    largest = float(norms.max())
    if largest == 0.0:
        return np.ones(len(norms))
    factors: Array = np.maximum(norms / largest, FAINT) ** -power
    return factors
