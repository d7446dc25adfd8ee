"""The smoother that tunes itself: kernels, noise levels, the choice of window."""

import math
import warnings
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle, turning
from sparsefit.rows import Derivative
from sparsefit.rows.clean import LogPieces
from sparsefit.rows.smoothing import (
    FEWEST,
    ORDER,
    SHORTEST,
    filtered,
    least_risk,
    noise_level,
    polynomial_kernels,
    smooth,
)

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
AUTO = Derivative("auto")


@cache
def fly(seed, timescale, duration=10.0, **noise):
    length_scale = np.random.default_rng(seed).uniform(2.0, 10.0)
    flow = CellularFlow(length_scale / timescale, length_scale)
    return simulate_flight(flow, VEHICLE, duration=duration, sample_rate=100.0, seed=seed, **noise)


def log_of(position, velocity, step=0.01):
    time = step * np.arange(len(position))
    return LogPieces(time, np.hstack([position, velocity]), np.empty(0, dtype=np.intp))


def test_polynomial_kernels_are_the_least_squares_polynomial_in_the_middle():
    values, time = np.random.default_rng(3).standard_normal(21), 0.01 * np.arange(-10, 11)
    constant, slope, bend = np.polynomial.Polynomial.fit(time, values, 4).convert().coef[:3]
    read = polynomial_kernels(21, 4, 0.01) @ values
    np.testing.assert_allclose(read, [constant, slope, 2 * bend], rtol=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.floats(-6.0, 1.0), st.integers(0, 99))
def test_noise_level_is_found_under_a_smooth_signal(exponent, seed):
    sigma, time = 10.0**exponent, np.arange(3000) / 100.0
    signal = 30.0 * np.column_stack([np.sin(3.0 * time), np.cos(5.0 * time)])
    noisy = signal + sigma * np.random.default_rng(seed).standard_normal((3000, 2))
    assert noise_level(noisy, log_of(noisy, noisy)) == pytest.approx(sigma, rel=0.15)


def test_noise_level_of_exact_and_of_no_signal_is_rounding():
    exact, nothing = np.sin(np.arange(1000) / 100.0)[:, None], np.zeros((100, 2))
    assert noise_level(exact, log_of(exact, exact)) < 1e-13
    assert noise_level(nothing, log_of(nothing, nothing)) > 0.0


def test_the_window_grows_with_the_noise_and_shrinks_with_the_speed_of_the_flow():
    levels = [
        AUTO(fly(2, 0.4, velocity_noise=v, position_noise=v / 5)).smoothing.window
        for v in (0.0, 0.01, 0.5)
    ]
    assert levels == sorted(levels)
    assert levels[0] < levels[2]
    noisy = {"velocity_noise": 0.5, "position_noise": 0.1}
    assert AUTO(fly(2, 0.05, **noisy)).smoothing.window < levels[2] / 2


def test_the_window_chosen_has_nearly_the_least_true_error():
    flight = fly(3, 0.3, 30.0, velocity_noise=0.5, position_noise=0.1)
    truth = fly(3, 0.3, 30.0)
    log = log_of(flight.position, flight.velocity)

    def true_risk(window):
        half = window // 2
        smoothed = filtered(flight.velocity, polynomial_kernels(window, ORDER, 0.01)[0])
        return np.mean((smoothed - truth.velocity[half : len(truth.time) - half]) ** 2)

    window = least_risk(flight.velocity, 0.5, log)
    assert true_risk(window) < 1.1 * min(map(true_risk, range(SHORTEST, 200, 4)))


def test_the_filter_and_the_noise_are_reported():
    flight = fly(4, 0.5, 30.0, velocity_noise=0.5, position_noise=0.1)
    samples = AUTO(flight)
    smoothing = samples.smoothing
    assert (smoothing.method, smoothing.reason, smoothing.order) == ("auto", "", ORDER)
    assert SHORTEST <= smoothing.rate_window < smoothing.window
    assert smoothing.sigma_position == pytest.approx(0.1, rel=0.05)
    assert smoothing.sigma_velocity == pytest.approx(0.5, rel=0.05)
    truth = fly(4, 0.5, 30.0)
    rows = slice(smoothing.window // 2, len(truth.time) - smoothing.window // 2)
    exact = VEHICLE.acceleration(truth.velocity, truth.flow.velocity(*truth.position.T))[rows]
    assert np.std(samples.acceleration - exact) < 0.1 * np.std(exact)
    np.testing.assert_array_equal(samples.time, flight.time[rows])


def test_an_origin_far_away_changes_nothing():
    flight = fly(6, 0.5, velocity_noise=0.2, position_noise=0.04)
    moved = Flight(
        time=flight.time + 1.7e9,
        position=flight.position + 2.0**20,
        velocity=flight.velocity,
        vehicle=VEHICLE,
    )
    here, there = AUTO(flight), AUTO(moved)
    assert here.smoothing.window == there.smoothing.window
    np.testing.assert_allclose(there.position - 2.0**20, here.position, atol=1e-8)
    np.testing.assert_allclose(there.acceleration, here.acceleration, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("speed", [0.0, 1.0])
def test_flights_that_stand_still_or_go_straight_divide_by_nothing(speed):
    time = np.arange(300) / 100.0
    line = np.column_stack([speed * time, np.zeros(300)])
    velocity = np.tile([speed, 0.0], (300, 1))
    flight = Flight(time=time, position=line, velocity=velocity, vehicle=VEHICLE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        samples = AUTO(flight)
    np.testing.assert_allclose(samples.velocity, velocity[: len(samples.time)], atol=1e-12)
    np.testing.assert_allclose(samples.acceleration, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (np.r_[0:400, 402:800], "time steps are not uniform"),
        (np.arange(FEWEST - 1), "54 samples are fewer than 55"),
    ],
)
def test_uneven_steps_and_short_flights_fall_back_by_name(rows, reason):
    flight = fly(7, 0.5)
    part = Flight(flight.time[rows], flight.position[rows], flight.velocity[rows], VEHICLE)
    samples, expected = Derivative(repair=False)(part), Derivative("midpoint")(part)
    assert samples.smoothing.method == "midpoint"
    assert samples.smoothing.reason == reason
    np.testing.assert_array_equal(samples.acceleration, expected.acceleration)


@pytest.mark.parametrize("timescale", [0.05, 0.3, 1.0])
def test_exact_flights_are_read_to_a_thousandth_of_a_percent(timescale):
    flight = fly(10, timescale)
    samples = AUTO(flight)
    truth = flight.flow.velocity(*samples.position.T)
    error = samples.flow_velocity(VEHICLE) - truth
    assert math.sqrt(np.mean(error**2)) < 1e-5 * flight.flow.mean_velocity


def test_a_long_flight_is_judged_by_its_middle():
    flight = fly(9, 0.4, 30.0, velocity_noise=0.3, position_noise=0.05)
    log = log_of(flight.position, flight.velocity)
    whole, part = smooth(log)[3], smooth(log, judged_rows=1000)[3]
    assert part.window == pytest.approx(whole.window, rel=0.5)


def test_positions_alone_are_smoothed_by_their_own_polynomial():
    flight = fly(8, 0.5, position_noise=0.02)
    samples = AUTO(Flight.from_positions(flight.time, flight.position, VEHICLE))
    assert samples.smoothing.sigma_velocity == 0.0
    truth = fly(8, 0.5)
    velocity = np.interp(samples.time, truth.time, truth.velocity[:, 0])
    assert np.std(samples.velocity[:, 0] - velocity) < 0.03 * np.std(velocity)


def test_a_measured_thrust_is_that_at_the_rows():
    vehicle, flow = PointMassVehicle(0.5, thrust_scale=1.2), CellularFlow(8.0, 4.0)
    thrust = turning(6.0, 100.0, constant=(5.0, 3.0), size=9.0, period=3.0, phase=0.0)
    flight = simulate_flight(flow, vehicle, duration=6.0, sample_rate=100.0, seed=2, thrust=thrust)
    samples = AUTO(flight)
    error = samples.flow_velocity(vehicle) - flow.velocity(*samples.position.T)
    assert np.abs(error).max() < 5e-4
    weak = Derivative("weak")(flight).averages
    averaged = weak.operator @ flow.velocity(*weak.position.T)
    assert np.abs(weak.flow_velocity(vehicle) - averaged).max() < 1e-3
