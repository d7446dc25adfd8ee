"""Elastic net and ridge against scikit-learn, augmented rows and hand values."""

import numpy as np
import pytest
import sklearn.linear_model as peers
from hypothesis import given, settings
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues, alpha_max
from sparsefit.regression.problem import RegressionProblem
from tests.problems import regular


@pytest.mark.parametrize("fraction", [0.5, 0.05])
@pytest.mark.parametrize("ratio", [0.9, 0.2])
def test_scikit_learns_elastic_net_agrees(ratio, fraction):
    problem = regular(4)
    s = problem.statistics
    unit = float(np.sqrt(s.target_square.mean()))
    backend = backends.get("elastic-net", alpha_fraction=fraction, l1_ratio=ratio)
    alpha = fraction * alpha_max(s.cross, backend.penalty(problem))
    peer = peers.ElasticNet(
        alpha / unit, l1_ratio=ratio, fit_intercept=False, tol=1e-12, max_iter=100_000
    )
    expected = peer.fit(problem.theta / s.rms, problem.target / unit).coef_.T * unit
    found = sf.fit(problem, backend)
    assert found.status == "ok"
    assert found.weights * s.rms[:, None] == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("fraction", [1.0, 1e-3, 1e-6])
def test_scikit_learns_ridge_agrees(fraction):
    problem = regular(5)
    rms, m, k = problem.statistics.rms, problem.samples, problem.columns
    peer = peers.Ridge(fraction * k * m, fit_intercept=False, solver="svd")
    expected = peer.fit(problem.theta / rms, problem.target).coef_.T
    found = sf.fit(problem, backends.get("ridge", alpha_fraction=fraction))
    assert found.status == "ok"
    assert found.weights * rms[:, None] == pytest.approx(expected, rel=1e-9)


def test_a_ridge_that_rounds_away_is_least_squares():
    found = sf.fit(regular(), backends.get("ridge", alpha_fraction=1e-300))
    assert found.status == "inaccurate" or found.certificate.bound <= 1e-8
    least = sf.fit(regular(), "least-squares").weights
    np.testing.assert_allclose(found.weights, least, atol=1e-12)


@given(seed=st.integers(0, 10**6), ratio=st.floats(0.05, 1.0), size=st.floats(0.0, 2.0))
@settings(max_examples=12)
def test_the_certificate_is_that_of_the_lasso_on_the_rows_of_the_ridge(seed, ratio, size):
    """k more rows sqrt(m mu) I with targets of zero, whatever the weights."""
    problem, rng = regular(seed), np.random.default_rng(seed)
    s, backend = problem.statistics, backends.get("elastic-net", l1_ratio=ratio)
    penalty, m, k = backend.penalty(problem), problem.samples, problem.columns
    alpha = 0.1 * alpha_max(s.cross, penalty)
    exact = sf.fit(problem, backend)

    weights = exact.weights + size * rng.normal(size=exact.weights.shape) / s.rms[:, None]
    lift = np.diag(np.sqrt(m * alpha * penalty.ridge) * s.rms)
    design = Design(np.vstack([problem.theta, lift]), m)
    target = np.vstack([problem.target, np.zeros((k, 2))])
    norms = AbsoluteValues(s.rms / design.rms)  # in columns of the unit that these rows have
    (expected,) = duality_gaps(design, target, weights[None], np.array([alpha * ratio]), norms)
    (found,) = duality_gaps(
        problem.design, problem.target, weights[None], np.array([alpha]), penalty
    )
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
