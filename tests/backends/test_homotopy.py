"""The homotopy path against scikit-learn, identities, and the optimality conditions themselves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from sparsefit.backends import loops
from sparsefit.backends.active_set import DEPENDENT, FINE, SINGULAR, ActiveSet
from sparsefit.backends.homotopy import HomotopyPath, lasso_path
from sparsefit.backends.loops import Loop, loop_of

Array = NDArray[np.float64]
LOOPS: tuple[Loop, ...] = ("compiled", "python")
COMPILED = "sparsefit.backends.compiled.homotopy_walk"
BUILT = LOOPS if loop_of("lasso") == "compiled" else LOOPS[1:]


@pytest.fixture(params=LOOPS)
def loop(request: pytest.FixtureRequest) -> Loop:
    """Each of the two loops; the compiled one where it was built."""
    if request.param == "compiled":
        pytest.importorskip(COMPILED)
    chosen: Loop = request.param
    return chosen


def gram_of(design: Array, target: Array) -> tuple[Array, Array]:
    """G and c of columns scaled to unit rms; a dead column stays zero."""
    rms = np.sqrt((design**2).mean(axis=0))
    scaled = design / np.where(rms > 0, rms, 1.0)
    return scaled.T @ scaled / len(target), scaled.T @ target / len(target)


def fractions(cross: Array, last: float = 1e-3, points: int = 30) -> Array:
    return np.geomspace(1.0, last, points) * float(np.abs(cross).max())


def violation(gram: Array, cross: Array, path: HomotopyPath, alphas: Array) -> float:
    """Worst breach of |c - G w| <= alpha, w (c - G w) = alpha |w|, relative to max |c|."""
    residual = cross - path.weights @ gram
    excess = np.abs(residual).max(axis=1) - alphas
    mismatch = np.abs(path.weights) * np.abs(residual - alphas[:, None] * np.sign(path.weights))
    return float(max(excess.max(), mismatch.max())) / float(np.abs(cross).max())


def cellular(seed: int, samples: int, noise: float) -> tuple[Array, Array]:
    """Eight products of sines for each of 56 length scales along a smooth random curve."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0.0, 20.0, samples)
    position = [3.0 * time + rng.uniform(0, 5) + 2 * np.sin(f * time) for f in rng.uniform(1, 3, 2)]
    columns = []
    for scale in np.arange(1.0, 12.0 + 1e-9, 0.2):
        x, y = (np.pi * p / scale for p in position)
        sx, sy, cx, cy = np.sin(x), np.sin(y), np.cos(x), np.cos(y)
        columns += [sx, sy, cx, cy, sx * sy, sx * cy, cx * sy, cx * cy]
    x, y = np.pi * np.array(position) / rng.uniform(2, 10)
    target: Array = 8.0 * np.sin(x) * np.cos(y) + noise * rng.normal(size=samples)
    return np.stack(columns, axis=1), target


def degenerate(seed: int) -> tuple[Array, Array]:
    """Ties, duplicates, dead and dependent columns, too few samples, perfect fits."""
    rng = np.random.default_rng(seed)
    samples, columns = (int(n) for n in rng.integers(3, 60, 2))
    kind = seed % 6
    if kind == 0:
        whole = rng.integers(-1, 2, (samples, columns))
        return whole.astype(float), rng.integers(-2, 3, samples).astype(float)
    if kind == 1:
        design = rng.normal(size=(samples, columns))
        design[:, rng.integers(0, columns, columns // 2)] = design[:, :1]
        design[:, rng.integers(0, columns)] = 0.0
        return design, rng.normal(size=samples)
    if kind == 2:
        factor = rng.normal(size=(samples, 4)) @ rng.normal(size=(4, columns))
        return factor, rng.normal(size=samples)
    if kind == 3:
        design = rng.choice([-1.0, 1.0], size=(samples, columns))
        return design, design[:, 0].copy()
    if kind == 4:
        design = rng.integers(0, 2, (samples, columns)).astype(float)
        return design, design @ rng.integers(-1, 2, columns)
    pairs = np.kron(np.eye(samples), np.ones((2, 1)))
    design = np.hstack([np.eye(2 * samples), pairs, -pairs, np.ones((2 * samples, 1))])
    return design, rng.integers(-3, 4, 2 * samples).astype(float)


@pytest.mark.parametrize(("samples", "noise"), [(500, 0.0), (500, 2.0), (2000, 0.0), (2000, 2.0)])
def test_flight_libraries_are_solved_at_every_penalty(
    samples: int, noise: float, loop: Loop
) -> None:
    gram, cross = gram_of(*cellular(samples + int(noise), samples, noise))
    alphas = fractions(cross)
    path = lasso_path(gram, cross, alphas, loop)
    assert path.complete.all()
    assert violation(gram, cross, path, alphas) < 1e-10


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.integers(0, 10**6))
def test_both_loops_reach_the_same_optimum_of_degenerate_problems(seed: int) -> None:
    """Weights of repeated columns are not unique; fit, penalty and objective are."""
    gram, cross = gram_of(*degenerate(seed))
    alphas = fractions(cross)
    paths = [lasso_path(gram, cross, alphas, loop) for loop in BUILT]
    for path in paths:
        assert path.complete.all()
        if np.abs(cross).max() > 1e-12:
            assert violation(gram, cross, path, alphas) < 1e-9
    scale = float(np.abs(cross).max())
    fits = [path.weights @ gram for path in paths]
    lengths = [np.abs(path.weights).sum(axis=1) for path in paths]
    np.testing.assert_allclose(fits[-1], fits[0], atol=1e-8 * scale)
    np.testing.assert_allclose(lengths[-1], lengths[0], rtol=1e-7, atol=1e-8 * scale)


@pytest.mark.parametrize("seed", range(4))
def test_objective_is_that_of_scikit_learn_lars(seed: int, loop: Loop) -> None:
    linear_model = pytest.importorskip("sklearn.linear_model")
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(60, 5)) @ rng.normal(size=(5, 25)) + 0.3 * rng.normal(size=(60, 25))
    target = rng.normal(size=60)
    gram, cross = design.T @ design / 60, design.T @ target / 60
    alphas = fractions(cross, points=8)
    path = lasso_path(gram, cross, alphas, loop)
    for alpha, weights in zip(alphas, path.weights, strict=True):
        peer = linear_model.LassoLars(alpha=alpha, fit_intercept=False).fit(design, target)
        np.testing.assert_allclose(weights, peer.coef_, atol=1e-9 * np.abs(weights).max() + 1e-12)


def test_objective_is_that_of_coordinate_descent(loop: Loop) -> None:
    linear_model = pytest.importorskip("sklearn.linear_model")
    design, target = degenerate(7)
    gram, cross = design.T @ design / len(target), design.T @ target / len(target)
    alphas = fractions(cross, last=0.05, points=6)
    path = lasso_path(gram, cross, alphas, loop)
    _, peer, _ = linear_model.lasso_path(design, target, alphas=alphas, tol=1e-13, max_iter=10**6)
    for weights, other, alpha in zip(path.weights, peer.T, alphas, strict=True):
        ours, theirs = (
            0.5 * w @ gram @ w - cross @ w + alpha * np.abs(w).sum() for w in (weights, other)
        )
        assert ours <= theirs + 1e-12
        assert ours == pytest.approx(theirs, rel=1e-7)


def test_two_columns_by_hand(loop: Loop) -> None:
    """rho = 1/2, c = (2, 3/2): the second enters where 3/2 - (2 - alpha)/2 = alpha, at alpha = 1.

    Below, G w = c - alpha gives w1 + w2/2 = 2 - alpha, w1/2 + w2 = 3/2 - alpha.
    """
    gram, cross = np.array([[1.0, 0.5], [0.5, 1.0]]), np.array([2.0, 1.5])
    path = lasso_path(gram, cross, np.array([3.0, 2.0, 1.5, 1.0, 0.4, 0.0]), loop)
    expected = np.array([[0, 0], [0, 0], [0.5, 0], [1, 0], [1.4, 0.4], [5 / 3, 2 / 3]])
    np.testing.assert_allclose(path.weights, expected, atol=1e-15)
    assert path.complete.all()


def test_orthonormal_columns_give_soft_thresholding(loop: Loop) -> None:
    cross = np.array([3.0, -2.0, 0.5, 0.0, -2.0])
    alphas = np.array([3.0, 2.0, 1.0, 0.1])
    path = lasso_path(np.eye(5), cross, alphas, loop)
    expected = np.sign(cross) * np.maximum(np.abs(cross) - alphas[:, None], 0.0)
    np.testing.assert_allclose(path.weights, expected, atol=1e-15)


def test_permuted_and_flipped_columns_permute_and_flip_the_weights(loop: Loop) -> None:
    rng = np.random.default_rng(3)
    design, target = rng.normal(size=(40, 30)), rng.normal(size=40)
    gram, cross = gram_of(design, target)
    order, flip = rng.permutation(30), rng.choice([-1.0, 1.0], 30)
    alphas = fractions(cross)
    direct = lasso_path(gram, cross, alphas, loop).weights
    gram, cross = (gram * np.outer(flip, flip))[np.ix_(order, order)], (flip * cross)[order]
    turned = lasso_path(gram, cross, alphas, loop)
    np.testing.assert_allclose(turned.weights, (direct * flip)[:, order], atol=1e-10)


@pytest.mark.parametrize("units", [1e-150, 1e-9, 1e9, 1e150])
def test_units_of_the_target_do_not_matter(units: float, loop: Loop) -> None:
    gram, cross = gram_of(*cellular(1, 300, 1.0))
    gram, cross = gram[:60, :60], cross[:60]
    plain = lasso_path(gram, cross, fractions(cross), loop).weights
    scaled = lasso_path(gram, units * cross, fractions(units * cross), loop)
    assert scaled.complete.all()
    np.testing.assert_allclose(scaled.weights / units, plain, atol=1e-9 * np.abs(plain).max())


def test_units_of_the_columns_only_scale_the_weights(loop: Loop) -> None:
    gram, cross = gram_of(*degenerate(6))
    alphas = fractions(cross)
    plain = lasso_path(gram, cross, alphas, loop).weights
    np.testing.assert_allclose(
        lasso_path(2.0**40 * gram, cross, alphas, loop).weights * 2.0**40, plain
    )


def test_nothing_to_explain_is_zero_and_complete(loop: Loop) -> None:
    path = lasso_path(np.eye(3), np.zeros(3), np.array([1.0, 0.5, 0.0]), loop)
    assert path.complete.all()
    assert path.steps == 0
    assert not path.weights.any()


def test_no_columns_and_no_penalties(loop: Loop) -> None:
    assert lasso_path(np.empty((0, 0)), np.empty(0), np.array([1.0]), loop).weights.shape == (1, 0)
    assert lasso_path(np.eye(2), np.ones(2), np.empty(0), loop).weights.shape == (0, 2)


def test_penalties_may_repeat_or_start_low(loop: Loop) -> None:
    gram, cross = gram_of(*degenerate(6))
    alphas = 0.1 * np.abs(cross).max() * np.ones(3)
    path = lasso_path(gram, cross, alphas, loop)
    assert path.complete.all()
    np.testing.assert_allclose(path.weights[2], path.weights[0], atol=1e-12)


@pytest.mark.parametrize("alphas", [[0.1, 0.2], [1.0, -0.5]])
def test_ascending_or_negative_penalties_are_refused(alphas: list[float], loop: Loop) -> None:
    with pytest.raises(ValueError, match="descend"):
        lasso_path(np.eye(2), np.ones(2), np.array(alphas), loop)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_never_complete(bad: float, loop: Loop) -> None:
    gram, cross = np.eye(3), np.ones(3)
    assert not lasso_path(gram, np.array([1.0, bad, 0.0]), np.array([0.5]), loop).complete.any()
    gram[0, 1] = bad
    assert not lasso_path(gram, cross, np.array([0.5]), loop).complete.any()


def test_an_impossible_problem_is_incomplete(loop: Loop) -> None:
    """G_22 = 0 with c_2 != 0 is unbounded below: no design has it, and none is invented."""
    path = lasso_path(np.diag([1.0, 0.0]), np.array([1.0, 2.0]), np.array([1.5, 0.5]), loop)
    assert not path.complete.any()


def near_twins(seed: int, samples: int = 120, columns: int = 48) -> tuple[Array, Array]:
    """A quarter of the columns differs from others in the ninth digit: G cannot tell them."""
    rng = np.random.default_rng(seed)
    design, target = cellular(seed, samples, 0.5)
    design = design[:, rng.choice(design.shape[1], columns, replace=False)]
    to, source = rng.choice(columns, columns // 4, replace=False), rng.integers(0, columns, 12)
    design[:, to] = design[:, source] + 1e-9 * rng.normal(size=(samples, columns // 4))
    return design, target


@pytest.mark.parametrize("seed", range(12))
def test_columns_that_the_gram_matrix_cannot_tell_apart_are_exchanged(
    seed: int, loop: Loop
) -> None:
    gram, cross = gram_of(*near_twins(seed))
    alphas = fractions(cross, last=1e-4)
    path = lasso_path(gram, cross, alphas, loop)
    assert path.complete.all()
    assert violation(gram, cross, path, alphas) < 1e-9


@pytest.mark.parametrize(
    ("samples", "noise", "units"),
    [(500, 0.0, 1.0), (500, 2.0, 1e-12), (2000, 2.0, 1e12), (60, 1.0, 1.0), (2000, 0.0, 1.0)],
)
def test_both_loops_walk_the_same_path(samples: int, noise: float, units: float) -> None:
    pytest.importorskip(COMPILED)
    gram, cross = gram_of(*cellular(3 * samples + 1, samples, noise))
    alphas = fractions(units * cross)
    fast, slow = (lasso_path(gram, units * cross, alphas, loop) for loop in LOOPS)
    assert (fast.loop, slow.loop) == LOOPS
    assert fast.steps == slow.steps
    np.testing.assert_array_equal(fast.weights != 0, slow.weights != 0)
    np.testing.assert_allclose(
        fast.weights, slow.weights, rtol=0, atol=1e-10 * np.abs(slow.weights).max()
    )


def test_what_the_compiled_loop_cannot_read_is_refused() -> None:
    compiled = pytest.importorskip(COMPILED)
    done = np.zeros(1, bool)
    with pytest.raises(ValueError, match="gram"):
        compiled.path(np.eye(2), np.ones(3), np.ones(1), np.zeros((1, 3)), done)
    with pytest.raises((ValueError, BufferError)):
        compiled.path(np.ones((4, 4))[:, ::2], np.ones(2), np.ones(1), np.zeros((1, 2)), done)
    frozen = np.zeros((1, 2))
    frozen.flags.writeable = False
    with pytest.raises((ValueError, BufferError)):
        compiled.path(np.eye(2), np.ones(2), np.ones(1), frozen, done)


@pytest.mark.parametrize("loop", BUILT)
@pytest.mark.parametrize("alphas", [[np.nan], [0.5, np.nan], [-0.1]])
def test_penalties_that_are_none_are_refused(loop: Loop, alphas: list[float]) -> None:
    with pytest.raises(ValueError, match="alphas"):
        lasso_path(np.eye(2), np.ones(2), np.array(alphas), loop)


@pytest.mark.parametrize("alpha", [np.nan, -1.0])
def test_the_compiled_loop_stops_at_penalties_that_are_none(alpha: float) -> None:
    compiled = pytest.importorskip(COMPILED)
    weights, complete = np.zeros((1, 2)), np.zeros(1, bool)
    steps = compiled.path(np.eye(2), np.array([1.0, 0.5]), np.array([alpha]), weights, complete)
    assert steps <= 4  # beyond, columns were entered again and again, past the end of arrays


def test_without_the_compiled_loop_python_runs_and_says_so(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(loops, "_compiled", lambda name: "no compiler")
    assert loop_of("lasso") == "python"
    assert loop_of("least-squares") is None
    assert lasso_path(np.eye(2), np.ones(2), np.array([0.5])).loop == "python"
    with pytest.raises(ImportError, match="no compiler"):
        lasso_path(np.eye(2), np.ones(2), np.array([0.5]), "compiled")


def test_active_set_inverse_survives_many_changes() -> None:
    rng = np.random.default_rng(5)
    design = rng.normal(size=(50, 6)) @ rng.normal(size=(6, 20)) + 0.05 * rng.normal(size=(50, 20))
    gram, _ = gram_of(design, design[:, 0])
    active = ActiveSet(gram)
    for _ in range(400):
        outside = np.setdiff1d(np.arange(20), active.index[: active.n])
        if active.n and (not len(outside) or rng.random() < 0.5):
            position = int(rng.integers(active.n))
            assert active.leaving(position) == FINE
            active.leave(position)
        else:
            column, sign = int(rng.choice(outside)), float(rng.choice([-1.0, 1.0]))
            assert active.entering(column, sign) == FINE
            active.enter()
    n, columns, signs = active.n, active.index[: active.n], active.sign[: active.n]
    block = gram[np.ix_(columns, columns)] * np.outer(signs, signs)
    np.testing.assert_allclose(block @ active.inverse[:n, :n], np.eye(n), atol=1e-8)


def test_active_set_sees_dependence_and_reports_singular_blocks() -> None:
    active = ActiveSet(np.ones((2, 2)))
    active.entering(0, 1.0)
    active.enter()
    assert active.entering(1, -1.0) == DEPENDENT
    active.pivot = 1.0
    active.enter()
    assert active.rebuilt(1.0) == SINGULAR
