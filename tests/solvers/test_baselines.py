"""best-scale and group-omp against slow references and known flows."""

import dataclasses

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Derivative
from sparsefit.solvers.searches import BestScale, GroupOMP, explained
from tests.problems import DEGENERATE_KINDS, VEHICLE, degenerate, flight_problem, regular


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


def test_explained_agrees_with_least_squares_on_groups_of_any_size_and_order():
    groups = np.array([2, 0, 1, 1, 3, 2, 2, 0, 3, 3, 3, 2])
    mixed = dataclasses.replace(regular(seed=1, groups=4, size=3), groups=groups)
    for problem in (flight_problem(3.3, velocity_noise=0.5), mixed):
        left = np.sum(problem.target**2) - residuals_one_by_one(problem)
        np.testing.assert_allclose(explained(problem) * problem.samples, left, rtol=1e-7)


@pytest.mark.parametrize("length_scale", [2.5, 4.2, 6.1])
def test_best_scale_is_the_nearest_of_the_grid(length_scale):
    problem = flight_problem(length_scale)
    weights = BestScale().solve(problem).weights
    (group,) = chosen(problem, weights)
    assert group == np.argmin(residuals_one_by_one(problem))
    assert abs(problem.group_scales[group] - length_scale) <= 0.25


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


def test_omp_with_one_scale_is_best_scale():
    problem = flight_problem(4.2, velocity_noise=0.5)
    one, best = GroupOMP(scales=1).solve(problem).weights, BestScale().solve(problem).weights
    np.testing.assert_allclose(one, best)


def test_omp_finds_two_flows():
    flow = sf.flows.SuperposedFlow((sf.CellularFlow(10.0, 3.0), sf.CellularFlow(8.0, 5.0)))
    flown = sf.simulate_flight(flow, VEHICLE, duration=20.0, sample_rate=100.0, seed=1)
    problem = Library(LengthScaleGrid(2.0, 7.0, step=0.5)).build([Derivative()(flown)], [VEHICLE])
    backend = GroupOMP()
    weights = backend.solve(problem).weights
    np.testing.assert_allclose(problem.group_scales[chosen(problem, weights)], [3.0, 5.0])
    np.testing.assert_array_equal((backend.next_weights(problem, weights) != 0), weights != 0)
    early = GroupOMP(scales=1).solve(problem).weights  # a stop that is too soon is seen
    assert np.any((backend.next_weights(problem, early) != 0) != (early != 0))


def test_omp_bic_stops_at_the_truth():
    problem = regular(seed=2, samples=200, groups=6, size=3)
    assert chosen(problem, GroupOMP(stop="bic").solve(problem).weights).tolist() == [0]
