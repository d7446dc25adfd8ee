import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle

VEHICLE = PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))


def test_acceleration_by_hand():
    # (w - v)/tau + a = ((1, 2) - (3, 1))/0.5 + (5, 3)
    assert VEHICLE.acceleration([3.0, 1.0], [1.0, 2.0]) == pytest.approx([1.0, 5.0], abs=1e-15)


def test_terminal_velocity_in_still_air_is_thrust_times_response_time():
    assert VEHICLE.acceleration([2.5, 1.5], [0.0, 0.0]) == pytest.approx([0.0, 0.0], abs=1e-15)


@given(
    tau=st.floats(1e-3, 1e3),
    values=st.lists(st.floats(-100, 100), min_size=6, max_size=6),
)
def test_flow_velocity_inverts_the_equation_of_motion(tau, values):
    vehicle = PointMassVehicle(tau, (values[0], values[1]))
    velocity, flow = np.array(values[2:4]), np.array(values[4:])
    back = vehicle.flow_velocity(velocity, vehicle.acceleration(velocity, flow))
    np.testing.assert_allclose(back, flow, atol=1e-10 * max(1.0, tau))


def test_rows_are_samples():
    velocity = np.arange(8.0).reshape(4, 2)
    rows = VEHICLE.acceleration(velocity, np.ones(2))
    assert rows.shape == (4, 2)
    np.testing.assert_array_equal(rows[2], VEHICLE.acceleration(velocity[2], [1.0, 1.0]))
    assert VEHICLE.flow_velocity(velocity, velocity).shape == (4, 2)


def test_values_are_stored_as_floats():
    assert PointMassVehicle(1, np.array([5, 3])) == PointMassVehicle(1.0, (5.0, 3.0))
    assert PointMassVehicle(1.0).thrust_acceleration == (0.0, 0.0)
    assert hash(VEHICLE) == hash(PointMassVehicle(0.5, [5, 3]))


@pytest.mark.parametrize("bad", [0.0, -0.1, math.nan, math.inf, "1", None, False])
def test_response_time_must_be_positive(bad):
    with pytest.raises(InputError, match=r"response_time .* \[s\]"):
        PointMassVehicle(bad)


@pytest.mark.parametrize("bad", [1.0, (1.0,), (1.0, 2.0, 3.0), (1.0, math.nan), ("a", 1.0), None])
def test_thrust_must_be_two_numbers(bad):
    with pytest.raises(InputError, match="thrust_acceleration"):
        PointMassVehicle(0.5, bad)
