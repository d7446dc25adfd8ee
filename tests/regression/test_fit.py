"""The front door: paths, statuses, repairs, and back-ends that misbehave."""

import dataclasses
from dataclasses import dataclass
from importlib import import_module
from typing import ClassVar

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError
from sparsefit.regression.backend import Solution
from sparsefit.regression.losses import Squares
from sparsefit.regression.penalties import lasso_penalty
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.penalised import Lasso
from tests.problems import flight_problem, regular

door = import_module("sparsefit.regression.fit")
PROBLEM = regular()
FRACTIONS = (0.9, 0.5, 0.2, 0.05, 0.01)
NAN, ZERO = np.full((12, 2), np.nan), np.zeros((12, 2))
SOME_NAN = np.where(np.arange(24).reshape(12, 2) == 5, np.nan, 1.0)


@dataclass(frozen=True, eq=False)
class Double:
    """A convex back-end that answers whatever it is told to."""

    name: ClassVar[str] = "double"
    certificate_kind: ClassVar[str] = "duality_gap"
    alpha_fraction: float = 0.1
    answer: Solution = dataclasses.field(default_factory=lambda: Solution(None))

    def solve(self, problem):
        return self.answer

    def penalty(self, problem):
        return lasso_penalty(problem.columns)


@dataclass(frozen=True, eq=False)
class Plain:
    """The same without a penalty, with the certificate of a fixed point."""

    name: ClassVar[str] = "plain"
    certificate_kind: ClassVar[str] = "fixed_point"
    answer: Solution = dataclasses.field(default_factory=lambda: Solution(None))
    kept: int = 99

    def solve(self, problem):
        return self.answer

    def next_weights(self, problem, weights):
        return np.where(np.arange(weights.size).reshape(weights.shape) < self.kept, weights, 0.0)


@dataclass(frozen=True)
class WrongFastPath(Lasso):
    """Its fast path answers ``wrong`` instead of the solution; its referee is right."""

    wrong: str = "zeros"

    def solve_path(self, problem, alpha_fractions):
        zeros = np.zeros((problem.columns, problem.targets))
        answer = {
            "zeros": Solution(zeros, shared_seconds=7.0),
            "nan": Solution(zeros * np.nan),
            "none": Solution(None, "error", "gave up"),
            "failed zeros": Solution(zeros, "error", "gave up"),
        }[self.wrong]
        return (answer,) * len(alpha_fractions)

    def referee(self):
        return Lasso(self.alpha_fraction, solver="clarabel")


@dataclass(frozen=True)
class WrongReferee(Lasso):
    """Right at once, but asked for more than rounding allows; its referee knows nothing."""

    def referee(self):
        return WrongFastPath(self.alpha_fraction, solver="clarabel", wrong="none")


@pytest.mark.parametrize(
    ("solution", "reason"),
    [
        (Solution(None, "error", "out of memory"), "out of memory"),
        (Solution(None), "no finite weights"),
        (Solution(None, "inaccurate"), "no finite weights"),
        (Solution(NAN), "no finite weights"),
        (Solution(SOME_NAN), "no finite weights"),
        (Solution(SOME_NAN * np.inf), "no finite weights"),
        (Solution(ZERO, "error", "infeasible"), "infeasible"),
        (Solution(np.ones((12, 2)), "error", "infeasible"), "infeasible"),
    ],
)
@pytest.mark.parametrize("double", [Double, Plain])
def test_a_failed_solver_is_an_error_with_nan_weights_and_never_zeros(double, solution, reason):
    found = sf.fit(PROBLEM, double(answer=solution))
    assert found.status == "error"
    assert reason in found.reason
    assert found.weights.shape == (12, 2)
    assert np.isnan(found.weights).all()
    assert found.certificate is None
    assert found.support.size == 0


def test_the_certificate_and_not_the_solvers_word_decides():
    exact = backends.get("lasso", alpha_fraction=0.1).solve(PROBLEM).weights
    modest = Solution(exact, "inaccurate", "almost solved", "AlmostSolved")
    found = sf.fit(PROBLEM, Double(answer=modest))
    assert (found.status, found.solver_status) == ("ok", "AlmostSolved")
    for factor, least in ((1.01, 1e-8), (0.0, 0.1)):
        boastful = Solution(exact * factor, "ok", "", "Solved")
        found = sf.fit(PROBLEM, Double(answer=boastful))
        assert found.status == "inaccurate"
        assert found.certificate.value > least
        assert "duality_gap" in found.reason


def test_the_certificate_of_a_fixed_point_is_the_share_of_the_support_that_moves():
    weights = np.where(np.arange(24) < 5, 1e-12, 0.0).reshape(12, 2)
    for kept, share in ((4, 1 / 5), (0, 1.0), (5, 0.0)):
        found = sf.fit(PROBLEM, Plain(answer=Solution(weights), kept=kept))
        assert found.certificate.value == pytest.approx(share)
    large = sf.fit(PROBLEM, Plain(answer=Solution(1e12 * weights), kept=4))
    fitted = [np.linalg.norm(own) for own in (PROBLEM.theta[:, 2], PROBLEM.target)]
    assert large.certificate.value == pytest.approx(max(1 / 5, fitted[0] / fitted[1]))


def test_a_path_with_no_grid_given_has_thirty_points_down_to_a_thousandth():
    found = sf.path(PROBLEM, "lasso")
    assert found.alpha_fractions == pytest.approx(10.0 ** (-3 * np.arange(30) / 29), rel=1e-12)
    assert len(found.fits) == 30
    assert not found.fits[0].weights.any()


@pytest.mark.parametrize("wrong", ["zeros", "nan", "none", "failed zeros"])
def test_the_referee_repairs_a_wrong_fast_path(wrong):
    backend = WrongFastPath(0.1, wrong=wrong)
    found = sf.fit(PROBLEM, backend)
    assert (found.status, found.repaired) == ("ok", True)
    assert (found.seconds > 7.0) == (wrong == "zeros")  # of the fast path and of the referee
    assert found.backend is backend or found.backend == backend
    expected = sf.fit(PROBLEM, backends.get("lasso", alpha_fraction=0.1))
    assert found.weights == pytest.approx(expected.weights, abs=1e-4)
    along = sf.path(PROBLEM, backend, [0.5, 0.1])
    assert sum(fit.repaired for fit in along.fits) == 2
    assert [f.status for f in along.fits] == ["ok", "ok"]


def test_the_fast_path_stays_where_the_referee_is_no_better():
    found = sf.fit(PROBLEM, WrongReferee(0.1), tolerance=0.0)
    exact = backends.get("lasso", alpha_fraction=0.1).solve(PROBLEM).weights
    assert found.status in ("ok", "inaccurate")
    assert found.certificate.value <= 1e-12
    assert not found.repaired
    assert np.array_equal(found.weights, exact)


@pytest.mark.parametrize("name", ["lasso", "group-lasso"])
def test_a_path_is_its_points_where_weights_are_not_unique(name):
    problem = flight_problem()
    along = sf.path(problem, backends.get(name), FRACTIONS)
    for fraction, found in zip(FRACTIONS, along.fits, strict=True):
        point = sf.fit(problem, backends.get(name, alpha_fraction=fraction))
        assert found.backend == point.backend
        assert found.status == point.status == "ok"
        null = problem.null_objective
        assert found.certificate.primal == pytest.approx(point.certificate.primal, abs=1e-8 * null)


def test_a_path_of_repeated_fractions_or_of_one():
    along = sf.path(PROBLEM, backends.get("lasso"), [0.3, 0.3])
    assert along.weights[0] == pytest.approx(along.weights[1], rel=1e-12)
    assert sf.path(PROBLEM, backends.get("lasso"), 0.3).weights.shape == (1, 12, 2)
    assert along.gaps.shape == (2,)


def test_a_back_end_without_a_path_of_its_own_is_run_point_by_point():
    exact = backends.get("lasso", alpha_fraction=0.2).solve(PROBLEM)
    along = sf.path(PROBLEM, Double(answer=exact), [0.1, 0.2, 0.4])
    assert [f.status for f in along.fits] == ["inaccurate", "ok", "inaccurate"]
    assert [f.backend.alpha_fraction for f in along.fits] == [0.1, 0.2, 0.4]
    broken = sf.path(PROBLEM, Double(), [0.1, 0.2])
    assert np.isnan(broken.gaps).all()


@pytest.mark.parametrize("name", ["least-squares", "stlsq"])
def test_a_path_needs_a_penalty(name):
    with pytest.raises(InputError, match="no penalty"):
        sf.path(PROBLEM, backends.get(name), FRACTIONS)


@pytest.mark.parametrize("fractions", [[], [0.0], [-0.1], [1.1], [0.1, np.nan], [[0.1, 0.2]], "x"])
def test_bad_fractions_are_refused(fractions):
    with pytest.raises(InputError, match="alpha_fraction"):
        sf.path(PROBLEM, backends.get("lasso"), fractions)


@pytest.mark.parametrize("tolerance", [-1e-9, np.nan, np.inf, "1e-8", None, True])
def test_bad_tolerances_are_refused(tolerance):
    with pytest.raises(InputError, match="tolerance"):
        sf.fit(PROBLEM, backends.get("lasso"), tolerance=tolerance)


def test_what_is_not_a_problem_or_a_back_end_is_refused():
    with pytest.raises(InputError, match="RegressionProblem"):
        sf.fit(PROBLEM.theta, backends.get("lasso"))
    with pytest.raises(InputError, match=r"backends\.get"):
        sf.fit(PROBLEM, 3)
    with pytest.raises(InputError, match=r"not its class: Lasso\(\)"):
        sf.fit(PROBLEM, backends.load("lasso"))


@pytest.mark.parametrize("name", ["lasso", "group-lasso"])
@pytest.mark.parametrize("seed", range(3))
def test_a_tolerance_that_rounding_may_not_reach_keeps_the_best_weights(name, seed):
    problem = flight_problem(seed=seed, velocity_noise=0.3)
    found = sf.fit(problem, backends.get(name, alpha_fraction=0.01), tolerance=0.0)
    assert found.status == ("ok" if found.certificate.value == 0 else "inaccurate")
    assert ("above tolerance" in found.reason) == (found.status == "inaccurate")
    assert np.isfinite(found.weights).all()
    assert found.certificate.value <= 1e-9


def test_a_gap_that_rounding_may_hide_is_not_proven():
    theta = np.eye(6)[:, :3]  # a target exactly orthogonal to all columns: alpha_max is 0
    found = sf.fit(RegressionProblem.from_arrays(theta, np.eye(6)[5]), "lasso")
    assert found.certificate.value == 0.0
    assert found.certificate.bound > 0.5
    assert (found.status, found.repaired) == ("inaccurate", False)
    assert "more that rounding may hide, above tolerance" in found.reason


@pytest.mark.parametrize("level", [0.0, 7.0])
@pytest.mark.parametrize("outlier", [3.0, 1e3, 1e7])
def test_one_gross_outlier_does_not_move_the_weights_of_hubers_loss(outlier, level):
    theta = regular(targets=1).theta[:, :4]
    target = theta @ [1.0, -2.0, 0.0, 0.5] + level
    target[7] += outlier * np.abs(target).max()
    settings = {"names": list("abcd"), "intercept": level > 0}
    for fraction in (1e-3, "auto"):
        fit = sf.fit(theta, target, "huber-lasso", alpha_fraction=fraction, **settings)
        assert fit.status == "ok"
        np.testing.assert_allclose(fit.weights.ravel(), [1.0, -2.0, 0.0, 0.5], atol=0.1)
        assert fit.intercept == pytest.approx([level], abs=0.15)
        if outlier == 3.0 and fraction == 1e-3:
            referee = dataclasses.replace(fit.backend, solver="clarabel")
            np.testing.assert_allclose(sf.fit(fit.problem, referee).weights, fit.weights, atol=1e-4)


@pytest.mark.parametrize("intercept", [False, True])
def test_samples_of_hubers_loss_count_by_their_weights(intercept):
    rng, count = np.random.default_rng(1), np.arange(40) % 3
    theta = rng.normal(size=(40, 4))
    target = theta @ [1.0, -2.0, 0.0, 0.5] + rng.standard_t(1.5, size=40)
    settings = {"alpha_fraction": 0.05, "names": list("abcd"), "intercept": intercept}
    fit = sf.fit(theta, target, "huber-lasso", sample_weight=count, **settings)
    again = sf.fit(*(np.repeat(rows, count, axis=0) for rows in (theta, target)), fit.backend,
                   names=list("abcd"), intercept=intercept)  # fmt: skip
    assert fit.status == again.status == "ok"
    np.testing.assert_allclose(fit.weights, again.weights, atol=1e-8)
    np.testing.assert_allclose(fit.intercept, again.intercept, atol=1e-8)


@pytest.mark.parametrize(("rows", "columns"), [(20_001, 3), (60, 300)])
def test_hubers_loss_takes_many_rows_or_columns(rows, columns):
    rng = np.random.default_rng(0)
    theta = rng.normal(size=(rows, columns))
    target = theta[:, :2] @ [1.0, -2.0] + 0.1 * rng.standard_t(1.5, size=rows)
    fit = sf.fit(theta, target, "huber-lasso", alpha_fraction=0.02)
    assert (fit.status, fit.repaired) == ("ok", False)
    np.testing.assert_allclose(fit.weights[:2, 0], [1.0, -2.0], atol=0.3)


@pytest.mark.parametrize("intercept", [False, True])
def test_hubers_loss_without_outliers_is_that_of_squares(intercept):
    rng, fractions = np.random.default_rng(2), np.geomspace(1.0, 1e-3, 12)
    theta, settings = rng.normal(size=(60, 80)), {"intercept": intercept}
    target = theta[:, :2] @ [1.0, -2.0] + 0.01 * rng.normal(size=60) + 3.0 * intercept
    problem = RegressionProblem.from_arrays(theta, target, **settings)
    path = sf.path(problem, backends.get("huber-lasso"), fractions)
    assert all(fit.status == "ok" and not fit.repaired for fit in path.fits)
    squares = sf.path(problem, backends.get("lasso"), (1.0,)).alpha_max
    lasso = sf.path(problem, backends.get("lasso"), fractions[-4:] * path.alpha_max / squares)
    np.testing.assert_allclose(path.weights[-4:], lasso.weights, atol=1e-7)


def test_the_size_of_a_target_that_is_mostly_zero_is_its_rms():
    loss, target = Squares(clip=2.0), np.zeros((8, 2))
    target[0] = 4.0, 0.0
    assert loss.bound(target).tolist() == [[2.0 * 2.0**0.5, 2.0]]
    assert loss.bound(np.arange(-2.0, 3.0)[:, None]) == pytest.approx(2.0 * 1.4826)
    equal = np.ones(5) / 5**0.5  # four rows differ by their last digit only
    target = np.array([[1.0], [1.0 + 2e-16], [1.0 - 1e-16], [1.0 + 2e-16], [2.0]])
    assert Squares(clip=2.0, direction=equal).bound(target) == pytest.approx(2.0 * 0.2**0.5)
