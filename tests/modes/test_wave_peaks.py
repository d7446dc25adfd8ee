"""Peaks of weights over the plane, headings and length scales of pairs, the origin of phases."""

import math

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.modes.wave_peaks import (
    at_origin,
    strengths,
    wave_peaks,
)

EXTENT = 20.0
NEAR = math.pi / EXTENT


def test_strength_is_the_amplitude_of_the_velocity():
    k, weights = np.array([[0.6, 0.8], [0.0, -2.0]]), np.array([[3.0, 4.0], [0.5, 0.0]])
    assert strengths(k, weights) == pytest.approx([5.0, 1.0])


def test_a_wave_between_two_of_the_grid_is_one_peak_between_them():
    k = np.array([[1.0, 0.0], [1.0 + NEAR, 0.0], [0.0, 1.5]])
    weights = np.array([[2.0, 0.0], [0.0, 2.0 / (1.0 + NEAR)], [1.0, 0.0]])
    peaks = wave_peaks(k, weights, EXTENT, 5)
    np.testing.assert_allclose(peaks.wavevectors, [[1.0 + 0.5 * NEAR, 0.0], [0.0, 1.5]])
    assert peaks.top.tolist() in ([0, 2], [1, 2])


def test_a_wave_and_its_opposite_are_one():
    """The half plane ends at the angle pi, beside the angle 0 of the waves with -k."""
    k = np.array([[1.0, 0.01], [-1.0, 0.01]])
    peaks = wave_peaks(k, np.array([[1.0, 0.0], [1.0, 0.0]]), EXTENT, 5)
    np.testing.assert_allclose(np.abs(peaks.wavevectors), [[1.0, 0.0]], atol=1e-12)


def test_what_is_far_weaker_than_the_strongest_proposes_nothing():
    k = np.array([[1.0, 0.0], [0.0, 1.0], [2.0, 0.0]])
    weights = np.array([[10.0, 0.0], [0.9, 0.0], [1.0, 0.0]])
    assert wave_peaks(k, weights, EXTENT, 5).top.tolist() == [0, 2]
    assert wave_peaks(k, weights, EXTENT, 1).top.tolist() == [0]


def test_phases_are_carried_to_another_origin():
    rng = np.random.default_rng(3)
    k, weights, origin = rng.normal(size=(4, 2)), rng.normal(size=(4, 2)), np.array([3.0, -7.0])
    moved = sf.WaveFlow(k, *at_origin(k, weights, origin).T)
    here = sf.WaveFlow(k, *weights.T)
    x, y = rng.uniform(-9.0, 9.0, (2, 20))
    np.testing.assert_allclose(
        moved.velocity(x, y), here.velocity(x - origin[0], y - origin[1]), atol=1e-12
    )
