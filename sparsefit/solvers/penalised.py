"""Back-ends of one convex penalty, of single coefficients or of groups of columns: LASSO and kin.

    minimise over V (k, n):   loss(Y - Z V) + alpha * Omega(V),   alpha = alpha_fraction * alpha_max

Each is a penalty with its settings, on V in columns of unit rms; `PenalisedPath` has what all of
them share: an exact path and its referee. A group spans all targets (joint), for a flight its
velocity components, or each target has groups of its own (``separate``, the paper's n problems).
group_weights: omega_g = 1 (``unit``) or the root of the number of columns (``sqrt-size``).
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from typing import ClassVar, Literal, Self

import numpy as np

from sparsefit.arrays import Array, IntArray, like
from sparsefit.errors import one_of
from sparsefit.regression.backend import (
    AlphaFraction,
    Checked,
    Selection,
    Solution,
    numeric_fraction,
    setting,
)
from sparsefit.regression.certificate import CertificateKind
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
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
from sparsefit.solvers.exact import exact_path

GroupWeights = Literal["unit", "sqrt-size"]
RATIO = "it is the share of the absolute values in the penalty"
NO_RIDGE = f"{RATIO}; for none of them use ridge"


@dataclass(frozen=True)
class PenalisedPath(Checked, ABC):
    """Base of the back-ends of one convex penalty; their fields are their settings.

    alpha_fraction: alpha / alpha_max, or ``auto``: chosen by `fit` from the data by the rule
    ``selection``. solver: ``exact``, or the name of the exact path, or ``clarabel``, the
    independent referee.
    """

    certificate_kind: ClassVar[CertificateKind] = "duality_gap"
    alpha_fraction: AlphaFraction = 0.1
    solver: str = "exact"
    selection: Selection = "cross-validation"

    def __post_init__(self) -> None:
        super().__post_init__()
        names = (type(self).solver, "exact", "clarabel")
        one_of(f"solver of {self.name}", self.solver, names)

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
        self, problem: RegressionProblem, alpha_fractions: tuple[float, ...]
    ) -> tuple[Solution, ...]:
        """Solutions at descending penalties, each warm-started by the one before."""
        penalty = self.penalty(problem)
        if not self._is_exact:
            from sparsefit.solvers.registry import Recipe, answers

            return answers(Recipe(self.solver).make(), problem, penalty, alpha_fractions)
        alphas = problem.alpha_max(penalty) * np.array(alpha_fractions)
        path = exact_path(problem.design, problem.target, penalty, alphas, cross=problem.cross)
        weights = path.weights / problem.design.rms[:, None]
        # The certificate judges points where rounding prevents the solver's own stop.
        words = "the path is incomplete at this penalty"
        solved = Solution(None, solver_status=path.words)
        cut_short = like(solved, status="inaccurate", reason=words)
        points = zip(weights, path.complete.tolist(), path.steps.tolist(), strict=True)
        return tuple(
            like(solved if complete else cut_short, weights=values, iterations=count)
            for values, complete, count in points
        )

    def referee(self) -> Self | None:
        """The back-end solved by Clarabel, for points that the certificate rejects."""
        return replace(self, solver="clarabel") if self._is_exact else None


@dataclass(frozen=True)
class Lasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum |V_jt| (Tibshirani 1996), V >= 0 where ``positive``."""

    name: ClassVar[str] = "lasso"
    solver: str = "homotopy"
    positive: bool = False

    def penalty(self, problem: RegressionProblem) -> Penalty:
        return _signed(lasso_penalty(problem.columns), self.positive)


@dataclass(frozen=True)
class ElasticNet(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha [r sum |V_jt| + (1 - r)/2 |V|^2 / y] (Zou and Hastie 2005).

    l1_ratio: r in (0, 1]; 1 is the LASSO. y is the rms of the target, so that the ridge does not
    depend on its unit; where it is 1, this is scikit-learn's objective. positive: V >= 0.
    """

    name: ClassVar[str] = "elastic-net"
    solver: str = "homotopy"
    l1_ratio: float = setting(0.5, low=0.0, high=1.0, open_low=True, meaning=NO_RIDGE)
    positive: bool = False

    def penalty(self, problem: RegressionProblem) -> Penalty:
        rms = float(np.sqrt(problem.target_square.mean())) or 1.0
        weights = np.full(problem.columns, self.l1_ratio)
        plain = AbsoluteValues(weights, ridge=(1.0 - self.l1_ratio) / rms)
        return _signed(plain, self.positive)


def _signed(plain: AbsoluteValues, positive: bool) -> AbsoluteValues:
    if not positive:
        return plain
    lower, upper = np.zeros(plain.columns), np.full(plain.columns, np.inf)
    return BoundedValues(plain.weights, lower, upper, ridge=plain.ridge)


@dataclass(frozen=True)
class BoxLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum |V_jt| where lower <= W_jt <= upper for the weights W of theta.

    lower <= 0 <= upper, in the unit of the weights; None: there is no such bound.
    """

    name: ClassVar[str] = "box-lasso"
    solver: str = "newton"
    lower: float | None = setting(None, low=-np.inf, high=0.0)
    upper: float | None = setting(None, low=0.0)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        plain, rms = lasso_penalty(problem.columns), problem.design.rms
        if self.lower is None and self.upper is None:
            return plain
        lower, upper = -np.inf if self.lower is None else self.lower, self.upper
        bounds = np.array([[lower], [np.inf if upper is None else upper]])
        edges = bounds * rms  # whose weights, divided by rms, must not exceed them by rounding
        edges = np.where(np.abs(edges / rms) > np.abs(bounds), np.nextafter(edges, 0.0), edges)
        return BoundedValues(plain.weights, *edges)


@dataclass(frozen=True)
class Ridge(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha/2 |V|^2, alpha = alpha_fraction * k (Hoerl and Kennard 1970).

    No penalty has a solution of zero: the unit is the number of columns k, the trace of Z'Z/m,
    which bounds its largest eigenvalue.
    """

    name: ClassVar[str] = "ridge"
    alpha_fraction: AlphaFraction = 0.001
    solver: str = "cholesky"

    def penalty(self, problem: RegressionProblem) -> Penalty:
        return SquaredNorm(problem.columns)


@dataclass(frozen=True)
class SquareRootLasso(PenalisedPath):
    """y |Y - ZV|/sqrt(m) + alpha sum |V_jt|, y = |Y|/sqrt(m) (Belloni, Chernozhukov, Wang 2011).

    The penalty that suits a noise does not depend on how strong it is. All targets share one root.
    """

    name: ClassVar[str] = "square-root-lasso"
    solver: str = "scaled-homotopy"

    def penalty(self, problem: RegressionProblem) -> Penalty:
        return replace(lasso_penalty(problem.columns), loss=RootSquares())


@dataclass(frozen=True)
class HuberLasso(PenalisedPath):
    """Huber's loss of Y - ZV plus alpha sum |V_jt|: outliers beyond clip * s_t count linearly.

    clip: in units of s_t = 1.48 median |Y_t| of each target (less its median beside an intercept,
    which minimises the loss with the weights). BIC, of squares, does not apply.
    """

    name: ClassVar[str] = "huber-lasso"
    solver: str = "newton"
    selection: Literal["cross-validation"] = "cross-validation"
    clip: float = setting(1.0, low=0.0, open_low=True)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        loss = Squares(self.clip, problem.design.weights, problem.design.direction)
        return replace(lasso_penalty(problem.columns), loss=loss)


@dataclass(frozen=True)
class Slope(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_i lambda_i |V|_(i) by target (Bogdan et al. 2015).

    lambda_i = Phi^-1(1 - i rate / 2k), over lambda_1: those that keep the rate of false discoveries
    at orthonormal columns; rate in (0, 1).
    """

    name: ClassVar[str] = "slope"
    solver: str = "cluster-descent"
    rate: float = setting(0.1, low=1e-6, high=1.0 - 1e-6)

    def penalty(self, problem: RegressionProblem) -> Penalty:
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
    solver: str = "newton"
    l1_ratio: float = setting(0.1, low=0.0, high=1.0, open_low=True, meaning=NO_RIDGE)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        return FusedNorm(problem.columns, self.l1_ratio)


@dataclass(frozen=True)
class Grouped(PenalisedPath, ABC):
    """Base of the penalties of groups of columns; separate, group_weights: see the file's head."""

    solver: str = "variational"
    separate: bool = False
    group_weights: GroupWeights = "unit"

    def norms(self, problem: RegressionProblem, factors: Array | float = 1.0) -> GroupNorms:
        """The norms of the problem's groups, whose weights omega are multiplied by ``factors``."""
        sizes = np.bincount(problem.groups)
        omega = np.ones(len(sizes)) if self.group_weights == "unit" else np.sqrt(sizes)
        return GroupNorms(problem.groups, omega * factors, not self.separate)


@dataclass(frozen=True)
class GroupLasso(Grouped):
    """1/(2m) |Y - ZV|^2 + alpha sum_g omega_g |V_g| (Yuan and Lin 2006)."""

    name: ClassVar[str] = "group-lasso"

    def penalty(self, problem: RegressionProblem) -> Penalty:
        return self.norms(problem)


@dataclass(frozen=True)
class SparseGroupLasso(Grouped):
    """1/(2m) |Y - ZV|^2 + alpha [(1 - r) sum_g omega_g |V_g| + r sum_h |V_h|] (Simon et al. 2013).

    h are the problem's subgroups within its groups g (the waves of a ring), where it has them, and
    single coefficients elsewhere. l1_ratio: r in [0, 1]; 0 is the group-LASSO, 1 the LASSO.
    """

    name: ClassVar[str] = "sparse-group-lasso"
    solver: str = "block-newton"
    l1_ratio: float = setting(0.5, low=0.0, high=1.0, meaning=RATIO)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        ratio = self.l1_ratio
        inner: AbsoluteValues | GroupNorms = AbsoluteValues(np.full(problem.columns, ratio))
        if problem.subgroups is not None:
            weights = np.full(int(problem.subgroups.max()) + 1, ratio)
            inner = GroupNorms(problem.subgroups, weights, not self.separate)
        if ratio in (0.0, 1.0):
            return inner if ratio else self.norms(problem)
        return NestedNorms(self.norms(problem, 1.0 - ratio), inner)


@dataclass(frozen=True)
class AdaptiveLasso(PenalisedPath):
    """1/(2m) |Y - ZV|^2 + alpha sum_j omega_j sum_t |V_jt| (Zou 2006).

    omega_j = (|V0_j| / max |V0_j|)^-power, V0 the ridge fit (Z'Z/m + pilot_ridge I)^-1 Z'Y/m over
    all targets together, whose norms below 1e-3 of the largest count as that. power 0 is the
    LASSO. Where alpha_fraction is chosen, the weights are learned in each fold.
    """

    name: ClassVar[str] = "adaptive-lasso"
    solver: str = "homotopy"
    power: float = setting(1.0, low=0.0, high=4.0)
    pilot_ridge: float = setting(0.05, low=0.0, open_low=True)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        return AbsoluteValues(_pilot_factors(problem, np.arange(problem.columns), self))


@dataclass(frozen=True)
class AdaptiveGroupLasso(Grouped):
    """The group-LASSO with omega_g = (|V0_g| / max |V0_g|)^-power (Wang and Leng 2008).

    As `AdaptiveLasso`; with group_weights ``sqrt-size`` omega_g is larger by the root of the number
    of columns. power 0 is the group-LASSO.
    """

    name: ClassVar[str] = "adaptive-group-lasso"
    power: float = setting(1.0, low=0.0, high=4.0)
    pilot_ridge: float = setting(0.05, low=0.0, open_low=True)

    def penalty(self, problem: RegressionProblem) -> Penalty:
        return self.norms(problem, _pilot_factors(problem, problem.groups, self))


def _pilot_factors(
    problem: RegressionProblem, groups: IntArray, settings: AdaptiveLasso | AdaptiveGroupLasso
) -> Array:
    """The factors omega (g,) of groups of columns; 1 where the ridge fit is zero."""
    ridge, penalty = np.array([settings.pilot_ridge]), SquaredNorm(problem.columns)
    path = exact_path(problem.design, problem.target, penalty, ridge, cross=problem.cross)
    pilot = path.weights[0]
    norms = np.sqrt(np.bincount(groups, np.square(pilot).sum(axis=1)))
    largest = float(norms.max())
    factors: Array = np.maximum(norms / (largest or 1.0), 1e-3) ** -settings.power
    return factors if largest else np.ones(len(norms))
