"""The family of cells: its columns, their derivatives, and what is read from their weights."""

import math

import numpy as np
import pytest

from sparsefit.flight.flow import CellularFlow
from sparsefit.library.cells import (
    CANDIDATES,
    MEAN_SQUARE,
    Cells,
    candidate_columns,
    rms_mean_velocity,
)
from sparsefit.library.family import Family

POSITION = np.random.default_rng(1).uniform(-9, 9, (40, 2))
K = np.array([[0.4], [1.1], [2.9]])
STEP = 1e-5


def test_it_is_a_family():
    assert isinstance(Cells(), Family)
    assert Cells().size == len(CANDIDATES)


def test_columns_are_those_of_the_library():
    columns = Cells().values(POSITION, K).transpose(2, 0, 1).reshape(len(POSITION), -1)
    theta = candidate_columns(POSITION, math.pi / K[:, 0])
    np.testing.assert_allclose(columns, theta, atol=1e-14)


def test_derivatives_by_the_wavenumber_are_those_of_differences():
    cells = Cells()
    values = cells.values(POSITION, K)
    above, below = (cells.values(POSITION, K + step) for step in (STEP, -STEP))
    slopes = cells.slopes(POSITION, K, values)
    np.testing.assert_allclose(slopes[:, 0], (above - below) / (2 * STEP), atol=1e-7)
    bends = cells.bends(POSITION, K, values)
    rise = [cells.slopes(POSITION, K, shifted)[:, 0] for shifted in (above, below)]
    np.testing.assert_allclose(bends[:, 0, 0], (rise[0] - rise[1]) / (2 * STEP), atol=1e-6)


def test_derivatives_in_space_are_those_of_differences():
    cells = Cells()
    values = cells.values(POSITION, K)
    gradients = cells.gradients(K, values)
    second = np.zeros_like(values)
    for axis, shift in enumerate(np.eye(2) * STEP):
        above, below = (cells.values(POSITION + sign * shift, K) for sign in (1, -1))
        np.testing.assert_allclose(gradients[axis], (above - below) / (2 * STEP), atol=1e-7)
        ends = [cells.gradients(K, shifted)[axis] for shifted in (above, below)]
        second += (ends[0] - ends[1]) / (2 * STEP)
    np.testing.assert_allclose(cells.laplacians(K, values), second, atol=1e-6)


def test_the_bent_flow_is_the_slopes_times_the_weights():
    cells = Cells()
    weights = np.random.default_rng(2).standard_normal((3, 8, 2))
    values = cells.values(POSITION, K)
    slopes = cells.slopes(POSITION, K, values)
    expected = np.einsum("spcm,scn->spmn", slopes, weights)
    bent = cells.bent(POSITION, K, values, weights)
    np.testing.assert_allclose(bent, expected, rtol=1e-12, atol=1e-12)


def test_the_bent_flow_in_space_is_that_of_differences():
    cells = Cells()
    weights = np.random.default_rng(4).standard_normal((3, 8, 2))
    gradients = cells.bent_gradients(POSITION, K, cells.values(POSITION, K), weights)
    for axis, shift in enumerate(np.eye(2) * STEP):
        ends = [POSITION + sign * shift for sign in (1, -1)]
        above, below = (cells.bent(end, K, cells.values(end, K), weights) for end in ends)
        np.testing.assert_allclose(gradients[axis], (above - below) / (2 * STEP), atol=1e-6)


def test_mean_squares_are_those_over_a_cell():
    axis = np.arange(64) * (2 * math.pi / 64)
    cell = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    values = Cells().values(cell, np.ones((1, 1)))[0]
    np.testing.assert_allclose(np.mean(values**2, axis=1), MEAN_SQUARE, atol=1e-14)


def test_the_flow_of_equation_1_has_its_mean_velocity():
    flow = CellularFlow(15.43, 4.21)
    weights = np.zeros((8, 2))
    weights[5, 0], weights[6, 1] = 15.43, -15.43
    values = Cells().values(POSITION, np.array([[flow.wavenumber]]))[0]
    np.testing.assert_allclose(values.T @ weights, flow.velocity(*POSITION.T), atol=1e-12)
    assert rms_mean_velocity(weights) == pytest.approx(15.43)
