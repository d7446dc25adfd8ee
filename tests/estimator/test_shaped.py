"""The ladder in an estimate: shape, heading, drift and flow of a flight, with their intervals."""

import math

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.cli.printed import ReadLog, lines
from sparsefit.flight.waves import WaveFlow
from sparsefit.logs.checks import quality_of
from sparsefit.model import Readout

VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
LADDER = sf.Estimator(readout=Readout(refine="ladder"))


@pytest.fixture(scope="module")
def turned():
    """A flight through square cells turned by 0.3 rad, and what is estimated from it."""
    scale, heading, speed = 4.0, 0.3, 10.0
    k = math.pi / scale * np.array([[1.0, 1.0], [1.0, -1.0]])
    turn = np.array(
        [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
    )
    size = speed / (2 * math.pi / scale)
    flow = WaveFlow(k @ turn.T, np.array([size, -size]), np.zeros(2))
    flight = sf.simulate_flight(
        flow, VEHICLE, duration=8.0, sample_rate=100.0, seed=3, position_noise=0.02,
        velocity_noise=0.1, initial_position=(101.0, -57.0),
    )  # fmt: skip
    return flow, flight, LADDER.estimate(flight)


def test_cells_at_a_heading_are_told(turned):
    flow, _, estimate = turned
    assert (estimate.status, estimate.shape) == ("ok", "square")
    sure, shape = estimate.uncertainty, estimate.shape_uncertainty
    assert abs(estimate.mean_velocity - flow.mean_velocity) < 4 * sure.mean_velocity
    assert abs(estimate.length_scale - 4.0) < 4 * sure.length_scale < 0.1
    assert abs(estimate.heading - 0.3) < 4 * shape.heading < 0.05
    assert estimate.drift == (0.0, 0.0)
    assert estimate.length_scales == pytest.approx([estimate.length_scale] * 2)
    assert estimate.rungs[0].bic == 0 < estimate.rungs[1].bic


def test_the_flow_is_that_of_the_flight_in_its_own_coordinates(turned):
    flow, flight, estimate = turned
    x, y = flight.position.T
    true, found = flow.velocity(x, y), estimate.flow.velocity(x, y, flight.time)
    assert np.mean((found - true) ** 2) < 1e-3 * np.mean(true**2)


def test_the_command_line_tells_the_shape(turned):
    _, flight, estimate = turned
    words = "\n".join(lines([ReadLog("turned", flight, quality_of(flight), ())], estimate, ()))
    assert "shape                 square cells\n" in words
    assert f"heading               {math.degrees(estimate.heading):.4f} degrees" in words
    assert "drift" not in words


def test_two_flows_are_read_each_by_itself():
    parts = (
        sf.flows.ShapedCells(9.0, 4.0, heading=0.3),
        sf.flows.ShapedCells(6.0, 5.5, heading=-0.5),
    )
    flight = sf.simulate_flight(
        sf.flows.SuperposedFlow(parts), VEHICLE, duration=12.0, sample_rate=100.0, seed=9,
        position_noise=0.02, velocity_noise=0.1,
    )  # fmt: skip
    found = LADDER.estimate(flight)
    assert (found.status, found.shape, len(found.scales)) == ("ok", "several", 2)
    assert found.mean_velocity == found.scales[0].mean_velocity
    for read, true in zip(found.scales, parts, strict=True):
        assert abs(read.mean_velocity - true.mean_velocity) < 4 * read.uncertainty.mean_velocity
        assert abs(read.length_scale - true.length_scale) < 4 * read.uncertainty.length_scale
        assert read.uncertainty.mean_velocity < 0.02 * true.mean_velocity
        assert read.heading == pytest.approx(true.heading, abs=0.01)
    log = ReadLog("f", flight, quality_of(flight), ())
    told = [line for line in lines([log], found, ()) if line.startswith("flow ")]
    assert len(told) == 2
    assert all(" heading " in line and line.endswith(" degrees") for line in told)


def test_the_heading_of_a_rhomb_halves_the_angle_of_its_waves():
    cells = sf.flows.ShapedCells(9.0, 4.0, heading=0.4, angle=1.1)
    flight = sf.simulate_flight(cells, VEHICLE, duration=8.0, sample_rate=100.0, seed=2)
    found = LADDER.estimate(flight)
    assert found.shape == "pair"
    assert found.heading == pytest.approx(0.4, abs=1e-3)
    assert found.length_scales == pytest.approx((4.0, 4.0), rel=1e-3)
