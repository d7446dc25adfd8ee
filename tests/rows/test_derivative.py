"""Derivatives and the weak form: rates, averages, and the settings that are refused."""

from functools import cache

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight import Flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.rows import Derivative, Smoothing
from sparsefit.rows.clean import LogPieces
from sparsefit.rows.derivative import weak_form
from tests.problems import VEHICLE, fly, part

FLOW = CellularFlow(15.0, 4.21)
UNEVEN = np.array([0.0, 0.1, 0.25, 0.3, 0.5, 0.6, 0.9, 1.0])


def flight_of(time, position, velocity):
    return Flight(time, position, velocity, VEHICLE)


def waves(time):
    """Return a flight of sines, its states and rates known in closed form."""
    position = np.column_stack([np.sin(2 * time), np.cos(3 * time)])
    velocity = np.column_stack([np.sin(4 * time), np.cos(time)])
    return flight_of(time, position, velocity)


@pytest.mark.parametrize("method", ["forward", "central", "midpoint"])
def test_straight_lines_are_exact_on_uneven_steps(method):
    line = np.column_stack([2.0 * UNEVEN + 1.0, -3.0 * UNEVEN])
    samples = Derivative(method)(flight_of(UNEVEN, line, 2 * line))
    np.testing.assert_allclose(samples.position_rate, np.tile([2.0, -3.0], (len(samples.time), 1)))
    np.testing.assert_allclose(samples.acceleration, 2 * samples.position_rate)
    np.testing.assert_allclose(samples.position[:, 1], -3.0 * samples.time, atol=1e-15)


@pytest.mark.parametrize("method", ["central", "midpoint"])
def test_two_sides_are_exact_for_parabolas_on_uneven_steps(method):
    curve = np.column_stack([UNEVEN**2, 3 * UNEVEN - UNEVEN**2])
    samples = Derivative(method)(flight_of(UNEVEN, curve, curve))
    expected = np.column_stack([2 * samples.time, 3 - 2 * samples.time])
    np.testing.assert_allclose(samples.acceleration, expected, atol=1e-13)


@pytest.mark.parametrize(("window", "order"), [(7, 4), (5, 4), (7, 2), (3, 1)])
def test_savgol_is_exact_for_polynomials_of_its_order_up_to_the_kept_edges(window, order):
    time, half = np.arange(20) / 10.0, window // 2
    curve = np.column_stack([time**order - time, 3.0 * time])
    samples = Derivative("savgol", window=window, order=order)(flight_of(time, curve, curve))
    inner = time[half:-half]
    np.testing.assert_array_equal(samples.time, inner)
    np.testing.assert_allclose(samples.velocity, curve[half:-half], atol=1e-12)
    expected = np.column_stack([order * inner ** (order - 1) - 1, np.full(len(inner), 3.0)])
    np.testing.assert_allclose(samples.acceleration, expected, atol=1e-11)


def test_forward_is_equation_15():
    flight = waves(UNEVEN)
    samples = Derivative("forward")(flight)
    np.testing.assert_array_equal(samples.time, UNEVEN[:-1])
    np.testing.assert_array_equal(samples.position, flight.position[:-1])
    by_hand = (flight.velocity[3] - flight.velocity[2]) / (UNEVEN[3] - UNEVEN[2])
    np.testing.assert_array_equal(samples.acceleration[2], by_hand)


def test_savgol_refuses_uneven_steps_and_short_flights_by_name():
    with pytest.raises(InputError, match=r"savgol needs uniform time steps.*0\.05 to 0\.3 s"):
        Derivative("savgol")(waves(UNEVEN))
    with pytest.raises(InputError, match="window 11 does not fit into 8 samples"):
        Derivative("savgol", window=11)(waves(np.arange(8.0)))


def test_savgol_takes_rounded_clocks_and_clocks_that_count_from_1970():
    steps = np.arange(100) / 100.0
    for clock in (np.round(steps, 2), 1.7e9 + steps):
        assert Derivative("savgol")(waves(clock)).time.shape == (96,)
    late = steps.copy()
    late[50] += 1e-6
    with pytest.raises(InputError, match="uniform"):
        Derivative("savgol")(waves(late))


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        *(({"window": bad, "order": 1}, "odd integer") for bad in (4, 1, -3, 5.0, True, "5")),
        *(({"order": bad}, "an integer from 1 to window - 1 = 4") for bad in (5, 0, 2.0)),
        *(({"method": bad, "window": 7}, "no window and no order") for bad in ("auto", "forward")),
        *(
            ({"method": "weak", bad: 9}, "'weak' has no window and no o")
            for bad in ("window", "order")
        ),
        ({"method": "centrl"}, 'unknown derivative "centrl": did you mean "central"'),
        ({"method": None}, "unknown derivative"),
    ],
)
def test_bad_settings_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        Derivative(**{"method": "savgol", **settings})


def test_samples_tell_how_they_were_smoothed():
    for settings, expected in (
        ({"method": "forward"}, Smoothing("forward", rate_window=2)),
        ({"method": "central"}, Smoothing("central", rate_window=3)),
        ({"method": "midpoint"}, Smoothing("midpoint", window=2, rate_window=2)),
        ({"method": "savgol", "window": 7, "order": 2}, Smoothing("savgol", "", 7, 7, 2)),
    ):
        found = Derivative(**settings)(waves(np.linspace(0.0, 1.0, 11))).smoothing
        assert repr(found) == repr(expected)  # NaN is not equal to itself


def rows_of(time, values, window):
    """Weak rows whose position and velocity are both ``values`` (m,)."""
    piece = np.cumsum(np.diff(time, prepend=time[0]) > 4.0 * np.median(np.diff(time)))
    return weak_form(LogPieces(time, np.column_stack([values] * 4), piece), window)


@cache
def flown():
    return fly(FLOW, seed=7)


def test_a_test_function_by_hand():
    # (1 - s^2)^8 at s = -1, -1/2, 0, 1/2, 1, over its sum
    rows = rows_of(np.arange(7.0), np.arange(7.0), 5)
    expected = np.array([0.0, 0.75**8, 1.0, 0.75**8, 0.0]) / (1.0 + 2.0 * 0.75**8)
    np.testing.assert_allclose(rows.operator.toarray()[0, :5], expected, rtol=1e-14)
    np.testing.assert_allclose(rows.velocity[:, 0], [2.0, 3.0, 4.0], rtol=1e-14)


@pytest.mark.parametrize("window", [5, 21, 61, 101])
def test_exact_for_constant_and_linear_motion(window):
    time = np.arange(400) / 100.0
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


def test_no_row_spans_a_gap_in_the_log():
    time = np.concatenate([np.arange(200), np.arange(300, 500)]) / 100.0
    rows = rows_of(time, time, 41)
    assert len(rows.time) > 60
    for row in rows.operator:
        assert np.ptp(time[row.indices]) == pytest.approx(0.4)
    np.testing.assert_allclose(rows.acceleration, 1.0, rtol=1e-10)


@pytest.mark.parametrize(("samples", "window"), [(1001, 21), (60, 17), (30, 11)])
def test_the_window_is_the_smoothers_if_none_is_given(samples, window):
    flight = flown()
    rows = Derivative("weak")(flight.rows(np.arange(1001) < samples))
    assert rows.averages.smoothing.window == max(window, rows.smoothing.window)


def test_rows_of_the_flow_velocity_are_its_averages():
    flight = flown()
    rows = np.sort(np.random.default_rng(4).choice(1001, 700, replace=False))
    for log, accuracy in ((flight, 1e-7), (part(flight, rows), 5e-2)):
        weak = Derivative("weak")(log).averages
        truth = weak.operator @ FLOW.velocity(*weak.position.T)
        error = weak.flow_velocity(VEHICLE) - truth
        assert np.abs(error).max() < accuracy * FLOW.mean_velocity
    with pytest.raises(InputError, match="weak needs uniform time steps"):
        Derivative("weak", repair=False)(part(flight, rows))


def test_some_of_the_rows_have_the_samples_under_them():
    weak = Derivative("weak")(flown()).averages
    some = weak.rows(slice(7, 30, 3))
    np.testing.assert_array_equal(some.velocity, weak.velocity[7:30:3])
    values = [own.averaged(FLOW.velocity(*own.position.T)) for own in (weak, some)]
    np.testing.assert_allclose(values[1], values[0][7:30:3], rtol=1e-14)


def test_refuses_windows_longer_than_the_flight_and_quadratic_drag():
    time = np.arange(1001) / 100.0
    with pytest.raises(InputError, match="no weak test function of 1201 samples"):
        rows_of(time, time, 1201)
    with pytest.raises(InputError, match="quadratic response does not allow"):
        rows_of(time, time, 21).flow_velocity(PointMassVehicle(0.5, drag=0.1))
