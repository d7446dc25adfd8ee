"""Back-ends whose penalties are of single coefficients: LASSO and its kin.

In all of them alpha = alpha_fraction * alpha_max, and with ``auto`` it is chosen by `fit` from the
data, by the rule ``selection``; solver: ``exact`` or ``clarabel``, the referee.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sparsefit.errors import flag_setting, number_setting, one_of
from sparsefit.regression.backend import AlphaFraction, Selection
from sparsefit.regression.losses import RootSquares, Squares
from sparsefit.regression.ordered_penalties import FusedNorm, SortedNorm
from sparsefit.regression.penalties import (
    AbsoluteValues,
    BoundedValues,
    Penalty,
    SquaredNorm,
    lasso_penalty,
)
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.penalised import PenalisedPath, adapted, check_pilot, check_ratio


@dataclass(frozen=True)
class Lasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum |V_jt| (Tibshirani 1996), V >= 0 where ``positive``."""

    name: ClassVar[str] = "lasso"
    exact: ClassVar[str] = "homotopy"
    alpha_fraction: AlphaFraction = 0.1
    solver: str = "homotopy"
    selection: Selection = "cross-validation"
    positive: bool = False

    def check_settings(self) -> None:
        """Raise InputError on a flag that is none."""
        flag_setting(self.name, "positive", self.positive)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own."""
        plain = lasso_penalty(problem.columns)
        return _positive(plain) if self.positive else plain


def _positive(penalty: AbsoluteValues) -> BoundedValues:
    k = penalty.columns
    return BoundedValues(penalty.weights, np.zeros(k), np.full(k, np.inf), ridge=penalty.ridge)


@dataclass(frozen=True)
class ElasticNet(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha [r sum |V_jt| + (1 - r)/2 |V|^2 / y] (Zou and Hastie 2005).

    l1_ratio: r in (0, 1]; 1 is the LASSO. y is the rms of the target, so that the ridge does not
    depend on its unit; where it is 1, this is scikit-learn's objective. positive: V >= 0.
    """

    name: ClassVar[str] = "elastic-net"
    exact: ClassVar[str] = "homotopy"
    alpha_fraction: AlphaFraction = 0.1
    l1_ratio: float = 0.5
    solver: str = "homotopy"
    selection: Selection = "cross-validation"
    positive: bool = False

    def check_settings(self) -> None:
        """Raise InputError on an l1_ratio outside (0, 1]."""
        check_ratio(self.name, self.l1_ratio, open_low=True)
        flag_setting(self.name, "positive", self.positive)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own, and a ridge."""
        rms = float(np.sqrt(problem.statistics.target_square.mean())) or 1.0
        weights = np.full(problem.columns, self.l1_ratio)
        plain = AbsoluteValues(weights, ridge=(1.0 - self.l1_ratio) / rms)
        return _positive(plain) if self.positive else plain


@dataclass(frozen=True)
class Ridge(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha/2 |V|^2, alpha = alpha_fraction * k (Hoerl and Kennard 1970).

    No penalty has a solution of zero: the unit is the number of columns k, the trace of Z'Z/m,
    which bounds its largest eigenvalue. The rules ``selection`` that count zeros do not apply.
    """

    name: ClassVar[str] = "ridge"
    exact: ClassVar[str] = "cholesky"
    alpha_fraction: AlphaFraction = 0.001
    solver: str = "cholesky"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a rule that chooses by which weights are zero."""
        if self.selection in ("ebic", "stability"):
            one_of(
                "selection of ridge, whose weights are never zero,",
                self.selection,
                ("bic", "cross-validation"),
            )

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """A ridge alone."""
        return SquaredNorm(problem.columns)


@dataclass(frozen=True)
class AdaptiveLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_j omega_j sum_t |V_jt| (Zou 2006).

    omega_j = (|V0_j| / max |V0_j|)^-power, V0 the ridge fit (Z'Z/m + pilot_ridge I)^-1 Z'Y/m over
    all targets together, whose norms below 1e-3 of the largest count as that. power 0 is the
    LASSO. Where alpha_fraction is chosen, the weights are learned in each fold.
    """

    name: ClassVar[str] = "adaptive-lasso"
    exact: ClassVar[str] = "homotopy"
    alpha_fraction: AlphaFraction = 0.1
    power: float = 1.0
    pilot_ridge: float = 0.05
    solver: str = "homotopy"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a setting of the first fit that is out of range."""
        check_pilot(self.name, self.pilot_ridge, self.power)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own, weighted by the first fit."""
        each = np.arange(problem.columns)
        return AbsoluteValues(adapted(problem, each, self.pilot_ridge, self.power))


@dataclass(frozen=True)
class SquareRootLasso(PenalisedPath):
    """y |Y - ZV|/sqrt(m) + alpha sum |V_jt|, y = |Y|/sqrt(m) (Belloni, Chernozhukov, Wang 2011).

    The penalty that suits a noise does not depend on how strong it is. All targets share one root.
    """

    name: ClassVar[str] = "square-root-lasso"
    exact: ClassVar[str] = "scaled-homotopy"
    alpha_fraction: AlphaFraction = 0.1
    solver: str = "scaled-homotopy"
    selection: Selection = "cross-validation"

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own, added to a root."""
        return replace(lasso_penalty(problem.columns), loss=RootSquares())


@dataclass(frozen=True)
class HuberLasso(PenalisedPath):
    """Huber's loss of Y - ZV plus alpha sum |V_jt|: outliers beyond clip * y count linearly.

    clip: in units of the rms y of each target.
    """

    name: ClassVar[str] = "huber-lasso"
    exact: ClassVar[str] = "newton"
    alpha_fraction: AlphaFraction = 0.1
    clip: float = 1.0
    solver: str = "newton"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a clip that is not above 0, and on rules that count squares."""
        number_setting(self.name, "clip", self.clip, low=0.0, open_low=True)
        one_of(f"selection of {self.name}", self.selection, ("cross-validation", "stability"))

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Every coefficient a block of its own, added to Huber's loss."""
        return replace(lasso_penalty(problem.columns), loss=Squares(clip=self.clip))


@dataclass(frozen=True)
class Slope(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_i lambda_i |V|_(i) by target (Bogdan et al. 2015).

    lambda_i = Phi^-1(1 - i rate / 2k), over lambda_1: those that keep the rate of false discoveries
    at orthonormal columns; rate in (0, 1).
    """

    name: ClassVar[str] = "slope"
    exact: ClassVar[str] = "newton"
    alpha_fraction: AlphaFraction = 0.1
    rate: float = 0.1
    solver: str = "newton"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on a rate that is none."""
        number_setting(self.name, "rate", self.rate, low=1e-6, high=1.0 - 1e-6)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Weights by rank."""
        from scipy.special import ndtri

        k = problem.columns
        lambdas = ndtri(1.0 - np.arange(1, k + 1) * self.rate / (2 * k))
        return SortedNorm(lambdas / lambdas[0])


@dataclass(frozen=True)
class FusedLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_t [r sum_j |V_jt| + (1 - r) sum_j |V_(j+1)t - V_jt|].

    For columns in an order (Tibshirani et al. 2005); l1_ratio: r in (0, 1].
    """

    name: ClassVar[str] = "fused-lasso"
    exact: ClassVar[str] = "newton"
    alpha_fraction: AlphaFraction = 0.1
    l1_ratio: float = 0.1
    solver: str = "newton"
    selection: Selection = "cross-validation"

    def check_settings(self) -> None:
        """Raise InputError on an l1_ratio outside (0, 1]."""
        check_ratio(self.name, self.l1_ratio, open_low=True)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        """Absolute values and differences of neighbours."""
        return FusedNorm(problem.columns, self.l1_ratio)
