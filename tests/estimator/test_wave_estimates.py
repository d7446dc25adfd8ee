"""From a flight through cells of any heading to their waves, by back-ends on the wave library."""

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.estimator import Doubt

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
FLOW = sf.flows.ShapedCells(12.0, 4.2, heading=math.radians(25.0), offset=(1.0, 0.5))
WAVES = sf.Library(sf.model.LengthScaleGrid(3.0, 8.0), family="waves", every=10)


@cache
def flown(flow=FLOW, seed=7, noise=0.2, duration=8.0):
    return sf.simulate_flight(
        flow, VEHICLE, duration=duration, sample_rate=100.0, seed=seed,
        velocity_noise=noise, position_noise=0.25 * noise,
    )  # fmt: skip


FLIGHT, OTHER = flown(), flown(seed=91, noise=0.0)


def missed(flow):
    """The relative error of a flow along another flight through the true one."""
    truth = FLOW.velocity(*OTHER.position.T)
    return np.linalg.norm(flow.velocity(*OTHER.position.T) - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize(
    ("name", "settings", "refine", "shape"),
    [
        ("lasso", {}, "ladder", "square"),
        ("group-lasso", {}, "variable-projection", "square"),
        ("group-omp", {}, "variable-projection", "square"),
        ("least-squares", {"rcond": 0.03}, "ladder", "square"),
        ("stlsq", {"threshold": 0.02, "ridge": 0.1}, "variable-projection", "square"),
    ],
)
def test_every_back_end_leads_to_the_turned_cells(name, settings, refine, shape):
    backend, readout = backends.get(name, **settings), sf.Readout(refine=refine)
    found = sf.Estimator(library=WAVES, backend=backend, readout=readout).estimate(FLIGHT)
    assert found.status == "ok"
    assert found.mean_velocity == pytest.approx(12.0, rel=0.01)
    assert found.length_scale == pytest.approx(4.2, rel=0.002)
    assert math.degrees(found.heading) == pytest.approx(25.0, abs=0.2)
    assert found.timescale == found.length_scale / found.mean_velocity
    assert found.shape == shape
    assert abs(found.mean_velocity - 12.0) < 4 * found.uncertainty.mean_velocity < 0.5
    assert abs(found.length_scale - 4.2) < 4 * found.uncertainty.length_scale < 0.1
    assert found.goodness.r_squared > 0.98
    assert missed(found.flow) < 0.02


@pytest.mark.parametrize("groups", ["wave", "nested"])
def test_on_the_grid_the_flow_is_the_sum_of_its_waves(groups):
    estimator = sf.Estimator(
        library=replace(WAVES, groups=groups), readout=sf.Readout(refine="none")
    )
    prepared = estimator.prepare(FLIGHT)
    fit = estimator.fit(prepared)
    found = estimator.read(prepared, fit)
    position = prepared.samples.position[::10]
    np.testing.assert_allclose(
        found.flow.velocity(*position.T).reshape(-1, 1), prepared.problem.theta @ fit.weights,
        atol=1e-9,
    )  # fmt: skip
    assert found.grid_length_scale in found.weights_by_scale
    # The grid holds the cells only as nearly as half a step, pi/(2 extent), of |k|.
    off = abs(1 / found.length_scale - 1 / 4.2) * math.sqrt(2.0) * FLIGHT.extent
    assert off < 1.0


def test_a_wind_that_was_unknown_is_part_of_the_flow():
    windy = flown(sf.flows.SuperposedFlow((FLOW,), (1.5, -0.5)), noise=0.0)
    found = sf.Estimator(library=replace(WAVES, unknown=("wind",))).estimate(windy)
    assert found.wind == pytest.approx((1.5, -0.5), abs=0.01)
    place = windy.position[100]
    expected = FLOW.velocity(*place) + np.array([1.5, -0.5])
    np.testing.assert_allclose(found.flow.velocity(*place), expected, atol=0.05)


def test_two_flows_of_different_headings_are_found_together():
    first = sf.flows.ShapedCells(9.0, 4.0, heading=0.2)
    second = sf.flows.ShapedCells(7.0, 6.5, heading=-0.4)
    flow = sf.flows.SuperposedFlow((first, second))
    library = replace(WAVES, grid=sf.model.LengthScaleGrid(3.0, 9.0))
    found = sf.Estimator(library=library).estimate(flown(flow, seed=4, duration=10.0))
    k = np.concatenate([first.waves.wavevectors, second.waves.wavevectors])
    near = [min(np.linalg.norm(found.flow.wavevectors - s * one, axis=1).min() for s in (-1, 1))
            for one in k]  # fmt: skip
    assert max(near) < 0.01
    assert found.scales[0].length_scale == found.length_scale  # of the faster
    for read, true in zip(found.scales, (first, second), strict=True):
        assert read.mean_velocity == pytest.approx(true.mean_velocity, rel=0.01)
        assert read.length_scale == pytest.approx(true.length_scale, rel=0.01)
        assert read.heading == pytest.approx(true.heading, abs=0.005)


def test_it_goes_with_the_weak_form_and_an_unknown_vehicle():
    believed = replace(FLIGHT, vehicle=sf.PointMassVehicle(0.55, (5.0, 3.0)))
    for method in ("auto", "weak"):
        library = replace(WAVES, unknown=("response_time",), every=10 if method == "auto" else 1)
        found = sf.Estimator(method, library).estimate(believed)
        assert found.response_time == pytest.approx(0.5, rel=0.01)
        assert found.mean_velocity == pytest.approx(12.0, rel=0.02)
        assert missed(found.flow) < 0.05


def test_zero_weights_and_waves_that_the_flight_does_not_bear_out_are_said():
    nothing = sf.Estimator(library=WAVES, backend=backends.get("group-lasso", alpha_fraction=1.0))
    found = nothing.estimate(FLIGHT)
    assert (found.status, found.doubt) == ("unidentifiable", Doubt.NO_WEIGHTS)
    assert found.flow is None
    still = flown(None, seed=5)
    for refine in ("ladder", "variable-projection"):
        found = sf.Estimator(library=WAVES, readout=sf.Readout(refine=refine)).estimate(still)
        assert (found.status, found.doubt) == ("unidentifiable", Doubt.NO_FLOW)
    assert math.isnan(found.mean_velocity)  # of proposed waves none is borne out
    assert found.flow is None


def test_the_estimate_is_json_with_its_waves():
    found = sf.Estimator(library=WAVES).estimate(FLIGHT)
    shown = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert shown["heading"] == found.heading
    np.testing.assert_array_equal(shown["flow"]["wavevectors"], found.flow.wavevectors)
