"""What every back-end promises, ours or a plug-in's, in several settings and by several solvers."""

import copy
import dataclasses
import json
from functools import cache, partial

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.regression.backend import PathBackend, PenalisedBackend
from sparsefit.regression.losses import RootSquares
from sparsefit.regression.problem import RegressionProblem
from tests.problems import orthonormal, regular

BY_REFEREE = [
    (name, {"solver": "clarabel", **more})
    for name, more in (
        ("lasso", {}),
        ("lasso", {"alpha_fraction": 0.02}),
        ("group-lasso", {}),
        ("group-lasso", {"separate": True, "group_weights": "sqrt-size"}),
        ("sparse-group-lasso", {"separate": True}),
        ("sparse-group-lasso", {"l1_ratio": 0.2}),
        ("elastic-net", {}),
        ("ridge", {}),
    )
]
SETTINGS = [
    ("least-squares", {"rcond": 1e-2}),
    ("least-squares", {"rcond": 0.3}),
    ("stlsq", {"unbias": False}),
    ("stlsq", {"ridge": 0.0, "threshold": 0.3}),
    ("stlsq", {"mode": "pysindy", "threshold": 0.1}),
    ("stlsq", {"mode": "pysindy", "threshold": 0.5, "unbias": False}),
    ("lasso", {"alpha_fraction": 0.5}),
    ("lasso", {"alpha_fraction": 1e-4}),
    ("group-lasso", {"alpha_fraction": 0.5}),
    ("group-lasso", {"alpha_fraction": 1e-4}),
    ("group-lasso", {"separate": True}),
    ("group-lasso", {"group_weights": "sqrt-size"}),
    ("sparse-group-lasso", {"alpha_fraction": 1e-3, "group_weights": "sqrt-size"}),
    ("sparse-group-lasso", {"separate": True, "l1_ratio": 0.2}),
    ("adaptive-group-lasso", {"separate": True, "power": 2.0}),
    ("group-mcp", {"alpha_fraction": 0.3}),
    ("elastic-net", {"alpha_fraction": 1e-3, "l1_ratio": 0.05}),
    ("ridge", {"alpha_fraction": 1.0}),
    ("square-root-lasso", {"alpha_fraction": 0.01}),
    ("group-omp", {"stop": "bic"}),
]
CASES = [(name, {}) for name in backends.known()] + SETTINGS + BY_REFEREE
PROBLEM = regular(3)
GAP = 1e-10  # of Clarabel, whose tolerance that is
LEAST = np.linalg.svd(PROBLEM.theta / PROBLEM.design.rms, compute_uv=False)[-1]


def describe(case):
    return case[0] + "".join(f" {key}={value}" for key, value in case[1].items())


def close(backend, values):
    """Two answers of relative gaps g are as near as |Z (V - V')| <= 2 |Y| sqrt(g) lets them be."""
    solver, largest = getattr(backend, "solver", ""), np.abs(values).max()
    if solver == "clarabel":
        reach = 2.0 * np.sqrt(GAP) * np.linalg.norm(PROBLEM.target) / LEAST
        units = largest / np.abs(answered(backend).weights).max()
        return pytest.approx(values, abs=reach * units / PROBLEM.design.rms.min())
    return pytest.approx(values, abs=1e-5 * largest)


def rebuilt(problem, theta=None, target=None, groups=None):
    return RegressionProblem.from_arrays(
        problem.theta if theta is None else theta,
        problem.target if target is None else target,
        problem.groups if groups is None else groups,
    )


def solved(problem, backend):
    cones = getattr(backend, "solver", "") == "clarabel"
    found = sf.fit(problem, backend, tolerance=GAP if cones else 1e-6)
    assert found.status == "ok", found.reason
    return found


@cache
def answered(backend):
    """The certified fit of the one problem: many laws are about it and a changed problem's."""
    return solved(PROBLEM, backend)


every = pytest.mark.parametrize("case", CASES, ids=describe)
CONVEX = [c for c in CASES if backends.load(c[0]).certificate_kind == "duality_gap"]
convex = pytest.mark.parametrize("case", CONVEX, ids=describe)
SPARSE = [case for case in CONVEX if case[0] != "ridge"]  # no ridge has a solution of zero
OF_SQUARES = [c for c in SPARSE if c[0] not in ("square-root-lasso", "huber-lasso")]


@every
def test_the_answer_is_certified(case):
    found = answered(backends.get(case[0], **case[1]))
    assert found.certificate.value <= 1e-6
    assert found.certificate.kind == found.backend.certificate_kind
    assert found.weights.shape == (PROBLEM.columns, PROBLEM.targets)
    assert found.weights.dtype == np.float64
    assert not found.repaired


@every
def test_solving_is_pure(case):
    backend = backends.get(case[0], **case[1])
    problem = regular(4)
    before = copy.deepcopy((problem.theta, problem.target, problem.groups))
    settings = backends.settings_of(backend)
    first = backend.solve(problem).weights
    second = backend.solve(problem).weights
    fresh = backends.get(case[0], **case[1]).solve(regular(4)).weights
    assert np.array_equal(first, second)
    assert np.array_equal(first, fresh)
    after = (problem.theta, problem.target, problem.groups)
    for old, new in zip(before, after, strict=True):
        assert np.array_equal(old, new)
    assert backends.settings_of(backend) == settings


@every
def test_settings_are_frozen_and_round_trip_through_json(case):
    backend = backends.get(case[0], **case[1])
    settings = json.loads(json.dumps(backends.settings_of(backend), allow_nan=False))
    again = backends.get(case[0], **settings)
    assert again == backend
    assert hash(again) == hash(backend)
    for key in settings:
        with pytest.raises(dataclasses.FrozenInstanceError):
            setattr(backend, key, None)
    assert isinstance(backend, backends.Backend)
    assert backend.name == case[0]
    assert type(backend) is backends.load(case[0])


def changes():
    """Problems that say what `PROBLEM` says, each with the way back of its weights."""
    order, rows = (np.random.default_rng(0).permutation(count) for count in PROBLEM.theta.T.shape)
    theta, target, groups = PROBLEM.theta, PROBLEM.target, PROBLEM.groups
    yield "columns permuted", (theta[:, order], target, groups[order]), lambda w: w[order.argsort()]
    yield "rows permuted", (theta[rows], target[rows][:, ::-1], groups), lambda w: w[:, ::-1]
    yield "rows twice", (np.tile(theta, (2, 1)), np.tile(target, (2, 1)), groups), lambda w: w
    for span in (1e3, 1e6):
        units = np.geomspace(1 / span, span, PROBLEM.columns)
        back = partial(np.multiply, units[:, None])
        yield f"columns in units to {span:g}", (theta * units, target, groups), back
    for unit in (-1.0, 1e-9, 1e9):
        back = partial(np.multiply, 1 / unit)
        yield f"target times {unit:g}", (theta, target * unit, groups), back


CHANGES = {name: (rebuilt(PROBLEM, *parts), back) for name, parts, back in changes()}


def stays(case, change):
    """Whether the answer of a back-end to a changed problem is that to the problem."""
    name, backend = case[0], backends.get(case[0], **case[1])
    unscaled = getattr(backend, "mode", "") == "pysindy"  # its loss is the plain sum of squares
    if "units" in change:
        # The paper's least squares does not scale: it is backward stable, |theta| |W| eps.
        cut = bool(getattr(backend, "rcond", None))
        return not unscaled and not cut and ("1000" in change) == (name == "least-squares")
    if change == "columns permuted":
        return name != "fused-lasso"  # whose columns have an order
    # More samples, and units of the target, weaken a ridge and a threshold that do not scale.
    return not unscaled or change in ("rows permuted", "target times -1")


@pytest.mark.parametrize(
    ("case", "change"),
    [
        pytest.param(case, change, id=f"{describe(case)}: {change}")
        for case in CASES
        for change in CHANGES
        if stays(case, change)
    ],
)
def test_a_problem_that_says_as_much_has_the_answer(case, change):
    backend, (problem, back) = backends.get(case[0], **case[1]), CHANGES[change]
    assert back(solved(problem, backend).weights) == close(backend, answered(backend).weights)


@every
def test_a_zero_target_has_zero_weights(case):
    backend = backends.get(case[0], **case[1])
    found = sf.fit(rebuilt(PROBLEM, target=0.0 * PROBLEM.target), backend)
    if found.status == "unidentifiable":  # a threshold that is not relative removes everything
        assert "empty support" in found.reason or "target is zero" in found.reason
        return
    assert found.status == "ok"
    assert not found.weights.any()


@every
def test_one_column_and_one_target(case):
    theta = np.array([[1.0], [2.0], [3.0]])
    problem = RegressionProblem.from_arrays(theta, 2.0 * theta[:, 0])
    backend = backends.get(case[0], **case[1])
    weight = solved(problem, backend).weights[0, 0]
    if isinstance(backend, PenalisedBackend) and case[0] != "group-mcp":
        # One scaled column whose correlation is the target's rms: c = y. With the ridge mu,
        # v = (c - shrink)/(1 + mu): elastic net alpha = f c/r, shrink = f c, mu = alpha (1 - r)/y.
        fraction, ratio = backend.alpha_fraction, getattr(backend, "l1_ratio", 1.0)
        # Without noise the root of its square is as steep as the norm: nothing is shrunk.
        # Huber's loss clips the largest of (2, 4, 6) at 1.4826 times their median, in alpha_max.
        clipped = 1 - fraction * (1 * 2 + 2 * 4 + 3 * 1.4826 * 4) / 28
        others = {"ridge": 1 / (1 + fraction), "square-root-lasso": 1, "huber-lasso": clipped}
        left = others.get(case[0], 1 - fraction)
        if case[0] == "elastic-net":
            left /= 1 + fraction * (1 - ratio) / ratio
        assert weight == pytest.approx(2.0 * left, rel=1e-4)
    else:
        assert weight == pytest.approx(2.0, rel=0.06)  # up to the shrinkage of a ridge


def objective(problem, backend, weights):
    penalty = backend.penalty(problem)
    alpha = backend.alpha_fraction * problem.alpha_max(penalty)
    residual = problem.target - problem.theta @ weights
    loss = np.sum(residual**2) / (2 * problem.samples)
    if isinstance(penalty.loss, RootSquares):
        loss = 2 * np.sqrt(loss * problem.null_objective)
    elif np.isfinite(penalty.loss.clip):
        bound = penalty.loss.clip * 1.4826 * np.median(np.abs(problem.target), axis=0)
        cut = np.clip(residual, -bound, bound)
        loss = np.sum(cut * (residual - cut / 2)) / problem.samples
    return loss + alpha * penalty.value(weights * problem.design.rms[:, None])


@convex
def test_random_perturbations_never_lower_the_objective(case):
    backend, rng = backends.get(case[0], **case[1]), np.random.default_rng(5)
    found = answered(backend)
    least, null = objective(PROBLEM, backend, found.weights), PROBLEM.null_objective
    assert least == pytest.approx(found.certificate.primal, rel=1e-12)
    for size in np.geomspace(1e-6, 1.0, 60):
        step = size * rng.normal(size=found.weights.shape)
        for direction in (step, step * (found.weights != 0), -size * found.weights):
            moved = objective(PROBLEM, backend, found.weights + direction)
            assert moved >= least - max(found.certificate.value, 1e-15) * null


@pytest.mark.parametrize("case", SPARSE, ids=describe)
def test_at_alpha_max_all_is_zero_and_just_below_it_is_not(case):
    backend = backends.get(case[0], **{**case[1], "alpha_fraction": 1.0})
    top = sf.fit(PROBLEM, backend, tolerance=1e-6)
    peak = np.abs(PROBLEM.cross / PROBLEM.design.rms[:, None]).max()
    assert top.status == "ok"
    if case[0] != "sparse-group-lasso":  # where only the gap of an inner point is that small
        assert top.weights == pytest.approx(np.zeros((12, 2)), abs=1e-5 * peak)
    if "solver" not in case[1]:
        assert not top.weights.any()
    below = dataclasses.replace(backend, alpha_fraction=0.99)
    assert np.abs(sf.fit(PROBLEM, below).weights).max() > 1e-4 * peak


@convex
def test_a_path_is_its_points(case):
    backend = backends.get(case[0], **case[1])
    assert isinstance(backend, PathBackend)
    order = [0.05, 0.6, 0.2]
    along = sf.path(PROBLEM, backend, order, tolerance=1e-6)
    assert along.alpha_fractions.tolist() == order
    for fraction, found in zip(along.alpha_fractions, along.fits, strict=True):
        point = dataclasses.replace(backend, alpha_fraction=float(fraction))
        assert found.weights == close(backend, solved(PROBLEM, point).weights)


@pytest.mark.parametrize("case", OF_SQUARES, ids=describe)
@pytest.mark.parametrize("seed", range(2))
def test_orthonormal_columns_give_the_prox_of_their_correlations(case, seed):
    problem = orthonormal(seed)
    backend = backends.get(case[0], **{**case[1], "alpha_fraction": 0.3})
    penalty = backend.penalty(problem)
    alpha = 0.3 * problem.alpha_max(penalty)
    expected = penalty.prox(problem.cross, alpha) / (1.0 + alpha * penalty.ridge)
    assert 0.0 < np.linalg.norm(expected) < np.linalg.norm(problem.cross)
    assert solved(problem, backend).weights * problem.design.rms[:, None] == close(
        backend, expected
    )


@every
def test_fewer_samples_than_columns(case):
    wide = RegressionProblem.from_arrays(PROBLEM.theta[:7], PROBLEM.target[:7], PROBLEM.groups)
    backend = backends.get(case[0], **case[1])
    found = sf.fit(wide, backend, tolerance=1e-6)
    refused = backend == backends.get("least-squares") or getattr(backend, "ridge", 1.0) == 0
    assert found.status == ("error" if refused else "ok"), found.reason
    assert np.isnan(found.weights).all() == refused
    if refused:
        assert "7 samples are fewer than 12 columns" in found.reason
