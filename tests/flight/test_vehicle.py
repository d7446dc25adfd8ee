"""The vehicle's laws, linear and quadratic, and thrust that is measured."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries

VEHICLE = PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))


def flown(vehicle, **options):
    """In still air, from rest."""
    return sf.simulate_flight(None, vehicle, duration=3.0, sample_rate=20.0, seed=0, **options)


def acceleration(vehicle, velocity, flow, thrust=None):
    """v' = (1/tau + c |w - v|) (w - v) + a [m/s^2], Eq. 12."""
    relative = np.subtract(flow, velocity)
    law = 1.0 / vehicle.response_time + vehicle.drag * np.hypot(*relative)
    return law * relative + vehicle.thrust(thrust)


def test_the_flow_velocity_by_hand_and_rows_are_samples():
    # (w - v)/tau + a = ((1, 2) - (3, 1))/0.5 + (5, 3); in still air the terminal velocity is tau a
    assert VEHICLE.flow_velocity([3.0, 1.0], [1.0, 5.0]) == pytest.approx([1.0, 2.0], abs=1e-15)
    assert VEHICLE.flow_velocity([2.5, 1.5], [0.0, 0.0]) == pytest.approx([0.0, 0.0], abs=1e-15)
    velocity = np.arange(8.0).reshape(4, 2)
    rows = VEHICLE.flow_velocity(velocity, np.ones(2))
    np.testing.assert_array_equal(rows[2], VEHICLE.flow_velocity(velocity[2], [1.0, 1.0]))
    assert rows.shape == VEHICLE.flow_velocity(velocity, velocity).shape == (4, 2)


def test_quadratic_drag_by_hand():
    # r = w - v = (3, 4): |r| = 5, F = 0.2 * 5 * (3, 4) = (3, 4); with tau = 0.5 another (6, 8).
    pure, both = PointMassVehicle(math.inf, drag=0.2), PointMassVehicle(0.5, drag=0.2)
    assert pure.flow_velocity([1.0, 1.0], [3.0, 4.0]) == pytest.approx([4.0, 5.0], abs=1e-14)
    assert both.flow_velocity([1.0, 1.0], [9.0, 12.0]) == pytest.approx([4.0, 5.0], abs=1e-14)
    # At rest in the flow nothing drags, and nothing is divided by zero.
    assert pure.flow_velocity([1.0, 1.0], [0.0, 0.0]) == pytest.approx([1.0, 1.0], abs=0)


@given(
    tau=st.one_of(st.just(math.inf), st.floats(0.01, 100)),
    drag=st.one_of(st.floats(1e-3, 10)),
    values=st.lists(st.floats(-100, 100), min_size=8, max_size=8),
)
def test_the_flow_velocity_inverts_every_law(tau, drag, values):
    vehicle = PointMassVehicle(tau, (values[0], values[1]), drag, thrust_scale=1.5)
    velocity, flow, thrust = np.array(values[2:]).reshape(3, 2)
    back = vehicle.flow_velocity(velocity, acceleration(vehicle, velocity, flow, thrust), thrust)
    np.testing.assert_allclose(back, flow, atol=1e-5)


def test_a_vehicle_falls_at_its_terminal_velocity():
    # v' = a - c v |v| from rest: v = sqrt(a/c) tanh(sqrt(a c) t), x = log(cosh(sqrt(a c) t)) / c.
    flight = flown(PointMassVehicle(math.inf, (4.0, 0.0), 0.25))
    t = flight.time
    np.testing.assert_allclose(flight.velocity[:, 0], 4.0 * np.tanh(t), atol=1e-11)
    np.testing.assert_allclose(flight.position[:, 0], 4.0 * np.log(np.cosh(t)), atol=1e-11)


def test_a_thrust_that_turns_is_flown_and_logged():
    # v' = s m(t) - v/tau with m a ramp (t, 0): v = s tau (t - tau (1 - exp(-t/tau))).
    ramp = ThrustSeries([0.0, 3.0], [[0.0, 1.0], [3.0, 1.0]])
    flight = flown(PointMassVehicle(0.5, thrust_scale=2.0), thrust=ramp)
    t = flight.time
    speed = t - 0.5 * (1 - np.exp(-2 * t))
    np.testing.assert_allclose(flight.velocity[:, 0], speed, atol=1e-11)
    np.testing.assert_allclose(flight.thrust, np.stack([t, np.ones_like(t)], axis=1), atol=1e-14)
    clean, noisy = (
        flown(PointMassVehicle(0.5), thrust=ramp, thrust_noise=noise) for noise in (0.0, 0.5)
    )
    np.testing.assert_array_equal(clean.velocity, noisy.velocity)
    assert np.std(noisy.thrust - clean.thrust) == pytest.approx(0.5, rel=0.2)


def test_a_series_is_a_straight_line_between_its_samples():
    boat = ThrustSeries([0.0, 1.0], [[1.0, 0.0], [3.0, 0.0]])
    np.testing.assert_allclose(boat.at([0.5]), [[2.0, 0.0]])
    assert boat.pointwise()(0.25) == pytest.approx((1.5, 0.0))
    with pytest.raises(InputError, match="known from 0 to 1 s, the flight is from 0 to 2 s"):
        boat.at([0.0, 2.0])
