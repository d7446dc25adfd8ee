"""The group-LASSO against celer, and its two ways to solve."""

import numpy as np
import pytest
from celer import GroupLasso
from hypothesis import given, settings
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from tests.problems import flight_problem, regular


def single(problem, target=0):
    return RegressionProblem.from_arrays(problem.theta, problem.target[:, [target]], problem.groups)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("fraction", [0.5, 0.2, 0.1])
@pytest.mark.parametrize("target", [0, 1])
@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_celer_agrees_on_flights(noise, target, fraction):
    problem = single(flight_problem(velocity_noise=noise), target)
    backend = backends.get("group-lasso", alpha_fraction=fraction)
    found = sf.fit(problem, backend)
    s, null = problem.statistics, problem.statistics.null_objective
    penalty = backend.penalty(problem)
    alpha = fraction * alpha_max(s.cross, penalty)
    z, y = problem.theta / s.rms, problem.target[:, 0]
    groups = [np.flatnonzero(problem.groups == g).tolist() for g in range(len(penalty.weights))]
    peer = GroupLasso(groups, alpha=alpha, fit_intercept=False, tol=1e-9, max_iter=200)
    scaled = peer.fit(np.asfortranarray(z), y).coef_
    other = np.sum((y - z @ scaled) ** 2) / (2 * len(y)) + alpha * penalty.norm(scaled[:, None])
    assert (found.status, found.repaired) == ("ok", False)
    assert found.certificate.primal <= other + 1e-12 * null
    assert other - found.certificate.primal <= 1e-6 * null


@given(seed=st.integers(0, 10**6), fraction=st.floats(1e-4, 1.0), separate=st.booleans())
@settings(max_examples=80)
def test_every_fit_is_certified_and_whole_groups_are_in_or_out(seed, fraction, separate):
    problem = regular(seed, samples=20 + seed % 30)
    backend = backends.get("group-lasso", alpha_fraction=fraction, separate=separate)
    found = sf.fit(problem, backend)
    assert (found.status, found.repaired) == ("ok", False)
    on = (found.weights != 0).reshape(4, 3, 2)
    within = (1,) if separate else (1, 2)
    assert np.array_equal(on.any(axis=within), on.all(axis=within))


def test_separate_is_one_problem_per_target_at_a_common_penalty():
    problem = regular(6)
    backend = backends.get("group-lasso", alpha_fraction=0.2, separate=True)
    together = backend.solve(problem).weights
    top = alpha_max(problem.statistics.cross, backend.penalty(problem))
    for t in range(2):
        alone = single(problem, t)
        own = alpha_max(alone.statistics.cross, backend.penalty(alone))
        one = backends.get("group-lasso", alpha_fraction=0.2 * top / own).solve(alone)
        assert together[:, [t]] == pytest.approx(one.weights, abs=1e-5)


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
    assert not alone.design.formed
    assert whole.statistics.gram.shape == (120, 120)
    every = sf.fit(whole, backend)
    np.testing.assert_allclose(few.weights, every.weights, rtol=1e-9, atol=1e-12)
    assert few.certificate.value < 1e-10
