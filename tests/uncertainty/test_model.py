"""The fitted model: its Jacobian is that of differences, for any family, rows and nuisances."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array

from sparsefit.library.cells import Cells
from sparsefit.library.family import Family
from sparsefit.library.waves import Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project
from sparsefit.uncertainty.information import Information
from sparsefit.uncertainty.model import Model
from tests.fits import located

COUNT = 60


def rows_of(weak, unknown):
    rng = np.random.default_rng(7)
    operator, count = None, COUNT
    if weak:
        count = COUNT - 4
        dense = [np.roll(np.r_[np.full(5, 0.2), np.zeros(COUNT - 5)], i) for i in range(count)]
        operator = csr_array(np.array(dense))
    nuisance = rng.standard_normal((2, count, 3 if unknown else 0))
    return Rows(rng.uniform(-9, 9, (COUNT, 2)), rng.standard_normal((count, 2)), nuisance, operator)


def model_of(family, rows):
    parameters = {"cells": [[0.7], [1.1]], "waves": [[0.7, 0.4], [-0.3, 0.9]]}[family.name]
    return Model.of(family, rows, project(family, rows, np.array(parameters)))


def at(model, theta):
    parameters, weights, coefficients = model.split(theta)
    return replace(model, parameters=parameters, weights=weights, coefficients=coefficients)


def dense(model):
    """J (2 q, n), x before y, by what it does to every direction of theta."""
    return model.jacobian.times(np.eye(model.jacobian.size)).reshape(model.jacobian.size, -1).T


families = pytest.mark.parametrize("family", [Cells(), Waves()], ids=lambda family: family.name)
kinds = pytest.mark.parametrize("weak", [False, True], ids=["samples", "weak"])
unknowns = pytest.mark.parametrize("unknown", [False, True], ids=["known", "unknown"])


def test_waves_are_a_family():
    assert isinstance(Waves(), Family)


@families
@kinds
@unknowns
def test_the_jacobian_is_that_of_differences(family, weak, unknown):
    model = model_of(family, rows_of(weak, unknown))
    theta = model.joined(model.parameters, model.weights, model.coefficients)
    assert len(theta) == model.jacobian.size
    expected, step = [], 1e-6
    for shift in step * np.eye(len(theta)):
        above, below = (at(model, theta + sign * shift).fitted for sign in (1, -1))
        expected.append((above - below).T.ravel() / (2 * step))
    jacobian = dense(model)
    np.testing.assert_allclose(jacobian.T, expected, atol=1e-6)
    np.testing.assert_allclose(model.jacobian.gram, jacobian.T @ jacobian, atol=1e-9)
    errors = np.random.default_rng(1).standard_normal(model.rows.target.shape)
    np.testing.assert_allclose(model.jacobian.score(errors), jacobian.T @ errors.T.ravel())
    spectra = model.jacobian.turned(np.eye(len(theta)), model.jacobian.spectra(75))
    times = model.jacobian.times(np.eye(len(theta)))
    np.testing.assert_allclose(spectra, np.fft.rfft(times, 75), atol=1e-12)


@families
@kinds
@unknowns
def test_the_projection_leaves_nothing_along_the_weights(family, weak, unknown):
    model = model_of(family, rows_of(weak, unknown))
    score = model.jacobian.score(model.residual)
    free = model.parameters.size
    assert np.abs(score[free:]).max() < 1e-9
    assert np.abs(score[:free]).max() > 1e-3


@families
def test_a_step_in_theta_is_that_of_its_parts(family):
    model = model_of(family, rows_of(weak=False, unknown=True))
    theta = np.arange(model.jacobian.size, dtype=float)
    np.testing.assert_array_equal(model.joined(*model.split(theta)), theta)
    score = np.random.default_rng(2).standard_normal(len(theta))
    moved = model.moved(score)
    before, after = (m.joined(m.parameters, m.weights, m.coefficients) for m in (model, moved))
    expected = np.linalg.pinv(dense(model).T @ dense(model)) @ score
    np.testing.assert_allclose(after - before, expected, rtol=1e-6, atol=1e-12)


@families
def test_the_flow_in_space_is_that_of_differences(family):
    model, step = model_of(family, rows_of(weak=False, unknown=False)), 1e-4
    second = np.zeros_like(model.laplacian)
    for axis, shift in enumerate(np.eye(2) * step):
        ends = [model.rows.position + sign * shift for sign in (1, -1)]
        above, below = (replace(model, rows=replace(model.rows, position=x)) for x in ends)
        expected = (above.flow - below.flow) / (2 * step)
        np.testing.assert_allclose(model.gradient[axis].T, expected, atol=1e-6)
        second += (above.gradient[axis] - below.gradient[axis]) / (2 * step)
    np.testing.assert_allclose(model.laplacian, second, atol=1e-5)


@families
@kinds
def test_errors_move_theta_by_their_influence(family, weak):
    rows = rows_of(weak, unknown=True)
    truth = model_of(family, rows)
    rows = replace(rows, target=truth.fitted)
    error = 1e-6 * np.random.default_rng(3).standard_normal(rows.target.shape)

    def theta(sign):
        fit = located(replace(rows, target=rows.target + sign * error), truth.parameters, family)
        return truth.joined(fit.parameters, fit.weights, fit.coefficients)

    influence = truth.influence(np.eye(truth.jacobian.size))
    expected = np.einsum("ftq,qt->f", influence, error)
    np.testing.assert_allclose(0.5 * (theta(1) - theta(-1)), expected, rtol=1e-4, atol=1e-10)


def test_a_line_tells_some_and_not_all():
    t = np.linspace(0, 10, 400)
    position = np.stack([3.0 * t, 3.0 * t], axis=1)
    rows = Rows.plain(position, np.zeros((400, 2)))
    weights = np.arange(16.0).reshape(1, 8, 2)
    model = Model(Cells(), rows, np.array([[0.8]]), weights, np.zeros(0))
    assert not model.information.whole  # on a diagonal sin x = sin y: only their sum is told
    one, other = np.zeros((2, 17))
    one[1] = other[1] = other[2] = 1.0
    assert model.information.lost(np.stack([one, other])).tolist() == [True, False]


def test_the_pseudo_inverse_leaves_out_what_is_not_told():
    jacobian = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 0.0], [0.0, 0.0, 3.0]])
    information = Information.of(jacobian.T @ jacobian)
    np.testing.assert_allclose(
        information.solved(np.eye(3)), np.linalg.pinv(jacobian.T @ jacobian), atol=1e-12
    )
    assert not information.whole
    assert information.lost(np.array([[1.0, 0, 0], [1, 1, 0], [0, 0, 1]])).tolist() == [1, 0, 0]
    assert information.lost(np.array([[math.nan, 0.0, 0.0]])).tolist() == [True]


@families
def test_what_a_fit_leaves_of_a_spectrum(family):
    # Errors of a known spectrum, projected off J by dense matrices; ends of the flight aside.
    t = np.linspace(0, 8, 300)
    position = np.stack([6 * np.sin(t) + t, 5 * np.cos(0.7 * t) + 2 * t], axis=1)
    m, size = len(t), 4 * len(t)
    model = model_of(family, Rows.plain(position, np.random.default_rng(3).standard_normal((m, 2))))
    shape = np.abs(np.fft.rfft(np.array([1.0, 0.6, 0.3]), size)) ** 2
    tiled = np.fft.irfft(shape, size)[np.abs(np.subtract.outer(np.arange(m), np.arange(m)))]
    covariance = np.kron(np.eye(2), tiled)
    jacobian = dense(model)
    off = np.eye(2 * m) - jacobian @ np.linalg.pinv(jacobian)
    after = off @ covariance @ off
    expected = np.zeros(size // 2 + 1)
    for component in range(2):
        part = slice(component * m, (component + 1) * m)
        once = np.fft.rfft(after[part, part], size, axis=0)  # E F e e'F', its diagonal
        turned = np.exp(-2j * np.pi * np.outer(np.arange(size // 2 + 1), np.arange(m)) / size)
        expected += np.sum(once * turned.conj(), axis=1).real / (2 * m)
    (left,) = model.left(shape[None], model.jacobian.spectra(size), size)
    assert np.abs(left - expected).max() < 0.05 * expected.max()
    assert left.sum() == pytest.approx(expected.sum(), rel=1e-2)
    assert (left < 0.9 * shape).any()


@families
@kinds
@unknowns
def test_freed_columns_are_orthogonal_to_the_jacobian(family, weak, unknown):
    model = model_of(family, rows_of(weak, unknown))
    columns = np.random.default_rng(1).standard_normal((3, 2, len(model.rows.target)))
    jacobian = dense(model)
    flat = columns.reshape(3, -1).T
    expected = flat - jacobian @ np.linalg.lstsq(jacobian, flat, rcond=1e-10)[0]
    np.testing.assert_allclose(model.freed(columns).reshape(3, -1).T, expected, atol=1e-8)
