"""The certificate against hand values and high precision."""

import itertools
from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.certificate import DualPoint, duality_gaps, of_signs, rounding_of
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.losses import RootSquares
from sparsefit.regression.penalties import BoundedValues, SquaredNorm, alpha_max, lasso_penalty
from sparsefit.regression.problem import RegressionProblem, compressed
from sparsefit.solvers.exact import exact_path
from tests.problems import DEGENERATE_KINDS, degenerate, regular

THETA = np.array([[1.0, 1.0], [1.0, -1.0]])
TARGET = np.array([[3.0], [1.0]])  # Z = theta, Z'Z/m = I, c = Z'y/m = (2, 1), |y|^2/2m = 2.5


def certified(theta, target, weights, alphas, penalty, by_products=False):
    """Certificates of weights (p, k, n)."""
    design, sums = Design(theta, len(theta)), {}
    if by_products:
        sums = {"cross": design.correlate(target), "enough": np.inf * design.gram[0, 0]}
    return duality_gaps(design, target, np.asarray(weights), np.asarray(alphas), penalty, **sums)


def certify(theta, target, weights, alpha, *more):
    return certified(theta, target, np.asarray(weights)[None], [alpha], *more)[0]


def test_primal_and_dual_of_two_columns_worked_by_hand():
    # v = (1, 0): r = (2, 0), |r|^2/2m = 1, alpha |v| = 0.5 and so P = 1.5.
    # Z'r/m = (1, 1), s = min(<r, y>/|r|^2 = 1.5, alpha = 0.5), D = (0.5 * 6 - 0.125 * 4)/2 = 1.25.
    found = certify(THETA, TARGET, [[1.0], [0.0]], 0.5, lasso_penalty(2))
    assert (found.primal, found.dual) == pytest.approx((1.5, 1.25))
    assert found.value == pytest.approx(0.25 / 2.5)
    assert found.kind == "duality_gap"


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
        square = mp.fsum(r**2 for r in y - z * v)
        value = square / (2 * m) + penalty * mp.fsum(abs(x) for x in v)
        best = value if best is None or value < best else best
    return best


@pytest.mark.parametrize("seed", range(6))
def test_gap_bounds_the_true_suboptimality_in_high_precision(seed):
    rng = np.random.default_rng(seed)
    theta, target = rng.normal(size=(7, 3)) * [1.0, 1e3, 1e-3], rng.normal(size=(7, 1))
    problem = RegressionProblem.from_arrays(theta, target)
    fraction = float(rng.uniform(0.05, 0.9))
    alpha = fraction * alpha_max(problem.cross, lasso_penalty(3))
    with mp.workdps(50):
        optimum = lasso_by_enumeration(theta, target, problem.design.rms, alpha)
        for size in (1.0, 1e-2, 1e-5):
            weights = (rng.normal(size=(3, 1)) * size) / problem.design.rms[:, None]
            found = certify(theta, target, weights, alpha, lasso_penalty(3))
            exact, _ = exactly(theta, target, problem.design.rms, weights, alpha, lasso_penalty(3))
            null, size = problem.null_objective, np.abs(weights.T * problem.design.rms).sum()
            assert abs(found.primal - float(exact)) <= 1e-14 * null
            assert found.dual <= float(optimum) + 1e-14 * null
            assert found.value * null >= float(exact - optimum) - 1e-14 * null
            assert found.value + found.rounding >= (exact - optimum) / null
            assert found.rounding <= 1e-12 * (1 + size) ** 2
    weights = backends.get("lasso", alpha_fraction=fraction).solve(problem).weights
    tight = certify(theta, target, weights, alpha, lasso_penalty(3))
    assert tight.primal == pytest.approx(float(optimum), rel=1e-14)
    assert tight.dual == pytest.approx(float(optimum), rel=1e-13)


@pytest.mark.parametrize("sparse", [True, False])
def test_gathering_columns_and_points_together_changes_nothing(sparse):
    rng = np.random.default_rng(0)
    theta, target = rng.normal(size=(50, 8)), rng.normal(size=(50, 2))
    weights = rng.normal(size=(3, 8, 2))
    if sparse:
        weights[:, 2:] = 0.0
    alphas, penalty = np.array([0.3, 0.2, 0.1]), lasso_penalty(8)
    together = certified(theta, target, weights, alphas, penalty)
    for one, values, alpha in zip(together, weights, alphas, strict=True):
        alone = certify(theta, target, values, alpha, penalty)
        assert (one.primal, one.dual) == pytest.approx((alone.primal, alone.dual), rel=1e-13)


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
    penalty = GroupNorms(problem.groups, np.ones(4), joint)
    plain = certify(problem.theta, problem.target, weights, 0.3, penalty)
    theta, target = problem.theta * theta_unit, problem.target * target_unit
    weights *= target_unit / theta_unit
    changed = certify(theta, target, weights, 0.3 * target_unit, penalty)
    assert changed.value == pytest.approx(plain.value, rel=1e-12)
    assert changed.rounding == pytest.approx(plain.rounding, rel=1e-2)
    assert changed.primal == pytest.approx(plain.primal * target_unit**2, rel=1e-12)


@given(seed=st.integers(0, 10_000), kind=st.sampled_from(DEGENERATE_KINDS), size=st.floats(0, 3))
@settings(max_examples=120)
def test_gap_is_never_negative_and_dual_never_above_primal(seed, kind, size):
    problem = degenerate(kind, seed)
    rng = np.random.default_rng(seed)
    unit = np.sqrt(problem.target_square) / problem.design.rms[:, None]
    weights = size * unit * rng.normal(size=(problem.columns, problem.targets))
    penalty = GroupNorms(problem.groups, np.ones(problem.groups.max() + 1), bool(seed % 2))
    alpha = 0.3 * alpha_max(problem.cross, penalty)
    found = certify(problem.theta, problem.target, weights, alpha, penalty)
    assert found.value >= 0
    assert found.dual <= found.primal + 1e-12 * problem.null_objective


def exactly(theta, target, rms, weights, alpha, penalty):
    """P and (P - D) / (|Y|^2/2m) in 60 digits at the best s, of the very numbers certified."""
    m, n = target.shape
    z = [[mp.mpf(x) / mp.mpf(r) for x, r in zip(row, rms, strict=True)] for row in theta.tolist()]
    v = [[mp.mpf(w) * mp.mpf(r) for w in row] for row, r in zip(weights.tolist(), rms, strict=True)]
    residual = [
        [mp.mpf(float(target[i, t])) - mp.fdot(z[i], [row[t] for row in v]) for t in range(n)]
        for i in range(m)
    ]
    primal, dual = mp.mpf(0), mp.mpf(0)
    for block in [range(n)] if penalty.coupled else [[t] for t in range(n)]:
        square = mp.fsum(residual[i][t] ** 2 for i in range(m) for t in block)
        product = mp.fsum(residual[i][t] * float(target[i, t]) for i in range(m) for t in block)
        peak, norm = mp.mpf(0), mp.mpf(0)
        for group, omega in enumerate(penalty.weights.tolist()):
            on = np.flatnonzero(penalty.blocks == group).tolist()
            pull = [mp.fsum(z[i][j] * residual[i][t] for i in range(m)) for j in on for t in block]
            peak = max(peak, mp.sqrt(mp.fsum(x**2 for x in pull)) / m / omega)
            norm += omega * mp.sqrt(mp.fsum(v[j][t] ** 2 for j in on for t in block))
        limit = alpha / peak
        s = max(-limit, min(limit, product / square))
        primal += square / (2 * m) + alpha * norm
        dual += (s * product - s**2 * square / 2) / m
    null = mp.fsum(mp.mpf(y) ** 2 for y in target.ravel().tolist()) / (2 * m)
    return primal, (primal - dual) / null


@given(
    seed=st.integers(0, 10_000),
    size=st.sampled_from([0.0, 1.0, 1e3, 1e6]),
    fitted=st.booleans(),
    penalty=st.sampled_from(["lasso", "separate", "joint"]),
    by_products=st.booleans(),
)
@settings(max_examples=40)
def test_rounding_covers_what_double_precision_loses(seed, size, fitted, penalty, by_products):
    # Nearly equal columns with large opposite weights: they cancel in Z V, and so do the sums.
    # Where the weights fit the target, the residual is all rounding.
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(20, 6)) * 10.0 ** rng.uniform(-3, 3, 6)
    theta[:, 1] = theta[:, 0] * (1.0 + 1e-9 * rng.normal(size=20))
    target = rng.normal(size=(20, 2))
    weights = rng.normal(size=(6, 2)) / np.sqrt(np.mean(theta**2, axis=0))[:, None]
    weights[:2] += size * np.array([[1.0], [-1.0]]) / np.abs(theta[:, 0]).mean()
    target = theta @ weights if fitted else target
    groups = np.array([2, 0, 1, 1, 2, 2])  # sizes 1, 2 and 3, not in order
    blocks = GroupNorms(groups, np.sqrt([1.0, 2.0, 3.0]), penalty == "joint")
    blocks = lasso_penalty(6) if penalty == "lasso" else blocks
    found = certify(theta, target, weights, 0.05, blocks, by_products)
    with mp.workdps(60):
        rms = RegressionProblem.from_arrays(theta, target).design.rms
        primal, exact = exactly(theta, target, rms, weights, 0.05, blocks)
        assert fitted or size > 1.0 or found.primal == pytest.approx(float(primal), rel=1e-12)
        assert exact <= mp.mpf(found.value) + mp.mpf(found.rounding)
        assert fitted or exact >= mp.mpf(found.value) - 2 * mp.mpf(found.rounding)
    reach = 1.0 + np.abs(weights * np.sqrt(np.mean(theta**2, axis=0))[:, None]).sum()
    assert fitted or found.rounding <= 1e-13 * (reach / np.sqrt(np.mean(target**2))) ** 2


def test_the_error_of_sums_over_many_rows_is_within_the_bound():
    # One large term and many that it swallows: the Gram matrix is wrong in its tenth digit.
    theta = np.full((4000, 2), 1e-8)
    theta[0] = 1.0
    theta[1:, 1] *= -1.0
    target, weights = theta[:, :1] * 3.0, np.array([[1.0], [1.0]])
    with mp.workdps(60):
        rms = RegressionProblem.from_arrays(theta, target).design.rms
        exact = exactly(theta, target, rms, weights, 0.01, lasso_penalty(2))[1]
        for by_products in (False, True):
            found = certify(theta, target, weights, 0.01, lasso_penalty(2), by_products)
            assert abs(exact - found.value) <= found.rounding < 1e-10


def test_what_products_do_not_prove_is_certified_by_the_rows():
    """The second weights have a gap of 1e8: more than enough."""
    rng = np.random.default_rng(0)
    design, target = Design(rng.normal(size=(40, 3)), 40), rng.normal(size=(40, 1))
    weights = rng.normal(size=(2, 3, 1)) * np.array([1.0, 1e4])[:, None, None]
    posed = (design, target, weights, np.array([0.2, 0.1]), lasso_penalty(3))
    by_rows, sums = duality_gaps(*posed), {"cross": design.correlate(target), "enough": 100.0}
    assert duality_gaps(*posed, **sums) == by_rows  # Z'Z was not formed
    assert design.gram.shape == (3, 3)
    first, second = duality_gaps(*posed, **sums)
    assert first.value == pytest.approx(by_rows[0].value, rel=1e-12)
    assert first.rounding > by_rows[0].rounding
    assert second.rounding == pytest.approx(by_rows[1].rounding, rel=1e-9)


def test_a_compressed_problem_has_the_gap_of_its_samples():
    rng = np.random.default_rng(3)
    theta, target = rng.normal(size=(900, 5)), rng.normal(size=(900, 2))
    blocks = ((theta[i : i + 100], target[i : i + 100]) for i in range(0, 900, 100))
    triangle = RegressionProblem.from_arrays(*compressed(blocks))
    small = replace(triangle, sample_count=900)
    weights = rng.normal(size=(1, 5, 2))
    assert (small.samples, small.design.terms) == (900, 7)
    whole = certified(theta, target, weights, [0.1], lasso_penalty(5))[0]
    alphas, penalty = np.array([0.1]), lasso_penalty(5)
    (found,) = duality_gaps(small.design, small.target, weights, alphas, penalty)
    assert (found.value, found.primal) == pytest.approx((whole.value, whole.primal), rel=1e-12)
    assert found.rounding < whole.rounding  # 7 rows are summed, not 900


@pytest.mark.parametrize("alpha", [0.5, 2.0], ids=["by the columns", "by the norm"])
def test_a_dual_point_has_each_rounding_on_its_safe_side(alpha):
    """Z'Z/m = I, u = Z (1, 1): C = (1, 1), r = 2, q = 3; y^2 = 5; gamma 1e-3, by hand."""
    design, gamma, y = Design(THETA, 2), 1e-3, np.sqrt(5.0)
    (point, _) = of_signs(design, TARGET, np.array([[2.0], [1.0]]), gamma)
    penalty = replace(lasso_penalty(2), loss=RootSquares())
    dual, least = point.bounds(np.array([alpha]), penalty, np.array([y]))
    assert dual == pytest.approx(min(alpha, y / np.sqrt(2.0)) * 3.0, rel=1e-12)
    error = gamma * np.sqrt(2.0)  # of C
    longer = np.sqrt(2.0 * (1.0 + gamma) + 2.0 * np.sqrt(2.0) * error)
    s = min(alpha / ((1.0 + error) * (1.0 + gamma)), y / longer)
    off = s * y * error + s**2 * np.sqrt(2.0) * error + gamma * (12.0 * s + s**2)
    assert least == pytest.approx(3.0 * s - off, rel=1e-12)


def test_the_pull_of_a_root_is_the_residual_on_the_scale_of_the_target():
    """The derivative of |Y| |R| by R, where |Y| = 10 and |R| = 5; zero without a residual."""
    residual, target = np.array([[3.0, 0.0], [0.0, 4.0]]), np.array([[6.0, 8.0], [0.0, 0.0]])
    np.testing.assert_allclose(RootSquares().pull(residual, target), 2.0 * residual)
    assert not RootSquares().pull(0.0 * residual, target).any()


def test_signs_are_those_of_weights_that_are_not_rounding():
    """An interior point's 1e-12 of the wrong sign spoils the dual point of its exact fit."""
    root = replace(lasso_penalty(2), loss=RootSquares())
    spoilt = np.array([[2.0], [-1e-12]])
    found = certify(THETA, 2.0 * THETA[:, :1], spoilt, 0.5, root)
    assert found.bound < 1e-11


def test_a_box_by_hand():
    """Z'Z/m = I, C = (2, 1), -1 <= V <= 1, alpha = 1/2: V = (1, 1/2), D at s = 1."""
    box = BoundedValues(np.ones(2), -np.ones(2), np.ones(2))
    found = certify(THETA, TARGET, [[1.0], [0.5]], 0.5, box)
    # R'R/m = 5 - 2 (2 + 1/2) + 5/4 = 5/4, P = 5/8 + 3/4; Z'R/m = (1, 1/2), q = 5/2, and the
    # conjugate is 1 (1 - 1/2): D = 5/2 - 5/8 - 1/2 = P.
    assert (found.primal, found.dual) == pytest.approx((1.375, 1.375))
    assert found.bound < 1e-13
    off = certify(THETA, TARGET, [[0.5], [0.5]], 0.5, box)  # C = (3/2, 1/2), q = 7/2, r = 5/2
    assert (off.primal, off.dual) == pytest.approx((1.75, 1.3))  # 7/2 s - 5/4 s^2 - 3/2 s + 1/2


NUMBERS = [np.array([[value]]) for value in (1.25, 2.5, 1e-3, 2e-3, 3e-3)]
PULL = np.array([[[1.0], [0.25]]])
POINT = DualPoint(PULL, *NUMBERS, 1e-4)  # C, r and q, the error of each, and gamma


def test_the_dual_point_of_a_box_has_each_rounding_on_its_safe_side():
    """The numbers of the box above, but the second of C, each off by its own error."""
    box = BoundedValues(np.ones(2), -np.ones(2), np.ones(2))
    dual, least = POINT.bounds(np.array([0.5]), box, np.ones(1))
    assert dual == pytest.approx(1.375)  # s = 1; s = q/r = 2 gives 5/2 - 2
    # q, r/2, |V| <= 1 times what the first of C is off, gamma (4 q + r/2 + conjugate)
    assert dual - least == pytest.approx(3e-3 + 1e-3 + 1e-3 + 1e-4 * (10.0 + 0.625 + 0.501))


def test_the_dual_point_of_a_ridge_has_each_rounding_on_its_safe_side():
    """mu = 1/2, F = (2, 1): C less mu F, r more mu |F|^2 = 5/2; without a norm F = C/mu."""
    alphas = np.array([0.25])
    net = POINT.with_ridge(np.array([[[2.0], [1.0]]]), alphas, replace(lasso_penalty(2), ridge=2.0))
    assert net.correlation.ravel().tolist() == [0.0, -0.25]
    assert (net.square, net.product) == (3.75, 2.5)
    assert net.correlation_error == pytest.approx(1e-3 + 1e-4 * 1.0)  # mu max |F|
    assert net.square_error == pytest.approx(2e-3 + 1e-4 * 2.5)
    bare = POINT.with_ridge(PULL, alphas, SquaredNorm(2, ridge=2.0))
    assert not bare.correlation.any()
    assert bare.square == 1.25 + 0.5 * 4.25
    # F is off by e = 2e-3 in each entry: mu |F + e|^2 by mu (2 |F|_1 e + 2 e^2)
    off = 0.5 * (2.0 * 2.5 * 2e-3 + 2.0 * 2e-3**2)
    assert bare.square_error == pytest.approx(2e-3 + off + 1e-4 * 2.125)


def test_a_residual_of_zero_may_be_all_that_its_rounding_can_hide():
    """y = l = 2, one column in use: |R|/sqrt(m) <= 4 gamma_9, and P less by 2 of these of 4."""
    root = replace(lasso_penalty(2), loss=RootSquares())
    exact = certify(THETA, 2.0 * THETA[:, :1], [[2.0], [0.0]], 0.5, root)
    assert (exact.primal, exact.value) == (1.0, 0.0)
    assert 2.0 * rounding_of(9) <= exact.rounding < 1e-13


@pytest.mark.parametrize("seed", range(4))
def test_the_gap_of_bounds_is_that_to_the_optimum_or_more(seed):
    rng = np.random.default_rng(seed)
    theta, target = rng.normal(size=(30, 5)), rng.normal(size=(30, 1))
    problem = RegressionProblem.from_arrays(theta, target)
    upper = np.array([0.05, 0.1, np.inf, np.inf, 0.0])  # a box, a half-line and all numbers
    box = BoundedValues(rng.uniform(0.5, 2, 5), np.array([-0.1, 0, 0, -np.inf, -0.02]), upper)
    path = exact_path(problem.design, target, box, np.array([0.02]))
    optimum = path.weights[0]
    least = certify(theta, target, optimum / problem.design.rms[:, None], 0.02, box)
    for size in (1.0, 1e-2, 0.0):
        weights = box.prox(optimum + size * rng.normal(size=(5, 1)), 0.0)
        found = certify(theta, target, weights / problem.design.rms[:, None], 0.02, box)
        assert found.bound * problem.null_objective >= found.primal - least.primal - 1e-15
    assert least.bound < 1e-9


def test_no_column_with_a_positive_correlation_leaves_a_proven_zero():
    theta, target = np.array([[1.0, 2.0], [1.0, 3.0], [1.0, 1.0]]), -np.ones(3)
    problem = RegressionProblem.from_arrays(theta, target)
    along = sf.path(problem, backends.get("lasso", positive=True), (1.0, 0.1))
    assert along.alpha_max == np.abs(along.weights).max() == 0.0
    assert all(fit.status == "ok" and fit.certificate.bound < 1e-12 for fit in along.fits)


@pytest.mark.parametrize("outlier", [4.0, 5.8e13])
def test_the_gap_of_hubers_loss_is_relative_to_its_value_at_zero_weights(outlier):
    target = [-1.3, outlier, -1.7]
    posed = RegressionProblem.from_arrays(np.eye(3)[:, :2], target, intercept=True)
    penalty = backends.get("huber-lasso", clip=1e-3).penalty(posed)
    point = np.zeros((1, 2, 1)), np.array([1e-9])
    (own,) = duality_gaps(posed.design, posed.target, *point, penalty)
    assert own.value == pytest.approx(1.0 - own.dual / own.primal)
