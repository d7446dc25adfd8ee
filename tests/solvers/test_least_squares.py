"""Least squares against numpy's, with and without a truncated spectrum."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.problem import RegressionProblem
from tests.problems import flight_problem, regular


def fitted(problem, rcond=None, tolerance=1e-8):
    return sf.fit(problem, backends.get("least-squares", rcond=rcond), tolerance=tolerance)


@given(st.integers(0, 10_000))
@settings(max_examples=40)
def test_full_rank_agrees_with_numpy(seed):
    problem = regular(seed)
    expected = np.linalg.lstsq(problem.theta, problem.target, rcond=None)[0]
    found = fitted(problem)
    assert found.weights == pytest.approx(expected, rel=1e-9, abs=1e-11)
    assert (found.status, found.solver_status) == ("ok", "rank 12")
    assert found.certificate.value <= 1e-14


@pytest.mark.parametrize("rcond", [1e-3, 1e-2, 3e-2, 0.1, 0.5, 1.0])
def test_truncation_agrees_with_numpy_on_a_flight(rcond):
    problem = flight_problem(velocity_noise=0.1)
    expected, _, rank, _ = np.linalg.lstsq(problem.theta, problem.target, rcond=rcond)
    found = fitted(problem, rcond)
    # numpy keeps s >= rcond s_max where we keep s > rcond s_max: only rcond = 1 can tell.
    assert found.solver_status == f"rank {rank if rcond < 1 else 1}"
    assert found.weights.any()
    if rcond < 1:
        assert found.weights == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())
    assert found.status == "ok"


def test_the_minimum_norm_solution_where_columns_repeat():
    theta = np.array([[1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
    found = fitted(RegressionProblem.from_arrays(theta, 2.0 * theta[:, 0]))
    assert found.weights[:, 0] == pytest.approx([1.0, 1.0])  # not (2, 0)
    assert found.solver_status == "rank 1"


def test_fewer_samples_than_columns_are_refused_with_the_alternatives():
    theta = np.random.default_rng(0).normal(size=(4, 6))
    found = fitted(RegressionProblem.from_arrays(theta, np.ones(4)))
    assert found.status == "error"
    assert np.isnan(found.weights).all()
    assert found.certificate is None
    for word in ("4 samples", "6 columns", "Section V.B", "stlsq", "lasso", "group-lasso"):
        assert word in found.reason


def test_fewer_samples_than_columns_are_solved_where_rcond_says_how():
    theta = np.random.default_rng(0).normal(size=(4, 6))
    problem = RegressionProblem.from_arrays(theta, np.ones(4))
    expected = np.linalg.lstsq(theta, np.ones((4, 1)), rcond=1e-3)[0]
    assert fitted(problem, 1e-3).weights == pytest.approx(expected)
