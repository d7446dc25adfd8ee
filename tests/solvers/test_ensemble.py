"""The ensemble: its inclusion probabilities fit by fit, what it keeps, and what it refuses."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.problem import RegressionProblem
from tests.problems import flight_problem, regular


def by_hand(problem, name, *, blocks, draws, seed, fraction):
    """Inclusion probabilities by fits of the back-end itself to the rows of each half.

    Columns keep the scale that they have over all rows, so each half is weighed by that.
    """
    rows = np.array_split(np.arange(problem.samples), blocks)
    rng, counts, rms = np.random.default_rng(seed), 0, problem.statistics.rms
    for _ in range(draws // 2):
        order = rng.permutation(blocks)
        for part in (order[: blocks // 2], order[blocks // 2 :]):
            taken = np.concatenate([rows[i] for i in part])
            theta = problem.theta[taken] / rms
            whole = np.sqrt(np.sum(theta**2, axis=0) / len(taken))
            half = RegressionProblem.from_arrays(
                theta / whole, problem.target[taken], problem.groups
            )
            assert np.abs(whole - 1).max() < 0.02  # the scales of the halves are the same
            found = sf.fit(half, backends.get(name, alpha_fraction=fraction))
            counts = counts + (found.weights != 0)
    return counts / draws


@pytest.mark.parametrize("name", ["lasso", "group-lasso"])
def test_inclusion_is_the_share_of_fits(name):
    """With columns of +-1, every half has the scales of the whole."""
    rng = np.random.default_rng(7)
    theta = rng.choice([-1.0, 1.0], size=(60, 9))
    target = theta[:, :3] @ rng.normal(size=(3, 2)) + rng.normal(size=(60, 2))
    problem = RegressionProblem.from_arrays(theta, target, np.repeat([0, 1, 2], 3))
    settings = {"blocks": 6, "draws": 10, "seed": 3, "alpha_fraction": 0.3}
    shares = backends.get("ensemble", base=name, **settings).inclusion(problem)
    expected = by_hand(problem, name, blocks=6, draws=10, seed=3, fraction=0.3)
    assert np.array_equal(shares, expected)
    assert 0 < shares.mean() < 1


def test_what_is_kept_is_fitted_by_least_squares():
    problem = regular(3)
    found = sf.fit(problem, backends.get("ensemble"))
    kept = problem.groups == 0
    expected = np.linalg.lstsq(problem.theta[:, kept], problem.target, rcond=None)[0]
    assert found.weights[kept] == pytest.approx(expected, rel=1e-9)
    assert not found.weights[~kept].any()
    assert found.status == "ok"
    assert found.solver_status.startswith("inclusion: group 0 1.00, ")


def test_a_flight_tells_its_scale_and_how_often():
    found = sf.fit(flight_problem(4.0, velocity_noise=0.3), backends.get("ensemble", draws=10))
    problem = found.problem
    assert problem.group_scales[np.unique(problem.groups[found.support])].tolist() == [4.0]
    assert found.solver_status.startswith("inclusion: 4 m 1.00, ")
    assert "falsely kept: at most" in found.solver_status


def test_noise_is_not_kept():
    """The expected number of false ones is bounded; the bound is told."""
    kept = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        theta = rng.normal(size=(100, 30))
        target = theta[:, 0] + 0.5 * rng.normal(size=100)
        problem = RegressionProblem.from_arrays(theta, target)
        backend = backends.get("ensemble", base="lasso", alpha_fraction=0.4, draws=10)
        kept.append(sf.fit(problem, backend).support.tolist())
    assert all(0 in one for one in kept)
    assert sum(len(one) - 1 for one in kept) <= 1


def test_where_no_group_is_often_chosen_nothing_is_answered():
    rng = np.random.default_rng(11)
    problem = RegressionProblem.from_arrays(rng.normal(size=(60, 40)), rng.normal(size=60))
    found = sf.fit(problem, backends.get("ensemble", alpha_fraction=0.9, threshold=1.0))
    assert found.status == "unidentifiable"
    assert found.reason.startswith("nothing is chosen by 1 of the fits; inclusion: group ")
    assert np.isnan(found.weights).all()


def test_compressed_rows_and_a_single_sample_are_refused():
    problem = regular(1)
    folded = RegressionProblem.from_blocks([(problem.theta, problem.target)], problem.groups)
    found = sf.fit(folded, backends.get("ensemble"))
    assert (found.status, "these are compressed" in found.reason) == ("error", True)
    one = RegressionProblem.from_arrays(problem.theta[:1], problem.target[:1])
    assert sf.fit(one, backends.get("ensemble")).reason == "ensemble needs at least 2 samples"


def test_targets_that_choose_by_themselves_keep_so_many_more_falsely():
    one = regular(1)
    twice = RegressionProblem.from_arrays(one.theta, one.target[:, [0, 0]], one.groups)
    alone = RegressionProblem.from_arrays(one.theta, one.target[:, 0], one.groups)
    backend = backends.get("ensemble", base="lasso", alpha_fraction=0.3)
    bounds = [
        float(backend.solve(problem).solver_status.split("at most ")[1].split()[0])
        for problem in (alone, twice)
    ]
    assert bounds[1] == pytest.approx(2.0 * bounds[0], rel=0.05)
