"""Samples mended and smoothed: outliers, gaps, kernels, noise levels, the choice of window."""

import dataclasses
import math
import warnings
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sparsefit.flight import Flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle, turning
from sparsefit.rows import Derivative, Repairs
from sparsefit.rows import derivative as room
from sparsefit.rows.clean import LogPieces, filtered, without_outliers
from sparsefit.rows.derivative import (
    FEWEST,
    ORDER,
    SHORTEST,
    least_risk,
    noise_level,
    polynomial_kernels,
    smooth,
)
from tests.problems import VEHICLE, fly, part

FLOW = CellularFlow(12.0, 4.0)
NOISE = {"noise": (0.2, 0.05)}
AUTO = Derivative("auto")
ARRAYS = ("time", "position", "velocity", "position_rate", "acceleration")
flown = cache(partial(fly, seed=1, duration=8.0))


def drawn(seed, timescale, duration=10.0, noise=(0.0, 0.0)):
    length_scale = np.random.default_rng(seed).uniform(2.0, 10.0)
    flow = CellularFlow(length_scale / timescale, length_scale)
    return flown(flow, seed=seed, duration=duration, noise=noise)


def log_of(position, velocity, step=0.01):
    time = step * np.arange(len(position))
    return LogPieces(time, np.hstack([position, velocity]), np.zeros(len(time), dtype=np.intp))


def test_polynomial_kernels_are_the_least_squares_polynomial_in_the_middle():
    values, time = np.random.default_rng(3).standard_normal(21), np.arange(-10, 11)
    constant, slope, bend = np.polynomial.Polynomial.fit(time, values, 4).convert().coef[:3]
    read = polynomial_kernels(21, 4) @ values
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


def test_the_window_chosen_has_nearly_the_least_true_error():
    flight = drawn(3, 0.3, 30.0, noise=(0.5, 0.1))
    truth = drawn(3, 0.3, 30.0)
    log = log_of(flight.position, flight.velocity)

    def true_risk(window):
        half = window // 2
        smoothed = filtered(flight.velocity, polynomial_kernels(window, ORDER)[0])
        return np.mean((smoothed - truth.velocity[half : len(truth.time) - half]) ** 2)

    window = least_risk(flight.velocity, 0.5, log)
    assert true_risk(window) < 1.1 * min(map(true_risk, range(SHORTEST, 200, 4)))


def test_two_rises_of_the_risk_end_the_search():
    """Against the risk by its formula, window by window: one rise alone is passed over."""
    rng, ladder, passed = np.random.default_rng(5), [SHORTEST], 0
    while ladder[-1] < 150:
        ladder.append(max(ladder[-1] + 2, 2 * round(ladder[-1] * 1.25 / 2) + 1))
    for _ in range(20):
        wave = np.sin(rng.uniform(0.4, 2.5) * np.arange(400) + rng.uniform(0.0, 7.0, (2, 1))).T
        values = rng.standard_normal((400, 2)) + rng.uniform(0.1, 0.8) * wave
        risks = []
        for half, other in ((n // 2, n) for n in ladder if 5 * (401 - n) >= 4 * 400):
            kernels = [polynomial_kernels(n, ORDER)[0] for n in (other, SHORTEST)]
            left, least = (
                values[len(k) // 2 : -(len(k) // 2)] - filtered(values, k) for k in kernels
            )
            more = np.mean(left**2) - np.mean(least[half - 5 : len(least) - half + 5] ** 2)
            risks.append(more + 2 * (kernels[0][half] - kernels[1][SHORTEST // 2]))
        rises = np.array(risks) >= np.minimum.accumulate([np.inf, *risks])[:-1]
        ends = [i for i in range(1, len(risks)) if rises[i] and rises[i - 1]] or [len(risks)]
        best = int(np.argmin(risks[: ends[0]]))
        passed += bool(rises[:best].any())
        assert least_risk(values, 1.0, log_of(values, values)) == ladder[best]
    assert passed >= 3


def test_the_filter_and_the_noise_are_reported():
    flight = drawn(4, 0.5, 30.0, noise=(0.5, 0.1))
    samples = AUTO(flight)
    smoothing = samples.smoothing
    assert (smoothing.method, smoothing.reason, smoothing.order) == ("auto", "", ORDER)
    assert SHORTEST <= smoothing.rate_window < smoothing.window
    assert smoothing.sigma_position == pytest.approx(0.1, rel=0.05)
    assert smoothing.sigma_velocity == pytest.approx(0.5, rel=0.05)
    truth = drawn(4, 0.5, 30.0)
    rows = slice(smoothing.window // 2, len(truth.time) - smoothing.window // 2)
    air = truth.flow.velocity(*truth.position.T)
    exact = ((air - truth.velocity) / VEHICLE.response_time + VEHICLE.thrust_acceleration)[rows]
    assert np.std(samples.acceleration - exact) < 0.1 * np.std(exact)
    assert np.std(samples.position_rate - truth.velocity[rows]) < 0.1 * np.std(truth.velocity)
    np.testing.assert_array_equal(samples.time, flight.time[rows])


def test_an_origin_far_away_changes_nothing():
    flight = drawn(6, 0.5, noise=(0.2, 0.04))
    moved = dataclasses.replace(
        flight, time=flight.time + 1.7e9, position=flight.position + 2.0**20
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
    flight = Flight(time, line, velocity, VEHICLE)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        samples = AUTO(flight)
    np.testing.assert_allclose(samples.velocity, velocity[: len(samples.time)], atol=1e-12)
    np.testing.assert_allclose(samples.acceleration, 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("rows", "reason"),
    [
        (np.r_[0:400, 402:800], "time steps are not uniform"),
        (np.arange(FEWEST - 1), "no 55 samples without a gap"),
    ],
)
def test_uneven_steps_and_short_flights_fall_back_by_name(rows, reason):
    flight = part(drawn(7, 0.5), rows)
    samples, expected = Derivative(repair=False)(flight), Derivative("midpoint")(flight)
    assert samples.smoothing.method == "midpoint"
    assert samples.smoothing.reason == reason
    np.testing.assert_array_equal(samples.acceleration, expected.acceleration)


@pytest.mark.parametrize("timescale", [0.05, 0.3, 1.0])
def test_exact_flights_are_read_to_a_thousandth_of_a_percent(timescale):
    flight = drawn(10, timescale)
    samples = AUTO(flight)
    truth = flight.flow.velocity(*samples.position.T)
    error = samples.flow_velocity(VEHICLE) - truth
    assert math.sqrt(np.mean(error**2)) < 1e-5 * flight.flow.mean_velocity


def test_a_long_flight_is_judged_by_its_middle(monkeypatch):
    flight = drawn(9, 0.4, 30.0, noise=(0.3, 0.05))
    log = log_of(flight.position, flight.velocity)
    whole = smooth(log)[3]
    monkeypatch.setattr(room, "JUDGED", 1000)
    part = smooth(log)[3]
    assert part.window == pytest.approx(whole.window, rel=0.5)


def test_positions_alone_are_smoothed_by_their_own_polynomial():
    flight = drawn(8, 0.5, noise=(0.0, 0.02))
    samples = AUTO(Flight.from_positions(flight.time, flight.position, VEHICLE))
    assert samples.smoothing.sigma_velocity == 0.0
    truth = drawn(8, 0.5)
    velocity = np.interp(samples.time, truth.time, truth.velocity[:, 0])
    assert np.std(samples.velocity[:, 0] - velocity) < 0.03 * np.std(velocity)


def test_a_measured_thrust_is_that_at_the_rows():
    vehicle, flow = PointMassVehicle(0.5, thrust_scale=1.2), CellularFlow(8.0, 4.0)
    thrust = turning(
        np.arange(6 * 100 + 2) / 100, constant=(5.0, 3.0), size=9.0, period=3.0, phase=0.0
    )
    flight = fly(flow, vehicle, duration=6.0, seed=2, thrust=thrust)
    samples = AUTO(flight)
    error = samples.flow_velocity(vehicle) - flow.velocity(*samples.position.T)
    assert np.abs(error).max() < 5e-4
    weak = Derivative("weak")(flight).averages
    averaged = weak.operator @ flow.velocity(*weak.position.T)
    assert np.abs(weak.flow_velocity(vehicle) - averaged).max() < 1e-3


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
    "noise", [{}, {"noise": (0.01, 0.0)}, NOISE, {"process_noise": 2.0}], ids=str
)
@pytest.mark.parametrize("method", ["forward", "auto"])
def test_clean_flights_are_not_touched(timescale, noise, method):
    flight = flown(CellularFlow(5.0 / timescale, 5.0), seed=3, duration=3.0, **noise)
    here, there = Derivative(method)(flight), Derivative(method, repair=False)(flight)
    assert here.repairs == Repairs()
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(here, name), getattr(there, name))


@pytest.mark.parametrize("count", [2, 8, 40])
@pytest.mark.parametrize("noise", [{}, NOISE], ids=str)
def test_outliers_are_found_and_nothing_else_moves(noise, count):
    flight = flown(FLOW, **noise)
    dirty, rows = spoilt(flight, count, seed=count)
    velocity = without_outliers(dirty.velocity)
    assert without_outliers(dirty.position) is dirty.position
    replaced = np.any(velocity != dirty.velocity, axis=1)
    assert set(np.flatnonzero(replaced).tolist()) == rows
    np.testing.assert_array_equal(velocity[~replaced], flight.velocity[~replaced])
    assert np.abs(velocity - flight.velocity).max() < (1.2 if noise else 0.1)
    assert AUTO(dirty).repairs == Repairs(outliers=count)


def test_a_position_off_by_itself_moves_no_other():
    noisy = flown(FLOW, **NOISE)
    position = noisy.position.copy()
    position[400] += [2.0, 0.0]
    mended = without_outliers(position)
    np.testing.assert_allclose(mended[400], noisy.position[400], atol=0.2)
    np.testing.assert_array_equal(np.delete(mended - noisy.position, 400, axis=0), 0.0)


def test_an_outlier_on_a_polynomial_of_degree_5_is_put_back_onto_it():
    time = np.linspace(-1.0, 1.0, 60)
    curve = np.column_stack([time**5 - time, time**4 + time])
    dirty = curve + np.eye(60)[20][:, None]
    np.testing.assert_allclose(without_outliers(dirty), curve, atol=1e-12)


def test_no_window_crosses_a_gap():
    exact, rows = flown(FLOW), np.r_[0:300, 360:801]
    flight = part(exact, rows)
    samples = AUTO(flight)
    assert (samples.repairs.gaps, samples.repairs.longest_gap) == (1, pytest.approx(0.61))
    half = samples.smoothing.window // 2
    expected = exact.time[np.r_[half : 300 - half, 360 + half : 801 - half]]
    np.testing.assert_allclose(samples.time, expected, atol=1e-12)
    truth = FLOW.velocity(*samples.position.T)
    np.testing.assert_allclose(samples.flow_velocity(VEHICLE), truth, atol=1e-4)
    assert len(Derivative("forward")(flight).time) == len(rows) - 2


def test_pieces_too_short_for_a_filter_give_no_rows():
    samples = AUTO(part(flown(FLOW), np.r_[0:300, 340:341, 400:420, 480:801]))
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
    dirty, _ = spoilt(flown(FLOW, **NOISE), 320, seed=2, size=50.0)
    assert AUTO(dirty).repairs.outliers == 0


def test_repairs_in_words():
    assert not Repairs().words
    found = Repairs(outliers=2, gaps=1, longest_gap=0.5)
    assert found.words == "2 outliers replaced, 1 gap of up to 0.5 s left open"
