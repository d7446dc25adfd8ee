"""Group MCP: its stationarity, and the closed form on orthonormal columns."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from tests.problems import DEGENERATE_KINDS, degenerate, flight_problem, orthonormal, regular


def test_orthonormal_columns_are_kept_shrunk_or_dropped():
    """Firm thresholding of |C_g| (Breheny and Huang 2015): 0, gamma/(gamma - 1) soft, identity."""
    problem, gamma = orthonormal(3), 1.5
    backend = backends.get("group-mcp", gamma=gamma, alpha_fraction=0.6)
    s, found = problem.statistics, sf.fit(problem, backend)
    alpha, kinds = 0.6 * alpha_max(s.cross, backend.penalty(problem)), set()
    for g in range(2):
        pull = s.cross[problem.groups == g]
        norm = np.linalg.norm(pull)
        shrunk = pull * max(1 - alpha / norm, 0.0) * gamma / (gamma - 1)
        expected = pull if norm > gamma * alpha else shrunk
        kinds.add((norm > gamma * alpha, bool(shrunk.any())))
        ours = (found.weights * s.rms[:, None])[problem.groups == g]
        assert ours == pytest.approx(expected, abs=1e-6)
    assert len(kinds) > 1
    assert found.certificate.kind == "fixed_point"
    assert found.certificate.value < 1e-9


@given(seed=st.integers(0, 10**6), fraction=st.floats(0.01, 1.0), gamma=st.floats(1.5, 10.0))
@settings(max_examples=12)
def test_every_answer_is_stationary(seed, fraction, gamma):
    """C_g = (alpha omega_g - |V_g|/gamma)_+ V_g/|V_g|, and |C_g| <= alpha omega_g at zero."""
    problem = regular(seed)
    backend = backends.get("group-mcp", alpha_fraction=fraction, gamma=gamma)
    found, s = sf.fit(problem, backend), problem.statistics
    assert found.status == "ok"
    assert found.certificate.value < 1e-9
    values = found.weights * s.rms[:, None]
    alpha = fraction * alpha_max(s.cross, backend.penalty(problem))
    slope = s.cross - s.gram @ values
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


def test_it_lets_a_flights_length_scale_go_free():
    problem = flight_problem(length_scale=4.0)
    found = sf.fit(problem, backends.get("group-mcp", alpha_fraction=0.2))
    plain = sf.fit(problem, backends.get("group-lasso", alpha_fraction=0.2))
    square = [np.sum((problem.target - problem.theta @ fit.weights) ** 2) for fit in (found, plain)]
    assert square[0] < 1e-3 * square[1]


def test_the_penalty_can_be_chosen():
    problem = regular(7, noise=1.0)
    found = sf.fit(problem, backends.get("group-mcp", alpha_fraction="auto"))
    assert found.status == "ok"
    assert set(found.support) <= {0, 1, 2}


def test_weights_that_still_move_are_inaccurate():
    crawling = backends.get("group-mcp", alpha_fraction=0.99, gamma=1.0001)
    column = np.linspace(1.0, 3.0, 20)
    found = sf.fit(RegressionProblem.from_arrays(column[:, None], column), crawling)
    assert found.certificate.value > 1e-8
    assert (found.status, found.solver_status) == ("inaccurate", "still moving")
    assert "still move after 100 approximations" in found.reason
