"""The best subset against every subset, its bound, and what a greedy choice misses."""

from itertools import combinations

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.best_subset import GroupSpans
from tests.problems import VEHICLE


def correlated(seed, samples=40, groups=9, size=2, targets=2):
    """Groups that resemble their neighbours, as length scales do; three make the truth."""
    rng = np.random.default_rng(seed)
    walk = np.cumsum(rng.normal(size=(samples, groups, size)), axis=1)
    theta = walk.reshape(samples, -1) * rng.uniform(0.1, 10.0, groups * size)
    weights = np.zeros((groups * size, targets))
    for group in rng.choice(groups, 3, replace=False):
        weights[group * size : (group + 1) * size] = rng.normal(size=(size, targets))
    target = theta @ weights + 0.5 * rng.normal(size=(samples, targets))
    return RegressionProblem.from_arrays(theta, target, np.repeat(np.arange(groups), size))


def residual_on(problem, groups):
    theta = problem.theta[:, np.isin(problem.groups, groups)]
    weights = np.linalg.lstsq(theta, problem.target, rcond=None)[0]
    return float(np.sum((problem.target - theta @ weights) ** 2))


def used(found):
    return np.unique(found.problem.groups[found.support]).tolist()


@pytest.mark.parametrize("size", [1, 2, 3])
@pytest.mark.parametrize("seed", range(4))
def test_no_set_of_all_is_better(seed, size):
    problem = correlated(seed)
    found = sf.fit(problem, backends.get("best-subset", scales=size, tolerance=0.0))
    sets = list(combinations(range(9), size))
    best = min(sets, key=lambda one: residual_on(problem, one))
    assert used(found) == list(best)
    residual = np.sum((problem.target - problem.theta @ found.weights) ** 2)
    assert residual == pytest.approx(residual_on(problem, best), rel=1e-9)
    assert found.status == "ok"


def test_the_bound_holds_and_excludes():
    rng = np.random.default_rng(5)
    theta = rng.normal(size=(200, 60))
    target = theta[:, [3, 10, 11]] @ [3.0, 2.0, 1.0] + 0.1 * rng.normal(size=200)
    problem = RegressionProblem.from_arrays(theta, target, np.repeat(np.arange(30), 2))
    spans = GroupSpans.of(problem)
    for size in (2, 3):
        sets = np.array(list(combinations(range(30), size)))
        bounds, explained = spans._bounds(sets), spans.explained(sets)
        assert np.all(bounds >= explained * (1 - 1e-12))
        best, worked = spans.best(size, 0.0)
        assert set(best[0]) == set(sets[np.argmax(explained)])
        assert 0 < worked < 0.5 * len(sets)
    found = sf.fit(problem, backends.get("best-subset", tolerance=1e-3))
    assert used(found) == [1, 5]  # two of the three columns are of one group
    assert "excluded by their bound" in found.solver_status


def test_where_a_greedy_choice_is_misled_the_best_set_is_found():
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=(2, 100))
    decoy = first + second + 0.3 * rng.normal(size=100)
    problem = RegressionProblem.from_arrays(
        np.stack([decoy, first, second], axis=1), first + second
    )
    assert 0 in used(sf.fit(problem, backends.get("group-omp", scales=2)))
    assert used(sf.fit(problem, backends.get("best-subset", scales=2))) == [1, 2]


def test_targets_choose_apart_where_they_are_told_to():
    theta = np.random.default_rng(1).normal(size=(50, 6))
    target = np.stack([theta[:, 0] - theta[:, 1], theta[:, 4]], axis=1)
    problem = RegressionProblem.from_arrays(theta, target)
    apart = sf.fit(problem, backends.get("best-subset", separate=True))
    assert [np.flatnonzero(column).tolist() for column in apart.weights.T] == [[0, 1], [4]]
    assert used(sf.fit(problem, backends.get("best-subset"))) == [0, 1, 4]


def test_the_exchange_finds_what_is_not_the_best():
    problem = correlated(1)
    backend = backends.get("best-subset", scales=2, tolerance=0.0)
    best = backend.solve(problem).weights
    assert np.array_equal((backend.next_weights(problem, best) != 0), best != 0)
    wrong = np.where(np.isin(problem.groups, used(sf.fit(problem, backend))[:1])[:, None], best, 0)
    wrong[problem.groups == 8] = 1.0
    assert not np.array_equal((backend.next_weights(problem, wrong) != 0), wrong != 0)


def test_two_flows_of_a_flight_are_found():
    flow = sf.flows.SuperposedFlow((sf.CellularFlow(10.0, 3.0), sf.CellularFlow(8.0, 5.0)))
    flown = sf.simulate_flight(flow, VEHICLE, duration=20.0, sample_rate=50.0, seed=1)
    grid = sf.model.LengthScaleGrid(2.0, 7.0, step=0.5)
    problem = sf.Library(grid).build(sf.Derivative()(flown), VEHICLE)
    found = sf.fit(problem, backends.get("best-subset"))
    assert problem.group_scales[used(found)].tolist() == [3.0, 5.0]


def test_too_many_sets_are_refused_before_any_is_tried():
    theta = np.random.default_rng(2).normal(size=(10, 300))
    found = sf.fit(RegressionProblem.from_arrays(theta, theta[:, 0]), backends.get("best-subset"))
    assert found.status == "error"
    assert found.reason == "best-subset: 4455100 sets of 3 of 300 groups are too many; lower scales"
