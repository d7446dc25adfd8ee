"""The kernels by themselves: going on is going at once, compiled is generic, warm is cold."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.ordered_penalties import SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, BoundedValues, SquaredNorm
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers import exact, kernels, working_set
from sparsefit.solvers.descent import descent_path
from sparsefit.solvers.exact import exact_path
from sparsefit.solvers.kernels import BEGIN, KERNELS, STOP, kernel_for
from sparsefit.solvers.newton import relative_gap, solved_by_newton, towards_clusters_optimum
from sparsefit.solvers.working_set import Columns

homotopy = pytest.importorskip("sparsefit.solvers.homotopy", reason="it was not compiled")
variances = pytest.importorskip("sparsefit.solvers.variances", reason="it was not compiled")
K = 24


def penalties(k):
    groups, count = np.arange(k) // 3, k // 3
    uneven = GroupNorms(groups, np.linspace(0.5, 1.0, count))
    return {
        "LASSO": AbsoluteValues(np.ones(k)),
        "adaptive": AbsoluteValues(np.geomspace(0.1, 3.0, k)),
        "elastic net": AbsoluteValues(np.ones(k), ridge=0.3),
        "adaptive elastic net": AbsoluteValues(np.geomspace(0.1, 3.0, k), ridge=2.0),
        "SLOPE": SortedNorm(np.linspace(1.0, 0.3, k)),
        "groups": GroupNorms(groups, np.ones(count)),
        "weighted groups": GroupNorms(groups, np.linspace(0.5, 2.0, count)),
        "nested groups": NestedNorms(uneven, AbsoluteValues(np.full(k, 0.3))),
    }


PENALTIES = penalties(K)


def problem(seed, samples=40, targets=1, correlated=True):
    """Z (m, K) and Y (m, n) of unit rms."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(samples, K))
    z = np.cumsum(z, axis=1) if correlated else z
    z /= np.sqrt(np.mean(z**2, axis=0))
    y = z[:, :5] @ rng.normal(size=(5, targets)) + 0.3 * rng.normal(size=(samples, targets))
    return np.asfortranarray(z), y / np.sqrt(np.sum(y**2) / samples)


def path_of(z, y, penalty, alphas, stretches):
    on = Columns(penalty, z.T @ y / len(z), z.T @ z / len(z), z)
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
    on = Columns(penalty, cross, z.T @ z / len(z), z)
    for alpha, point in zip(alphas[3::5], values[3::5], strict=True):
        start = np.zeros(cross.shape)
        generic, gap, _ = solved_by_newton(on, float(alpha), start, 1e-13)
        assert gap < 1e-9
        np.testing.assert_allclose(point, generic, atol=2e-4)


@pytest.mark.parametrize("kind", PENALTIES)
def test_columns_that_join_on_the_way_change_no_point(kind, monkeypatch):
    rng = np.random.default_rng(5)
    theta, weights = rng.normal(size=(30, 240)), np.zeros((240, 1))
    weights[::40] = rng.normal(size=(6, 1))
    target, penalty = theta @ weights + 0.1 * rng.normal(size=(30, 1)), penalties(240)[kind]
    design = RegressionProblem.from_arrays(theta, target).design
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
    gaps = duality_gaps(design, target, joined.weights / design.rms[:, None], alphas, penalty)
    assert max(gap.bound for gap in gaps) < 1e-8


@pytest.mark.parametrize("targets", [1, 2])
@pytest.mark.parametrize("most", [1, kernels.MOST])
def test_groups_that_outnumber_rows_are_descended_to_one_optimum(targets, most, monkeypatch):
    """Or, where descent takes too many sweeps, Newton's method ends it."""
    rng = np.random.default_rng(3)
    theta, groups = rng.normal(size=(40, 700)), np.arange(700) % 100
    target = theta[:, groups < 4] @ rng.normal(size=(28, targets)) + rng.normal(size=(40, targets))
    design = RegressionProblem.from_arrays(theta, target, groups).design
    penalty = GroupNorms(groups, np.linspace(0.5, 1.0, 100))
    largest = float(penalty.dual_norm(design.correlate(target)).max())
    alphas = largest * np.geomspace(1.0, 3e-2, 12)
    with monkeypatch.context() as patch:
        for home in (exact, working_set):
            patch.setattr(home, "STORED", 0)  # without rows there is no descent
        whole = exact.exact_path(design, target, penalty, alphas)
    monkeypatch.setattr(kernels, "MOST", most)
    if most > 1:
        monkeypatch.setattr(kernels, "variational", None)
    descended = exact.exact_path(design, target, penalty, alphas)
    assert "block descent" in descended.words
    assert most == 1 or descended.steps.max() < most
    assert "variational" in whole.words
    assert descended.complete.all()
    gaps = duality_gaps(design, target, descended.weights / design.rms[:, None], alphas, penalty)
    assert max(gap.bound for gap in gaps) < 1e-8
    np.testing.assert_allclose(descended.weights, whole.weights, atol=1e-3)


def test_groups_of_one_column_for_one_target_are_solved_as_absolute_values():
    rng = np.random.default_rng(6)
    theta = rng.normal(size=(30, 40))
    target = theta[:, :3] @ rng.normal(size=(3, 2)) + 0.1 * rng.normal(size=(30, 2))
    design, weights = Design(theta, 30), np.linspace(0.5, 2.0, 40)
    order, alphas = rng.permutation(40), np.array([0.5, 0.3, 0.1, 0.05])
    plain = exact.exact_path(design, target, AbsoluteValues(weights[order]), alphas)
    apart = exact.exact_path(design, target, GroupNorms(order, weights, False), alphas)
    joint = exact.exact_path(design, target[:, :1], GroupNorms(order, weights), alphas)
    np.testing.assert_array_equal(apart.weights, plain.weights)
    np.testing.assert_allclose(joint.weights, plain.weights[:, :, :1], atol=1e-12)
    assert "homotopy" in joint.words


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
        gaps = duality_gaps(design, target, points.weights / design.rms[:, None], alphas, penalty)
        assert max(gap.bound for gap in gaps) < 1e-8


@pytest.mark.parametrize(("most", "centred"), [(0, True), (500, True), (500, False)])
def test_sparse_clusters_are_descended_in_their_columns(most, centred, monkeypatch):
    """Or Newton's method ends it; neither forms Z'Z."""
    rng, penalty = np.random.default_rng(8), SortedNorm(np.linspace(1.0, 0.3, 700))
    theta = sparse.random(90, 700, 0.05, "csc", random_state=rng)
    target = theta[:, :4] @ rng.normal(size=(4, 1)) + 0.05 * rng.normal(size=(90, 1))
    design = Design(theta, 90, direction=np.full(90, 90**-0.5) if centred else None)
    target = design.off(target)
    alphas = float(penalty.dual_norm(design.correlate(target)).max()) * np.geomspace(0.9, 0.05, 6)
    whole = exact.exact_path(replace(design, source=theta.toarray()), target, penalty, alphas)
    monkeypatch.setattr(kernels, "CLUSTERED", most)
    for name in ("FEW", "SMALL_CLUSTERS"):
        monkeypatch.setattr(exact, name, 0)
    monkeypatch.setattr(Design, "products", None)
    points = exact.exact_path(design, target, penalty, alphas)
    assert points.complete.all()
    np.testing.assert_allclose(points.weights, whole.weights, atol=1e-6)
    gaps = duality_gaps(design, target, points.weights / design.rms[:, None], alphas, penalty)
    assert max(gap.bound for gap in gaps) < 1e-8


@pytest.mark.parametrize(("rows", "columns"), [(30, 80), (80, 30)])
def test_a_ridge_by_conjugate_gradients_is_that_of_the_matrix(rows, columns, monkeypatch):
    design, target = drawn(1, rows, columns, 0.2)
    design = replace(design, direction=np.full(rows, rows**-0.5))
    target, penalty = design.off(np.outer(target, [1.0, -2.0])), SquaredNorm(columns)
    alphas = np.array([5.0, 0.1, 1e-9])
    direct = exact_path(design, target, penalty, alphas)
    monkeypatch.setattr(exact, "DIRECT", 10)
    iterated = exact_path(design, target, penalty, alphas)
    np.testing.assert_allclose(iterated.weights, direct.weights, atol=1e-9)
    assert iterated.complete.all()
    assert (direct.words, iterated.words) == ("cholesky", "conjugate gradients")


@pytest.mark.parametrize("kind", [*PENALTIES, "box"])
def test_the_gap_by_sums_is_that_of_the_certificate(kind):
    box = BoundedValues(np.ones(K), np.full(K, -0.5), np.full(K, 0.3))
    (z, y), penalty = problem(2), PENALTIES.get(kind, box)
    values = penalty.prox(np.random.default_rng(0).normal(size=(K, 1)), 0.2)
    on = Columns(penalty, z.T @ y / 40, z.T @ z / 40)
    gap = relative_gap(on, 0.1, values, on.cross - on.times(values))
    (expected,) = duality_gaps(Design(z, 40), y, values[None], np.array([0.1]), penalty)
    assert gap == pytest.approx(expected.value, rel=1e-9)


@pytest.mark.parametrize(("width", "q"), [(0, 1), (15, 1), (0, 2), (30, 2)])
def test_newtons_system_is_solved_by_few_rows_as_it_is_by_columns(width, q):
    """s N (I + s N'G N)^-1 N' c, N of more columns than the rows of Z for all targets."""
    (z, y), rng, every = problem(0, samples=9), np.random.default_rng(2), np.arange(K * q)
    lift = rng.normal(size=(K * q, width)) if width else np.eye(K * q)
    gram, pull = z.T @ z / 9, rng.normal(size=K * q)
    square = np.eye(lift.shape[1]) + 3.0 * lift.T @ np.kron(gram, np.eye(q)) @ lift
    expected = 3.0 * lift @ np.linalg.solve(square, lift.T @ pull)
    for store in ({"gram": gram}, {"gram": None, "rows": z, "design": Design(z, 9)}):
        on = Columns(PENALTIES["LASSO"], z.T @ y / 9, **store)
        assert on.solved(every, lift if width else None, pull, 3.0, q) == pytest.approx(expected)


def test_clusters_that_meet_on_the_way_to_their_optimum_are_pooled_where_the_objective_falls():
    """G = I, lambda = (2, 1): from (2, 1) to (1, 3), which is pooled to 2, the optimum of one."""
    penalty, pull = SortedNorm(np.array([2.0, 1.0])), np.array([[3.0], [-4.0]])
    on = Columns(penalty, pull, np.eye(2))
    pooled, met = towards_clusters_optimum(on, 1.0, np.array([[2.0], [-1.0]]))
    moved, meets = towards_clusters_optimum(on, 1.0, pooled)
    assert np.hstack([pooled, moved]) == pytest.approx(np.array([[2.0, 2.0], [-2.0, -2.0]]))
    assert (met, meets) == (True, False)
    steep = Columns(penalty, np.array([[102.0], [-4.0]]), np.diag([100.0, 1.0]))
    near, meet = np.array([[1.1], [-1.0]]), 1.1 - 0.1 * 0.1 / 2.1
    assert towards_clusters_optimum(steep, 1.0, near)[0] == pytest.approx(meet * np.sign(near))


def test_a_target_that_no_column_correlates_with_has_weights_of_zero():
    design = Design(np.eye(6)[:, :3], 6)
    for target in (np.eye(6)[:, 3:5], np.zeros((6, 2))):
        points = exact.exact_path(design, target, AbsoluteValues(np.ones(3)), np.zeros(2))
        assert (points.words, points.complete.all()) == ("zero", True)
        assert not points.weights.any()


def test_few_columns_are_solved_on_those_that_pull_the_most():
    rng, few = np.random.default_rng(6), exact.START // 8
    theta, used = rng.normal(size=(200, 8 * few)), np.arange(few, 2 * few)
    design, target = Design(theta, 200), theta[:, used] @ np.ones((few, 1))
    groups = GroupNorms(np.arange(8 * few) // few, np.ones(8))
    alpha = 0.7 * groups.dual_norm(design.correlate(target)).max()
    points = exact.exact_path(design, target, groups, np.array([alpha]))
    assert points.complete.all()
    assert points.words.endswith(f", {few} columns in play")
    alphas = np.geomspace(0.8, 1e-3, 5)
    target, penalty = target + rng.normal(size=(200, 1)), AbsoluteValues(np.ones(8 * few))
    path = exact.exact_path(design, target, penalty, alphas)
    design = replace(design)  # whose first point takes but some rows of Z'Z
    begin = exact.exact_path(design, target, penalty, alphas[:1])
    assert "gram" not in vars(design)
    np.testing.assert_allclose(begin.weights[0], path.weights[0], atol=1e-12)


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


pytest.importorskip("sparsefit.solvers.sweeps", reason="it was not compiled")


def drawn(seed, rows, columns, density):
    rng = np.random.default_rng(seed)
    theta = sparse.random_array((rows, columns), density=density, rng=rng, format="csc")
    theta = sparse.csc_matrix(theta + sparse.eye_array(rows, columns))
    theta = theta @ sparse.diags(rng.uniform(0.1, 10.0, columns))
    truth = rng.normal(size=columns) * (rng.random(columns) < 0.1)
    target = theta @ truth + 0.1 * rng.normal(size=rows)
    theta = sparse.csc_matrix(theta)
    if seed % 2:
        theta.indices, theta.indptr = theta.indices.astype(np.int64), theta.indptr.astype(np.int64)
    return Design(theta, rows), target


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("centred", [False, True])
@pytest.mark.parametrize("ridge", [0.0, 0.5])
@pytest.mark.parametrize(
    ("rows", "columns", "density"), [(60, 200, 0.05), (300, 60, 0.1), (80, 80, 0.5)]
)
def test_every_point_of_a_path_is_optimal(seed, centred, ridge, rows, columns, density):
    design, target = drawn(seed, rows, columns, density)
    if centred:
        design = replace(design, direction=np.full(rows, rows**-0.5))
        target = design.off(target[:, None] + 3.0)[:, 0]
    rng = np.random.default_rng(seed)
    penalty = AbsoluteValues(rng.uniform(0.5, 2.0, columns), ridge=ridge)
    cross = design.correlate(target[:, None])[:, 0]
    alphas = (np.abs(cross) / penalty.weights).max() * np.geomspace(1.0, 1e-2, 8)
    weights, complete, steps = descent_path(design, target, cross, penalty, alphas)
    assert complete.all()
    assert not weights[0].any()
    assert steps.sum() > 0
    for alpha, values in zip(alphas, weights, strict=True):
        residual = target - design.predict(values[:, None])[:, 0]
        pull = design.correlate(residual[:, None])[:, 0] - alpha * ridge * values
        limit, used = alpha * penalty.weights, values != 0
        assert np.abs(pull - limit * np.sign(values))[used].max(initial=0.0) < 1e-8 * alpha
        assert (np.abs(pull) - limit).max() < 1e-8 * alpha
