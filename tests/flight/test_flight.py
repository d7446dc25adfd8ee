import dataclasses
import math

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
TIME = np.array([0.0, 0.1, 0.2, 0.3])
PLANE = np.arange(8.0).reshape(4, 2)


def flight_with(**changes):
    fields = {"time": TIME, "position": PLANE, "velocity": PLANE, "vehicle": VEHICLE}
    return Flight(**(fields | changes))


def test_properties():
    flight = flight_with(time=TIME + 5.0, position=[[0, 1], [3, -2], [1, 5], [2, 0]])
    assert flight.samples == 4
    assert flight.duration == pytest.approx(0.3)
    assert flight.extent == 7.0
    assert flight.flow is None


def test_arrays_are_read_only_copies():
    source = PLANE.copy()
    flight = flight_with(position=source)
    source[0, 0] = 99.0
    assert flight.position[0, 0] == 0.0
    assert flight.position.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        flight.velocity[0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        flight.time = TIME


def test_some_rows_are_a_flight():
    flight = flight_with(thrust=PLANE, frame="NED")
    part = flight.rows(TIME > 0.05)
    np.testing.assert_array_equal(part.time, TIME[1:])
    np.testing.assert_array_equal(part.thrust, PLANE[1:])
    assert (part.frame, part.velocity_measured) == ("NED", True)
    assert not Flight.from_positions(TIME, PLANE, VEHICLE).rows(TIME > 0.05).velocity_measured
    with pytest.raises(InputError, match="at least 3 samples; got 2"):
        flight.rows(TIME > 0.15)


BACKWARDS = r"row 2 \(t=0\.1\) follows t=0\.2; sort or drop rows, or split the log where another"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"time": TIME[[0, 2, 1, 3]]}, rf"^time runs backwards: {BACKWARDS} begins$"),
        ({"time": TIME[[0, 1, 1, 2]]}, r"stands still: row 2 \(t=0\.1\) follows t=0\.1"),
        ({"time": [0.0, 0.1, 0.2, math.nan]}, "time must be finite: row 3 is nan"),
        ({"time": [0.0, 0.1, 0.2, math.inf]}, "time must be finite: row 3 is inf"),
        ({"velocity": [[0, 1], [2, 3], [4, math.nan], [6, 7]]}, "finite: row 2, y is nan"),
        (
            {"velocity": [[0, 1], [2, 3], [4, math.inf], [6, 7]]},
            "velocity must be finite: row 2, y",
        ),
        ({"time": TIME[:, None]}, r"time must have shape \(m,\); got \(4, 1\)"),
        ({"time": 3.0}, r"time must have shape \(m,\); got \(\)"),
        ({"position": PLANE.T}, r"position must have shape \(m, 2\); got \(2, 4\)"),
        ({"velocity": np.zeros((4, 3))}, r"velocity must have shape \(m, 2\)"),
        ({"velocity": np.zeros(4)}, r"velocity must have shape \(m, 2\)"),
        ({"velocity": np.zeros((5, 2))}, "got 4 of time, 4 of position, 5 of velocity"),
        ({"time": ["a", "b", "c", "d"]}, "time must be an array of real numbers"),
        ({"time": [0.0, None, 1.0, 2.0]}, "time must be an array of real numbers"),
        ({"position": PLANE * 1j}, "position must be an array of real numbers"),
        ({"position": [[1.0], [1.0, 2.0]]}, "position must be an array of numbers; its rows"),
        ({"time": np.ma.masked_greater(TIME, 0.2)}, "masked"),
        ({"time": TIME.astype("M8[s]")}, "time must be an array of real numbers"),
        ({"thrust": np.zeros((5, 2))}, "5 of thrust"),
        ({"vehicle": None}, "vehicle must be a PointMassVehicle"),
        ({"flow": 3.0}, "flow must be one of CellularFlow, "),
        ({"time": TIME[:2], "position": PLANE[:2], "velocity": PLANE[:2]}, "3 samples; got 2"),
        ({"time": TIME[:0], "position": PLANE[:0], "velocity": PLANE[:0]}, "3 samples; got 0"),
        ({"position": PLANE * 1e100}, "position is .* in row 0: no flight"),
        ({"velocity": PLANE * -1e300}, "velocity is .* no flight"),
        ({"vehicle": PointMassVehicle(1e-30)}, "is no vehicle that flies; change the units"),
        ({"vehicle": PointMassVehicle(1e308)}, "is no vehicle that flies"),
        ({"vehicle": PointMassVehicle(math.inf, drag=1e-30)}, "is no vehicle that flies"),
        ({"vehicle": PointMassVehicle(0.5, (0.0, -1e30))}, "is no vehicle that flies"),
        ({"time": TIME * 1e-320}, r"samples .* s apart are no flight; give time in seconds"),
    ],
)
def test_bad_fields_are_named(changes, message):
    with pytest.raises(InputError, match=message):
        flight_with(**changes)
