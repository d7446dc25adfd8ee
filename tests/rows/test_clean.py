"""Dirty samples: what is mended, what is not, and that clean flights are left alone."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.rows import Derivative, Repairs
from sparsefit.rows.clean import LogPieces, without_outliers

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
FLOW = CellularFlow(12.0, 4.0)
NOISE = {"velocity_noise": 0.2, "position_noise": 0.05}
AUTO = Derivative()
ARRAYS = ("time", "position", "velocity", "position_rate", "acceleration")


@cache
def flown(seed=1, duration=8.0, rate=100.0, flow=FLOW, **noise):
    return simulate_flight(flow, VEHICLE, duration=duration, sample_rate=rate, seed=seed, **noise)


def rows_of(flight, rows):
    arrays = (getattr(flight, name)[rows] for name in ("time", "position", "velocity"))
    return Flight(*arrays, VEHICLE)


def spoilt(flight, count, seed, size=5.0):
    """The flight with so many velocities off by ``size`` [m/s], and which."""
    rng = np.random.default_rng(seed)
    rows = rng.choice(flight.samples, count, replace=False)
    angle = rng.uniform(0.0, 2.0 * np.pi, count)
    velocity = flight.velocity.copy()
    velocity[rows] += size * np.column_stack([np.cos(angle), np.sin(angle)])
    return dataclasses.replace(flight, velocity=velocity), set(rows.tolist())


@pytest.mark.parametrize("timescale", [0.05, 0.3])
@pytest.mark.parametrize(
    "noise", [{}, {"velocity_noise": 0.01}, NOISE, {"process_noise": 2.0}], ids=str
)
@pytest.mark.parametrize("method", ["forward", "auto"])
def test_clean_flights_are_not_touched(timescale, noise, method):
    flight = flown(3, 3.0, flow=CellularFlow(5.0 / timescale, 5.0), **noise)
    here, there = Derivative(method)(flight), Derivative(method, repair=False)(flight)
    assert here.repairs == Repairs()
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(here, name), getattr(there, name))


@pytest.mark.parametrize("count", [2, 8, 40])
@pytest.mark.parametrize("noise", [{}, NOISE], ids=str)
def test_outliers_are_found_and_nothing_else_moves(noise, count):
    flight = flown(**noise)
    dirty, rows = spoilt(flight, count, seed=count)
    velocity = without_outliers(dirty.velocity)
    assert without_outliers(dirty.position) is dirty.position
    replaced = np.any(velocity != dirty.velocity, axis=1)
    assert set(np.flatnonzero(replaced).tolist()) == rows
    np.testing.assert_array_equal(velocity[~replaced], flight.velocity[~replaced])
    assert np.abs(velocity - flight.velocity).max() < (1.2 if noise else 0.1)
    assert AUTO(dirty).repairs == Repairs(outliers=count)


def test_a_position_off_by_itself_moves_no_other():
    noisy = flown(**NOISE)
    position = noisy.position.copy()
    position[400] += [2.0, 0.0]
    mended = without_outliers(position)
    np.testing.assert_allclose(mended[400], noisy.position[400], atol=0.2)
    np.testing.assert_array_equal(np.delete(mended - noisy.position, 400, axis=0), 0.0)


def test_no_window_crosses_a_gap():
    exact, rows = flown(), np.r_[0:300, 360:801]
    samples = AUTO(rows_of(exact, rows))
    assert (samples.repairs.gaps, samples.repairs.longest_gap) == (1, pytest.approx(0.61))
    half = samples.smoothing.window // 2
    expected = exact.time[np.r_[half : 300 - half, 360 + half : 801 - half]]
    np.testing.assert_allclose(samples.time, expected, atol=1e-12)
    truth = FLOW.velocity(*samples.position.T)
    np.testing.assert_allclose(samples.flow_velocity(VEHICLE), truth, atol=1e-4)
    forward = Derivative("forward")(rows_of(exact, rows))
    assert len(forward.time) == len(rows) - 2


def test_windows_that_cross_a_gap_by_hand():
    time = np.array([0.0, 1.0, 2.0, 9.0, 10.0, 11.0, 12.0])
    pieces = LogPieces(time, np.zeros((7, 4)), np.array([3]))
    found = pieces.whole(3)  # of samples 0-2, 1-3, 2-4, 3-5, 4-6
    np.testing.assert_array_equal(found, [True, False, False, True, True])
    assert pieces.slices == [slice(0, 3), slice(3, 7)]
    assert (pieces.step, pieces.even) == (1.0, True)


def test_pieces_too_short_for_a_filter_give_no_rows():
    part = rows_of(flown(), np.r_[0:300, 340:341, 400:420, 480:801])
    samples = AUTO(part)
    assert samples.repairs == Repairs(gaps=3, longest_gap=pytest.approx(0.61))
    assert not ((samples.time > 3.0) & (samples.time < 4.0)).any()  # one sample alone
    truth = FLOW.velocity(*samples.position.T)
    np.testing.assert_allclose(samples.flow_velocity(VEHICLE), truth, atol=1e-4)


def test_uneven_steps_are_smoothed_as_even_ones():
    rng, even = np.random.default_rng(4), np.arange(801) / 100.0
    time = even + 0.003 * rng.uniform(-1.0, 1.0, 801)
    errors = {}
    for name, at in (("even", even), ("uneven", time)):
        position = np.column_stack([np.sin(3 * at), np.cos(2 * at)])
        velocity = np.column_stack([3 * np.cos(3 * at), -2 * np.sin(2 * at)])
        noise = np.random.default_rng(5).standard_normal((2, 801, 2))
        flight = Flight(at, position + 0.05 * noise[0], velocity + 0.2 * noise[1], VEHICLE)
        samples = AUTO(flight)
        assert samples.smoothing.method == "auto"
        off = samples.acceleration[:, 0] + 9 * np.sin(3 * samples.time)
        errors[name] = np.sqrt(np.mean(off**2))
        assert samples.repairs == Repairs(resampled=0 if name == "even" else len(even))
    assert errors["uneven"] < 1.5 * errors["even"]  # what is interpolated is not white


def test_where_most_stand_out_none_does():
    dirty, _ = spoilt(flown(**NOISE), 320, seed=2, size=50.0)
    assert AUTO(dirty).repairs.outliers == 0


def test_repairs_in_words():
    assert not Repairs().words
    found = Repairs(outliers=2, gaps=1, longest_gap=0.5)
    assert found.words == "2 outliers replaced, 1 gap of up to 0.5 s left open"
