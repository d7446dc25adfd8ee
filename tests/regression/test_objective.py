"""The norms of the penalties against values worked by hand."""

import numpy as np
import pytest

from sparsefit.regression.objective import Penalty, lasso_penalty


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


def test_blocks_within_blocks_and_a_ridge_add_up_worked_by_hand():
    # |V| = 5 over both; |3| + |4| within at 0.5; rho/2 |V|^2 = 0.1 * 25.
    values = np.array([[3.0], [4.0]])
    inner = Penalty(np.arange(2), np.full(2, 0.5), joint=False)
    penalty = Penalty(np.zeros(2, dtype=np.intp), np.ones(1), True, within=inner, ridge=0.2)
    assert penalty.norm(values) == pytest.approx(8.5)
    assert penalty.value(values) == pytest.approx(11.0)


def slow_dual_norm(values, groups, omega, parts, shrink):
    """max over the groups of tau, where the soft part of |V_h| at tau has the norm tau omega."""
    worst = 0.0
    for g, weight in enumerate(omega):
        low, high = 0.0, 1e6
        sizes = [
            (np.linalg.norm(values[(parts == h) & (groups == g)]), shrink[h])
            for h in np.unique(parts[groups == g])
        ]
        for _ in range(200):
            tau = 0.5 * (low + high)
            excess = sum(max(size - tau * part, 0.0) ** 2 for size, part in sizes)
            low, high = (tau, high) if excess > (tau * weight) ** 2 else (low, tau)
        worst = max(worst, high)
    return worst


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("targets", [1, 2])
def test_the_dual_norm_of_blocks_within_blocks_is_that_of_bisection(seed, targets):
    rng = np.random.default_rng(seed)
    groups = np.array([0, 1, 0, 2, 1, 2, 2, 3])
    parts = np.array([0, 1, 0, 2, 3, 4, 4, 5])
    values = rng.normal(size=(8, targets)) * 10.0 ** rng.integers(-3, 3)
    omega, shrink = rng.uniform(0.1, 2.0, 4), rng.uniform(0.1, 2.0, 6)
    inner = Penalty(parts, shrink, joint=True)
    penalty = Penalty(groups, omega, joint=True, within=inner)
    expected = slow_dual_norm(values, groups, omega, parts, shrink)
    found = penalty.dual_norms(values).item()
    assert found == pytest.approx(expected, rel=1e-12)
    # Several at once, and it is the dual: <C, V> <= dual(C) Omega(V), and no smaller.
    assert penalty.dual_norms(np.stack([values, 3 * values])).ravel() == pytest.approx(
        [found, 3 * found], rel=1e-12
    )
    others = rng.normal(size=(500, 8, targets))
    assert np.all((others * values).sum(axis=(1, 2)) <= found * penalty.norm(others) * (1 + 1e-12))
