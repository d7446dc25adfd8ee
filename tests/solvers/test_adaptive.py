"""The adaptive LASSOs: their weights by hand, and scikit-learn on scaled columns."""

import numpy as np
import pytest
import sklearn.linear_model as peers

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from tests.problems import orthonormal, regular

PLAIN = {"adaptive-lasso": "lasso", "adaptive-group-lasso": "group-lasso"}


def test_the_weights_are_worked_by_hand_on_orthonormal_columns():
    # The first fit is C / (1 + ridge): its ratios are those of C, whatever the ridge.
    problem = orthonormal(2)
    cross = problem.statistics.cross
    rows = np.linalg.norm(cross, axis=1)
    penalty = backends.get("adaptive-lasso", power=2.0).penalty(problem)
    assert penalty.weights == pytest.approx((rows / rows.max()) ** -2.0, rel=1e-9)
    blocks = np.array([np.linalg.norm(cross[:3]), np.linalg.norm(cross[3:])])
    backend = backends.get("adaptive-group-lasso", group_weights="sqrt-size", pilot_ridge=1.0)
    expected = np.sqrt(3) * blocks.max() / blocks
    assert backend.penalty(problem).weights == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("target", [0, 1])
def test_scikit_learn_agrees_on_columns_divided_by_the_weights(target):
    problem, s = regular(3), regular(3).statistics
    backend = backends.get("adaptive-lasso", alpha_fraction=0.05)
    penalty = backend.penalty(problem)
    first = np.linalg.solve(s.gram + 0.05 * np.eye(12), s.cross)
    sizes = np.linalg.norm(first, axis=1)
    omega = np.maximum(sizes / sizes.max(), 1e-3) ** -1.0
    assert penalty.weights == pytest.approx(omega, rel=1e-9)
    alpha = 0.05 * (np.abs(s.cross) / omega[:, None]).max()
    assert alpha == pytest.approx(0.05 * alpha_max(s.cross, penalty), rel=1e-9)
    peer = peers.Lasso(alpha, fit_intercept=False, tol=1e-13, max_iter=100_000)
    scaled = peer.fit(problem.theta / s.rms / omega, problem.target[:, target]).coef_ / omega
    found = sf.fit(problem, backend)
    assert found.status == "ok"
    assert (found.weights * s.rms[:, None])[:, target] == pytest.approx(scaled, abs=1e-7)


@pytest.mark.parametrize("name", PLAIN)
def test_it_leaves_out_noise_that_the_plain_one_takes_in(name):
    problem = regular(4)
    fits = [sf.fit(problem, backends.get(one, alpha_fraction=0.01)) for one in (name, PLAIN[name])]
    adaptive, plain = (set(fit.support) for fit in fits)
    assert {0, 1, 2} <= adaptive < plain


def test_a_first_ridge_that_rounding_loses_is_the_least_squares_of_least_norm():
    theta = np.random.default_rng(0).normal(size=(30, 4))
    problem = RegressionProblem.from_arrays(theta[:, [0, 1, 2, 3, 0]], theta @ [1.0, 0.3, 0.1, 0.0])
    lost, small = (
        backends.get("adaptive-lasso", pilot_ridge=ridge).penalty(problem).weights
        for ridge in (1e-30, 1e-9)
    )
    assert lost[:3] == pytest.approx(small[:3], rel=1e-5)
    assert lost[0] < 0.5 * lost[2]
