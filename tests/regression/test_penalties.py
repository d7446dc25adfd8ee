"""Penalties against a conic solver, finite differences and what defines them."""

import cvxpy
import numpy as np
import pytest

from sparsefit.penalties import (
    AbsoluteValues,
    BoundedValues,
    FusedNorm,
    GroupNorms,
    NestedNorms,
    Penalty,
    SortedNorm,
)

K, N = 12, 2
GROUPS = np.repeat(np.arange(4), 3)
DRAW = np.random.default_rng(7)
SUBGROUPS = np.arange(K) // 3 * 2 + (np.arange(K) % 3 > 0)
OUTER = GroupNorms(GROUPS, np.ones(4))
PENALTIES = {
    "lasso": AbsoluteValues(DRAW.uniform(0.5, 2, K)),
    "non-negative": BoundedValues(np.ones(K), np.zeros(K), np.full(K, np.inf)),
    "box": BoundedValues(np.ones(K), np.full(K, -0.5), np.full(K, 0.7)),
    "groups": GroupNorms(GROUPS, DRAW.uniform(0.5, 2, 4)),
    "groups, separate": GroupNorms(GROUPS, DRAW.uniform(0.5, 2, 4), False),
    "sparse groups": NestedNorms(OUTER, AbsoluteValues(np.full(K, 0.5))),
    "subgroups": NestedNorms(OUTER, GroupNorms(SUBGROUPS, DRAW.uniform(0.3, 0.6, 8))),
    "slope": SortedNorm(np.linspace(2, 1, K)),
    "fused": FusedNorm(K, 0.3),
}
named = pytest.mark.parametrize("penalty", PENALTIES.values(), ids=PENALTIES.keys())


@named
@pytest.mark.parametrize("step", [0.3, 1.0])
def test_the_prox_minimises_what_it_says_and_the_slope_is_its_derivative(
    penalty: Penalty, step: float
) -> None:
    origin = np.random.default_rng(0).normal(size=(K, N)) * 1.5
    values = penalty.prox(origin, step)
    variable = cvxpy.Variable((K, N))
    norm, constraints = penalty.conic(variable, cvxpy)
    cost = 0.5 * cvxpy.sum_squares(variable - origin) + step * norm
    cvxpy.Problem(cvxpy.Minimize(cost), constraints).solve(solver="CLARABEL")
    assert np.allclose(variable.value, values, atol=1e-4)
    on, factor = penalty.slope(origin, values, step)
    derivative = np.zeros((K * N, K * N))
    square = np.eye(len(on)) if factor is None else (factor @ factor.T).todense()
    derivative[np.ix_(on, on)] = square
    small = 1e-6
    for i in range(K * N):
        push = small * np.eye(K * N)[i].reshape(K, N)
        rate = penalty.prox(origin + push, step) - penalty.prox(origin - push, step)
        assert np.allclose(derivative[:, i], rate.ravel() / (2 * small), atol=1e-7)
    by_coefficient = Penalty.slope(penalty, origin, values, step)
    if factor is None:  # separate coefficients: what a penalty without a slope gets is exact too
        assert np.array_equal(by_coefficient[0], on)
        assert np.allclose(by_coefficient[1].diagonal(), 1.0, atol=1e-6)


@named
def test_the_dual_norm_is_the_largest_product_in_the_unit_ball(penalty, monkeypatch):
    pull = np.random.default_rng(1).normal(size=(K, N))
    if not np.isfinite(getattr(penalty, "upper", np.array(np.inf))).any():  # a box is no gauge
        for targets in [slice(None)] if penalty.coupled else [slice(0, 1), slice(1, 2)]:
            variable = cvxpy.Variable(pull[:, targets].shape)
            norm, constraints = penalty.conic(variable, cvxpy)
            gain = cvxpy.sum(cvxpy.multiply(pull[:, targets], variable))
            program = cvxpy.Problem(cvxpy.Maximize(gain), [norm <= 1, *constraints])
            program.solve(solver="CLARABEL")
            assert penalty.dual_norm(pull[:, targets]).max() == pytest.approx(program.value, 1e-5)
    batch = np.stack([pull, 2 * pull])
    assert penalty.conjugate(batch, 1e9).tolist() == [[0.0] * N] * 2  # alpha is above the dual norm
    assert np.allclose(penalty.dual_norm(batch)[1], 2 * penalty.dual_norm(pull))
    dual = penalty.dual_norm(pull)
    assert np.allclose(penalty.block_dual_norms(pull).max(axis=0), dual)
    for name in ("dual_norm", "block_dual_norms"):  # without a closed form it follows from the prox
        monkeypatch.setattr(type(penalty), name, getattr(Penalty, name))
    assert np.allclose(penalty.dual_norm(pull), dual, rtol=1e-14)


@named
def test_some_columns_alone_have_the_penalty_of_the_others_at_zero(penalty: Penalty) -> None:
    index = np.flatnonzero(np.isin(GROUPS, [1, 3]))
    part = penalty.restricted(index)
    if part is None:
        assert isinstance(penalty, FusedNorm)
        return
    values = np.abs(np.random.default_rng(2).normal(size=(len(index), N))) * 0.2
    full = np.zeros((K, N))
    full[index] = values
    assert part.value(values) == pytest.approx(float(penalty.value(full)))
    assert np.allclose(part.prox(values, 0.05), penalty.prox(full, 0.05)[index])


def test_the_norm_bounds_a_wrong_dual_norm_from_below() -> None:
    class Odd(AbsoluteValues):
        def block_dual_norms(self, values):
            return 0.5 * super().block_dual_norms(values)

    pull = np.random.default_rng(3).normal(size=(K, N))
    assert np.array_equal(Odd(np.ones(K)).constraint(pull), np.abs(pull).max(axis=0))


def test_hand_values() -> None:
    column = np.array([[3.0], [-4.0]])
    both = NestedNorms(GroupNorms(np.zeros(2, int), np.ones(1)), AbsoluteValues(np.ones(2)))
    assert float(both.value(column)) == 12.0  # 5 + 7
    # (3/t - 1)_+^2 + (4/t - 1)_+^2 = 1 at t = (7 - sqrt(49 - 25)) / 1 ... : t^2 - 14 t + 25 = 0
    assert both.dual_norm(column)[0] == pytest.approx(7 - np.sqrt(24))
    for omega, size in ((30.0, (np.sqrt(22_499) - 7) / 898), (0.1, 4 / 1.1)):  # the 3 is below t
        nested = NestedNorms(GroupNorms(np.zeros(2, int), np.array([omega])), both.inner)
        assert nested.dual_norm(column)[0] == pytest.approx(size)
    slope = SortedNorm(np.array([2.0, 1.0]))
    assert float(slope.value(column)) == 11.0
    assert slope.dual_norm(column)[0] == pytest.approx(7 / 3)
    assert np.allclose(slope.prox(np.array([[3.0], [2.5]]), 1.0), [[1.25], [1.25]])
    for pull, violations in (((2.5, 0.7), (2.5, -1)), ((1.9, 1.5), (1.9, 1.5)), ((1, 1), (-1, -1))):
        columns = np.array([pull], float).T
        assert slope.violations(columns, np.zeros((2, 1)), 1.0).tolist() == list(violations)
        assert slope.violations(columns, np.ones((2, 1)), 1.0).tolist() == [-1.0, -1.0]
    fused = FusedNorm(3, 0.5)
    assert float(fused.value(np.array([[1.0], [1.0], [0.0]]))) == 1.5
    assert float(fused.rough(np.array([[1.0], [1.0], [0.0]]))) == 2.5  # jumps of 2 and 1
    # runs: all (6 / 1.5), the last two (5 / 1.5), the middle (2 / 1.5), the last (3 / 1)
    assert fused.dual_norm(np.array([[1.0], [2.0], [3.0]]))[0] == pytest.approx(4.0)
