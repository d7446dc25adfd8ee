"""The LASSO against scikit-learn and Clarabel, on flights and on degenerate problems."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.linear_model import Lasso

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.penalties import alpha_max, lasso_penalty
from tests.problems import flight_problem, regular


def primal(problem, weights, fraction):
    s = problem.statistics
    alpha = fraction * alpha_max(s.cross, lasso_penalty(problem.columns))
    residual = problem.target - problem.theta @ weights
    size = np.abs(weights * s.rms[:, None]).sum()
    return np.sum(residual**2) / (2 * problem.samples) + alpha * size, alpha


@pytest.mark.filterwarnings("ignore::sklearn.exceptions.ConvergenceWarning")
@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("fraction", [0.3, 0.1, 0.03])
@pytest.mark.parametrize("length_scale", [4.0, 2.6])
def test_coordinate_descent_agrees_on_flights(length_scale, fraction, noise):
    problem = flight_problem(length_scale, velocity_noise=noise)
    found = sf.fit(problem, backends.get("lasso", alpha_fraction=fraction))
    null, rms = problem.statistics.null_objective, problem.statistics.rms
    least, alpha = primal(problem, found.weights, fraction)
    peer = Lasso(alpha=alpha, fit_intercept=False, tol=1e-7, max_iter=20_000)
    weights = peer.fit(problem.theta / rms, problem.target).coef_.T / rms[:, None]
    other = primal(problem, weights, fraction)[0]
    assert (found.status, found.repaired) == ("ok", False)
    assert least <= other + 1e-12 * null
    assert other - least <= 1e-6 * null


@given(seed=st.integers(0, 10**6), fraction=st.floats(1e-6, 1.0))
@settings(max_examples=100)
def test_every_fit_is_certified_and_keeps_the_optimality_conditions(seed, fraction):
    problem = regular(seed, samples=20 + seed % 30)
    found = sf.fit(problem, backends.get("lasso", alpha_fraction=fraction))
    assert (found.status, found.repaired) == ("ok", False)
    s = problem.statistics
    alpha = fraction * alpha_max(s.cross, lasso_penalty(12))
    residual = problem.target - problem.theta @ found.weights
    correlation = problem.theta.T @ residual / (s.rms[:, None] * s.samples)
    assert np.abs(correlation).max() <= alpha * (1 + 1e-6)
    on = found.weights != 0
    assert correlation[on] == pytest.approx(alpha * np.sign(found.weights[on]), rel=1e-6)
