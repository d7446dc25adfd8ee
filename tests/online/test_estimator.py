"""The online answer against the batch answer of the same samples, and what a stream may do."""

from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.estimator import Doubt
from sparsefit.library.cells import candidate_columns, rms_mean_velocity
from sparsefit.online.stream import Stream
from sparsefit.online.sums import BLOCK
from tests.online.streams import (
    ESTIMATOR,
    FLIGHT,
    FLOW,
    LIBRARY,
    VEHICLE,
    assert_same,
    fed,
    online_of,
)


@pytest.mark.parametrize("method", ["forward", "midpoint", "central", "savgol"])
def test_the_answer_is_that_of_the_batch_on_the_same_window(method):
    derivative = sf.Derivative(method, repair=False)
    estimator = replace(ESTIMATOR, derivative=derivative)
    online = online_of(estimator)
    for start, stop in ((0, 40), (40, 203), (203, 555), (555, 751)):
        fed(online, FLIGHT, start, stop)
        flight = online.flight
        held = FLIGHT.time[:stop]
        np.testing.assert_array_equal(flight.time, held[held >= held[-1] - 8.0 - 1e-9])
        batch, scanned = estimator.estimate(flight), online.estimate(scan=True)
        assert_same(online.estimate(), batch)
        assert_same(scanned, batch)
        np.testing.assert_allclose(scanned.rival_length_scale, batch.rival_length_scale, rtol=1e-9)


def test_a_measured_thrust_and_drag_are_followed():
    vehicle = sf.PointMassVehicle(1.5, (1.0, 0.5), drag=0.02)
    time = np.arange(501) * 0.04
    thrust = sf.ThrustSeries(time, np.stack([np.sin(time), 2 * np.cos(0.7 * time)], axis=1))
    flight = sf.simulate_flight(
        FLOW, vehicle, duration=20.0, sample_rate=25.0, seed=5, velocity_noise=0.1, thrust=thrust
    )
    online = Stream(window=8.0).followed(ESTIMATOR, flight)
    np.testing.assert_array_equal(online.flight.thrust, flight.thrust[-201:])
    assert_same(online.estimate(), ESTIMATOR.estimate(online.flight))
    with pytest.raises(sf.InputError, match="with every sample or with none"):
        online.update(20.04, (0.0, 0.0), (0.0, 0.0))


@pytest.mark.parametrize("backend", ["lasso", "group-lasso", "stlsq"])
def test_other_back_ends_and_readouts_agree_too(backend):
    readout = sf.Readout(refine="none")
    estimator = replace(ESTIMATOR, backend=backend, readout=readout)
    online = fed(online_of(estimator, window=12.0), FLIGHT, 0, 500)
    assert_same(online.estimate(), estimator.estimate(online.flight), 1e-7)


def test_a_memory_weighs_samples_by_their_age():
    """Against the least squares of weighted rows, taken by hand."""
    memory = 3.0
    online = fed(online_of(memory=memory), FLIGHT, 0, 703)
    estimate, flight = online.estimate(), online.flight
    assert flight.duration == pytest.approx(5 * memory, abs=0.05)
    assert_same(estimate, online.estimate(scan=True))
    samples = ESTIMATOR.derivative(flight)
    root = np.exp((samples.time - samples.time[-1]) / (2 * memory))[:, None]
    phi = root * samples.flow_velocity(VEHICLE)

    def residual(scale):
        theta = root * candidate_columns(samples.position, np.array([scale]))
        weights, *_ = np.linalg.lstsq(theta, phi, rcond=None)
        return float(np.sum((phi - theta @ weights) ** 2)), weights

    away = [residual(estimate.length_scale * (1 + step))[0] for step in (-1e-5, 0.0, 1e-5)]
    assert away[1] < min(away[0], away[2])
    _, weights = residual(estimate.length_scale)
    assert estimate.mean_velocity == pytest.approx(rms_mean_velocity(weights), rel=1e-9)
    whole = ESTIMATOR.estimate(flight).uncertainty
    assert estimate.uncertainty.mean_velocity > whole.mean_velocity  # of fewer samples, in effect


def test_the_window_follows_a_mean_velocity_that_drifts():
    swelling = sf.ShapedCells(6.0, 4.21, swell=0.2, swell_period=40.0)
    flight = sf.simulate_flight(swelling, VEHICLE, duration=40.0, sample_rate=25.0, seed=3)
    online, read, true = online_of(window=6.0), [], []
    for start in range(0, 1000, 125):
        estimate = fed(online, flight, start, start + 125).estimate()
        if online.samples > 150:
            middle = flight.time[start + 124] - 3.0
            read.append(estimate.mean_velocity)
            true.append(6.0 * (1 + 0.2 * np.sin(2 * np.pi * middle / 40.0)))
    whole = ESTIMATOR.estimate(flight).mean_velocity
    online_error, batch_error = (
        np.sqrt(np.mean((np.array(values) - true) ** 2)) for values in (read, [whole] * len(read))
    )
    assert online_error < 0.25 * batch_error


def test_unidentifiable_until_there_is_enough_flight():
    online = online_of()
    assert online.estimate().doubt is Doubt.FEW_SAMPLES
    seen = []
    for start in range(0, 400, 20):
        seen.append(fed(online, FLIGHT, start, start + 20).estimate())
    assert seen[0].status == "unidentifiable"
    assert "samples are too few" in seen[0].reason
    told = [one for one in seen if one.status == "ok"]
    assert 3 < len(told) < 18
    assert told == seen[-len(told) :]  # once there is enough, there is
    widths = [float(np.ptp(one.uncertainty.mean_velocity_interval)) for one in told]
    assert widths[-1] < 0.6 * widths[0]
    for one in told:
        assert one.length_scale == pytest.approx(FLOW.length_scale, rel=0.03)


@pytest.mark.parametrize(
    ("sample", "words"),
    [
        ((np.nan, (0, 0), (0, 0)), "time must be a finite number"),
        ((9.0, (np.nan, 0), (0, 0)), r"position\[0\] must be a finite number"),
        ((9.0, (0, 0, 0), (0, 0)), "position must be two numbers"),
        ((9.0, (0, 0), (0, np.inf)), r"velocity\[1\] must be a finite number"),
        ((9.0, (0, 0), "ab"), "velocity must be two numbers"),
        ((4.0, (0, 0), (0, 0)), "time must increase strictly: 4.0 follows 8.0"),
        ((8.0, (0, 0), (0, 0)), "time must increase strictly: 8.0 follows 8.0"),
        ((8.0 + 1e-10, (0, 0), (0, 0)), "give time in seconds"),
        ((8.01, (0, 0), (0, 0)), "savgol needs uniform time steps"),
        ((8.04, (1e70, 0), (0, 0)), "change the unit"),
    ],
)
def test_a_bad_sample_is_refused_in_a_line_and_changes_nothing(sample, words):
    online = fed(online_of(), FLIGHT, 0, 201)  # to 8 s
    before = online.estimate()
    with pytest.raises(sf.InputError, match=words) as refusal:
        online.update(*sample)
    assert "\n" not in str(refusal.value)
    assert (online.samples, online.restarts) == (201, 0)
    after = online.estimate()
    assert (after.length_scale, after.mean_velocity) == (before.length_scale, before.mean_velocity)


def test_a_gap_begins_a_new_window_and_so_does_a_restart():
    online = fed(online_of(), FLIGHT, 0, 300)
    fed(online, FLIGHT, 304, 400)
    assert (online.restarts, online.samples) == (1, 96)
    assert online.flight.time[0] == FLIGHT.time[304]
    assert online.lag == pytest.approx(3 * 0.04)
    online.restart()
    assert (online.restarts, online.samples) == (1, 0)
    fed(online, FLIGHT, 0, 100)
    assert online.samples == 100


def test_a_rehearsal_leaves_nothing_behind():
    online = online_of()
    online.rehearse()
    assert (online.samples, online.restarts) == (0, 0)
    assert_same(fed(online, FLIGHT, 0, 300).estimate(), fed(online_of(), FLIGHT, 0, 300).estimate())


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"derivative": "auto"}, "savgol, central, midpoint or forward"),
        ({"derivative": sf.Derivative("weak")}, "tunes itself to a whole flight"),
        ({"derivative": sf.Derivative("central")}, "repair=False"),
        ({"library": sf.Library(unknown=("wind",))}, "unknown"),
        ({"library": sf.Library(family="waves")}, "family 'waves'"),
        ({"library": sf.Library(grid=sf.LengthScaleGrid(spacing="flight"))}, "'flight'"),
        ({"library": replace(LIBRARY, every=2)}, "every 2"),
    ],
)
def test_an_estimator_that_cannot_follow_is_refused_by_what_stands_in_the_way(changed, words):
    with pytest.raises(sf.InputError, match=words):
        online_of(replace(ESTIMATOR, **changed))


def test_one_of_window_and_memory_is_given():
    for wrong in ({}, {"window": 1.0, "memory": 1.0}):
        with pytest.raises(sf.InputError, match="one of the two"):
            sf.OnlineEstimator(ESTIMATOR, vehicle=VEHICLE, **wrong)
    with pytest.raises(sf.InputError, match="window must be a finite number above 0"):
        online_of(window=-1.0)


def test_a_flight_that_stands_still_or_keeps_to_an_axis_is_told_so():
    still, along = online_of(), online_of()
    for moment in np.arange(100) * 0.04:
        still.update(moment, (1.0, 2.0), (0.0, 0.0))
        along.update(moment, (moment, 0.0), (1.0, 0.0))
    for online, words in ((still, "does not move"), (along, "line y = 0")):
        estimate = online.estimate()
        assert (estimate.status, estimate.doubt) == ("unidentifiable", Doubt.SHORT_TRACK)
        assert words in estimate.reason


def circling(count, step=0.02):
    """Samples of a vehicle on a curve that never closes, at 50 Hz, one after another."""
    for i in range(count):
        t = i * step
        x, y = 40 * np.sin(0.31 * t) + 3 * np.sin(1.7 * t), 40 * np.cos(0.23 * t)
        vx = 12.4 * np.cos(0.31 * t) + 5.1 * np.cos(1.7 * t)
        yield t, (x, y), (vx, -9.2 * np.sin(0.23 * t))


def assert_long_flight_is_followed(count):
    """Against sums of the rows of the last window, and the batch answer, with the stated bound."""
    online, rows = online_of(window=4.0), 195
    bound = 3 * (rows / BLOCK + 3) * (rows + BLOCK**2) * np.finfo(float).eps
    for number, sample in enumerate(circling(count), 1):
        online.update(*sample)
        if number in (count // 2, count):
            problem = online.prepared().problem
            rms = problem.statistics.rms
            summed = problem.statistics.gram * np.outer(rms, rms) * rows
            assert np.abs(summed - problem.theta.T @ problem.theta).max() < bound
            assert_same(online.estimate(scan=True), ESTIMATOR.estimate(online.flight), 1e-9)
        if number == 2000:
            taken = online.nbytes
    assert online.nbytes == taken
    assert online.samples == 201


def test_sums_and_memory_are_bounded_however_long_the_flight():
    assert_long_flight_is_followed(3_000)


@pytest.mark.slow
def test_sums_and_memory_are_bounded_over_a_million_samples():
    assert_long_flight_is_followed(1_000_000)
