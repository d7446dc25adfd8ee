"""The gap of a fit that leaves no residual: never too small, and small where it should be."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.exact_fits import sharpened
from sparsefit.regression.objective import Penalty
from sparsefit.regression.problem import RegressionProblem


def exact_problem(seed, samples=20, columns=6, targets=2):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(samples, columns)) * np.geomspace(0.1, 10.0, columns)
    weights = rng.normal(size=(columns, targets)) * (rng.random((columns, targets)) < 0.6)
    weights[0] = 1.0
    return RegressionProblem.from_arrays(theta, theta @ weights), weights


def objective(problem, weights, alpha):
    y = np.sqrt(np.sum(problem.target**2) / problem.samples)
    residual = np.linalg.norm(problem.target - problem.theta @ weights) / np.sqrt(problem.samples)
    return y * residual + alpha * np.abs(weights * problem.statistics.rms[:, None]).sum()


def certified(problem, weights, alpha):
    """From the rows, and by the signs."""
    s = problem.statistics
    penalty = Penalty(np.arange(len(s.rms)), np.ones(len(s.rms)), joint=False, root=True)
    rows = duality_gaps(
        problem.theta, problem.target, s.rms, weights[None], np.array([alpha]), penalty
    )[0]
    return rows, sharpened(s, weights, alpha, rows)


@pytest.mark.parametrize("seed", range(4))
def test_an_exact_fit_at_a_small_penalty_is_proven_to_be_the_optimum(seed):
    problem, truth = exact_problem(seed)
    alpha = 1e-3 * float(np.abs(problem.statistics.cross).max())
    limit = sf.fit(problem, backends.get("square-root-lasso", alpha_fraction=1e-3)).weights
    assert limit == pytest.approx(truth, abs=1e-6)
    rows, sharp = certified(problem, limit, alpha)  # columns that join at the limit have signs too
    assert sharp.proves(1e-9)
    assert not rows.proves(1e-9)  # its residual is rounding
    excess = sharp.primal - objective(problem, truth, alpha)
    assert abs(excess) <= 1e-9 * problem.statistics.target_square.sum()


@pytest.mark.parametrize("fraction", [0.9, 0.3, 0.02])
@pytest.mark.parametrize("seed", range(3))
def test_the_dual_is_below_every_objective_whatever_the_weights(seed, fraction):
    problem, truth = exact_problem(seed)
    alpha = fraction * float(np.abs(problem.statistics.cross).max())
    rng = np.random.default_rng(seed)
    tried = [truth, 0.5 * truth, np.zeros_like(truth)]
    tried += [rng.normal(size=truth.shape) * (rng.random(truth.shape) < 0.5) for _ in range(10)]
    least = min(objective(problem, one, alpha) for one in tried)
    for weights in tried:
        rows, sharp = certified(problem, weights, alpha)
        assert sharp.dual <= least * (1 + 1e-12)
        assert sharp.value <= rows.value
        excess = (
            objective(problem, weights, alpha) - least
        ) / problem.statistics.target_square.sum()
        assert sharp.value >= excess - 1e-12
