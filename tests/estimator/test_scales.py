"""Sets of scales: what the flight bears out of those proposed, and what is said of the rest."""

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.estimator.estimator import Estimator
from sparsefit.score import score_scales
from tests.problems import flight, fly

SEVERAL = sf.Readout(scales="several")
VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(20.0, 11.3))


@cache
def flown(*parts, seed=3, noise=0.05, duration=12.0):
    flow = sf.flows.SuperposedFlow(tuple(sf.CellularFlow(*part) for part in parts))
    return fly(flow, VEHICLE, duration=duration, seed=seed, noise=(noise, 0.0))


@pytest.mark.parametrize("backend", ["group-lasso", "lasso"])
def test_two_flows_are_found_with_their_velocities(backend):
    flight_ = flown((10.0, 3.1), (4.0, 4.4))
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


def test_three_flows():
    flight_ = flown((10.0, 3.0), (6.0, 4.1), (4.0, 6.3), duration=20.0)
    found = Estimator(backend="group-lasso", readout=SEVERAL).estimate(flight_)
    scored = score_scales(found, flight_.flow)
    assert found.status == "ok"
    assert scored.within(1.0)
    assert scored.spurious == 0


def test_a_back_end_that_proposes_one_gets_one_and_is_told():
    flight_ = flown((10.0, 3.1), (8.0, 4.4))
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
    flight_ = flown((10.0, 3.0), (8.0, 5.0))
    readout = sf.Readout(scales="several", refine="none")
    found = Estimator(backend="group-lasso", readout=readout).estimate(flight_)
    assert {3.0, 5.0} <= {round(one.length_scale, 9) for one in found.scales}
    for one in found.scales:
        assert one.length_scale == pytest.approx(one.grid_length_scale)
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
    values = {"mean_velocity", "length_scale", "timescale"}
    assert set(scale) == values | {"grid_length_scale", "uncertainty", "heading"}
    intervals = {f"{name}_interval" for name in values}
    assert set(scale["uncertainty"]) == values | intervals
    assert scale["uncertainty"] == record["uncertainty"]
    assert Estimator().estimate(flight()).to_dict()["scales"] == []


def test_the_papers_velocity_cannot_part_several():
    with pytest.raises(sf.InputError, match="cannot part several"):
        sf.Readout(scales="several", mean_velocity="paper")
    with pytest.raises(sf.InputError, match="readout scales"):
        sf.Readout(scales="two")


@pytest.mark.parametrize("samples", [18, 24, 48])
def test_a_flight_too_short_to_tell_is_never_ok_and_wrong(samples):
    for seed in range(4):
        draw = np.random.default_rng([5, seed])
        scale, timescale = draw.uniform(2, 10), draw.uniform(0.1, 1)
        flow = sf.CellularFlow(scale / timescale, scale)
        short = fly(flow, duration=(samples - 1) / 50, rate=50, seed=seed)
        found = Estimator(readout=SEVERAL).estimate(short)
        if found.status == "ok":
            assert found.length_scale == pytest.approx(scale, rel=0.05)
            assert found.mean_velocity == pytest.approx(flow.mean_velocity, rel=0.05)
        else:
            assert found.reason


@pytest.mark.parametrize("readout", [SEVERAL, sf.Readout()])
@pytest.mark.parametrize(
    ("scale", "words"),
    [(3.3, ""), (3.27, "a length scale is at the edge of the search, 3.33 m"),
     (1e4, "no waves of 10000 to 10000 m explain")],
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
    believed = replace(flown((10.0, 3.1), (6.0, 4.4)), vehicle=wrong)
    library = sf.Library(unknown=("response_time", "thrust_acceleration"))
    found = Estimator(method, library, "group-lasso", SEVERAL).estimate(believed)
    assert found.status == "ok"
    assert [scale.length_scale for scale in found.scales] == pytest.approx([3.1, 4.4], rel=5e-3)
    assert found.response_time == pytest.approx(0.5, rel=0.02)
    for scale, true in zip(found.scales, (10.0, 6.0), strict=True):
        low, high = scale.uncertainty.mean_velocity_interval
        assert low - 0.01 * true < true < high + 0.01 * true
