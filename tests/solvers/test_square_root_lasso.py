"""The square-root LASSO: by hand, through cones, as a LASSO, and what sets it apart from one."""

import numpy as np
import pytest
from scipy import sparse

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from tests.problems import DEGENERATE_KINDS, degenerate, flight_problem, orthonormal, regular

FRACTIONS = [0.7, 0.1, 0.01, 0.001]


def fitted(problem, fraction=0.1, **more):
    return sf.fit(problem, backends.get("square-root-lasso", alpha_fraction=fraction, **more))


def level(values, samples):
    return np.sqrt(np.sum(values**2) / samples)


def test_orthonormal_columns_by_hand():
    """Soft thresholds at t = a rho/y, with rho^2 = y^2 - |C|^2 + sum min(|C|, t)^2."""
    problem = orthonormal()
    s = problem.statistics
    size, square = np.abs(s.cross), s.target_square.sum()
    alpha = 0.4 * size.max()
    low, high = 0.0, size.max()
    for _ in range(200):
        middle = (low + high) / 2
        rho = np.sqrt(square - np.sum(size**2) + np.sum(np.minimum(size, middle) ** 2))
        low, high = (middle, high) if middle < alpha * rho / np.sqrt(square) else (low, middle)
    expected = np.sign(s.cross) * np.maximum(size - low, 0.0)
    assert 0 < np.count_nonzero(expected) < expected.size
    assert fitted(problem, 0.4).weights * s.rms[:, None] == pytest.approx(expected, abs=1e-9)


def test_cones_agree():
    problem = regular(3)
    expected, found = fitted(problem), fitted(problem, solver="clarabel")
    size = np.abs(expected.weights).max()
    assert found.weights == pytest.approx(expected.weights, abs=1e-4 * size)
    assert found.certificate.primal == pytest.approx(expected.certificate.primal, rel=1e-8)
    assert found.certificate.value < 1e-4
    assert not found.repaired


@pytest.mark.parametrize("unit", [1e-120, 1e120])
def test_the_unit_of_the_target_does_not_matter(unit):
    problem = regular()
    scaled = RegressionProblem.from_arrays(problem.theta, problem.target * unit, problem.groups)
    found = fitted(scaled)
    assert found.status == "ok"
    np.testing.assert_allclose(found.weights / unit, fitted(problem).weights, atol=1e-12)


def test_a_solution_is_one_of_the_lasso_at_the_penalty_that_its_residual_sets():
    problem = flight_problem(velocity_noise=0.3)
    found = fitted(problem, 0.05)
    residual = problem.target - problem.theta @ found.weights
    fraction = 0.05 * np.linalg.norm(residual) / np.linalg.norm(problem.target)
    lasso = sf.fit(problem, backends.get("lasso", alpha_fraction=fraction))
    assert found.weights == pytest.approx(lasso.weights, abs=1e-9 * np.abs(lasso.weights).max())


def test_one_penalty_suits_every_noise():
    """y alpha, in the unit of Z'R/(sqrt(m) |R|), holds the noise out whatever its size is."""
    rng = np.random.default_rng(0)
    theta, noise = rng.normal(size=(200, 30)), rng.normal(size=(200, 1))
    supports = []
    for size in (1.0, 0.1, 0.01):
        problem = RegressionProblem.from_arrays(
            theta, 3.0 * theta[:, :2] @ [[1.0], [1]] + size * noise
        )
        s = problem.statistics
        largest = np.abs(s.cross).max() / np.sqrt(s.target_square.sum())
        found = fitted(problem, 4.0 / np.sqrt(problem.samples) / largest)
        supports.append(found.support.tolist())
    assert supports == [[0, 1]] * 3


@pytest.mark.parametrize("kind", DEGENERATE_KINDS)
def test_degenerate_problems_have_certificates_that_are_proven_bounds(kind):
    problem = degenerate(kind, 2)
    backend = backends.get("square-root-lasso")
    along = sf.path(problem, backend, FRACTIONS)
    assert along.gaps.max() < 1e-9
    assert all(fit.certificate.bound <= 1e-8 for fit in along.fits)
    for fit in along.fits:
        residual = problem.target - problem.theta @ fit.weights
        size = np.abs(fit.weights * problem.statistics.rms[:, None]).sum()
        loss = level(problem.target, problem.samples) * level(residual, problem.samples)
        assert fit.certificate.primal == pytest.approx(loss + fit.alpha * size, rel=1e-9)


def test_the_gap_sees_what_is_not_optimal():
    problem = regular(5)
    found = fitted(problem)
    s, penalty = problem.statistics, found.backend.penalty(problem)
    alpha = 0.1 * alpha_max(s.cross, penalty)
    least = found.certificate.primal
    for factor in (0.0, 0.9, 1.01):
        weights, alphas = factor * found.weights[None], np.array([alpha])
        (moved,) = duality_gaps(problem.design, problem.target, weights, alphas, penalty)
        assert moved.value >= (moved.primal - least) / s.target_square.sum() - 1e-12
        assert moved.value > 1e-5


def test_an_exact_fit_that_is_certified_has_no_reason_for_doubt():
    found = fitted(flight_problem(4.0), 0.1)
    assert (found.status, found.reason) == ("ok", "")
    assert found.solver_status.startswith("root of the scaled path")
    assert found.certificate.bound <= 1e-9


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
