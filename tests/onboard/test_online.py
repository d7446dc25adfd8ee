"""The stream: answers that hold, refusals, threads, checkpoints, and flights scored as flown."""

import contextlib
import math
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.estimator import Doubt
from sparsefit.onboard import OnlineEstimator, Stream, as_flown, refusal
from sparsefit.onboard import board as module
from tests.problems import fly

VEHICLE = sf.PointMassVehicle(0.3, (6.0, -3.0))
TURNED = sf.flows.ShapedCells(10.0, 4.21, heading=0.4)
GRID = sf.model.LengthScaleGrid(2.0, 8.0)
LADDER = sf.Estimator(library=sf.Library(grid=GRID), readout=sf.Readout(refine="ladder"))
AXES = replace(LADDER, readout=sf.Readout(refine="variable-projection"))
compiled = pytest.mark.skipif(module.CompiledFlow is None, reason="there was no compiler")


def flown(flow=TURNED, vehicle=VEHICLE, **changes):
    options = {"duration": 14.0, "rate": 50.0, "seed": 7, "noise": (0.1, 0.05)}
    return fly(flow, vehicle, **(options | changes))


def samples_of(flight):
    return zip(flight.time, flight.position, flight.velocity, strict=True)


def fed(online, flight, start=0, stop=None):
    for sample in list(samples_of(flight))[start:stop]:
        online.update(*sample)
    return online


@pytest.fixture(scope="module")
def flight():
    return flown()


@pytest.fixture(scope="module")
def whole(flight):
    return fed(online_of(), flight).estimate()


def online_of(estimator=LADDER, **options):
    return OnlineEstimator(estimator, vehicle=VEHICLE, **options)


def test_an_answer_at_every_sample_that_is_right_when_it_is_ok(flight):
    online, seen = online_of(), []
    for stop in range(0, flight.samples, 25):
        seen.append(fed(online, flight, stop, stop + 25).estimate())
    assert (seen[0].status, seen[0].doubt) == ("unidentifiable", Doubt.FEW_SAMPLES)
    sure = [estimate for estimate in seen if estimate.status == "ok"]
    assert len(sure) > 8
    for estimate in sure:
        assert estimate.length_scale == pytest.approx(4.21, rel=0.02)
        assert estimate.mean_velocity == pytest.approx(10.0, rel=0.05)
    last = seen[-1]
    assert (last.status, last.shape) == ("ok", "square")
    assert last.heading == pytest.approx(0.4, abs=0.01)
    low, high = last.uncertainty.length_scale_interval
    assert low < 4.21 < high
    x, y = flight.position[-300:].T
    np.testing.assert_allclose(
        last.flow.velocity(x, y), flight.flow.velocity(x, y), atol=0.05 * 10.0
    )
    assert online.samples == flight.samples
    assert len(pickle.dumps(online)) < 2**20


def test_cells_that_are_turned_are_a_misfit_where_the_axes_are_demanded():
    statuses = {fed(online_of(AXES), flown(seed=s)).estimate().status for s in (1, 2, 3)}
    assert "ok" not in statuses
    along = fed(online_of(AXES), flown(sf.CellularFlow(10.0, 4.21))).estimate()
    assert (along.status, along.heading, along.shape) == ("ok", 0.0, "axis")


@pytest.mark.slow
@compiled
@pytest.mark.parametrize("estimator", [LADDER, AXES])
def test_turned_cells_are_never_ok_and_off(estimator):
    rng, answered = np.random.default_rng(41), 0
    for seed in range(40):
        scale, turn = rng.uniform(2.5, 7.5), math.exp(rng.uniform(math.log(0.2), math.log(0.9)))
        flow = sf.flows.ShapedCells(scale / turn, scale, heading=rng.uniform(-0.7, 0.7))
        vehicle = sf.PointMassVehicle(0.3, tuple(rng.normal(size=2) * flow.mean_velocity))
        online = OnlineEstimator(estimator, vehicle=vehicle)
        estimate = fed(online, flown(flow, vehicle, seed=seed, duration=20.0)).estimate()
        answered += estimate.status == "ok"
        if estimate.status == "ok":
            assert estimate.length_scale == pytest.approx(scale, rel=0.05)
    assert answered >= (36 if estimator is LADDER else 0)


@compiled
@pytest.mark.parametrize(
    "flow", [None, sf.flows.Turbulence(4.0, 5.0, seed=3), sf.flows.SuperposedFlow((), (3.0, 1.0))]
)
def test_where_there_are_no_cells_nothing_is_ok(flow):
    flight = flown(flow, duration=20.0, seed=2, noise=(0.2, 0.0))
    online = online_of()
    for stop in range(0, flight.samples, 50):
        assert fed(online, flight, stop, stop + 50).estimate().status != "ok"


def test_a_window_follows_a_flow_that_swells():
    swelling = sf.flows.ShapedCells(8.0, 4.21, swell=0.2, swell_period=30.0)
    flight, online, errors = flown(swelling, duration=30.0), online_of(window=4.0), []
    for start in range(0, 1500, 125):
        estimate = fed(online, flight, start, start + 125).estimate()
        if start >= 600 and math.isfinite(estimate.mean_velocity):
            middle = flight.time[min(start + 124, 1500)] - 2.0
            true = 8.0 * (1 + 0.2 * math.sin(2 * math.pi * middle / 30.0))
            errors.append(estimate.mean_velocity / true - 1)
    assert len(errors) > 4
    assert np.sqrt(np.mean(np.square(errors))) < 0.08


def test_a_checkpoint_goes_on_and_threads_do_not_disturb_it(flight, whole):
    cut = pickle.loads(pickle.dumps(fed(online_of(), flight, 0, 300)))
    assert str(fed(cut, flight, 300).estimate()) == str(whole)
    shared = online_of()
    with ThreadPoolExecutor(4) as pool:
        asked = [pool.submit(lambda: shared.estimate().status) for _ in range(50)]
        fed(shared, flight)
        assert {future.result() for future in asked} <= {"ok", "unidentifiable", "misfit"}
    assert str(shared.estimate()) == str(whole)


@pytest.mark.parametrize("clock", [0.0, -14.0, 5.0])
def test_positions_from_another_origin_are_not_read_as_the_flow_that_was(clock):
    online, samples, answers = online_of(), list(samples_of(flown(duration=28.0))), []
    for moment, place, velocity in samples[:700]:
        online.update(moment, place, velocity)
    assert online.estimate().status == "ok"
    for moment, place, velocity in samples[700:]:
        with contextlib.suppress(sf.InputError):
            online.update(moment + clock, place + np.array([50.0, -30.0]), velocity)
        answers.append(online.estimate())
    assert answers[-1].status == "ok"  # found again
    sure = [own for own in answers[20:] if own.status == "ok"]
    np.testing.assert_allclose([own.mean_velocity for own in sure], 10.0, rtol=0.05)


def test_an_odd_first_sample_does_not_deafen(flight, whole):
    online, rest = online_of(), ((0.0, 0.0), (0.0, 0.0))
    for sample, words in (
        *(((0.0, *rest, thrust), "thrust") for thrust in ((1.0,), 3.0, (math.nan, 1.0))),
        *(((stamp, *rest), "give seconds") for stamp in (-1e18, 1.7e12)),
    ):
        with pytest.raises(sf.InputError, match=words):
            online.update(*sample)
    online.update(1.7e9, *rest)  # of a satellite clock, before those since boot
    for row in range(2):
        with contextlib.suppress(sf.InputError):
            fed(online, flight, row, row + 1)
    assert fed(online, flight, 2).estimate().status == whole.status == "ok"


def test_bad_samples_are_refused_and_change_nothing(flight):
    online = fed(online_of(), flight, 0, 400)
    before, last = str(online.estimate()), float(flight.time[399])
    for sample, words in (
        ((last + 0.02, (math.nan, 0.0), (0.0, 0.0)), r"position\[0\] must be a finite"),
        ((last + 0.02, (0.0, 0.0), (0.0, math.inf)), r"velocity\[1\] must be a finite"),
        ((last + 0.02, (0.0,), (0.0, 0.0)), "position must be two numbers"),
        (("now", (0.0, 0.0), (0.0, 0.0)), "time must be a finite number"),
        ((last + 0.02, (1e9, 0.0), (0.0, 0.0)), "beyond 1e7 in SI units"),
        ((last, (0.0, 0.0), (0.0, 0.0)), "out of line with the samples before"),
        ((last + 1e6, (0.0, 0.0), (0.0, 0.0)), "out of line"),
        ((last + 0.02, (0.0, 0.0), (0.0, 0.0), (1.0, 0.0)), "with every sample or with none"),
    ):
        with pytest.raises(sf.InputError, match=words):
            online.update(*sample)
    assert str(online.estimate()) == before
    fed(online, flight, 400)  # and none of it deafens
    assert online.estimate().status == "ok"
    online.restart()
    assert online.samples == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"library": sf.Library(grid=GRID, unknown=("wind",))}, "unknown wind"),
        ({"readout": sf.Readout(scales="several")}, "several scales"),
        ({"readout": sf.Readout(mean_velocity="paper")}, "U0 is the rms"),
        ({"library": sf.Library(grid=sf.model.LengthScaleGrid(1.0, 40.0))}, "wider than 16 times"),
    ],
)
def test_what_cannot_fly_is_said_before_it_does(change, words):
    estimator = replace(LADDER, **change)
    assert words in refusal(estimator)
    with pytest.raises(sf.InputError, match=words):
        online_of(estimator)
    with pytest.raises(sf.InputError, match=words):
        as_flown(estimator)
    assert refusal(LADDER) == ""
    for bad in ({"window": 0.0}, {"window": 5.0, "memory": 5.0}):
        with pytest.raises(sf.InputError, match="window"):
            online_of(**bad)


def test_an_estimator_is_scored_as_it_would_fly(flight, whole):
    flies = as_flown(LADDER)
    estimate = flies.estimate(flight)
    assert str(estimate) == str(whole)
    assert estimate.certificate is not None
    with pytest.raises(sf.InputError, match="one flight is followed, not 2"):
        flies.estimate([flight, flown(seed=9)])
    fading = Stream(window=5.0).flying(LADDER)
    prepared = fading.prepare([flight])
    assert fading.read(prepared, fading.fit(prepared)).status == "ok"
    assert str(flies.read(prepared, flies.fit(prepared))) == str(whole)  # of settings of its own
    assert Stream().flying(LADDER) is LADDER
