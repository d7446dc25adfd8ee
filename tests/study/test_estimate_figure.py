"""The picture of one estimate: what its panels hold, that nothing is cut off, and the spectrum."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.figure import Figure

import sparsefit as sf
from sparsefit.study.report.drawing import to_pdf
from sparsefit.study.report.estimate_figure import estimate_figure
from sparsefit.study.report.flown import (
    draw_residual,
    draw_spectrum,
    draw_track,
    draw_weights,
    flown_by,
    spectrum,
)

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))


@pytest.fixture(scope="module")
def flown():
    flight = sf.simulate_flight(
        sf.CellularFlow(15.43, 4.21), VEHICLE, duration=4.0, sample_rate=100.0, seed=7,
        velocity_noise=0.2, position_noise=0.05,
    )  # fmt: skip
    grid = sf.LengthScaleGrid(3.0, 6.0, 0.2)
    estimator = sf.Estimator(library=sf.Library(grid), readout=sf.Readout(refine="none"))
    return flown_by(flight, sf.Derivative()(flight), estimator.estimate(flight))


def test_other_flights_are_drawn_within_the_map(flown):
    away = replace(flown.flight, position=flown.flight.position + 30.0)
    axes = Figure().subplots()
    draw_track(axes, flown_by(flown.flight, flown.samples, flown.estimate, (away,)))
    left, right, _, top = axes.images[0].get_extent()
    x, y = away.position.T
    assert left < x.min() - 30.0
    assert x.max() < right
    assert y.max() < top
    assert len(axes.lines) == 4  # two tracks and where they begin


def no_flow(flown):
    lost = replace(flown.estimate, flow=None, length_scale=np.nan, weights_by_scale={})
    return replace(flown, estimate=lost)


def cut(flown):
    """As a log with a gap, in NED, drifting."""
    time = flown.samples.time + 20.0 * (flown.samples.time > 1.5)
    flight = replace(flown.flight, frame="NED")
    moving = replace(flown.estimate, drift=(0.5, 0.2))
    return replace(flown, flight=flight, samples=replace(flown.samples, time=time), estimate=moving)


def test_the_picture_has_four_panels_and_nothing_is_cut_off(flown):
    figure = estimate_figure(cut(flown), "a_log_with_a_long_name" * 8 + ".csv")
    assert len(figure.axes) == 4
    box = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    assert box.x0 >= 0
    assert box.y0 >= 0
    assert box.x1 <= width
    assert box.y1 <= height
    assert to_pdf(figure).startswith(b"%PDF")


def test_panels_without_a_flow_say_so(flown):
    panels = Figure().subplots(2, 2).ravel()
    lost = no_flow(flown)
    for draw, axes in zip((draw_track, draw_weights, draw_residual), panels, strict=False):
        draw(axes, lost)
    draw_spectrum(panels[3], lost)
    titles = [axes.get_title() for axes in panels]
    assert titles[:2] == ["no flow was found", "no weights"]
    assert titles[2] == "no flow was found: the velocity of the air"
    assert [line.get_label() for line in panels[3].lines] == ["velocity of the air"]


def test_the_residual_is_what_the_flow_leaves_of_the_air(flown):
    x, y = flown.samples.position.T
    assert flown.left == pytest.approx(flown.measured - flown.estimate.flow.velocity(x, y))
    assert no_flow(flown).left is flown.measured
    assert flown.measured == pytest.approx(flown.samples.flow_velocity(VEHICLE))


def test_an_estimated_vehicle_is_the_one_that_flew(flown):
    other = replace(flown.flight, vehicle=sf.PointMassVehicle(1.0, (1.0, 1.0)))
    found = replace(flown.estimate, response_time=0.5, thrust_acceleration=(5.0, 3.0))
    assert flown_by(other, flown.samples, found).measured == pytest.approx(flown.measured)


def test_a_spectrum_sums_to_the_variance_and_finds_a_sine():
    rng, step = np.random.default_rng(5), 0.02
    values = rng.normal(0.0, [0.3, 2.0], (20_000, 2))
    frequency, power = spectrum(values, step)
    assert power.sum(axis=0) * frequency[0] == pytest.approx(values.var(axis=0), rel=0.02)
    assert power.mean(axis=0) == pytest.approx(2 * step * values.var(axis=0), rel=0.02)  # white
    time = step * np.arange(2000)
    tone = np.sin(2 * np.pi * 7.0 * time)[:, None]
    frequency, power = spectrum(tone, step)
    assert frequency[np.argmax(power)] == pytest.approx(7.0, abs=frequency[0])
    assert power.sum() * frequency[0] == pytest.approx(0.5, rel=0.01)
