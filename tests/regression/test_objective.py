"""The objective, its dual and the certificate against hand values and high precision."""

import itertools

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import DEGENERATE_KINDS, degenerate, regular

from sparsefit import backends
from sparsefit.regression.objective import (
    Penalty,
    accumulate,
    alpha_max,
    duality_gaps,
    lasso_penalty,
    row_blocks,
)
from sparsefit.regression.problem import RegressionProblem

THETA = np.array([[1.0, 1.0], [1.0, -1.0]])
TARGET = np.array([[3.0], [1.0]])  # Z = theta, Z'Z/m = I, c = Z'y/m = (2, 1), |y|^2/2m = 2.5


def statistics_of(theta, target):
    return accumulate(row_blocks(np.asarray(theta), np.asarray(target)))


def certify(theta, target, weights, alpha, penalty):
    rms = statistics_of(theta, target).rms
    return duality_gaps(theta, target, rms, np.asarray(weights)[None], np.array([alpha]), penalty)[
        0
    ]


def by_hand(theta, target, weights, alpha, groups, omega, joint):
    """Primal, dual and dual point by loops, one block at a time."""
    m, n = target.shape
    rms = np.sqrt(np.mean(theta**2, axis=0))
    z, v = theta / rms, weights * rms[:, None]
    residual = target - z @ v
    blocks = [range(n)] if joint else [[t] for t in range(n)]
    primal, dual, points = 0.0, 0.0, []
    for targets in blocks:
        targets = list(targets)
        r, y = residual[:, targets], target[:, targets]
        primal += np.sum(r**2) / (2 * m)
        worst = 0.0
        for g, weight in enumerate(omega):
            on = [j for j in range(theta.shape[1]) if groups[j] == g]
            primal += alpha * weight * np.sqrt(np.sum(v[np.ix_(on, targets)] ** 2))
            worst = max(worst, np.sqrt(np.sum((z[:, on].T @ r / m) ** 2)) / weight)
        s = np.sum(r * y) / np.sum(r * r)
        s = np.clip(s, -alpha / worst, alpha / worst)
        dual += (s * np.sum(r * y) - s**2 * np.sum(r * r) / 2) / m
        points.append((targets, s * r))
    return primal, dual, points


def test_statistics_of_two_columns_worked_by_hand():
    found = statistics_of(THETA * [2.0, 5.0], TARGET)
    assert found.rms == pytest.approx([2.0, 5.0])
    assert found.gram == pytest.approx(np.eye(2))
    assert found.cross[:, 0] == pytest.approx([2.0, 1.0])
    assert found.target_square == pytest.approx([5.0])
    assert found.null_objective == pytest.approx(2.5)
    assert (found.samples, found.rank) == (2, 2)


def test_primal_and_dual_of_two_columns_worked_by_hand():
    # v = (1, 0): r = (2, 0), |r|^2/2m = 1, alpha |v| = 0.5 and so P = 1.5.
    # Z'r/m = (1, 1), s = min(<r, y>/|r|^2 = 1.5, alpha = 0.5), D = (0.5 * 6 - 0.125 * 4)/2 = 1.25.
    found = certify(THETA, TARGET, [[1.0], [0.0]], 0.5, lasso_penalty(2))
    assert (found.primal, found.dual) == pytest.approx((1.5, 1.25))
    assert found.value == pytest.approx(0.25 / 2.5)
    assert found.kind == "duality_gap"


def test_gap_vanishes_at_the_soft_threshold_of_orthogonal_columns():
    assert certify(THETA, TARGET, [[1.5], [0.5]], 0.5, lasso_penalty(2)).value <= 1e-16
    assert certify(THETA, TARGET, [[0.5], [0.0]], 1.5, lasso_penalty(2)).value <= 1e-16


def test_group_norm_spans_columns_and_targets_worked_by_hand():
    # V = [[3, 0], [0, 4]]: joint |V| = 5; separate 3 + 4; elementwise 3 + 4; omega 2 doubles.
    values = np.array([[3.0, 0.0], [0.0, 4.0]])
    one = np.zeros(2, dtype=np.intp)
    assert Penalty(one, np.array([2.0]), joint=True).norm(values) == pytest.approx(10.0)
    assert Penalty(one, np.array([2.0]), joint=False).norm(values) == pytest.approx(14.0)
    assert lasso_penalty(2).norm(values) == pytest.approx(7.0)


def test_block_norms_keep_what_squares_would_lose():
    tiny = Penalty(np.zeros(2, dtype=np.intp), np.ones(1), joint=True)
    assert tiny.norm(np.full((2, 1), 1e-200)) == pytest.approx(np.sqrt(2) * 1e-200)


def lasso_by_enumeration(theta, target, rms, alpha):
    """The least P(V) over all sign patterns, in 50 digits, with V (k,) of one target."""
    m, k = theta.shape
    z = mp.matrix([[mp.mpf(theta[i, j]) / mp.mpf(rms[j]) for j in range(k)] for i in range(m)])
    y, penalty, best = mp.matrix(target.tolist()), mp.mpf(float(alpha)), None
    for signs in itertools.product((-1, 0, 1), repeat=k):
        on = [j for j in range(k) if signs[j]]
        v = mp.matrix(k, 1)
        if on:
            part = mp.matrix([[z[i, j] for j in on] for i in range(m)])
            right = part.T * y - m * penalty * mp.matrix([signs[j] for j in on])
            for j, value in zip(on, mp.lu_solve(part.T * part, right), strict=True):
                v[j] = value
        if any(v[j] * signs[j] < 0 for j in on):
            continue  # not this orthant
        value = primal_exactly(z, y, v, penalty)
        best = value if best is None or value < best else best
    return z, y, best


def primal_exactly(z, y, v, alpha):
    residual = y - z * v
    size = mp.fsum(abs(x) for x in v)
    return mp.fsum(r**2 for r in residual) / (2 * z.rows) + alpha * size


@pytest.mark.parametrize("seed", range(6))
def test_gap_bounds_the_true_suboptimality_in_high_precision(seed):
    rng = np.random.default_rng(seed)
    theta, target = rng.normal(size=(7, 3)) * [1.0, 1e3, 1e-3], rng.normal(size=(7, 1))
    s = statistics_of(theta, target)
    alpha = float(rng.uniform(0.05, 0.9)) * alpha_max(s.cross, lasso_penalty(3))
    with mp.workdps(50):
        z, y, optimum = lasso_by_enumeration(theta, target, s.rms, alpha)
        for size in (1.0, 1e-2, 1e-5):
            weights = (rng.normal(size=(3, 1)) * size) / s.rms[:, None]
            found = certify(theta, target, weights, alpha, lasso_penalty(3))
            v = mp.matrix(
                [mp.mpf(w) * mp.mpf(r) for w, r in zip(weights[:, 0], s.rms, strict=True)]
            )
            exact = primal_exactly(z, y, v, mp.mpf(alpha))
            null = s.null_objective
            assert abs(found.primal - float(exact)) <= 1e-14 * null
            assert found.dual <= float(optimum) + 1e-14 * null
            assert found.value * null >= float(exact - optimum) - 1e-14 * null


def test_gap_is_tight_at_the_high_precision_solution():
    rng = np.random.default_rng(5)
    theta, target = rng.normal(size=(9, 3)), rng.normal(size=(9, 1))
    s = statistics_of(theta, target)
    alpha = 0.3 * alpha_max(s.cross, lasso_penalty(3))
    problem = RegressionProblem.from_arrays(theta, target)
    weights = backends.get("lasso", alpha_fraction=0.3).solve(problem).weights
    found = certify(theta, target, weights, alpha, lasso_penalty(3))
    optimum = lasso_by_enumeration(theta, target, s.rms, alpha)[2]
    assert found.primal == pytest.approx(float(optimum), rel=1e-14)
    assert found.dual == pytest.approx(float(optimum), rel=1e-13)


@pytest.mark.parametrize("joint", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_certificate_agrees_with_loops_over_unequal_groups(seed, joint):
    rng = np.random.default_rng(seed)
    theta, target = rng.normal(size=(11, 7)), rng.normal(size=(11, 3))
    groups = np.array([2, 0, 1, 1, 2, 2, 2])  # sizes 1, 2 and 4, not in order
    omega = np.sqrt(np.bincount(groups))
    weights = rng.normal(size=(7, 3)) * (rng.random((7, 3)) < 0.6)
    penalty = Penalty(groups, omega, joint)
    found = certify(theta, target, weights, 0.2, penalty)
    primal, dual, points = by_hand(theta, target, weights, 0.2, groups, omega, joint)
    assert found.primal == pytest.approx(primal, rel=1e-13)
    assert found.dual == pytest.approx(dual, rel=1e-12)
    z = theta / np.sqrt(np.mean(theta**2, axis=0))
    for targets, point in points:  # the dual point obeys its constraint
        correlation = np.zeros((7, 3))
        correlation[:, targets] = z.T @ point / 11
        assert penalty.dual_norms(correlation).max() <= 0.2 * (1 + 1e-12)


@pytest.mark.parametrize("sparse", [True, False])
def test_gathering_columns_and_blocks_of_rows_change_nothing(sparse, monkeypatch):
    rng = np.random.default_rng(0)
    theta, target = rng.normal(size=(50, 8)), rng.normal(size=(50, 2))
    weights = rng.normal(size=(3, 8, 2))
    if sparse:
        weights[:, 2:] = 0.0
    alphas, penalty = np.array([0.3, 0.2, 0.1]), lasso_penalty(8)
    rms = statistics_of(theta, target).rms
    together = duality_gaps(theta, target, rms, weights, alphas, penalty)
    for one, values, alpha in zip(together, weights, alphas, strict=True):
        alone = duality_gaps(theta, target, rms, values[None], np.array([alpha]), penalty)[0]
        assert (one.primal, one.dual) == pytest.approx((alone.primal, alone.dual), rel=1e-13)
        primal, dual, _ = by_hand(theta, target, values, alpha, np.arange(8), np.ones(8), False)
        assert (one.primal, one.dual) == pytest.approx((primal, dual), rel=1e-12)


@given(
    theta_unit=st.sampled_from([1e-12, 1e-6, 1.0, 1e6, 1e12]),
    target_unit=st.sampled_from([1e-12, 1e-6, 1.0, 1e6, 1e12]),
    seed=st.integers(0, 50),
    joint=st.booleans(),
)
@settings(max_examples=80)
def test_gap_does_not_depend_on_units(theta_unit, target_unit, seed, joint):
    problem = regular(seed)
    weights = np.random.default_rng(seed).normal(size=(12, 2))
    penalty = Penalty(problem.groups, np.ones(4), joint)
    plain = certify(problem.theta, problem.target, weights, 0.3, penalty)
    changed = certify(
        problem.theta * theta_unit,
        problem.target * target_unit,
        weights * (target_unit / theta_unit),
        0.3 * target_unit,
        penalty,
    )
    assert changed.value == pytest.approx(plain.value, rel=1e-12)
    assert changed.primal == pytest.approx(plain.primal * target_unit**2, rel=1e-12)


@given(seed=st.integers(0, 10_000), kind=st.sampled_from(DEGENERATE_KINDS), size=st.floats(0, 3))
@settings(max_examples=120)
def test_gap_is_never_negative_and_dual_never_above_primal(seed, kind, size):
    problem = degenerate(kind, seed)
    s = problem.statistics
    rng = np.random.default_rng(seed)
    unit = np.sqrt(s.target_square) / s.rms[:, None]
    weights = size * unit * rng.normal(size=(problem.columns, problem.targets))
    penalty = Penalty(problem.groups, np.ones(problem.groups.max() + 1), bool(seed % 2))
    found = certify(
        problem.theta, problem.target, weights, 0.3 * alpha_max(s.cross, penalty), penalty
    )
    assert found.value >= 0
    assert found.dual <= found.primal + 1e-12 * s.null_objective


@given(
    seed=st.integers(0, 10_000),
    joint=st.booleans(),
    below=st.floats(0.01, 0.999),
    above=st.floats(1.0, 100.0),
)
@settings(max_examples=80)
def test_zero_is_the_solution_exactly_from_alpha_max_on(seed, joint, below, above):
    problem = regular(seed)
    penalty = Penalty(problem.groups, np.sqrt([1.0, 2.0, 3.0, 4.0]), joint)
    top = alpha_max(problem.statistics.cross, penalty)
    zeros = np.zeros((12, 2))
    assert certify(problem.theta, problem.target, zeros, top * above, penalty).value <= 1e-15
    lower = certify(problem.theta, problem.target, zeros, top * below, penalty)
    # alpha_max belongs to the worst block alone, so the gap is positive but not (1 - below)^2.
    assert lower.value > 0
    step = np.zeros((12, 2))  # and a step along the worst block does lower the objective
    cross = problem.statistics.cross
    ratio = penalty.block_norms(cross) / penalty.weights[:, None]
    group, t = np.unravel_index(ratio.argmax(), ratio.shape)
    block = np.ix_(np.flatnonzero(problem.groups == group), range(2) if joint else [t])
    step[block] = 1e-4 * (1 - below) * cross[block]
    weights = step / problem.statistics.rms[:, None]
    moved = certify(problem.theta, problem.target, weights, top * below, penalty)
    assert moved.primal < lower.primal


def test_zero_target_has_gap_zero():
    found = certify(THETA, np.zeros((2, 1)), np.zeros((2, 1)), 0.0, lasso_penalty(2))
    assert (found.value, found.primal, found.dual) == (0.0, 0.0, 0.0)


@given(size=st.integers(1, 70))
def test_statistics_do_not_depend_on_the_block_size(size):
    problem = regular()
    whole = problem.statistics
    blocks = accumulate(row_blocks(problem.theta, problem.target, size=size))
    for name in ("samples", "rms", "gram", "cross", "target_square"):
        assert getattr(blocks, name) == pytest.approx(getattr(whole, name), rel=1e-13, abs=1e-14)


def test_no_rows_are_refused():
    with pytest.raises(ValueError, match="no rows"):
        accumulate(iter([]))


def test_rank_counts_a_repeated_column_once():
    theta = regular().theta
    repeated = np.hstack([theta, theta[:, :2]])
    assert statistics_of(repeated, regular().target).rank == 12
