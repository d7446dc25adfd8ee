"""The kernels by themselves: going on is going at once, compiled is generic, warm is cold."""

import numpy as np
import pytest

from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers import exact, kernels
from sparsefit.solvers.kernels import BEGIN, KERNELS, STOP, kernel_for
from sparsefit.solvers.newton import Columns, settled

homotopy = pytest.importorskip("sparsefit.solvers.homotopy", reason="it was not compiled")
variances = pytest.importorskip("sparsefit.solvers.variances", reason="it was not compiled")
K = 24
PENALTIES = {
    "LASSO": AbsoluteValues(np.ones(K)),
    "adaptive": AbsoluteValues(np.geomspace(0.1, 3.0, K)),
    "elastic net": AbsoluteValues(np.ones(K), ridge=0.3),
    "adaptive elastic net": AbsoluteValues(np.geomspace(0.1, 3.0, K), ridge=2.0),
    "SLOPE": SortedNorm(np.linspace(1.0, 0.3, K)),
    "groups": GroupNorms(np.arange(K) // 3, np.ones(8)),
    "groups in another order": GroupNorms(np.arange(K) % 8, np.linspace(0.5, 2.0, 8)),
}


def problem(seed, samples=40, targets=1, correlated=True):
    """Z (m, K) and Y (m, n) of unit rms."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(samples, K))
    z = np.cumsum(z, axis=1) if correlated else z
    z /= np.sqrt(np.mean(z**2, axis=0))
    y = z[:, :5] @ rng.normal(size=(5, targets)) + 0.3 * rng.normal(size=(samples, targets))
    return np.asfortranarray(z), y / np.sqrt(np.sum(y**2) / samples)


def path_of(z, y, penalty, alphas, stretches):
    """The path of a kernel that is asked for stretches of it, in turn."""
    on = Columns(penalty, z.T @ y / len(z), len(z), z.T @ z / len(z), z)
    kernel, attempts, parts = KERNELS[kernel_for(penalty, y.shape[1])], {BEGIN: 0.0 * on.cross}, []
    for part in np.array_split(alphas, stretches):
        parts.append(kernel(on, part, attempts, STOP))
        attempts = {float(part[-1]): parts[-1].weights[-1]}
    assert all(part.complete.all() for part in parts)
    return np.concatenate([part.weights for part in parts])


@pytest.mark.parametrize("kind", PENALTIES)
@pytest.mark.parametrize("seed", range(2))
def test_going_on_is_going_at_once_and_compiled_is_generic(kind, seed):
    penalty = PENALTIES[kind]
    z, y = problem(seed, targets=1 + ("groups" in kind), correlated=bool(seed % 2))
    cross = z.T @ y / len(z)
    alphas = float(penalty.dual_norm(cross).max()) * np.geomspace(1.0, 3e-3, 9)
    values = path_of(z, y, penalty, alphas, 1)
    np.testing.assert_allclose(path_of(z, y, penalty, alphas, 4), values, atol=1e-5)
    on = Columns(penalty, cross, len(z), z.T @ z / len(z), z)
    for alpha, point in zip(alphas[3::5], values[3::5], strict=True):
        start = np.zeros(cross.shape)
        generic, gap, _ = settled(on, float(alpha), start, 1e-13)
        assert gap < 1e-9
        np.testing.assert_allclose(point, generic, atol=2e-4)


@pytest.mark.parametrize("kind", ["LASSO", "adaptive elastic net", "groups", "SLOPE"])
def test_columns_that_join_on_the_way_change_no_point(kind, monkeypatch):
    rng = np.random.default_rng(5)
    theta, weights = rng.normal(size=(30, 240)), np.zeros((240, 1))
    weights[::40] = rng.normal(size=(6, 1))
    target, groups = theta @ weights + 0.1 * rng.normal(size=(30, 1)), np.arange(240) // 3
    penalty = {
        "LASSO": AbsoluteValues(np.ones(240)),
        "adaptive elastic net": AbsoluteValues(np.geomspace(0.5, 2.0, 240), ridge=0.1),
        "groups": GroupNorms(groups, np.ones(80)),
        "SLOPE": SortedNorm(np.linspace(1.0, 0.5, 240)),
    }[kind]
    design = RegressionProblem.from_arrays(theta, target, groups).design
    largest = float(penalty.dual_norm(design.correlate(target)).max())
    alphas = largest * np.geomspace(1.0, 1e-2, 12)
    whole = exact.exact_path(design, target, penalty, alphas)
    monkeypatch.setattr(exact, "FEW", 10)
    monkeypatch.setattr(exact, "START", 12)
    joined = exact.exact_path(design, target, penalty, alphas)
    assert "all columns" in whole.words
    assert "in play" in joined.words
    assert joined.complete.all()
    np.testing.assert_allclose(joined.weights, whole.weights, atol=1e-5)


@pytest.mark.parametrize("targets", [1, 2])
@pytest.mark.parametrize("most", [1, 300])
def test_groups_that_outnumber_the_rows_are_descended_to_the_same_optimum(
    targets, most, monkeypatch
):
    """Or, where descent takes too many sweeps, Newton's method ends it."""
    rng = np.random.default_rng(3)
    theta, groups = rng.normal(size=(40, 700)), np.arange(700) % 100
    target = theta[:, groups < 4] @ rng.normal(size=(28, targets)) + rng.normal(size=(40, targets))
    design = RegressionProblem.from_arrays(theta, target, groups).design
    penalty = GroupNorms(groups, np.linspace(0.5, 1.0, 100))
    largest = float(penalty.dual_norm(design.correlate(target)).max())
    alphas = largest * np.geomspace(1.0, 3e-2, 12)
    with monkeypatch.context() as patch:
        patch.setattr(exact, "HELD", 0)  # without rows there is no descent
        whole = exact.exact_path(design, target, penalty, alphas)
    monkeypatch.setattr(kernels, "MOST", most)
    descended = exact.exact_path(design, target, penalty, alphas)
    assert "block descent" in descended.words
    assert "variational" in whole.words
    assert descended.complete.all()
    gaps = duality_gaps(design, target, descended.weights / design.rms[:, None], alphas, penalty)
    assert max(gap.bound for gap in gaps) < 1e-8
    np.testing.assert_allclose(descended.weights, whole.weights, atol=1e-3)


@pytest.mark.parametrize("kind", ["copies", "opposites", "cumulated"])
def test_clusters_of_columns_that_are_alike_are_certified(kind):
    rng = np.random.default_rng(4)
    theta = rng.normal(size=(60, 120))
    if kind == "cumulated":
        theta = np.cumsum(theta, axis=1)
    else:
        theta[:, 60:] = theta[:, :60] * (1.0 if kind == "copies" else -1.0)
    target = theta[:, :5] @ rng.normal(size=(5, 2)) + 0.3 * rng.normal(size=(60, 2))
    design = RegressionProblem.from_arrays(theta, target).design
    for weights in (np.ones(120), np.linspace(1.0, 0.2, 120), np.geomspace(1.0, 1e-3, 120)):
        penalty = SortedNorm(weights)
        alphas = float(penalty.dual_norm(design.correlate(target)).max()) * np.array([0.3, 1e-2])
        points = exact.exact_path(design, target, penalty, alphas)
        assert points.complete.all()
        scaled = points.weights / design.rms[:, None]
        gaps = duality_gaps(design, target, scaled, alphas, penalty)
        assert max(gap.bound for gap in gaps) < 1e-8


def test_a_walk_from_anywhere_ends_at_the_optimum():
    z, y = problem(1)
    gram, cross = np.ascontiguousarray(z.T @ z / 40), z.T @ y[:, 0] / 40
    walk = homotopy.Homotopy(gram, cross, np.zeros(K))
    straight, there = np.zeros((1, K)), np.zeros(1, bool)
    alpha = np.array([0.1 * np.abs(cross).max()])
    walk.advance(alpha, straight, there)
    walk.start(np.random.default_rng(2).normal(size=K), 3.0 * float(alpha[0]))
    again, done = np.zeros((1, K)), np.zeros(1, bool)
    walk.advance(alpha, again, done)
    assert there[0]
    assert done[0]
    np.testing.assert_allclose(again, straight, atol=1e-9)


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="a homotopy wants"):
        homotopy.Homotopy(np.eye(3), np.ones(2), np.zeros(2))
    walk = homotopy.Homotopy(np.eye(2), np.ones(2), np.zeros(2))
    with pytest.raises(ValueError, match="a homotopy fills"):
        walk.advance(np.ones(1), np.zeros((2, 2)), np.zeros(1, bool))
    with pytest.raises(ValueError, match="do not fit"):
        variances.Groups(np.eye(3), np.ones((1, 3)), np.array([0, 2]))
