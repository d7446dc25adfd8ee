"""Pictures: what their panels hold, and that nothing is cut off."""

from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.plot import draw_estimate, draw_flow, encoded
from sparsefit.plot.pictures import axis_unit, vorticity
from tests.problems import fly

FLOW = sf.CellularFlow(15.43, 4.21)


@pytest.fixture(scope="module")
def flown():
    flight = fly(FLOW, duration=4.0, rate=50.0, seed=7, noise=(0.2, 0.05))
    grid = sf.model.LengthScaleGrid(3.0, 6.0, 0.5)
    estimator = sf.Estimator(library=sf.Library(grid), readout=sf.Readout(refine="none"))
    return flight, estimator, estimator.estimate(flight)


def is_whole(figure):
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    return box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height


def test_the_picture_of_an_estimate_has_three_panels_and_nothing_is_cut_off(flown):
    flight, estimator, estimate = flown
    moving = replace(estimate, drift=(0.5, 0.2))
    north = replace(flight, frame="NED")
    figure = draw_estimate(moving, estimator, [north], "a_log_with_a_long_name" * 8, (4.21,))
    assert len(figure.axes) == 3
    assert is_whole(figure)
    assert "clockwise" in str([axes.get_ylabel() for axes in figure.axes[0].child_axes])


def test_no_line_is_drawn_over_a_gap(flown):
    flight, estimator, estimate = flown
    late = flight.time > 1.5
    moved = flight.position + 20.0 * flight.velocity[late][0] * late[:, None]
    broken = replace(flight, time=flight.time + 20.0 * late, position=moved)
    residual = draw_estimate(estimate, estimator, [broken], "x").axes[2]
    assert np.isnan(residual.lines[0].get_ydata()).sum() == 1


def test_a_flow_that_was_not_found_is_said(flown):
    flight, estimator, estimate = flown
    lost = replace(estimate, flow=None, length_scale=np.nan, weights_by_scale={})
    titles = [axes.get_title() for axes in draw_estimate(lost, estimator, [flight], "x").axes]
    assert titles[:3] == ["no flow to be drawn", "no weights", "velocity of the air, no flow found"]


def test_the_residual_is_what_the_flow_leaves_of_the_air(flown):
    flight, estimator, estimate = flown
    samples = estimator.derivative(flight)
    left = samples.flow_velocity(flight.vehicle) - estimate.flow.velocity(*samples.position.T)
    drawn = draw_estimate(estimate, estimator, [flight, flight], "x").axes[2]
    assert drawn.lines[0].get_ydata() == pytest.approx(left[:, 0])
    assert "first flight" in drawn.get_title()


def test_a_map_holds_all_tracks_and_the_vorticity_of_the_flow(flown):
    flight = flown[0]
    away = replace(flight, position=flight.position + 30.0)
    (axes, _) = draw_flow(FLOW, flight, away, length_scale=4.21).axes
    left, right, _, top = axes.images[0].get_extent()
    x, y = away.position.T
    assert left < flight.position[:, 0].min()
    assert x.max() < right
    assert y.max() < top
    _, turning = vorticity(FLOW, np.array([[0.0, 0.0], [4.21, 4.21]]), points=400)
    # dv/dx - du/dy = 2 pi U0 / L sin(pi x / L) sin(pi y / L)
    assert np.abs(turning).max() == pytest.approx(2 * np.pi * 15.43 / 4.21, rel=1e-3)
    assert axis_unit(7e3, "m") == (1e3, "km")


def test_a_picture_is_the_same_bytes_with_fonts_that_publishers_take(flown):
    flight, estimator, estimate = flown
    figure = draw_estimate(estimate, estimator, [flight], "x")
    pdf = encoded(figure, ".pdf")
    assert pdf.startswith(b"%PDF")
    assert b"/Type3" not in pdf
    assert encoded(figure, ".svg", "a") == encoded(figure, ".svg", "a")
