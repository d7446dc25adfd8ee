"""The weak form: rows that average by test functions."""

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.rows import Derivative
from sparsefit.rows.derivative import weak_form

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
FLOW = CellularFlow(15.0, 4.21)


def rows_of(time, values, window, order=8):
    """Weak rows whose position and velocity are both ``values`` (m,)."""
    return weak_form(time, np.column_stack([values] * 4), window, order)


def uneven(count=400, seed=1):
    return np.cumsum(np.random.default_rng(seed).uniform(0.5, 1.5, count) / 100.0)


def test_a_test_function_by_hand():
    # (1 - s^2)^2 at s = -1, -1/2, 0, 1/2, 1, over its sum 2.125
    rows = rows_of(np.arange(7.0), np.arange(7.0), 5, 2)
    expected = np.array([0.0, 0.5625, 1.0, 0.5625, 0.0]) / 2.125
    np.testing.assert_allclose(rows.operator.toarray()[0, :5], expected, rtol=1e-14)
    np.testing.assert_allclose(rows.velocity[:, 0], [2.0, 3.0, 4.0], rtol=1e-14)


@pytest.mark.parametrize("time", [np.arange(400) / 100.0, uneven()])
@pytest.mark.parametrize("window", [5, 21, 61, 101])
def test_exact_for_constant_and_linear_motion(time, window):
    rows = rows_of(time, 3.0 - 2.0 * time, window)
    np.testing.assert_allclose(rows.operator.sum(axis=1), 1.0, rtol=1e-13)
    expected = 3.0 - 2.0 * (rows.operator @ time)
    np.testing.assert_allclose(rows.velocity[:, 0], expected, rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(rows.acceleration, -2.0, rtol=1e-10)
    np.testing.assert_array_equal(rows.position_rate, rows.acceleration)


def test_integration_by_parts():
    time = np.arange(1000) / 100.0
    rows = rows_of(time, np.sin(3 * time), 41)
    expected = rows.operator @ (3 * np.cos(3 * time))
    np.testing.assert_allclose(rows.acceleration[:, 0], expected, atol=1e-10)


def test_uneven_steps_err_in_second_order():
    errors = []
    for count in (400, 1600):
        time = 4.0 * np.cumsum(np.random.default_rng(2).uniform(0.7, 1.3, count)) / count
        rows = rows_of(time, np.sin(3 * time), (count // 10) | 1)
        error = rows.acceleration[:, 0] - rows.operator @ (3 * np.cos(3 * time))
        errors.append(np.abs(error).max())
    assert errors[1] < errors[0] / 4


def test_no_row_spans_a_gap_in_the_log():
    time = np.concatenate([np.arange(200), np.arange(300, 500)]) / 100.0
    rows = rows_of(time, time, 41)
    for row in rows.operator:
        inside = time[row.indices]
        assert np.ptp(inside) <= rows.smoothing.window * np.ptp(time) / 399
        assert len(inside) >= 20


@pytest.mark.parametrize(("samples", "window"), [(1001, 21), (60, 17), (30, 11)])
def test_the_window_is_the_smoothers_if_none_is_given(samples, window):
    flight = simulate_flight(FLOW, VEHICLE, duration=10.0, sample_rate=100.0, seed=7)
    rows = Derivative("weak")(flight.rows(np.arange(1001) < samples))
    assert rows.averages.smoothing.window == max(window, rows.smoothing.window)


def test_rows_of_the_flow_velocity_are_its_averages():
    flight = simulate_flight(FLOW, VEHICLE, duration=10.0, sample_rate=100.0, seed=7)
    rows = np.sort(np.random.default_rng(4).choice(1001, 700, replace=False))
    part = Flight(flight.time[rows], flight.position[rows], flight.velocity[rows], VEHICLE)
    for log, accuracy in ((flight, 1e-7), (part, 5e-2)):
        weak = Derivative("weak", repair=log is flight)(log).averages
        truth = weak.operator @ FLOW.velocity(*weak.position.T)
        error = weak.flow_velocity(VEHICLE) - truth
        assert np.abs(error).max() < accuracy * FLOW.mean_velocity


def test_refuses_settings_windows_longer_than_the_flight_and_quadratic_drag():
    for settings in ({"window": 21}, {"order": 8}):
        with pytest.raises(InputError, match="'weak' has no window and no order"):
            Derivative("weak", **settings)
    time = np.arange(1001) / 100.0
    with pytest.raises(InputError, match="no weak test function of 1201 samples"):
        rows_of(time, time, 1201)
    with pytest.raises(InputError, match="quadratic response does not allow"):
        rows_of(time, time, 21).flow_velocity(PointMassVehicle(0.5, drag=0.1))
