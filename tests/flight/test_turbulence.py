"""Turbulence against its theory: rms, spectrum, isotropy, memory, seeds."""

import math

import numpy as np
import pytest

from sparsefit.flight.waves import Turbulence

LENGTH, STEP, POINTS = 5.0, 0.5, 2048
LINE = np.arange(POINTS) * STEP
KNEES = {"dryden": (1.0, 1.0), "von-karman": (1.339, 5.0 / 6.0)}


@pytest.fixture(scope="module")
def lines():
    """The velocity along a line of 205 lengths, for 16 fields each."""
    return {
        name: np.array(
            [Turbulence(2.0, LENGTH, spectrum=name, seed=s).velocity(LINE, 0.0) for s in range(16)]
        )
        for name in KNEES
    }


@pytest.mark.parametrize("name", KNEES)
def test_each_component_has_the_intensity(lines, name):
    assert np.sqrt(np.mean(lines[name] ** 2, axis=(0, 1))) == pytest.approx([2.0, 2.0], rel=0.03)
    field = Turbulence(2.0, LENGTH, spectrum=name)
    # pairs of waves at right angles: over the plane it is exact, for each component
    power = field.waves.wavevectors**2 * (field.waves.cosine**2 + field.waves.sine**2)[:, None] / 2
    assert power.sum(axis=0) == pytest.approx([4.0, 4.0], rel=1e-12)
    assert field.mean_velocity == pytest.approx(field.waves.mean_velocity, rel=1e-12) == 4.0


@pytest.mark.parametrize("name", KNEES)
def test_spectrum_along_a_line_is_the_named_one(lines, name):
    window = np.hanning(POINTS)
    sums = np.abs(np.fft.rfft(lines[name][:, :, 0] * window, axis=1)) ** 2
    measured = sums.mean(axis=0) * STEP / math.pi / np.sum(window**2)
    k = 2 * math.pi * np.fft.rfftfreq(POINTS, STEP)
    knee, power = KNEES[name]
    # one-sided, of integral sigma^2: sigma^2 2 L/pi / (1 + (c L k)^2)^p
    theory = 4.0 * 2 * LENGTH / math.pi / (1 + (knee * LENGTH * k) ** 2) ** power
    for low, high in ((0.2, 0.7), (0.7, 2.0), (2.0, 7.0), (7.0, 20.0)):
        band = (k * LENGTH >= low) & (k * LENGTH < high)
        assert measured[band].sum() / theory[band].sum() == pytest.approx(1.0, abs=0.16)


def test_the_lateral_component_is_that_of_a_plane_flow_without_divergence(lines):
    # Dryden in the plane: the correlation of the lateral velocity is (1 - r/L) exp(-r/L)
    for lag in (5, 10, 20):
        ratio = lag * STEP / LENGTH
        along, across = (
            np.mean(lines["dryden"][:, lag:, part] * lines["dryden"][:, :-lag, part]) / 4.0
            for part in (0, 1)
        )
        assert along == pytest.approx(math.exp(-ratio), abs=0.08)
        assert across == pytest.approx((1 - ratio) * math.exp(-ratio), abs=0.08)


def test_memory_is_the_integral_time_of_a_place():
    time, places = np.arange(0.0, 3.0, 0.3), 40.0 * np.arange(40)[:, None]
    fields = (Turbulence(1.0, LENGTH, memory=2.0, seed=seed) for seed in range(16))
    series = np.concatenate([field.velocity(places, 0.0, time) for field in fields])
    memory = np.mean(series * series[:, :1], axis=(0, 2))
    np.testing.assert_allclose(memory, np.exp(-math.pi / 4 * (time / 2.0) ** 2), atol=0.12)


def test_frozen_turbulence_does_not_move_and_is_the_start_of_an_evolving_one():
    frozen, moving = Turbulence(1.0, 5.0, seed=3), Turbulence(1.0, 5.0, memory=2.0, seed=3)
    np.testing.assert_array_equal(frozen.velocity(LINE, 1.0, 9.0), frozen.velocity(LINE, 1.0))
    np.testing.assert_array_equal(frozen.velocity(LINE, 1.0), moving.velocity(LINE, 1.0))
    assert np.ptp(moving.velocity(1.0, 1.0, LINE)) > 1.0


def test_a_seed_is_a_field_and_intensity_only_scales_it():
    here = Turbulence(1.0, 5.0, seed=3).velocity(LINE, 1.0)
    np.testing.assert_array_equal(Turbulence(1.0, 5.0, seed=3).velocity(LINE, 1.0), here)
    assert np.abs(Turbulence(1.0, 5.0, seed=4).velocity(LINE, 1.0) - here).max() > 0.5
    twice = Turbulence(2.0, 5.0, seed=3).velocity(LINE, 1.0)
    np.testing.assert_allclose(twice, 2.0 * here, rtol=1e-12, atol=1e-12)
    assert len(Turbulence(1.0, 5.0).waves.cosine) == 128
