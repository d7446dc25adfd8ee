"""Least squares alone and on supports that are searched: thresholds, candidates, groups."""

import dataclasses
import warnings

import numpy as np
import pysindy
import pytest
from scipy.sparse import csc_array

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError, MissingExtra
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Derivative
from sparsefit.solvers import least_squares, searches
from sparsefit.solvers.searches import BestScale, GroupOMP, explained
from tests.problems import DEGENERATE_KINDS, VEHICLE, degenerate, flight_problem, regular


def fitted(problem, rcond=None, tolerance=1e-8):
    return sf.fit(problem, backends.get("least-squares", rcond=rcond), tolerance=tolerance)


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


def test_fewer_samples_than_columns_are_solved_where_rcond_says_how():
    theta = np.random.default_rng(0).normal(size=(4, 6))
    problem = RegressionProblem.from_arrays(theta, np.ones(4))
    expected = np.linalg.lstsq(theta, np.ones((4, 1)), rcond=1e-3)[0]
    assert fitted(problem, 1e-3).weights == pytest.approx(expected)
    for word in ("4 samples", "6 columns", "Section V.B", "stlsq", "lasso", "group-lasso"):
        assert word in fitted(problem).reason


def fixture():
    """40 samples, 4 columns, 2 targets: each has one weight of note and one below 0.1."""
    rng = np.random.default_rng(7)
    theta = rng.normal(size=(40, 4))
    weights = np.array([[1.5, 0.0, -0.08, 0.0], [0.0, 0.05, 0.0, 2.0]])
    target = theta @ weights.T + 0.01 * rng.normal(size=(40, 2))
    return RegressionProblem.from_arrays(theta, target)


def ours(problem, **settings):
    settings = {"mode": "pysindy", "threshold": 0.1, **settings}
    return backends.get("stlsq", **settings).solve(problem)


def theirs(problem, *, max_iterations=20, ridge=0.05, **settings):
    """PySINDy's coefficients (k, n) and whether it warned of no convergence."""
    optimizer = pysindy.STLSQ(alpha=ridge, max_iter=max_iterations, **settings)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        optimizer.fit(problem.theta.copy(), problem.target.copy())
    return optimizer.coef_.T, any("did not converge" in str(w.message) for w in caught)


def random_problem(seed):
    rng = np.random.default_rng(seed)
    m, k, n = int(rng.integers(20, 60)), int(rng.integers(2, 10)), int(rng.integers(1, 4))
    theta = rng.normal(size=(m, k)) * rng.uniform(0.3, 3.0, k)
    weights = rng.normal(size=(k, n)) * (rng.random((k, n)) < 0.6)
    return RegressionProblem.from_arrays(theta, theta @ weights + 0.2 * rng.normal(size=(m, n)))


@pytest.mark.parametrize("unbias", [False, True])
@pytest.mark.parametrize("max_iterations", [1, 2, 3, 20])
@pytest.mark.parametrize("ridge", [0.0, 0.05, 5.0])
@pytest.mark.parametrize("threshold", [0.0, 0.05, 0.5, 1.5])
def test_pysindy_agrees(threshold, ridge, max_iterations, unbias):
    for seed in range(2):
        problem = random_problem(seed)
        settings = {"threshold": threshold, "ridge": ridge, "unbias": unbias}
        expected, warned = theirs(problem, max_iterations=max_iterations, **settings)
        found = ours(problem, max_iterations=max_iterations, **settings)
        if found.weights is None:
            assert not expected.any()
            assert "empty support" in found.reason
            continue
        assert np.array_equal(found.weights != 0, expected != 0)
        assert np.abs(found.weights - expected).max() <= 1e-10 * max(np.abs(expected).max(), 1.0)
        if warned:
            assert found.iterations == max_iterations


def test_pysindys_own_is_a_back_end_whose_support_is_certified(monkeypatch):
    problem, backend = fixture(), backends.get("pysindy", threshold=0.1)
    found = sf.fit(problem, backend)
    assert (found.status, found.certificate.kind) == ("ok", "fixed_point"), found.reason
    assert [np.flatnonzero(w).tolist() for w in found.weights.T] == [[0], [3]]
    assert np.allclose(found.weights, ours(problem).weights, atol=1e-10)
    assert not backend.next_weights(problem, np.ones((4, 2))).all()  # some are below it
    empty = sf.fit(problem, backends.get("pysindy", threshold=100.0))
    assert empty.status == "unidentifiable"
    monkeypatch.setattr(least_squares, "find_spec", lambda _: None)
    with pytest.raises(MissingExtra, match=r"sparsefit\[peers\]"):
        backends.get("pysindy")


def test_the_empty_support_of_one_target_is_named():
    theta = np.random.default_rng(0).normal(size=(30, 3))
    target = np.column_stack([theta[:, 0], 1e-3 * theta[:, 1]])
    problem = RegressionProblem.from_arrays(theta, target)
    found = sf.fit(problem, backends.get("stlsq", mode="pysindy", threshold=0.1))
    assert found.status == "ok"
    assert found.reason == "support of 1 is empty"
    assert not found.weights[:, 1].any()


def test_too_few_iterations_are_no_fixed_point():
    statuses = set()
    for seed in range(30):
        problem = random_problem(seed)
        settings = {"mode": "pysindy", "threshold": 0.7, "ridge": 5.0}
        settled = sf.fit(problem, backends.get("stlsq", **settings))
        if settled.status == "unidentifiable":  # an empty support
            continue
        assert (settled.status, settled.certificate.value) == ("ok", 0.0)
        found = sf.fit(problem, backends.get("stlsq", **settings, max_iterations=1))
        moves = not np.array_equal(found.weights != 0, settled.weights != 0)
        assert found.certificate.kind == "fixed_point"
        assert (found.certificate.value > 0) == moves
        assert found.status == ("inaccurate" if moves else "ok")
        statuses.add(found.status)
    assert statuses == {"ok", "inaccurate"}


@pytest.mark.parametrize("unbias", [True, False])
def test_scaled_mode_is_the_slow_obvious_loop(unbias):
    problem = flight_problem(velocity_noise=0.2)
    rms = np.sqrt(np.mean(problem.theta**2, axis=0))
    z, y, m = problem.theta / rms, problem.target, problem.samples
    support, values = np.ones((problem.columns, 2), bool), np.zeros((problem.columns, 2))
    for _ in range(20):
        before = support.copy()
        for t in range(2):
            on = np.flatnonzero(support[:, t])
            gram = z[:, on].T @ z[:, on] / m + 0.05 * np.eye(len(on))
            w = np.linalg.solve(gram, z[:, on].T @ y[:, t] / m)
            keep = np.abs(w) >= 0.1 * np.sqrt(np.mean(y[:, t] ** 2))
            values[:, t] = 0.0
            values[on[keep], t] = w[keep]
            support[:, t] = values[:, t] != 0
        if np.array_equal(before, support):
            break
    if unbias:
        for t in range(2):
            on = np.flatnonzero(support[:, t])
            values[on, t] = np.linalg.lstsq(z[:, on], y[:, t], rcond=None)[0]
    backend = backends.get("stlsq", threshold=0.1, unbias=unbias)
    found = sf.fit(problem, backend)
    assert found.status == "ok"
    assert np.array_equal(found.weights != 0, support)
    expected = values / rms[:, None]
    assert found.weights == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def test_repeated_columns_with_a_ridge_that_rounds_away_share_the_weight():
    theta = np.random.default_rng(2).normal(size=(30, 3))
    theta[:, 2] = theta[:, 1]
    problem = RegressionProblem.from_arrays(theta, theta @ [1.0, 1.0, 1.0])
    for ridge in (0.0, 1e-300, 1e-20):
        backend = backends.get("stlsq", ridge=ridge, threshold=0.0, unbias=False)
        found = sf.fit(problem, backend)
        assert found.status == "ok"
        assert found.weights[:, 0] == pytest.approx([1.0, 1.0, 1.0], abs=1e-5)


def test_unbiased_weights_on_an_ill_conditioned_support_are_those_of_lstsq():
    theta = np.random.default_rng(2).normal(size=(30, 3))
    theta[:, 2] = theta[:, 1] + 1e-9 * theta[:, 2]
    target = theta @ [1.0, 1.0, 1.0]
    problem = RegressionProblem.from_arrays(theta, target)
    found = backends.get("stlsq", threshold=0.0).solve(problem).weights[:, 0]
    assert found == pytest.approx(np.linalg.lstsq(theta, target, rcond=1e-6)[0], abs=1e-7)


def test_fewer_samples_than_columns_need_a_ridge(monkeypatch):
    problem = RegressionProblem.from_arrays(regular().theta[:5], regular().target[:5])
    refused = sf.fit(problem, backends.get("stlsq", ridge=0.0))
    assert refused.status == "error"
    assert "set ridge above 0 or use lasso" in refused.reason
    ridged = sf.fit(problem, backends.get("stlsq", ridge=0.2, threshold=0.0, unbias=False))
    scaled = problem.theta / problem.design.rms
    expected = np.linalg.solve(scaled.T @ scaled + 1.0 * np.eye(12), scaled.T @ problem.target)
    assert ridged.status == "ok"
    assert ridged.weights * problem.design.rms[:, None] == pytest.approx(expected)
    dense = [sf.fit(problem, backends.get("stlsq", unbias=last)) for last in (False, True)]
    monkeypatch.setattr(least_squares, "FEW", 2)  # sparse columns take conjugate gradients
    for fit in dense:
        iterated = sf.fit(csc_array(problem.theta), problem.target, fit.backend)
        assert iterated.weights == pytest.approx(fit.weights, abs=1e-10)
    with pytest.raises(InputError, match="lost to rounding beside 12 columns of 5 samples"):
        sf.fit(problem, backends.get("stlsq", ridge=1e-18))


def residuals_one_by_one(problem):
    """|Y - theta_g W_g|^2 of each group alone: the slow, obvious reference."""
    values = []
    for group in range(problem.groups.max() + 1):
        columns = problem.theta[:, problem.groups == group]
        fitted = columns @ np.linalg.lstsq(columns, problem.target, rcond=None)[0]
        values.append(np.sum((problem.target - fitted) ** 2))
    return np.array(values)


def chosen(problem, weights):
    return np.unique(problem.groups[np.any(weights != 0, axis=1)])


@pytest.mark.parametrize("few", [4, 2000])
def test_explained_agrees_with_least_squares_on_groups_of_any_size_and_order(few, monkeypatch):
    monkeypatch.setattr(searches, "FEW", few)
    groups = np.array([2, 0, 1, 1, 3, 2, 2, 0, 3, 3, 3, 2])
    mixed = dataclasses.replace(regular(seed=1, groups=4, size=3), groups=groups)
    for problem in (flight_problem(3.3, velocity_noise=0.5), mixed):
        left = np.sum(problem.target**2) - residuals_one_by_one(problem)
        np.testing.assert_allclose(explained(problem) * problem.samples, left, rtol=1e-7)


@pytest.mark.parametrize("kind", DEGENERATE_KINDS)
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("backend", [BestScale(), GroupOMP(), GroupOMP(stop="bic")])
def test_degenerate_problems(backend, kind, seed):
    problem = degenerate(kind, seed)
    solution = backend.solve(problem)
    assert np.isfinite(solution.weights).all()
    residual = np.sum((problem.target - problem.theta @ solution.weights) ** 2)
    floor = 1e-9 * np.sum(problem.target**2)
    assert residual <= residuals_one_by_one(problem).min() + floor
    if isinstance(backend, BestScale):
        support = solution.weights != 0
        np.testing.assert_array_equal(
            (backend.next_weights(problem, solution.weights) != 0), support
        )


def test_omp_ends_where_no_column_explains_anything():
    problem = RegressionProblem.from_arrays(np.eye(5)[:, :3], np.eye(5)[:, 3:])
    for stop in ("decrease", "bic"):
        found = sf.fit(problem, GroupOMP(stop=stop, tolerance=0.0))
        assert (found.status, found.weights.any()) == ("ok", False)


def test_omp_finds_two_flows():
    flow = sf.flows.SuperposedFlow((sf.CellularFlow(10.0, 3.0), sf.CellularFlow(8.0, 5.0)))
    flown = sf.simulate_flight(flow, VEHICLE, duration=20.0, sample_rate=100.0, seed=1)
    built = Library(LengthScaleGrid(2.0, 7.0, step=0.5)).build([Derivative()(flown)], [VEHICLE])
    problem = RegressionProblem.from_arrays(built.theta, 1e-3 * built.target, built.groups)
    backend = GroupOMP()
    weights = backend.solve(problem).weights
    np.testing.assert_allclose(built.group_scales[chosen(problem, weights)], [3.0, 5.0])
    np.testing.assert_array_equal((backend.next_weights(problem, weights) != 0), weights != 0)
    early = GroupOMP(scales=1).solve(problem).weights  # a stop that is too soon is seen
    assert np.any((backend.next_weights(problem, early) != 0) != (early != 0))


def test_omp_bic_stops_at_the_truth():
    problem = regular(seed=2, samples=200, groups=6, size=3)
    assert chosen(problem, GroupOMP(stop="bic").solve(problem).weights).tolist() == [0]
