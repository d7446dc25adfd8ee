"""Back-ends of a penalty against scikit-learn, cvxpy, augmented rows and values by hand."""

import dataclasses
from dataclasses import dataclass, replace
from typing import ClassVar

import cvxpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.optimize import lsq_linear

import sparsefit as sf
from sparsefit import backends
from sparsefit.penalties import Penalty
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, alpha_max
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.penalised import PenalisedPath
from tests.problems import DEGENERATE_KINDS, degenerate, flight_problem, orthonormal, regular


def test_the_weights_are_worked_by_hand_on_orthonormal_columns():
    # The first fit is C / (1 + ridge): its ratios are those of C, whatever the ridge.
    problem = orthonormal(2)
    cross = problem.cross
    rows = np.linalg.norm(cross, axis=1)
    penalty = backends.get("adaptive-lasso", power=2.0).penalty(problem)
    assert penalty.weights == pytest.approx((rows / rows.max()) ** -2.0, rel=1e-9)
    blocks = np.array([np.linalg.norm(cross[:3]), np.linalg.norm(cross[3:])])
    backend = backends.get("adaptive-group-lasso", group_weights="sqrt-size", pilot_ridge=1.0)
    expected = np.sqrt(3) * blocks.max() / blocks
    assert backend.penalty(problem).weights == pytest.approx(expected, rel=1e-9)
    problem = regular(3)  # of correlated columns, by a ridge of 0.05
    ridge = np.linalg.solve(problem.design.gram + 0.05 * np.eye(12), problem.cross)
    sizes = np.linalg.norm(ridge, axis=1)
    omega = np.maximum(sizes / sizes.max(), 1e-3) ** -1.0
    assert backends.get("adaptive-lasso").penalty(problem).weights == pytest.approx(omega, rel=1e-9)


def test_a_first_ridge_that_rounding_loses_is_the_least_squares_of_least_norm():
    theta = np.random.default_rng(0).normal(size=(30, 4))
    problem = RegressionProblem.from_arrays(theta[:, [0, 1, 2, 3, 0]], theta @ [1.0, 0.3, 0.1, 0.0])
    lost, small = (
        backends.get("adaptive-lasso", pilot_ridge=ridge).penalty(problem).weights
        for ridge in (1e-30, 1e-9)
    )
    assert lost[:3] == pytest.approx(small[:3], rel=1e-5)
    assert lost[0] < 0.5 * lost[2]


@pytest.mark.parametrize("separate", [True, False])
def test_a_fit_names_the_kernel_that_ran(monkeypatch, separate):
    problem, backend = regular(3), backends.get("group-lasso", separate=separate)
    usual = sf.path(problem, backend).fits[15]
    assert usual.solver_status == "variational, all columns"
    monkeypatch.setattr("sparsefit.solvers.kernels.compiled", lambda name: None)
    found = sf.path(problem, backend).fits[15]
    assert found.solver_status == "newton, all columns"
    assert found.weights == pytest.approx(usual.weights, rel=1e-5, abs=1e-7)


@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize("fraction", [1.0, 0.6, 0.3, 0.1, 1e-3])
@pytest.mark.parametrize("group_weights", ["unit", "sqrt-size"])
def test_a_point_on_the_groups_that_pull_is_the_point_on_all(separate, fraction, group_weights):
    """The Gram matrix is not formed for one point alone."""
    alone, whole = regular(groups=40, samples=400), regular(groups=40, samples=400)
    setting = {"separate": separate, "group_weights": group_weights}
    backend = backends.get("group-lasso", alpha_fraction=fraction, **setting)
    few = sf.fit(alone, backend)
    assert few.status == "ok"
    assert "gram" not in vars(alone.design)
    assert whole.design.gram.shape == (120, 120)
    every = sf.fit(whole, backend)
    np.testing.assert_allclose(few.weights, every.weights, rtol=1e-9, atol=1e-12)
    assert few.certificate.value < 1e-10


UNEQUAL = [0, 1, 1, 2, 2, 2, 3, 3, 3, 3, 3, 3]
WAVES = [0, 1, 1, 2, 2, 3, 4, 4, 5, 5, 6, 6]  # within the groups above


def nested(seed=2, subgroups=WAVES):
    plain = regular(seed)
    return RegressionProblem.from_arrays(plain.theta, plain.target, UNEQUAL, subgroups=subgroups)


@pytest.mark.parametrize(("ratio", "subgroups"), [(0.0, None), (0.3, None), (0.3, WAVES)])
@pytest.mark.parametrize("separate", [True, False])
def test_a_naive_model_of_the_rows_agrees(separate, ratio, subgroups):
    problem = nested(subgroups=subgroups)
    rms = np.sqrt(np.mean(problem.theta**2, axis=0))
    z, y, m = problem.theta / rms, problem.target, problem.samples
    own = {"separate": separate, "group_weights": "sqrt-size"}
    backend = backends.get("sparse-group-lasso", l1_ratio=ratio, **own)
    alpha = 0.15 * alpha_max(problem.cross, backend.penalty(problem))
    v, size = cvxpy.Variable((12, 2)), 0.0
    for part in ([0], [1]) if separate else ([0, 1],):
        for g in range(4):
            on = np.flatnonzero(np.array(UNEQUAL) == g)
            size += (1 - ratio) * len(on) ** 0.5 * cvxpy.norm(cvxpy.vec(v[on][:, part], order="F"))
        for h in range(7 if subgroups else 0):
            on = np.flatnonzero(np.array(WAVES) == h)
            size += ratio * cvxpy.norm(cvxpy.vec(v[on][:, part], order="F"))
    if subgroups is None:
        size += ratio * cvxpy.sum(cvxpy.abs(v))
    model = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(y - z @ v) / (2 * m) + alpha * size))
    model.solve(solver="CLARABEL", tol_gap_abs=1e-11, tol_gap_rel=1e-11)
    found = sf.fit(problem, dataclasses.replace(backend, alpha_fraction=0.15))
    assert (found.status, found.repaired) == ("ok", False)
    assert found.certificate.primal == pytest.approx(model.value, rel=1e-8)
    assert found.weights * rms[:, None] == pytest.approx(v.value, abs=1e-4)
    other = sf.fit(problem, dataclasses.replace(found.backend, solver="clarabel"))
    assert other.status == "ok", other.reason
    assert other.certificate.primal == pytest.approx(found.certificate.primal, rel=1e-8)


def test_a_path_that_is_cut_short_is_reported_as_incomplete(monkeypatch):
    monkeypatch.setattr("sparsefit.solvers.newton.OUTER", 1)
    problem = nested()
    backend = backends.get("sparse-group-lasso")
    assert backend.solve(problem).status == "inaccurate"
    found = sf.fit(problem, backend)  # the referee repairs it
    assert (found.status, found.repaired) == ("ok", True)


@given(seed=st.integers(0, 10**6), ratio=st.floats(0.05, 1.0), size=st.floats(0.0, 2.0))
@settings(max_examples=12)
def test_the_certificate_is_that_of_the_lasso_on_the_rows_of_the_ridge(seed, ratio, size):
    """k more rows sqrt(m mu) I with targets of zero, whatever the weights."""
    problem, rng = regular(seed), np.random.default_rng(seed)
    backend = backends.get("elastic-net", l1_ratio=ratio)
    penalty, m, k = backend.penalty(problem), problem.samples, problem.columns
    alpha = 0.1 * alpha_max(problem.cross, penalty)
    assert penalty.ridge == pytest.approx((1.0 - ratio) / np.sqrt(problem.target_square.mean()))
    exact = sf.fit(problem, backend)
    rms = problem.design.rms
    weights = exact.weights + size * rng.normal(size=exact.weights.shape) / rms[:, None]
    lift = np.diag(np.sqrt(m * alpha * penalty.ridge) * rms)
    design = Design(np.vstack([problem.theta, lift]), m)
    target = np.vstack([problem.target, np.zeros((k, 2))])
    norms = AbsoluteValues(rms / design.rms)  # in columns of the unit that these rows have
    (expected,) = duality_gaps(design, target, weights[None], np.array([alpha * ratio]), norms)
    values, alphas = weights[None], np.array([alpha])
    (found,) = duality_gaps(problem.design, problem.target, values, alphas, penalty)
    assert found.primal == pytest.approx(expected.primal, rel=1e-12)
    assert found.dual == pytest.approx(expected.dual, rel=1e-10)
    assert found.value == pytest.approx(expected.value, rel=1e-9, abs=1e-12)


def test_a_ridges_gap_by_hand():
    # Z = (1, 1), y = (3, 1): G = 1, c = 2, y^2/m = 5. alpha = fraction * k = 1/2, v = 1 in place of
    # c/(1 + alpha) = 4/3: P = (5 - 2*2 + 1)/2 + 1/4 = 5/4. C = 1, r = 2, q = 3, F = C/alpha = 2,
    # r' = 2 + 4/2 = 4, s = 3/4, D = 9/4 - 9/8 = 9/8: the gap is 1/8 over 5/2.
    problem = RegressionProblem.from_arrays(np.ones((2, 1)), [3.0, 1.0])
    penalty = backends.get("ridge").penalty(problem)
    weights, alpha = np.ones((1, 1, 1)), np.array([0.5])
    (gap,) = duality_gaps(problem.design, problem.target, weights, alpha, penalty)
    assert (gap.primal, gap.dual) == pytest.approx((1.25, 1.125))
    assert gap.value == pytest.approx(0.05)
    found = sf.fit(problem, backends.get("ridge", alpha_fraction=0.5))
    assert found.weights.item() == pytest.approx(4 / 3)


DRAW = np.random.default_rng(0)
THETA = DRAW.normal(size=(60, 12)) * np.geomspace(0.1, 10.0, 12)
TARGET = THETA @ DRAW.normal(size=(12, 2)) + 0.1 * DRAW.normal(size=(60, 2))
PROBLEM = sf.RegressionProblem.from_arrays(THETA, TARGET)


@pytest.mark.parametrize(("lower", "upper"), [(-0.1, 0.2), (0.0, 0.3), (None, 0.1)])
def test_bounds_that_bind_are_certified_and_agree_with_scipy(lower, upper):
    backend = backends.get("box-lasso", lower=lower, upper=upper)
    path = sf.path(PROBLEM, backend, [1.0, 0.3, 0.03, 1e-9])
    assert all(fit.status == "ok" for fit in path.fits)
    assert not any(fit.repaired for fit in path.fits)
    bounds = (-np.inf if lower is None else lower, upper)
    for weights, target in zip(path.weights[-1].T, TARGET.T, strict=True):
        expected = lsq_linear(THETA, target, bounds, method="bvls", tol=1e-14).x
        assert weights == pytest.approx(expected, abs=1e-6)
        assert (weights == upper).sum() >= 2


def test_columns_that_are_all_against_the_target_leave_positive_weights_at_zero():
    fit = sf.fit(np.abs(THETA), -np.ones(len(THETA)), "lasso", positive=True)
    assert (fit.status, fit.alpha, fit.weights.any()) == ("ok", 0.0, False)


def test_bounds_are_certified_on_more_columns_than_samples():
    theta, target = DRAW.normal(size=(30, 700)), DRAW.normal(size=(30, 1))
    problem = sf.RegressionProblem.from_arrays(theta, target)
    backend = backends.get("box-lasso", lower=-0.02, upper=0.03, alpha_fraction=0.1)
    found = sf.fit(problem, backend)
    assert found.status == "ok"
    assert -0.02 <= found.weights.min() < found.weights.max() == 0.03  # to the last digit


@dataclass(frozen=True, eq=False)
class Share(Penalty):
    """|V|_1 where -2 <= V/b <= 1, infinite elsewhere."""

    count: int
    bound: float = 0.25

    @property
    def columns(self):
        return self.count

    def norm(self, values):
        within = (np.abs(values + self.bound / 2) <= 1.5001 * self.bound).all(axis=(-2, -1))
        return np.where(within, np.abs(values).sum(axis=(-2, -1)), np.inf)

    def dual_norm(self, values):
        return np.abs(values).max(axis=-2)

    def conjugate(self, values, alpha):
        gain = np.maximum(values - alpha, np.maximum(-2 * (values + alpha), 0))
        return self.bound * gain.sum(axis=-2)

    def in_units(self, level):
        return replace(self, bound=self.bound / level)

    def prox(self, values, step):
        shrunk = np.sign(values) * np.maximum(np.abs(values) - step, 0)
        return np.clip(shrunk, -2 * self.bound, self.bound)


@dataclass(frozen=True)
class Shares(PenalisedPath):
    name: ClassVar[str] = "shares"

    def penalty(self, problem):
        return Share(problem.columns)


@pytest.mark.parametrize("name", ["box-lasso", "square-root-lasso"])
def test_columns_that_are_alike_are_certified(name):
    rng, settings = np.random.default_rng(4 if name == "box-lasso" else 2), {}
    if name == "box-lasso":
        theta, settings = rng.normal(size=(30, 14)) + 1e6, {"lower": -100.0, "upper": 100.0}
    else:
        theta = np.hstack([rng.normal(size=(49, 10))] * 2)
        theta[:, 10:] *= 1.0 + 1e-9 * rng.normal(size=(49, 10))
    target = theta[:, :3] @ [1.0, -2.0, 0.5] / np.abs(theta).max() + rng.normal(size=len(theta))
    path = sf.path(theta, target, name, [0.3, 0.1, 0.03, 0.01], **settings)
    assert [fit.status for fit in path.fits] == ["ok"] * 4


def test_a_users_box_is_certified_by_its_conjugate():
    unit = THETA / PROBLEM.design.rms
    problem = sf.RegressionProblem.from_arrays(unit, unit @ DRAW.normal(size=(12, 2)))
    fractions = [0.5, 0.1, 1e-3]
    assert not Share(12).constraint(np.ones((3, 12, 2))).any()
    assert Share(12).constraint(np.ones((3, 12, 2))).shape == (3, 2)
    path = sf.path(problem, Shares(), fractions)
    assert all(fit.status == "ok" for fit in path.fits)
    ours = sf.path(problem, backends.get("box-lasso", lower=-0.5, upper=0.25), fractions)
    assert path.weights == pytest.approx(ours.weights, abs=1e-8)
    assert np.isclose(path.weights[-1], 0.25, rtol=1e-12).any()


def test_bounds_that_do_not_bind_beside_some_that_do_cost_no_certificate():
    """In columns of units far apart the bounds are, too; each is where C meets alpha or is not."""
    theta = THETA * np.geomspace(1e-6, 1e6, 12)
    problem = sf.RegressionProblem.from_arrays(theta, TARGET)
    path = sf.path(problem, backends.get("box-lasso", lower=-2.0, upper=1e3), [0.5, 0.03, 1e-3])
    assert all(fit.status == "ok" for fit in path.fits)
    assert 0 < (path.weights[-1] == -2.0).sum() + (path.weights[-1] == 1e3).sum() < 12


def fitted(problem, fraction=0.1, **more):
    return sf.fit(problem, backends.get("square-root-lasso", alpha_fraction=fraction, **more))


def test_a_solution_is_one_of_the_lasso_at_the_penalty_that_its_residual_sets():
    problem = flight_problem(velocity_noise=0.3)
    found = fitted(problem, 0.05)
    residual = problem.target - problem.theta @ found.weights
    fraction = 0.05 * np.linalg.norm(residual) / np.linalg.norm(problem.target)
    lasso = sf.fit(problem, backends.get("lasso", alpha_fraction=fraction))
    assert found.weights == pytest.approx(lasso.weights, abs=1e-9 * np.abs(lasso.weights).max())


@pytest.mark.parametrize("kind", DEGENERATE_KINDS)
def test_degenerate_problems_have_certificates_that_are_proven_bounds(kind):
    problem = degenerate(kind, 2)
    backend = backends.get("square-root-lasso")
    along = sf.path(problem, backend, [0.7, 0.1, 0.01, 0.001])
    assert along.gaps.max() < 1e-9
    assert all(fit.certificate.bound <= 1e-8 for fit in along.fits)
    for fit in along.fits:
        residual = problem.target - problem.theta @ fit.weights
        size = np.abs(fit.weights * problem.design.rms[:, None]).sum()
        loss = np.linalg.norm(problem.target) * np.linalg.norm(residual) / problem.samples
        assert fit.certificate.primal == pytest.approx(loss + fit.alpha * size, rel=1e-9)


def test_the_gap_sees_what_is_not_optimal():
    problem = regular(5)
    found = fitted(problem)
    penalty = found.backend.penalty(problem)
    alpha = 0.1 * alpha_max(problem.cross, penalty)
    least = found.certificate.primal
    for factor in (0.0, 0.9, 1.01):
        weights, alphas = factor * found.weights[None], np.array([alpha])
        (moved,) = duality_gaps(problem.design, problem.target, weights, alphas, penalty)
        assert moved.value >= (moved.primal - least) / problem.target_square.sum() - 1e-12
        assert moved.value > 1e-5


def test_few_rows_are_fitted_nearly_or_exactly_by_the_root_of_the_path():
    for seed in (5, 11, 19, 50):  # slopes at bends of the residual's rms lead below the root
        rng = np.random.default_rng(seed)
        theta = rng.normal(size=(12, 60)) + 3.0 * rng.normal(size=(12, 1))
        target = theta[:, :3].sum(axis=1) + 0.01 * rng.normal(size=12)
        for fit in sf.path(theta, target, "square-root-lasso", [0.3, 0.2, 0.1, 0.05]).fits:
            assert (fit.status, fit.reason, fit.repaired) == ("ok", "", False)
            assert fitted(fit.problem, fit.alpha_fraction, solver="clarabel").status == "ok"


def test_sparse_columns_that_descend_are_not_taken_to_an_exact_fit(monkeypatch):
    rng = np.random.default_rng(2)
    theta = sparse.random_array((30, 80), density=0.2, rng=rng, format="csc")
    target = theta @ (np.arange(80) < 3) + 0.01 * rng.normal(size=30)
    problem = RegressionProblem.from_arrays(theta + 0.1 * sparse.eye_array(30, 80), target)
    backend = backends.get("square-root-lasso")
    exact = sf.path(problem, backend, (0.5, 1e-4))
    assert [fit.status for fit in exact.fits] == ["ok", "ok"]
    monkeypatch.setattr("sparsefit.solvers.exact.FEW", 20)
    first, last = backend.solve_path(problem, (0.5, 1e-4))
    assert (first.status, last.status) == ("ok", "inaccurate")
    assert "descent" in first.solver_status
    np.testing.assert_allclose(first.weights, exact.fits[0].weights, atol=1e-7)


@given(seed=st.integers(0, 10**6), fraction=st.floats(0.01, 1.0), gamma=st.floats(1.5, 10.0))
@settings(max_examples=12)
def test_every_answer_is_stationary(seed, fraction, gamma):
    """C_g = (alpha omega_g - |V_g|/gamma)_+ V_g/|V_g|, and |C_g| <= alpha omega_g at zero."""
    problem = regular(seed)
    backend = backends.get("group-mcp", alpha_fraction=fraction, gamma=gamma)
    found = sf.fit(problem, backend)
    assert found.status == "ok"
    assert found.certificate.value < 1e-9
    values = found.weights * problem.design.rms[:, None]
    alpha = fraction * alpha_max(problem.cross, backend.penalty(problem))
    slope = problem.cross - problem.design.gram @ values
    for g in range(4):
        on = problem.groups == g
        norm = np.linalg.norm(values[on])
        if norm == 0:
            assert np.linalg.norm(slope[on]) <= alpha * (1 + 1e-6)
        else:
            pull = max(alpha - norm / gamma, 0.0) * values[on] / norm
            assert slope[on] == pytest.approx(pull, abs=1e-4 * alpha)


@pytest.mark.parametrize("kind", DEGENERATE_KINDS)
def test_degenerate_problems_end_at_a_fixed_point(kind):
    along = sf.path(degenerate(kind, 2), backends.get("group-mcp"), [1.0, 0.3, 0.05])
    assert [fit.status for fit in along.fits] == ["ok"] * 3
    assert not along.fits[0].weights.any()


def test_weights_that_still_move_are_inaccurate():
    crawling = backends.get("group-mcp", alpha_fraction=0.99, gamma=1.0001)
    column = np.linspace(1.0, 3.0, 20)
    found = sf.fit(RegressionProblem.from_arrays(column[:, None], column), crawling)
    assert found.certificate.value > 1e-8
    assert (found.status, found.solver_status) == ("inaccurate", "still moving")
    assert "still move after 100 approximations" in found.reason
