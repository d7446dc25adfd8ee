"""Descent with an exact polish: the optimality conditions, on sparse designs of every kind."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from sparsefit.regression.design import Design
from sparsefit.regression.penalties import AbsoluteValues
from sparsefit.solvers.descent import descent_path
from sparsefit.solvers.registry import solver

pytest.importorskip("sparsefit.solvers.sweeps", reason="it was not compiled")


def problem(seed, rows, columns, density):
    rng = np.random.default_rng(seed)
    theta = sparse.random_array((rows, columns), density=density, rng=rng, format="csc")
    theta = sparse.csc_matrix(theta + sparse.eye_array(rows, columns))
    theta = theta @ sparse.diags(rng.uniform(0.1, 10.0, columns))
    truth = rng.normal(size=columns) * (rng.random(columns) < 0.1)
    target = theta @ truth + 0.1 * rng.normal(size=rows)
    return Design(sparse.csc_matrix(theta), rows), target


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("centred", [False, True])
@pytest.mark.parametrize("ridge", [0.0, 0.5])
@pytest.mark.parametrize(
    ("rows", "columns", "density"), [(60, 200, 0.05), (300, 60, 0.1), (80, 80, 0.5)]
)
def test_every_point_of_a_path_is_optimal(seed, centred, ridge, rows, columns, density):
    design, target = problem(seed, rows, columns, density)
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


def test_its_weights_are_those_of_the_referee():
    design, target = problem(7, 100, 150, 0.1)
    penalty = AbsoluteValues(np.ones(150), ridge=0.2)
    cross = design.correlate(target[:, None])[:, 0]
    alphas = np.abs(cross).max() * np.array([0.5, 0.1, 0.02])
    long = design.source.astype(float)
    long.indices, long.indptr = long.indices.astype(np.int64), long.indptr.astype(np.int64)
    weights, _, _ = descent_path(Design(long, 100), target, cross, penalty, alphas)
    reference = solver("clarabel").path(design, target[:, None], penalty, alphas, 1e-10)
    np.testing.assert_allclose(weights, reference[:, :, 0], atol=1e-6)


def test_columns_that_are_copies_share_an_optimum():
    design, target = problem(8, 60, 40, 0.2)
    double = Design(sparse.csc_matrix(sparse.hstack([design.source, design.source])), 60)
    penalty = AbsoluteValues(np.ones(80))
    cross = double.correlate(target[:, None])[:, 0]
    alphas = np.abs(cross).max() * np.array([0.3, 0.05])
    weights, complete, _ = descent_path(double, target, cross, penalty, alphas)
    assert complete.all()
    pull = double.correlate(target[:, None] - double.predict(weights[1][:, None]))[:, 0]
    assert np.abs(pull).max() <= alphas[1] * (1.0 + 1e-9)
