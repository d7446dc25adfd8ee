"""The group-LASSO path in Gram space against certificates, identities and other solvers."""

from __future__ import annotations

import warnings
from concurrent.futures import ThreadPoolExecutor

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from sklearn.linear_model import Lasso

from sparsefit.backends import loops
from sparsefit.backends.loops import Loop, loaded, loop_of
from sparsefit.backends.variational import GroupPath, group_path
from sparsefit.backends.variational_point import FINE, Point, Problem, evaluate
from tests.odd_flights import odd_problem

Array = NDArray[np.float64]
Labels = NDArray[np.int64]
built = pytest.mark.skipif(loop_of("group-lasso") != "compiled", reason="not built")
LOOPS = ["python", pytest.param("compiled", marks=built)]


def norms(matrix: Array, groups: Labels) -> Array:
    return np.sqrt(np.bincount(groups, np.sum(matrix**2, axis=1)))


def unit_columns(theta: Array) -> Array:
    rms = np.sqrt(np.mean(theta**2, axis=0))
    return theta / np.where(rms > 0, rms, 1.0)


def penalties(z: Array, y: Array, groups: Labels, omega: Array, points: int, ratio: float) -> Array:
    highest = np.max(norms(z.T @ y / len(z), groups) / omega)
    return float(highest) * np.geomspace(1.0, ratio, points)


def solve(
    z: Array,
    y: Array,
    groups: Labels,
    omega: Array,
    alphas: Array,
    tolerance: float = 1e-10,
    loop: Loop | None = None,
) -> GroupPath:
    m, square = len(z), np.sum(y**2) / len(z)
    return group_path(
        *(z.T @ z / m, z.T @ y / m, groups, omega, alphas, square),
        tolerance=tolerance,
        loop=loop,
    )


def objective(z: Array, y: Array, w: Array, groups: Labels, omega: Array, alpha: float) -> float:
    fit = np.sum((y - z @ w) ** 2) / (2 * len(z))
    return float(fit + alpha * omega @ norms(w, groups))


def row_gap(z: Array, y: Array, w: Array, groups: Labels, omega: Array, alpha: float) -> float:
    """Relative duality gap from the rows: the slow, independent certificate."""
    m, residual = len(z), y - z @ w
    top = float(np.max(norms(z.T @ residual / m, groups) / omega))
    limit = alpha / max(top, 1e-300)
    square, product = float(np.sum(residual**2)), float(np.sum(residual * y))
    s = float(np.clip(product / max(square, 1e-300), -limit, limit))
    dual = (s * product - s**2 * square / 2) / m
    gap = objective(z, y, w, groups, omega, alpha) - dual
    return gap / (float(np.sum(y**2)) / (2 * m))


def worst_gap(
    z: Array, y: Array, path: GroupPath, groups: Labels, omega: Array, alphas: Array
) -> float:
    return max(
        row_gap(z, y, w, groups, omega, float(a)) for w, a in zip(path.weights, alphas, strict=True)
    )


def flight(
    length: float, targets: int, noise: float, samples: int = 500
) -> tuple[Array, Array, Labels]:
    """A drifting vehicle in a cellular flow; the paper's 56 scales of 8 candidates."""
    rng = np.random.default_rng(7)
    state, rows, flow = np.array([1.0, 2.0, 0.0, 0.0]), [], []
    for _ in range(samples):
        a, b = np.pi * state[:2] / length
        w = 8.0 * np.array([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b)])
        rows.append(state[:2].copy())
        flow.append(w)
        rate = np.concatenate([state[2:], (w - state[2:]) / 0.5 + (5.0, 3.0)])
        state = state + 0.01 * rate
    x, y = np.pi * np.array(rows).T[:, :, None] / np.arange(1.0, 12.01, 0.2)
    single = [np.sin(x), np.sin(y), np.cos(x), np.cos(y)]
    both = [np.sin(x) * np.sin(y), np.sin(x) * np.cos(y), np.cos(x) * np.sin(y)]
    theta = np.stack([*single, *both, np.cos(x) * np.cos(y)], axis=2).reshape(samples, -1)
    target = np.array(flow)[:, :targets]
    target = target + noise * rng.standard_normal(target.shape)
    return unit_columns(theta), target, np.repeat(np.arange(56), 8)


def ragged(seed: int, targets: int) -> tuple[Array, Array, Labels, Array]:
    """Groups of unequal sizes with shuffled columns, and penalty weights that differ."""
    rng = np.random.default_rng(seed)
    groups = rng.permutation(np.repeat(np.arange(6), [1, 2, 3, 5, 7, 4]))
    z = unit_columns(rng.standard_normal((60, groups.size)))
    y = z[:, groups == 2] @ rng.standard_normal((3, targets)) + rng.standard_normal((60, targets))
    return z, y, groups, rng.uniform(0.5, 2.0, 6)


@pytest.mark.parametrize("targets", [1, 2])
@pytest.mark.parametrize(("length", "noise"), [(5.0, 0.0), (4.13, 0.5), (6.57, 0.0)])
def test_flight_path_is_certified(length: float, noise: float, targets: int) -> None:
    z, y, groups = flight(length, targets, noise)
    omega = np.ones(56)
    alphas = penalties(z, y, groups, omega, 30, 1e-3)
    path = solve(z, y, groups, omega, alphas)
    assert path.complete.all()
    assert worst_gap(z, y, path, groups, omega, alphas) < 2e-10


@pytest.mark.parametrize("targets", [1, 2, 4])
def test_gram_gap_is_the_gap_of_the_rows(targets: int) -> None:
    z, y, groups, omega = ragged(1, targets)
    alphas = penalties(z, y, groups, omega, 8, 1e-2)
    path = solve(z, y, groups, omega, alphas, tolerance=1e-13)
    assert path.complete.all()
    assert worst_gap(z, y, path, groups, omega, alphas) < 1e-12


@pytest.mark.parametrize("targets", [1, 3])
def test_agrees_with_a_cone_solver(targets: int) -> None:
    z, y, groups, omega = ragged(2, targets)
    alpha = float(penalties(z, y, groups, omega, 2, 0.1)[1])
    w = cp.Variable((z.shape[1], targets))
    size = cp.hstack([cp.norm(cp.vec(w[groups == g], order="F")) for g in range(6)])
    loss = cp.sum_squares(y - z @ w) / (2 * len(z))
    problem = cp.Problem(cp.Minimize(loss + alpha * omega @ size))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem.solve(solver=cp.CLARABEL)
    ours = solve(z, y, groups, omega, np.array([alpha])).weights[0]
    assert objective(z, y, ours, groups, omega, alpha) <= problem.value + 1e-8
    np.testing.assert_allclose(ours, w.value, atol=1e-4)


def test_zero_at_and_above_the_highest_penalty() -> None:
    z, y, groups, omega = ragged(3, 2)
    highest = penalties(z, y, groups, omega, 1, 1.0)[0] * (1 + 1e-12)
    path = solve(z, y, groups, omega, highest * np.array([3.0, 1.0, 0.99]))
    assert path.complete.all()
    assert not path.weights[:2].any()
    assert path.weights[2].any()


def test_groups_of_one_are_the_lasso() -> None:
    z, y, _, _ = ragged(4, 1)
    groups, omega = np.arange(z.shape[1]), np.ones(z.shape[1])
    alphas = penalties(z, y, groups, omega, 5, 1e-2)
    path = solve(z, y, groups, omega, alphas)
    for w, alpha in zip(path.weights, alphas, strict=True):
        reference = Lasso(alpha=alpha, fit_intercept=False, tol=1e-13, max_iter=100_000)
        np.testing.assert_allclose(w[:, 0], reference.fit(z, y[:, 0]).coef_, atol=1e-6)


def test_orthonormal_columns_shrink_blocks() -> None:
    rng = np.random.default_rng(5)
    z = np.linalg.qr(rng.standard_normal((40, 12)))[0] * np.sqrt(40)
    y, groups = rng.standard_normal((40, 3)), np.arange(12) % 4
    cross = z.T @ y / 40
    alpha = 0.6 * float(np.max(norms(cross, groups)))
    shrink = np.maximum(0.0, 1.0 - alpha / norms(cross, groups))[groups, None]
    w = solve(z, y, groups, np.ones(4), np.array([alpha]), tolerance=1e-14).weights[0]
    np.testing.assert_allclose(w, shrink * cross, atol=1e-9)


def test_permuted_columns_and_groups_permute_weights() -> None:
    z, y, groups, omega = ragged(6, 2)
    rng = np.random.default_rng(0)
    columns, names = rng.permutation(z.shape[1]), rng.permutation(6)
    renamed = np.empty(6)
    renamed[names] = omega
    alphas = penalties(z, y, groups, omega, 6, 1e-2)
    plain = solve(z, y, groups, omega, alphas, tolerance=1e-14).weights
    moved = solve(z[:, columns], y, names[groups][columns], renamed, alphas, tolerance=1e-14)
    np.testing.assert_allclose(moved.weights, plain[:, columns], atol=1e-7)


def test_repeated_samples_change_nothing() -> None:
    z, y, groups, omega = ragged(7, 2)
    alphas = penalties(z, y, groups, omega, 6, 1e-2)
    once = solve(z, y, groups, omega, alphas, tolerance=1e-14).weights
    twice = solve(np.vstack([z, z]), np.vstack([y, y]), groups, omega, alphas, tolerance=1e-14)
    np.testing.assert_allclose(twice.weights, once, atol=1e-7)


def test_order_of_penalties_does_not_matter() -> None:
    z, y, groups, omega = ragged(8, 1)
    alphas = penalties(z, y, groups, omega, 6, 1e-3)
    down = solve(z, y, groups, omega, alphas, tolerance=1e-14)
    up = solve(z, y, groups, omega, alphas[::-1], tolerance=1e-14)
    assert down.complete.all()
    assert up.complete.all()
    np.testing.assert_allclose(up.weights[::-1], down.weights, atol=1e-7)


@pytest.mark.parametrize("unit", [1e-120, 1e-9, 1e9, 1e120])
def test_units_of_the_target_scale_the_weights(unit: float) -> None:
    z, y, groups, omega = ragged(9, 2)
    alphas = penalties(z, y, groups, omega, 6, 1e-2)
    plain = solve(z, y, groups, omega, alphas, tolerance=1e-14).weights
    scaled = solve(z, y * unit, groups, omega, alphas * unit, tolerance=1e-14)
    np.testing.assert_allclose(scaled.weights / unit, plain, atol=1e-7)


def test_no_correlation_gives_zero() -> None:
    path = group_path(np.eye(4), np.zeros((4, 2)), [0, 0, 1, 1], [1.0, 1.0], [1.0, 0.1], 3.0)
    assert path.complete.all()
    assert not path.weights.any()
    assert not path.gaps.any()


def test_unreachable_tolerance_is_reported() -> None:
    z, y, groups = flight(5.0, 1, 0.3)
    alphas = penalties(z, y, groups, np.ones(56), 4, 1e-3)
    path = solve(z, y, groups, np.ones(56), alphas, tolerance=0.0)
    assert not path.complete[1:].all()
    assert path.gaps.max() < 1e-12


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    samples=st.integers(2, 40),
    rank=st.integers(1, 12),
    targets=st.integers(1, 4),
    copies=st.booleans(),
    exact=st.booleans(),
)
def test_degenerate_problems_are_certified(
    seed: int, samples: int, rank: int, targets: int, copies: bool, exact: bool
) -> None:
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((samples, rank)) @ rng.standard_normal((rank, 16))
    other = half if copies else rng.standard_normal((samples, 16))
    z = unit_columns(np.hstack([half, other, np.zeros((samples, 2))]))
    groups = np.concatenate([np.repeat(np.arange(8), 4), [8, 8]])
    weights = rng.standard_normal((z.shape[1], targets))
    y = z @ weights if exact else rng.standard_normal((samples, targets))
    omega = rng.uniform(0.5, 2.0, 9)
    alphas = penalties(z, y, groups, omega, 12, 1e-3)
    path = solve(z, y, groups, omega, alphas, tolerance=1e-9)
    assert path.complete.all()
    assert worst_gap(z, y, path, groups, omega, alphas) < 1e-8


@built
@pytest.mark.parametrize("targets", [1, 2, 4, 6])
@pytest.mark.parametrize("seed", range(4))
def test_the_compiled_loop_finds_the_weights_of_the_one_in_python(seed: int, targets: int) -> None:
    z, y, groups, omega = ragged(seed, targets)
    alphas = penalties(z, y, groups, omega, 15, 1e-3)
    slow = solve(z, y, groups, omega, alphas, 1e-14, "python")
    fast = solve(z, y, groups, omega, alphas, 1e-14, "compiled")
    assert (slow.loop, fast.loop) == ("python", "compiled")
    assert slow.complete.all()
    assert fast.complete.all()
    scale = float(np.abs(slow.weights).max())
    np.testing.assert_allclose(fast.weights, slow.weights, rtol=1e-9, atol=1e-9 * scale)


@built
@pytest.mark.parametrize("targets", [1, 2])
@pytest.mark.parametrize(("length", "noise"), [(5.0, 0.0), (4.13, 0.5), (6.57, 0.0)])
def test_both_loops_fit_a_rank_deficient_flight_alike(
    length: float, noise: float, targets: int
) -> None:
    z, y, groups = flight(length, targets, noise, samples=300)
    omega = np.ones(56)
    alphas = penalties(z, y, groups, omega, 20, 1e-3)
    slow = solve(z, y, groups, omega, alphas, 1e-11, "python")
    fast = solve(z, y, groups, omega, alphas, 1e-11, "compiled")
    assert slow.complete.all()
    assert fast.complete.all()
    assert worst_gap(z, y, fast, groups, omega, alphas) < 2e-11
    # The loss is strongly convex in Z W: |Z (V - W)|^2 / 2m <= gap of V + gap of W.
    apart = np.sum((z @ (fast.weights - slow.weights)) ** 2, axis=(1, 2)) / np.sum(y**2)
    assert np.all(apart <= 2 * (slow.gaps + fast.gaps) + 1e-20)


@built
@settings(max_examples=80, deadline=None, derandomize=True)
@given(
    seed=st.integers(0, 10**6),
    samples=st.integers(1, 40),
    rank=st.integers(1, 12),
    targets=st.integers(1, 5),
    copies=st.booleans(),
    exact=st.booleans(),
    unit=st.sampled_from([1e-100, 1e-12, 1.0, 1e12, 1e100]),
)
def test_both_loops_are_certified_on_degenerate_problems(
    seed: int, samples: int, rank: int, targets: int, copies: bool, exact: bool, unit: float
) -> None:
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((samples, rank)) @ rng.standard_normal((rank, 14))
    other = half if copies else rng.standard_normal((samples, 14))
    z = unit_columns(np.hstack([half, other, np.zeros((samples, 2))]))
    groups = rng.permutation(np.repeat(np.arange(9), [1, 2, 6, 4, 1, 3, 8, 3, 2]))
    weights = rng.standard_normal((z.shape[1], targets))
    y = (z @ weights if exact else rng.standard_normal((samples, targets))) * unit
    y[:, 1:2] = 0.0
    omega = rng.uniform(0.1, 10.0, 9)
    alphas = penalties(z, y, groups, omega, 10, 1e-3)
    both: tuple[Loop, ...] = ("python", "compiled")
    for loop in both:
        path = solve(z, y, groups, omega, alphas, 1e-9, loop)
        assert path.complete.all(), loop
        scaled = GroupPath(path.weights / unit, path.iterations, path.gaps, path.complete, loop)
        assert worst_gap(z, y / unit, scaled, groups, omega, alphas / unit) < 1e-8, loop


@built
def test_threads_do_not_disturb_each_other() -> None:
    made = [ragged(seed, 2) for seed in range(8)]
    inputs = [(*p, penalties(*p, 20, 1e-3)) for p in made]
    alone = [solve(*one, loop="compiled").weights for one in inputs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda one: solve(*one, loop="compiled").weights, inputs))
    for one, other in zip(alone, together, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("loop", LOOPS)
def test_arrays_that_do_not_fit_are_refused(loop: Loop) -> None:
    search = loaded("group-lasso", loop)[0]
    gram, cross, starts = np.eye(4), np.ones((1, 4)), np.array([0, 2, 4])
    out = np.zeros((1, 1, 4)), np.zeros(1, np.intp), np.zeros(1)
    search.path(gram, cross, starts, np.ones(1), 1e-9, *out)
    for wrong in (np.array([0, 2, 3]), np.array([0, 5, 4]), np.array([0, 2, 2, 4])):
        with pytest.raises(ValueError, match="do not fit"):
            search.path(gram, cross, wrong, np.ones(1), 1e-9, *out)
    with pytest.raises(ValueError, match="do not fit"):
        search.path(gram, cross, starts, np.ones(2), 1e-9, *out)


def test_without_the_compiled_loop_the_one_in_python_runs_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    z, y, groups, omega = ragged(0, 2)
    alphas = penalties(z, y, groups, omega, 5, 1e-2)
    monkeypatch.setattr(loops, "_compiled", lambda name: "no compiler")
    assert loop_of("group-lasso") == "python"
    assert solve(z, y, groups, omega, alphas).loop == "python"
    with pytest.raises(ImportError, match="no compiler"):
        solve(z, y, groups, omega, alphas, loop="compiled")


@pytest.mark.parametrize("loop", LOOPS)
def test_a_curvature_lost_to_rounding_does_not_stall_the_path(loop: Loop) -> None:
    """A flight with groups that have no power in the direction of their correlation."""
    problem = odd_problem(60241)[1]
    known = problem.statistics
    groups, omega = problem.groups, np.ones(int(problem.groups.max()) + 1)
    alphas = float(np.max(norms(known.cross, groups))) * np.geomspace(1.0, 1e-4, 30)
    square = float(known.target_square.sum())
    path = group_path(
        known.gram, known.cross, groups, omega, alphas, square, tolerance=1e-10, loop=loop
    )
    assert path.complete.all()
    z = unit_columns(problem.theta)
    assert worst_gap(z, problem.target, path, groups, omega, alphas) < 1e-9


def test_a_curvature_that_cancels_is_small_and_positive() -> None:
    # G = diag(1, 1e-18) and C = (0, c): A = I + eta G has the entry 1 for c, and H = 0 / eta.
    gram, cross = np.diag([1.0, 1e-18]), np.array([[0.0, 1e-3]])
    point = Point(1, 2, 1)
    point.eta[0] = 4.0
    assert evaluate(Problem(gram, cross, np.array([0, 2])), point) == FINE
    assert 0.0 < point.hessian[0, 0] < 1e-13 * 1e-6 / 4.0


def test_a_loop_that_scipy_does_not_suit_is_not_said_to_run(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(name: str) -> None:
        raise TypeError("C function scipy.linalg.cython_blas.dgemm has wrong signature")

    monkeypatch.setattr(loops, "import_module", refuse)
    loops._compiled.cache_clear()
    try:
        assert loop_of("group-lasso") == "python"
        with pytest.raises(ImportError, match="wrong signature"):
            loaded("group-lasso", "compiled")
    finally:
        loops._compiled.cache_clear()


@pytest.mark.parametrize("loop", LOOPS)
def test_a_penalty_that_is_none_ends_the_loop_quietly(
    loop: Loop, capfd: pytest.CaptureFixture[str]
) -> None:
    weights, spent, gaps = np.zeros((1, 1, 2)), np.zeros(1, np.intp), np.zeros(1)
    statistics = np.eye(2), np.array([[0.6, 0.3]]), np.array([0, 1, 2])
    search = loaded("group-lasso", loop)[0]
    with np.errstate(all="ignore"):
        search.path(*statistics, np.array([np.nan]), 1e-9, weights, spent, gaps)
    assert not weights.any()
    assert capfd.readouterr() == ("", "")  # LAPACK complains of an empty matrix
