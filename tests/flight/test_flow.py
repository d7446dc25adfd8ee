import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sparsefit.errors import InputError
from sparsefit.flight.flow import CellularFlow, SuperposedFlow

FLOW = CellularFlow(mean_velocity=6.0, length_scale=4.0)
TWO = SuperposedFlow((FLOW, CellularFlow(2.0, 1.5)))

places = st.floats(-50.0, 50.0)


def test_timescale_is_length_over_velocity():
    assert CellularFlow(15.0, 3.0).timescale == pytest.approx(0.2, rel=1e-15)


def test_velocity_at_hand_worked_points():
    # sin(pi/4) cos(pi/4) = 1/2; mid-edge (L/2, 0): sin(pi/2) cos(0) = 1
    assert FLOW.velocity(1.0, 1.0) == pytest.approx([3.0, -3.0], abs=1e-14)
    assert FLOW.velocity(2.0, 0.0) == pytest.approx([6.0, 0.0], abs=1e-14)
    assert FLOW.velocity(0.0, 2.0) == pytest.approx([0.0, -6.0], abs=1e-14)


@pytest.mark.parametrize("point", [(0, 0), (4, 0), (4, 4), (2, 2), (6, 2), (-2, 6)])
def test_cell_corners_and_centres_stand_still(point):
    assert FLOW.velocity(*point) == pytest.approx([0.0, 0.0], abs=1e-14)


def test_rotation_alternates_between_neighbouring_cells():
    assert FLOW.velocity(1.0, 0.5) == pytest.approx(-FLOW.velocity(5.0, 0.5), abs=1e-14)


@pytest.mark.parametrize("flow", [FLOW, TWO])
@given(x=places, y=places)
def test_divergence_free(flow, x, y):
    h = 1e-4
    dwx = flow.velocity(x + h, y)[0] - flow.velocity(x - h, y)[0]
    dwy = flow.velocity(x, y + h)[1] - flow.velocity(x, y - h)[1]
    assert (dwx + dwy) / (2 * h) == pytest.approx(0.0, abs=1e-7)


@given(x=places, y=places)
def test_periodic_and_never_faster_than_the_mean_velocity(x, y):
    here = FLOW.velocity(x, y)
    assert FLOW.velocity(x + 8.0, y - 16.0) == pytest.approx(here, abs=1e-11)
    assert math.hypot(*here) <= 6.0 * (1 + 1e-14)


def test_mean_speed_squared_over_a_period_is_half_the_mean_velocity_squared():
    x, y = np.meshgrid(np.arange(64) / 8.0, np.arange(64) / 8.0)
    assert np.mean(np.sum(FLOW.velocity(x, y) ** 2, axis=-1)) == pytest.approx(36.0 / 2, rel=1e-13)


def test_arrays_broadcast():
    assert FLOW.velocity(np.zeros(5), np.zeros(5)).shape == (5, 2)
    assert FLOW.velocity(np.zeros((3, 1)), np.zeros(4)).shape == (3, 4, 2)
    assert TWO.velocity(np.zeros((3, 1)), 0.0).shape == (3, 1, 2)
    assert FLOW.velocity([1, 2], [3, 4]).dtype == np.float64


def test_superposition_is_the_sum():
    x, y = np.array([0.3, 1.7]), np.array([2.2, -0.4])
    expected = FLOW.velocity(x, y) + CellularFlow(2.0, 1.5).velocity(x, y)
    np.testing.assert_allclose(TWO.velocity(x, y), expected, rtol=1e-15)
    np.testing.assert_array_equal(SuperposedFlow((FLOW,)).velocity(x, y), FLOW.velocity(x, y))


def test_a_wind_carries_the_sum():
    windy = SuperposedFlow((FLOW,), wind=[1, -2])
    x, y = np.array([0.3, 1.7]), np.array([2.2, -0.4])
    np.testing.assert_allclose(
        windy.velocity(x, y), FLOW.velocity(x, y) + np.array([1, -2]), rtol=1e-15
    )
    assert windy.wind == (1.0, -2.0)
    assert FLOW.wind == SuperposedFlow((FLOW,)).wind == (0.0, 0.0)
    with pytest.raises(InputError, match=r"wind must be two numbers"):
        SuperposedFlow((FLOW,), wind=(1.0,))


def test_values_are_stored_as_floats_and_compare_equal():
    assert CellularFlow(6, np.float64(4)) == FLOW
    assert type(CellularFlow(6, 4).mean_velocity) is float
    assert SuperposedFlow([FLOW]).components == (FLOW,)
    assert FLOW.components == (FLOW,)
    assert len({FLOW, CellularFlow(6, 4), TWO}) == 2


@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, "3", None, True])
def test_bad_parameters_are_named(bad):
    with pytest.raises(InputError, match=r"mean_velocity .* \[m/s\]"):
        CellularFlow(mean_velocity=bad, length_scale=1.0)
    with pytest.raises(InputError, match=r"length_scale .* \[m\]"):
        CellularFlow(mean_velocity=1.0, length_scale=bad)


@pytest.mark.parametrize("bad", [(), FLOW, (FLOW, 3.0), None])
def test_superposition_needs_cellular_flows(bad):
    with pytest.raises(InputError, match="at least one CellularFlow"):
        SuperposedFlow(bad)
