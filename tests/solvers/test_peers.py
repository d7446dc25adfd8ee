"""Public solvers of the registry: one objective, whatever the conventions of each of them."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from sparsefit.errors import InputError
from sparsefit.regression.design import Design
from sparsefit.regression.group_penalties import GroupNorms, NestedNorms
from sparsefit.regression.losses import RootSquares, Squares
from sparsefit.regression.ordered_penalties import FusedNorm, SortedNorm
from sparsefit.regression.penalties import AbsoluteValues, BoundedValues, SquaredNorm, alpha_max
from sparsefit.solvers.conic import BEHIND_CVXPY
from sparsefit.solvers.peers import kind_of, solved_in_parts
from sparsefit.solvers.registry import Recipe, solver, solver_names

K = 18
GROUPS = np.arange(K) // 3
LASSO = AbsoluteValues(np.ones(K))
EXACT = {  # what a peer reaches here of the objective at zero, where it is not 1e-9
    "celer": 1e-5,  # its own dual point is worse than ours where samples are few
    "glum": 1e-8,
}
PENALTIES = {
    "LASSO": LASSO,
    "adaptive": AbsoluteValues(np.linspace(0.5, 2.0, K)),
    "elastic net": replace(LASSO, ridge=0.7),
    "groups": GroupNorms(GROUPS, np.linspace(1.0, 2.0, 6), together=False),
    "joint": GroupNorms(GROUPS, np.linspace(1.0, 2.0, 6)),
    "sparse-group": NestedNorms(GroupNorms(GROUPS, 0.6 * np.ones(6), together=False), LASSO),
    "SLOPE": SortedNorm(np.linspace(2.0, 0.5, K)),
}
OTHERS = {  # of which only conic solvers take any
    "non-negative": BoundedValues(np.ones(K), lower=np.zeros(K), upper=np.full(K, np.inf)),
    "fused": FusedNorm(K, 0.5),
    "root": replace(LASSO, loss=RootSquares()),
    "Huber": replace(LASSO, loss=Squares(clip=0.5)),
    "ridge": SquaredNorm(K),
}


def problem(rows=60, seed=0):
    rng = np.random.default_rng(seed)
    theta = rng.normal(size=(rows, K)) * rng.uniform(0.5, 2.0, K)
    return theta, theta[:, :4] @ rng.normal(size=(4, 2)) + 0.3 * rng.normal(size=(rows, 2))


def path_of(name, design, target, penalty, points=5):
    alphas = alpha_max(design.correlate(target), penalty) * np.geomspace(1.0, 0.03, points)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return solver(name).path(design, target, penalty, alphas, 1e-11), alphas


def objective(design, target, penalty, weights, alphas):
    residual = target - np.stack([design.predict(values) for values in weights])
    half = np.square(residual).sum(axis=(1, 2)) / (2 * design.samples)
    return half + alphas * penalty.value(weights)


SLOW = ("skglm",)  # half a minute to compile


OTHER = {*BEHIND_CVXPY} - {"clarabel"}  # slower, to accuracies of their own
INSTALLED = [name for name in solver_names() if not (name in OTHER or Recipe(name).missing)]


def kinds_and_solvers():
    for kind, penalty in PENALTIES.items():
        takers = [name for name in INSTALLED if not solver(name).takes(penalty)]
        assert len(takers) >= 2, kind
        yield kind, 12, [name for name in takers if name not in SLOW]
        yield kind, 60, [name for name in takers if name not in SLOW]
        slow = [name for name in takers if name in SLOW]
        yield pytest.param(kind, 60, slow, marks=pytest.mark.slow)


@pytest.mark.parametrize(("kind", "rows", "names"), list(kinds_and_solvers()))
def test_every_solver_reaches_the_objective_of_the_referee(kind, rows, names):
    theta, target = problem(rows)
    penalty, design = PENALTIES[kind], Design(theta, rows)
    best, alphas = path_of("clarabel", design, target, penalty)
    reference = objective(design, target, penalty, best, alphas)
    null = np.square(target).sum() / (2 * rows)
    for name in names:
        weights, _ = path_of(name, design, target, penalty)
        excess = (objective(design, target, penalty, weights, alphas) - reference) / null
        assert excess.max() < EXACT.get(name, 1e-9), name
        assert excess.min() > -1e-9, name


@pytest.mark.parametrize("name", ["celer", "scikit-learn-cd", "glum", "sortedl1"])
def test_a_sparse_design_gives_the_weights_of_the_dense_one(name):
    theta, target = problem()
    theta[np.abs(theta) < 0.8] = 0.0
    penalty = next(p for p in PENALTIES.values() if not solver(name).takes(p))
    dense, _ = path_of(name, Design(theta, 60), target, penalty)
    thin, _ = path_of(name, Design(sparse.csc_matrix(theta), 60), target, penalty)
    np.testing.assert_allclose(thin, dense, atol=1e-4 * np.abs(dense).max())


@pytest.mark.parametrize("kind", PENALTIES)
def test_columns_of_zeros_are_left_out_and_get_a_weight_of_zero(kind):
    theta, target = problem()
    theta[:, GROUPS == 0] = 0.0

    def call(task, targets):
        assert task.design.any(axis=0).all()
        assert np.array_equal(np.unique(task.groups), np.arange(task.groups.max() + 1))
        assert task.lambdas is None or len(task.lambdas) == K - 3
        return np.ones((2, (K - 3) * task.target[:, targets].shape[1]))

    design, alphas = Design(theta, 60), np.array([1.0, 0.5])
    weights = solved_in_parts(call, design, target, PENALTIES[kind], alphas)
    assert np.array_equal(weights.any(axis=(0, 2)), GROUPS > 0)


@pytest.mark.parametrize("kind", OTHERS)
def test_conic_solvers_take_every_penalty_in_two_forms(kind):
    theta, target = problem()
    design = Design(theta, 60)
    ours, _ = path_of("clarabel", design, target, OTHERS[kind], 3)
    alphas = alpha_max(design.correlate(target), OTHERS[kind]) * np.geomspace(1.0, 0.03, 3)
    theirs = BEHIND_CVXPY["clarabel"].path(design, target, OTHERS[kind], alphas, None)
    np.testing.assert_allclose(theirs, ours, atol=1e-4 * np.abs(ours).max())
    assert not kind_of(OTHERS[kind])
    assert "only" in solver("celer").takes(OTHERS[kind])


def test_working_sets_of_the_referee_leave_out_what_does_not_object():
    rng = np.random.default_rng(1)
    theta = rng.normal(size=(80, 400))
    target = theta[:, :3] @ np.ones((3, 1)) + 0.1 * rng.normal(size=(80, 1))
    design = Design(theta, 80)
    for penalty in (AbsoluteValues(np.ones(400)), SortedNorm(np.linspace(1.0, 0.9, 400))):
        some, alphas = path_of("clarabel", design, target, penalty, 3)
        correlation = design.correlate(target - design.predict(some[-1]))
        gap = penalty.dual_norm(correlation).max() / alphas[-1] - 1.0
        assert abs(gap) < 1e-6


@pytest.mark.parametrize("name", ["scikit-learn-cd", "clarabel"])
@pytest.mark.parametrize("unit", [1.0, 1e-3])
def test_one_column_of_any_unit_has_the_weight_that_is_worked_by_hand(name, unit):
    """v = (c - alpha omega)/(1 + alpha rho), omega = 2 and rho = 3, at c = 5 in any unit."""
    column = np.array([[1.0], [-1.0], [1.0], [1.0]])
    penalty, alphas = AbsoluteValues(np.array([2.0]), ridge=3.0), np.array([1.0, 0.5])
    weights = solver(name).path(Design(unit * column, 4), 5.0 * column, penalty, alphas, 1e-12)
    assert weights.ravel() == pytest.approx([3.0 / 4.0, 4.0 / 2.5], rel=1e-6)


def test_a_tall_problem_is_handed_over_as_the_triangle_of_a_qr():
    theta, target = problem()
    parts = []

    def call(task, targets):
        parts.append((task, targets))
        return np.zeros((1, 2 * K))

    solved_in_parts(call, Design(theta, 60), target, PENALTIES["joint"], np.array([0.5]))
    task, targets = parts[0]
    design, values = task.rows(targets)
    assert design.shape == (2 * (K + 2), 2 * K)
    assert design.flags.f_contiguous
    residual = task.target - task.design @ np.ones((K, 2))
    short = values - design @ np.ones(2 * K)
    assert np.square(short).mean() == pytest.approx(np.square(residual).sum() / 60)


def test_what_a_solver_does_not_take_is_refused_in_a_line():
    theta, target = problem()
    with pytest.raises(InputError, match="scikit-learn-lars solves LASSO only"):
        path_of("scikit-learn-lars", Design(theta, 60), target, PENALTIES["joint"])
    assert "cones" in solver("osqp").takes(PENALTIES["joint"])
    assert "conic form" in solver("clarabel").takes(_Unstated(np.ones(K)))


class _Unstated(AbsoluteValues):
    conic = SquaredNorm.__mro__[1].conic
