"""Dirty samples: what is mended, what is not, and that clean flights are left alone."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.rows import Derivative, Repairs
from sparsefit.rows.clean import Pieces, clean_position, clean_velocity, straddling

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
FLOW = CellularFlow(12.0, 4.0)
NOISE = {"velocity_noise": 0.2, "position_noise": 0.05}
AUTO, RAW = Derivative(), Derivative(repair=False)
ARRAYS = ("time", "position", "velocity", "position_rate", "acceleration")


@cache
def flown(seed=1, duration=8.0, rate=100.0, flow=FLOW, **noise):
    return simulate_flight(flow, VEHICLE, duration=duration, sample_rate=rate, seed=seed, **noise)


@pytest.fixture(scope="module")
def exact():
    return flown()


@pytest.fixture(scope="module")
def noisy():
    return flown(**NOISE)


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
@pytest.mark.parametrize("case", ["exact", "noisy"])
def test_outliers_are_found_and_nothing_else_moves(request, case, count):
    flight = request.getfixturevalue(case)
    dirty, rows = spoilt(flight, count, seed=count)
    velocity = clean_velocity(dirty.velocity)
    assert clean_position(dirty.position, velocity, 0.01) is dirty.position
    replaced = np.any(velocity != dirty.velocity, axis=1)
    assert set(np.flatnonzero(replaced).tolist()) == rows
    np.testing.assert_array_equal(velocity[~replaced], flight.velocity[~replaced])
    assert np.abs(velocity - flight.velocity).max() < (1.2 if case == "noisy" else 0.1)
    repairs = AUTO(dirty).repairs
    assert repairs.outliers == count
    assert repairs.largest_outlier == pytest.approx(5.0, abs=1.2)


def test_outliers_cost_little_where_they_are_repaired(exact, noisy):
    dirty, _ = spoilt(noisy, 40, seed=5)

    def error(rule, flight):
        samples = rule(flight)
        truth = np.interp(samples.time, exact.time, exact.velocity[:, 0])
        return np.sqrt(np.mean((samples.velocity[:, 0] - truth) ** 2))

    assert error(AUTO, dirty) < 1.3 * error(AUTO, noisy)
    assert error(RAW, dirty) > 2.0 * error(AUTO, noisy)


@pytest.mark.parametrize("case", ["exact", "noisy"])
def test_a_jump_is_taken_out_of_all_later_positions(request, case):
    flight = request.getfixturevalue(case)
    position = flight.position.copy()
    position[300:] += [1.0, -0.5]
    position[520:] += [0.0, 2.0]
    mended = clean_position(position, flight.velocity, 0.01)
    left = mended - flight.position
    np.testing.assert_array_equal(left[:300], 0.0)
    assert np.abs(left).max() < (0.1 if case == "noisy" else 1e-3)
    assert AUTO(dataclasses.replace(flight, position=position)).repairs.jumps == 2


def test_a_position_off_by_itself_moves_no_other(noisy):
    position = noisy.position.copy()
    position[400] += [2.0, 0.0]
    mended = clean_position(position, noisy.velocity, 0.01)
    np.testing.assert_allclose(np.delete(mended - noisy.position, 400, axis=0), 0.0, atol=0.05)


def test_no_window_crosses_a_gap(exact):
    rows = np.r_[0:300, 360:801]
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
    found = straddling(np.array([3]), 3, 5)  # of samples 0-2, 1-3, 2-4, 3-5, 4-6
    np.testing.assert_array_equal(found, [False, True, True, False, False])
    time = np.array([0.0, 1.0, 2.0, 9.0, 10.0])
    pieces = Pieces(time, np.zeros((5, 4)), np.empty(0, dtype=np.intp)).cut(2)
    assert pieces.slices == [slice(0, 3), slice(3, 5)]
    assert pieces.step == 1.0


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
    assert errors["uneven"] < 1.3 * errors["even"]


def test_repeated_samples_are_dropped(exact):
    rows = 4 * (np.arange(801) // 4)  # a log at 100 Hz of what was measured at 25 Hz
    held = Flight(exact.time, exact.position[rows], exact.velocity[rows], VEHICLE)
    samples, slow = AUTO(held), AUTO(rows_of(exact, slice(None, None, 4)))
    assert samples.repairs.repeated == 600
    np.testing.assert_array_equal(samples.velocity, slow.velocity)


def test_a_vehicle_at_rest_repeats_nothing():
    time = np.arange(300) / 100.0
    rest = Flight(time, np.zeros((300, 2)), np.zeros((300, 2)), VEHICLE)
    assert AUTO(rest).repairs == Repairs()


def test_where_most_stand_out_none_does(noisy):
    dirty, _ = spoilt(noisy, 320, seed=2, size=50.0)
    assert AUTO(dirty).repairs.outliers == 0


def test_off_by_a_setting(noisy):
    dirty, _ = spoilt(noisy, 8, seed=1)
    assert RAW(dirty).repairs == Repairs()
    with pytest.raises(InputError, match="repair must be true or false; got 1"):
        Derivative(repair=1)


def test_repairs_in_words():
    assert not Repairs().words
    found = Repairs(outliers=2, largest_outlier=5.04, gaps=1, longest_gap=0.5)
    assert found.words == "2 outliers of up to 5.04 m/s replaced, 1 gap of up to 0.5 s left open"
