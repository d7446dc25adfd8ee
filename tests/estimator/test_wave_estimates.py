"""Cells of any heading, and flows of several scales: by the ladder, and by back-ends on waves."""

import json
import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.cli.printed import ReadLog, lines
from sparsefit.estimator import Doubt, Estimator
from sparsefit.estimator.measure import Optimum, lobes, measure_flow, read_waves
from sparsefit.flows import ShapedCells
from sparsefit.logs.checks import LogQuality
from sparsefit.model import Start, propose
from sparsefit.score import score_scales
from tests.problems import flight, fly

FLOW = ShapedCells(12.0, 4.2, heading=math.radians(25.0), offset=(1.0, 0.5))
WAVES = sf.Library(sf.model.LengthScaleGrid(3.0, 8.0), family="waves", every=10)


@cache
def flown(flow=FLOW, seed=7, noise=0.2, duration=8.0):
    return fly(flow, duration=duration, seed=seed, noise=(noise, 0.25 * noise))


FLIGHT, OTHER = flown(), flown(seed=91, noise=0.0)


def test_what_leaves_three_times_the_least_residual_is_not_measured():
    """The flow itself is proposed as what leaves five times as much as a wrong one."""
    prepared = sf.Estimator().prepare(FLIGHT)
    right = propose(prepared.search, Start())[0]
    wrong = replace(right, wavevectors=1.7 * right.wavevectors, residual=0.1)
    near, far = (
        measure_flow(prepared, (wrong, replace(right, residual=residual)), (), shapes=True)
        for residual in (0.25, 0.5)
    )
    assert near.posterior.model.pattern.length_scale == pytest.approx(4.2, rel=0.01)
    assert far is None


def missed(flow):
    """The relative error of a flow along another flight through the true one."""
    truth = FLOW.velocity(*OTHER.position.T)
    return np.linalg.norm(flow.velocity(*OTHER.position.T) - truth) / np.linalg.norm(truth)


@pytest.mark.parametrize(
    ("name", "settings", "refine"),
    [
        ("lasso", {}, "ladder"),
        ("group-lasso", {}, "variable-projection"),
        ("group-omp", {}, "variable-projection"),
        ("least-squares", {"rcond": 0.03}, "ladder"),
        ("stlsq", {"threshold": 0.02, "ridge": 0.1}, "variable-projection"),
    ],
)
def test_every_back_end_leads_to_the_turned_cells(name, settings, refine):
    backend, readout = backends.get(name, **settings), sf.Readout(refine=refine)
    found = sf.Estimator(library=WAVES, backend=backend, readout=readout).estimate(FLIGHT)
    assert found.status == "ok"
    assert found.mean_velocity == pytest.approx(12.0, rel=0.01)
    assert found.length_scale == pytest.approx(4.2, rel=0.002)
    assert math.degrees(found.heading) == pytest.approx(25.0, abs=0.2)
    assert found.timescale == found.length_scale / found.mean_velocity
    assert found.shape == "square"
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
    position = prepared.parts[0].position[::10]
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


LADDER = sf.Estimator(readout=sf.Readout(refine="ladder"))


@pytest.fixture(scope="module")
def turned():
    flow = ShapedCells(10.0, 4.0, heading=0.3)
    flight = fly(flow, duration=8.0, noise=(0.1, 0.02), initial_position=(101.0, -57.0))
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
    assert shape.length_scales == pytest.approx([sure.length_scale] * 2)
    assert estimate.rungs[0].bic == 0 < estimate.rungs[1].bic


def test_the_flow_is_that_of_the_flight_in_its_own_coordinates(turned):
    flow, flight, estimate = turned
    x, y = flight.position.T
    true, found = flow.velocity(x, y), estimate.flow.velocity(x, y, flight.time)
    assert np.mean((found - true) ** 2) < 1e-3 * np.mean(true**2)


def test_the_command_line_tells_the_shape(turned):
    _, flight, estimate = turned
    words = "\n".join(lines([ReadLog("turned", flight, LogQuality(flight), ())], estimate, ()))
    assert "shape                 square cells\n" in words
    assert f"heading               {math.degrees(estimate.heading):.4f} degrees" in words
    assert "drift" not in words


def test_cells_that_drift_are_told_with_their_drift():
    flow = ShapedCells(10.0, 4.0, heading=0.3, drift=(0.8, -0.5))
    found = LADDER.estimate(fly(flow, duration=8.0, noise=(0.1, 0.02)))
    assert (found.status, found.shape) == ("ok", "square")
    for drift, error, true in zip(
        found.drift, found.shape_uncertainty.drift, (0.8, -0.5), strict=True
    ):
        assert abs(drift - true) < 4 * error < 0.2


@pytest.mark.parametrize(("scale", "headings"), [(5.5, (0.3, -0.5)), (2.0, (0.0, 0.0))])
def test_two_flows_are_read_each_by_itself(scale, headings):
    """Waves of half the length along the same lines are no waves that free ones are told from."""
    parts = ShapedCells(9.0, 4.0, heading=headings[0]), ShapedCells(6.0, scale, heading=headings[1])
    flight = fly(sf.flows.SuperposedFlow(parts), duration=12.0, seed=9, noise=(0.1, 0.02))
    found = LADDER.estimate(flight)
    assert (found.status, found.shape, len(found.scales)) == ("ok", "several", 2)
    assert found.mean_velocity == found.scales[0].mean_velocity
    for read, true in zip(found.scales, parts, strict=True):
        assert abs(read.mean_velocity - true.mean_velocity) < 4 * read.uncertainty.mean_velocity
        assert abs(read.length_scale - true.length_scale) < 4 * read.uncertainty.length_scale
        assert read.uncertainty.mean_velocity < 0.02 * true.mean_velocity
        assert read.heading == pytest.approx(true.heading, abs=0.01)


def test_waves_are_read_by_hand():
    # Speeds |k| sqrt(a^2 + b^2) of 5, 13 and 0.6 m/s; the cells are those of the first two
    waves = [[-1.0, 0, -3.0, -4.0, -2.0], [0, -1.0, -12.0, -5.0, 1.0], [0.6, 0, 1.0, 0, 40.0]]
    speed, scale, time, x, y, heading = read_waves(np.array(waves))
    assert speed == pytest.approx(math.sqrt(25.0 + 169.0 + 0.36))
    assert (scale, x, y) == pytest.approx((math.sqrt(2.0) * math.pi,) * 3)
    assert time == pytest.approx(scale / speed)
    assert abs(heading) == pytest.approx(0.25 * math.pi)


def test_waves_are_loose_but_for_cells_of_one_flow_or_of_two():
    def loose(*waves, **levels):
        flow = SimpleNamespace(waves=np.array(waves))
        model = SimpleNamespace(pattern=flow, levels=levels)
        return Optimum(SimpleNamespace(model=model), None).loose

    cells = [[1.0, 0.0, 2.0, 0.0, 0.0], [0.0, 1.0, 0.0, 2.0, 0.0]]
    more, odd = [[0.5, 0.5, 5.0, 0.0, 0.0], [0.5, -0.5, 0.0, 5.0, 0.0]], [0.5, -0.5, 9.0, 9.0, 0.0]
    sets = cells[:1], cells, [*cells, more[0]], [*cells, *more], [*cells, more[0], odd]
    assert [loose(*own) for own in sets] == [True, False, True, False, True]
    # The weaker flow has a mean square of (4 + 4)/4 m^2/s^2: less than gusts of 1.5 m/s, not 1.4.
    assert [loose(*cells, *more, turbulence=own) for own in (1.4, 1.5)] == [False, True]
    assert not loose(*cells, turbulence=9.0)


def test_proposals_of_one_lobe_are_the_one_of_fewest_parameters():
    def proposal(shape, waves, **more):
        more = {"velocity": None, **more}
        return SimpleNamespace(shape=shape, wavevectors=np.array(waves), **more)

    waves = np.array([[1.0, 0.0], [0.0, 1.0]])
    square, axis = proposal("square", waves + 0.02), proposal("axis", -waves[::-1])
    drifting = proposal("axis", waves, velocity=(0.1, 0.0))
    far, alone = proposal("axis", np.add(waves, [0.2, 0.0])), proposal("several", waves[:1])
    twice = proposal("pair", [[1.0, 0.0], [1.01, 0.0]])  # of which one wave is near both
    every = [drifting, square, far, alone, axis, twice]
    for order in (every, every[::-1]):
        assert {id(own) for own in lobes(order, 0.1)} == {
            id(own) for own in (axis, far, alone, twice)
        }
    assert lobes([drifting, square], 0.1) == [drifting]
    prepared = sf.Estimator().prepare(FLIGHT)
    (stride,), velocity = prepared.strides, prepared.parts[0].velocity
    assert stride == pytest.approx(0.01 * np.sqrt(2 * np.mean(velocity**2)))  # at 100 Hz
    coarse = replace(prepared, library=sf.Library(sf.model.LengthScaleGrid(1.9 * stride, 8.0)))
    assert [coarse.too_fast(share * stride) for share in (2.9, 3.1)] == [[1], []]
    assert prepared.too_fast(2.9 * stride) == []  # shorter than half of the least of the search


def test_the_heading_of_a_rhomb_halves_the_angle_of_its_waves():
    cells = ShapedCells(9.0, 4.0, heading=0.4, angle=1.1)
    found = LADDER.estimate(fly(cells, duration=8.0, seed=2))
    assert found.shape == "pair"
    assert found.heading == pytest.approx(0.4, abs=1e-3)
    assert found.length_scales == pytest.approx((4.0, 4.0), rel=1e-3)


SEVERAL = sf.Readout(scales="several")
VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(20.0, 11.3))


@cache
def through(*parts, seed=3, noise=0.05, duration=12.0):
    flow = sf.flows.SuperposedFlow(tuple(sf.CellularFlow(*part) for part in parts))
    return fly(flow, VEHICLE, duration=duration, seed=seed, noise=(noise, 0.0))


@pytest.mark.parametrize("backend", ["group-lasso", "lasso"])
def test_two_flows_are_found_with_their_velocities(backend):
    flight_ = through((10.0, 3.1), (4.0, 4.4))
    found = Estimator(backend=backend, readout=SEVERAL).estimate(flight_)
    scored = score_scales(found, flight_.flow)
    assert found.status == "ok"
    assert (scored.detected, scored.spurious) == (2, 0)
    assert scored.max_length_scale_error < 0.1
    assert scored.max_mean_velocity_error < 1.0
    first, second = found.scales
    assert first.mean_velocity >= second.mean_velocity
    for name in ("mean_velocity", "length_scale", "timescale", "grid_length_scale"):
        assert getattr(found, name) == getattr(first, name)


def test_a_back_end_that_proposes_one_gets_one_and_is_told():
    flight_ = through((10.0, 3.1), (8.0, 4.4))
    found = Estimator(backend="best-scale", readout=SEVERAL).estimate(flight_)
    assert len(found.scales) == 1
    assert found.status in ("misfit", "unidentifiable")


@pytest.mark.parametrize("backend", ["group-lasso", "best-scale"])
def test_one_flow_is_one_scale_and_the_same_as_before(backend):
    several = Estimator(backend=backend, readout=SEVERAL).estimate(flight())
    one = Estimator(backend=backend).estimate(flight())
    assert several.status == one.status == "ok"
    assert len(several.scales) == 1
    assert several.length_scale == pytest.approx(one.length_scale, rel=1e-9)
    assert several.mean_velocity == pytest.approx(one.mean_velocity, rel=1e-7)
    assert one.scales == ()


def test_unrefined_scales_are_candidates_of_the_grid():
    flight_ = through((10.0, 3.0), (8.0, 5.0))
    readout = sf.Readout(scales="several", refine="none")
    found = Estimator(backend="group-lasso", readout=readout).estimate(flight_)
    assert {3.0, 5.0} <= {round(one.length_scale, 9) for one in found.scales}
    for one in found.scales:
        assert one.length_scale == pytest.approx(one.grid_length_scale)
        assert one.timescale == one.length_scale / one.mean_velocity
        assert np.min(np.abs(sf.model.LengthScaleGrid().scales - one.length_scale)) < 1e-9
    scored = score_scales(found, flight_.flow)
    assert scored.max_length_scale_error < 1e-9
    assert scored.max_mean_velocity_error < 10.0


def test_json_has_every_scale_and_the_estimator_comes_back():
    estimator = Estimator(readout=SEVERAL)
    assert Estimator.from_json(estimator.to_json()) == estimator
    record = json.loads(json.dumps(estimator.estimate(flight()).to_dict(), allow_nan=False))
    (scale,) = record["scales"]
    assert scale["length_scale"] == record["length_scale"]
    assert scale["uncertainty"] == record["uncertainty"]
    assert Estimator().estimate(flight()).to_dict()["scales"] == []


def test_the_papers_velocity_cannot_part_several():
    with pytest.raises(sf.InputError, match="cannot part several"):
        sf.Readout(scales="several", mean_velocity="paper")
    with pytest.raises(sf.InputError, match="readout scales"):
        sf.Readout(scales="two")


@pytest.mark.parametrize("readout", [SEVERAL, sf.Readout()])
@pytest.mark.parametrize(
    ("scale", "words"),
    [(3.3, ""), (3.27, "a length scale is at the edge of the search, 3.33 m"),
     (1e4, "less than the shortest length scale of the search, 10000 m")],
)  # fmt: skip
def test_a_grid_of_one_scale_is_judged_by_the_flight(scale, words, readout):
    library = sf.Library(sf.model.LengthScaleGrid(scale, scale))
    found = Estimator(library=library, readout=readout).estimate(flight(3.33, velocity_noise=0.2))
    assert found.status == ("unidentifiable" if words else "ok")
    assert words in found.reason
    if scale < 1e4:  # measured off the grid
        assert found.length_scale == pytest.approx(3.33, rel=1e-3)


@pytest.mark.parametrize("method", ["auto", "weak"])
def test_two_flows_of_a_vehicle_believed_wrong(method):
    wrong = sf.PointMassVehicle(response_time=0.6, thrust_acceleration=(24.0, 13.0))
    believed = replace(through((10.0, 3.1), (6.0, 4.4)), vehicle=wrong)
    library = sf.Library(unknown=("response_time", "thrust_acceleration"))
    found = Estimator(method, library, "group-lasso", SEVERAL).estimate(believed)
    assert found.status == "ok"
    assert [scale.length_scale for scale in found.scales] == pytest.approx([3.1, 4.4], rel=5e-3)
    assert found.response_time == pytest.approx(0.5, rel=0.02)
    for scale, true in zip(found.scales, (10.0, 6.0), strict=True):
        low, high = scale.uncertainty.mean_velocity_interval
        assert low - 0.01 * true < true < high + 0.01 * true
