"""The smoother that tunes itself: kernels, noise levels, the choice of window, the estimates."""

import math
import warnings
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sparsefit.derivative import Derivative
from sparsefit.derivative.kernels import coupled_kernels, polynomial_kernels
from sparsefit.derivative.smoothing import (
    FEWEST,
    ORDER,
    SHORTEST,
    SIDE_BY_SIDE,
    Channels,
    choose,
    noise_level,
    window_sizes,
)
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import rms_mean_velocity
from sparsefit.modes.search import locate_one
from sparsefit.modes.space import SearchSpace
from tests.fleet import fly_together

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
AUTO = Derivative("auto")


@cache
def fly(seed, timescale, duration=10.0, **noise):
    length_scale = np.random.default_rng(seed).uniform(2.0, 10.0)
    flow = CellularFlow(length_scale / timescale, length_scale)
    return simulate_flight(flow, VEHICLE, duration=duration, sample_rate=100.0, seed=seed, **noise)


def errors(flight, derivative):
    """Percent errors of U0, L and tau_w at the refined length scale."""
    samples = derivative(flight)
    phi = samples.flow_velocity(VEHICLE)
    bounds = (math.pi / 12, math.pi)
    found = locate_one(SearchSpace.plain(samples.position, phi, bounds))
    speed = rms_mean_velocity(found.fit.weights[0])
    truth, scale = flight.flow, math.pi / float(found.wavenumbers[0])
    ratios = (
        speed / truth.mean_velocity,
        scale / truth.length_scale,
        scale / speed / truth.timescale,
    )
    return 100.0 * np.abs(np.array(ratios) - 1.0)


@pytest.mark.parametrize("window", [11, 21, 101])
@pytest.mark.parametrize("ratio", [0.1, 5.0, 1e3])
def test_coupled_kernels_are_exact_for_polynomials_and_their_slopes(window, ratio):
    time = 0.01 * (np.arange(window) - window // 2)
    path = np.polynomial.Polynomial(np.random.default_rng(1).standard_normal(ORDER + 2))
    path = path(np.polynomial.Polynomial([0.0, 1.0 / time[-1]]))
    data = np.concatenate([path(time), path.deriv()(time)])
    expected = [path(0.0), path.deriv()(0.0), path.deriv(2)(0.0)]
    found = [kernel @ data for kernel in coupled_kernels(window, ORDER, 0.01, ratio)]
    size = [1.0, 1.0 / time[-1], 1.0 / time[-1] ** 2]
    np.testing.assert_allclose(np.divide(found, size), np.divide(expected, size), atol=1e-8)


def test_coupled_kernels_are_weighted_least_squares_by_normal_equations():
    window, order, step, ratio = 13, 4, 0.1, 3.0
    time = step * (np.arange(window) - window // 2)
    rows = [[t**p for p in range(order + 2)] for t in time]
    rows += [[p * t ** max(p - 1, 0) for p in range(order + 2)] for t in time]
    design, weight = np.array(rows), np.repeat([ratio**2, 1.0], window)
    solved = np.linalg.solve(design.T @ (weight[:, None] * design), design.T * weight)
    for found, expected in zip(
        coupled_kernels(window, order, step, ratio),
        (solved[0], solved[1], 2.0 * solved[2]),
        strict=True,
    ):
        np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_polynomial_kernels_are_savitzky_golay():
    from scipy.signal import savgol_coeffs

    value, slope, bend = polynomial_kernels(21, 4, 0.01)
    np.testing.assert_allclose(value, savgol_coeffs(21, 4, use="dot"), atol=1e-12)
    expected = savgol_coeffs(21, 4, deriv=1, delta=0.01, use="dot")
    np.testing.assert_allclose(slope, expected, atol=1e-9)
    expected = savgol_coeffs(21, 4, deriv=2, delta=0.01, use="dot")
    np.testing.assert_allclose(bend, expected, atol=1e-6)


def test_velocity_carries_the_position_over_the_window():
    coupled = coupled_kernels(41, ORDER, 0.01, 5.0)[0]
    alone = polynomial_kernels(41, ORDER, 0.01)[0]
    spread = np.hypot(0.1 * np.linalg.norm(coupled[:41]), 0.5 * np.linalg.norm(coupled[41:]))
    assert spread < 0.5 * 0.1 * np.linalg.norm(alone)
    average = 0.1 / np.sqrt(41)
    assert average < spread < 1.2 * average


@settings(deadline=None)
@given(st.floats(-6.0, 1.0), st.integers(0, 99))
def test_noise_level_is_found_under_a_smooth_signal(exponent, seed):
    sigma, time = 10.0**exponent, np.arange(3000) / 100.0
    signal = 30.0 * np.column_stack([np.sin(3.0 * time), np.cos(5.0 * time)])
    noise = sigma * np.random.default_rng(seed).standard_normal((3000, 2))
    assert noise_level(signal + noise) == pytest.approx(sigma, rel=0.15)


def test_noise_level_of_exact_and_of_no_signal_is_rounding():
    time = np.arange(1000) / 100.0
    assert noise_level(np.sin(time)[:, None]) < 1e-13
    assert noise_level(np.zeros((100, 2))) > 0.0


def test_windows_are_odd_rising_and_leave_most_of_the_flight():
    found = list(window_sizes(Channels(np.zeros((1000, 2)), np.zeros((1000, 2)), 0.01, 1.0, 1.0)))
    assert found[0] == SHORTEST
    assert found == sorted(set(found))
    assert all(window % 2 == 1 and window <= 1000 / SIDE_BY_SIDE for window in found)


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
    channels = Channels.measured(flight.position, flight.velocity, 0.01)

    def true_risk(window, coupled):
        kernels, half = channels.kernels(window, coupled), window // 2
        inner = slice(half, len(truth.time) - half)
        errors = (
            (channels.filtered(kernels[0]).T - truth.position[inner]) / channels.sigma_position,
            (channels.filtered(kernels[2]).T - truth.velocity[inner]) / channels.sigma_velocity,
        )
        return sum(float(np.mean(error**2)) for error in errors)

    every = [(true_risk(w, c), c) for w in window_sizes(channels) for c in (True, False)]
    window, coupled = choose(channels)
    assert coupled
    assert true_risk(window, coupled) < 1.1 * min(every)[0]


def test_the_choice_and_the_noise_are_told():
    flight = fly(4, 0.5, 30.0, velocity_noise=0.5, position_noise=0.1)
    samples = AUTO(flight)
    found = samples.smoothing
    assert (found.method, found.reason, found.order) == ("auto", "", ORDER)
    assert found.coupled
    assert SHORTEST <= found.rate_window < found.window
    assert found.sigma_position == pytest.approx(0.1, rel=0.05)
    assert found.sigma_velocity == pytest.approx(0.5, rel=0.05)
    truth = fly(4, 0.5, 30.0)
    rows = slice(found.window // 2, len(truth.time) - found.window // 2)
    exact = VEHICLE.acceleration(truth.velocity, truth.flow.velocity(*truth.position.T))[rows]
    for name, values, true in (
        ("position_error", samples.position, truth.position[rows]),
        ("velocity_error", samples.velocity, truth.velocity[rows]),
        ("acceleration_error", samples.acceleration, exact),
    ):
        assert np.std(values - true) == pytest.approx(getattr(found, name), rel=0.4), name
    np.testing.assert_array_equal(samples.time, flight.time[rows])
    assert all(
        getattr(samples, name).shape == (len(samples.time), 2)
        for name in ("position", "velocity", "position_rate", "acceleration")
    )


@pytest.mark.parametrize(
    "distort",
    [lambda t, v: 1.05 * v, lambda t, v: v + 3.0, lambda t, v: v + np.sin(t)[:, None]],
    ids=["scale", "offset", "drift"],
)
def test_a_velocity_that_is_not_the_slope_of_the_position_is_smoothed_by_itself(distort):
    flight = fly(5, 0.5, 30.0, velocity_noise=0.2, position_noise=0.04)
    velocity = distort(flight.time, flight.velocity)
    other = Flight(time=flight.time, position=flight.position, velocity=velocity, vehicle=VEHICLE)
    assert AUTO(flight).smoothing.coupled
    assert not AUTO(other).smoothing.coupled


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


def test_uneven_steps_and_short_flights_fall_back_by_name():
    flight = fly(7, 0.5)
    for rows, reason in (
        (np.r_[0:400, 402:800], "time steps are not uniform"),
        (np.arange(FEWEST - 1), "54 samples are fewer than 55"),
    ):
        part = Flight(
            time=flight.time[rows],
            position=flight.position[rows],
            velocity=flight.velocity[rows],
            vehicle=VEHICLE,
        )
        samples, expected = Derivative(repair=False)(part), Derivative("midpoint")(part)
        assert samples.smoothing.method == "midpoint"
        assert samples.smoothing.reason == reason
        np.testing.assert_array_equal(samples.acceleration, expected.acceleration)


def test_exact_flights_are_read_to_a_thousandth_of_a_percent():
    found = np.array([errors(fly(10 + i, t), AUTO) for i, t in enumerate((0.05, 0.06, 0.3, 1.0))])
    assert found.max() < 1e-3


def test_exact_positions_carry_the_flight_where_velocities_are_noisy():
    for exact in (0.0, 1e-6):
        flight = fly(13, 0.3, velocity_noise=0.6, position_noise=exact)
        assert AUTO(flight).smoothing.coupled
        assert errors(flight, AUTO).max() < 1e-2


def test_process_noise_costs_no_more_than_with_a_short_filter():
    scales = np.random.default_rng(20).uniform(2.0, 10.0, 8)
    timescales = np.linspace(0.1, 0.9, 8)
    flows = [(CellularFlow(s / t, s),) for s, t in zip(scales, timescales, strict=True)]
    setting = {"duration": 10.0, "rate": 100.0, "seed": 20, "process_noise": 2.0, "steps": 10}
    flights = fly_together(flows, VEHICLE, **setting)
    auto, short = (
        np.array([errors(flight, rule)[0] for flight in flights])
        for rule in (AUTO, Derivative("savgol", 5, 4))
    )
    assert auto.mean() < 1.1 * short.mean()
    assert all(AUTO(flight).smoothing.window <= 13 for flight in flights)


@pytest.mark.slow
def test_measured_noise_leaves_half_a_percent_and_beats_every_fixed_filter():
    flights = [
        fly(40 + i, t, 30.0, velocity_noise=0.5, position_noise=0.1)
        for i, t in enumerate(np.linspace(0.05, 1.0, 24))
    ]
    auto = np.array([errors(flight, AUTO)[2] for flight in flights])
    assert np.median(auto) < 0.4
    for window in (5, 11, 21):
        fixed = np.array([errors(f, Derivative("savgol", window, 4))[2] for f in flights])
        assert np.median(auto) < np.median(fixed)
        assert auto.mean() < fixed.mean()
