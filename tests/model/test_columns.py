"""Columns of cells and of waves: against formulas, differences, and sums over the rows."""

import math

import numpy as np
import pytest
from scipy.special import j0

from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.waves import WaveFlow
from sparsefit.model.grid import candidate_columns, sines_and_cosines, wave_columns
from sparsefit.model.readout import CandidateFlow, rms_mean_velocity, wave_peaks

EQUATION_1 = np.zeros((8, 2))
EQUATION_1[5, 0], EQUATION_1[6, 1] = 1.0, -1.0  # sin x cos y, -cos x sin y
POSITION = np.random.default_rng(1).uniform(-9, 9, (40, 2))


def test_sines_and_cosines_are_those_of_numpy():
    phase = np.concatenate([np.linspace(-50.0, 50.0, 2001), np.pi * np.arange(-9, 10)])
    sine, cosine = sines_and_cosines(phase)
    np.testing.assert_allclose(sine, np.sin(phase), atol=7e-16 * 50)
    np.testing.assert_allclose(cosine, np.cos(phase), atol=7e-16 * 50)


def test_candidates_are_a_flow_anywhere():
    flow = CellularFlow(15.43, 4.21)
    k = np.array([flow.wavenumber])
    own = CandidateFlow(k, 15.43 * EQUATION_1[None], np.array([4.21, 8.42]) * 2)
    x, y = POSITION.T.reshape(2, 8, 5)
    np.testing.assert_allclose(own.velocity(x, y), flow.velocity(x, y), atol=1e-12)
    assert rms_mean_velocity(15.43 * EQUATION_1) == pytest.approx(15.43)


def test_the_rms_is_that_over_the_cell():
    weights = np.random.default_rng(4).normal(size=(8, 2))
    axis = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    cell = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    speed = np.linalg.norm(candidate_columns(cell, np.array([np.pi])) @ weights, axis=1)
    assert rms_mean_velocity(weights) == pytest.approx(np.sqrt(2 * np.mean(speed**2)), rel=1e-12)


def test_waves_are_those_of_a_flow():
    k = np.array([[0.7, -0.4], [0.2, 1.1]])
    a, b = np.array([[1.0, -0.5], [0.3, 0.8]])
    flow = WaveFlow(k, a, b).velocity(*POSITION.T)
    theta = wave_columns(POSITION, k)
    np.testing.assert_allclose(theta @ np.column_stack([a, b]).ravel(), flow.ravel(), atol=1e-13)


def test_a_wave_between_those_of_a_grid_is_one_peak_at_its_place():
    """The weights of neighbours fall as the sums over a disc of positions do."""
    step = math.pi / 20.0
    axis = step * np.arange(-8, 9)
    k = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    k = k[(k[:, 1] > 0) & (np.hypot(*k.T) > 0.3)]
    true = np.array([0.9, 0.45])
    share = j0(10.0 * np.linalg.norm(k - true, axis=1)) ** 2
    weights = np.column_stack([share, np.zeros(len(k))]) / np.hypot(*k.T)[:, None]
    tops, peaks = wave_peaks(k, weights, 20.0, 5)
    assert np.linalg.norm(peaks[0] - true) < 0.3 * step
    assert tops[0] == share.argmax()
    assert len(wave_peaks(k, 0 * weights, 20.0, 5)[0]) == 0
