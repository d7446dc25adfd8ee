"""What a study flies and what it tells its estimators of the vehicle."""

import math

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.study.spec.draw import Draw, stream

VALUES = {"mean_velocity": 8.0, "length_scale": 4.0, "duration": 2.0, "sample_rate": 50.0}
PUSH = {"thrust_x": 5.0, "thrust_y": 3.0}
QUADRATIC = VALUES | PUSH | {"drag": 0.3}
TURNING = VALUES | PUSH | {"response_time": 0.5, "thrust_turn": 6.0, "thrust_period": 4.0}


def believed(values, **told):
    draw = Draw.from_values(values, **told)
    return draw, draw.fly(stream(1, 0, 0))


@pytest.mark.parametrize(
    ("told", "vehicle"),
    [
        ({}, PointMassVehicle(math.inf, (5.0, 3.0), 0.3)),
        ({"believed_drag_ratio": 2.0}, PointMassVehicle(math.inf, (5.0, 3.0), 0.6)),
        ({"believed_response_time": 0.5}, PointMassVehicle(0.5, (5.0, 3.0))),
        (
            {"believed_response_time": 0.5, "believed_drag": 0.1, "believed_thrust_ratio": 2.0},
            PointMassVehicle(0.5, (10.0, 6.0), 0.1),
        ),
    ],
)
def test_the_law_of_drag_that_is_told(told, vehicle):
    draw, flight = believed(QUADRATIC | told)
    assert draw.vehicle == PointMassVehicle(math.inf, (5.0, 3.0), 0.3)
    assert flight.vehicle == vehicle
    np.testing.assert_array_equal(flight.velocity, believed(QUADRATIC)[1].velocity)


def test_a_thrust_that_turns_is_measured_or_not():
    _, flight = believed(TURNING)
    turn = 2 * np.pi * flight.time / 4.0
    circle = 6.0 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    np.testing.assert_allclose(flight.thrust, np.add(circle, (5.0, 3.0)), atol=1e-12)
    assert flight.vehicle == PointMassVehicle(0.5)
    scaled = believed(TURNING | {"believed_thrust_ratio": 1.2})[1].vehicle
    assert scaled == PointMassVehicle(0.5, thrust_scale=1.2)
    _, blind = believed(TURNING, thrust_logged=False)
    assert blind.thrust is None
    assert blind.vehicle == PointMassVehicle(0.5, (5.0, 3.0))
    np.testing.assert_array_equal(blind.velocity, flight.velocity)


def test_flights_need_a_law_of_drag(tmp_path):
    from tests.study.test_spec import GOOD, load

    bare = GOOD.replace("response_time = 0.5\n", "")
    with pytest.raises(InputError, match="every flight needs it, or drag"):
        load(tmp_path, bare)
    study = load(tmp_path, bare.replace("duration =", "drag = 0.2\nduration ="))
    assert study.cells[0].setup.flights.draw(0, 6, 1).vehicle.drag == 0.2
    with pytest.raises(InputError, match="thrust_turn needs it too"):
        load(tmp_path, GOOD.replace("duration =", "thrust_turn = 2.0\nduration ="))
