"""The record of a flight, the faults of its log, and bad fields of every record of the room."""

import dataclasses
import math

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import CellularFlow, ShapedCells, SuperposedFlow
from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries
from sparsefit.flight.waves import Turbulence, WaveFlow
from tests.problems import FIELDS, PLANE, TIME, VEHICLE, flight_with

GLIDER = PointMassVehicle(0.5)
CLOCK = np.arange(4000) * 0.05
LINE = Flight(
    time=CLOCK, position=np.outer(CLOCK, [1.0, 2.0]), velocity=np.ones((4000, 2)), vehicle=GLIDER
)
SEED = np.random.SeedSequence(5)


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
    waves = np.ones(2)
    flow = WaveFlow([[1.0, 0.5], [0.2, 1.0]], waves, waves)
    waves[0] = 5.0
    assert flow.cosine[0] == 1.0
    with pytest.raises(ValueError, match="read-only"):
        flow.sine[0] = 2.0


def test_some_rows_are_a_flight():
    flight = flight_with(thrust=PLANE, frame="NED")
    part = flight.rows(TIME > 0.05)
    np.testing.assert_array_equal(part.time, TIME[1:])
    np.testing.assert_array_equal(part.thrust, PLANE[1:])
    assert (part.frame, part.velocity_measured) == ("NED", True)
    assert not Flight.from_positions(TIME, PLANE, VEHICLE).rows(TIME > 0.05).velocity_measured
    with pytest.raises(InputError, match=r"at least 3 samples: 2 of the 4 from t=0 to 0\.3 s"):
        flight.rows(TIME > 0.15)


BACKWARDS = r"row 2 \(t=0\.1\) follows t=0\.2; sort or drop rows, or split the log where another"
BAD = (0.0, -1.0, math.nan, math.inf, "3", None, True)
GOOD = {
    Flight: FIELDS,
    PointMassVehicle: {"response_time": 0.5},
    ThrustSeries: {"time": TIME, "acceleration": PLANE},
    LogFaults: {},
    ShapedCells: {"mean_velocity": 6.0, "length_scales": (4.0, 4.0)},
    WaveFlow: {"wavevectors": [[1.0, 0.0]], "cosine": [1.0], "sine": [1.0]},
    Turbulence: {"intensity": 1.0, "length": 5.0},
    SuperposedFlow: {"components": (CellularFlow(6.0, 4.0),)},
    CellularFlow: {"mean_velocity": 1.0, "length_scale": 1.0},
}


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        *((Flight, changes, message) for changes, message in [
            ({"velocity": None}, "a log of positions only is sf.Flight.from_positions"),
            ({"time": TIME[[0, 2, 1, 3]]}, rf"^time runs backwards: {BACKWARDS} begins$"),
            ({"time": TIME[[0, 1, 1, 2]]}, r"stands still: row 2 \(t=0\.1\) follows t=0\.1"),
            ({"time": [0.0, 0.1, 0.2, math.nan]}, "time must be finite: row 3 is nan"),
            ({"velocity": [[0, 1], [2, 3], [4, math.nan], [6, 7]]}, "finite: row 2, y is nan"),
            ({"velocity": np.where(PLANE == 5, math.inf, PLANE)}, "velocity .* finite: row 2, y"),
            ({"time": TIME[:, None]}, r"time must have shape \(m,\); got \(4, 1\)"),
            ({"position": PLANE.T}, r"position must have shape \(m, 2\); got \(2, 4\)"),
            ({"velocity": np.zeros((5, 2))}, "got 4 of time, 4 of position, 5 of velocity"),
            ({"time": ["a", "b", "c", "d"]}, "time must be an array of real numbers"),
            ({"position": PLANE * 1j}, "position must be an array of real numbers"),
            ({"position": [[1.0], [1.0, 2.0]]}, "position must be an array of numbers; its rows"),
            ({"time": np.ma.masked_greater(TIME, 0.2)}, "masked"),
            ({"time": TIME.astype("M8[s]")}, "time must be an array of real numbers"),
            ({"thrust": np.zeros((5, 2))}, "5 of thrust"),
            ({"vehicle": None}, "vehicle must be a PointMassVehicle"),
            ({"flow": 3.0}, "flow must be one of CellularFlow, "),
            ({"time": TIME[:2], "position": PLANE[:2], "velocity": PLANE[:2]}, "3 samples; got 2"),
            ({"position": PLANE * 1e100}, "position is .* in row 0: no flight"),
            ({"vehicle": PointMassVehicle(1e-30)}, "is no vehicle that flies; change the units"),
            ({"vehicle": PointMassVehicle(0.5, (0.0, -1e30))}, "is no vehicle that flies"),
            ({"time": TIME * 1e-320}, r"samples .* s apart are no flight; give time in seconds"),
        ]),
        *((PointMassVehicle, changes, message) for changes, message in [
            ({"response_time": math.inf}, "response_time"),
            ({"response_time": 0.0}, "response_time"),
            ({"thrust_acceleration": (1.0,)}, "thrust_acceleration must be two numbers"),
            ({"drag": -0.1}, "drag"),
            ({"thrust_scale": math.nan}, "thrust_scale"),
        ]),
        (ThrustSeries, {"time": TIME[[0, 1, 1, 2]]}, "increasing strictly"),
        (ThrustSeries, {"time": TIME[:1], "acceleration": PLANE[:1]}, "two times or more"),
        *((LogFaults, changes, message) for changes, message in [
            ({"wander": -1.0}, "wander must be"),
            ({"wander_time": 0.0}, "wander_time must be"),
            ({"outliers": 1.5}, "outliers must be a number in"),
            ({"jumps": 1.5}, "jumps must be an integer"),
            ({"gaps": -1}, "gaps must be an integer"),
            ({"lost_samples": 1.5}, "lost_samples must be a number in"),
        ]),
        (ShapedCells, {"length_scales": (4.0, 0.0)}, "length_scales must be a finite number above"),
        (ShapedCells, {"length_scales": "wide"}, "length_scales must be two numbers"),
        (ShapedCells, {"angle": math.pi}, "angle must lie between 0 and pi"),
        (ShapedCells, {"drift": 1.0}, "drift must be two numbers"),
        (ShapedCells, {"swell": 1.0}, "swell is a share of mean_velocity, below 1"),
        (ShapedCells, {"swell_period": 0.0}, "swell_period must be"),
        (WaveFlow, {"wavevectors": [[0.0, 0.0]]}, "no wavevector may be"),
        (WaveFlow, {"wavevectors": []}, "shape"),
        (WaveFlow, {"cosine": [1.0, 2.0]}, r"cosine must have shape \(1,\); got \(2,\)"),
        (WaveFlow, {"sine": [math.inf]}, "sine must be finite: row 0 is inf"),
        (Turbulence, {"intensity": 0.0}, r"intensity .* \[m/s\]"),
        (Turbulence, {"length": -1.0}, r"length .* \[m\]"),
        (Turbulence, {"spectrum": "dreyden"}, 'did you mean "dryden"'),
        (Turbulence, {"seed": -1}, "seed must be an integer"),
        *((SuperposedFlow, {"components": bad}, "components must be a tuple of flows")
          for bad in ((), CellularFlow(1.0, 1.0), (CellularFlow(1.0, 1.0), 3.0), None)),
        *((CellularFlow, {"mean_velocity": bad}, r"mean_velocity .* \[m/s\]") for bad in BAD),
        *((CellularFlow, {"length_scale": bad}, r"length_scale .* \[m\]") for bad in BAD),
    ],
)  # fmt: skip
def test_bad_fields_are_named(kind, changes, message):
    with pytest.raises(InputError, match=message):
        kind(**(GOOD[kind] | changes))


def test_wander_is_stationary_and_forgets_in_its_time():
    logs = [LogFaults(wander=0.2, wander_time=2.0).spoil(LINE, np.random.SeedSequence(s))
            for s in range(20)]  # fmt: skip
    error = np.stack([log.position - LINE.position for log in logs])
    assert error.std() == pytest.approx(0.2, rel=0.05)
    assert error[:, :40].std() == pytest.approx(0.2, rel=0.25)
    later = np.mean(error[:, 40:] * error[:, :-40]) / 0.04  # 40 samples: 2 s
    assert later == pytest.approx(math.exp(-1.0), abs=0.06)
    np.testing.assert_array_equal(logs[0].velocity, LINE.velocity)


def test_outliers_are_as_many_and_as_large_as_said():
    log = LogFaults(outliers=0.05, outlier_size=5.0).spoil(LINE, SEED)
    off = np.hypot(*(log.velocity - LINE.velocity).T)
    assert np.mean(off > 0) == pytest.approx(0.05, abs=0.01)
    np.testing.assert_allclose(off[off > 0], 5.0, rtol=1e-12)
    assert np.abs(np.mean((log.velocity - LINE.velocity)[off > 0], axis=0)).max() < 0.6  # all ways
    np.testing.assert_array_equal(log.position, LINE.position)
    np.testing.assert_array_equal(log.time, LINE.time)


def test_jumps_stay():
    log = LogFaults(jumps=3, jump_size=2.0).spoil(LINE, 5)  # as `SEED`
    steps = np.hypot(*np.diff(log.position - LINE.position, axis=0).T)
    np.testing.assert_allclose(steps[steps > 1e-9], 2.0, rtol=1e-9)
    assert np.sum(steps > 1e-9) == 3


def test_gaps_drop_samples_and_keep_both_ends():
    log = LogFaults(gaps=5, gap_duration=1.5).spoil(LINE, SEED)
    steps = np.diff(log.time)
    assert 1 <= np.sum(steps > 0.06) <= 5
    assert steps.max() <= 5 * 1.6
    assert log.time[0] == LINE.time[0]
    assert log.samples < LINE.samples
    kept = np.isin(LINE.time, log.time)
    np.testing.assert_array_equal(log.position, LINE.position[kept])


def test_lost_samples_are_the_share_that_is_said():
    log = LogFaults(lost_samples=0.3).spoil(LINE, SEED)
    assert 1 - log.samples / LINE.samples == pytest.approx(0.3, abs=0.03)
    assert log.duration == LINE.duration
    rows = np.flatnonzero(np.isin(LINE.time, log.time))
    np.testing.assert_array_equal(log.velocity, LINE.velocity[rows])
    assert np.mean(np.diff(rows) > 1) == pytest.approx(0.3, abs=0.03)  # each by itself


def test_a_fault_more_moves_no_other():
    plain = LogFaults(outliers=0.05).spoil(LINE, SEED)
    more = LogFaults(outliers=0.05, wander=0.1, jumps=2).spoil(LINE, SEED)
    np.testing.assert_array_equal(plain.velocity, more.velocity)
    larger = LogFaults(outliers=0.1).spoil(LINE, SEED)
    hit = (plain.velocity != 1.0).any(axis=1)
    np.testing.assert_array_equal(larger.velocity[hit], plain.velocity[hit])


def test_time_jitter_takes_true_samples_early_or_late():
    flow, options = CellularFlow(6.0, 4.0), {"duration": 2.0, "sample_rate": 50.0, "seed": 3}
    even = simulate_flight(flow, GLIDER, **options)
    uneven = simulate_flight(flow, GLIDER, **options, time_jitter=0.3)
    shift = uneven.time - even.time
    assert shift[0] == 0.0
    assert np.abs(shift).max() <= 0.3 * 0.02
    assert shift.std() == pytest.approx(0.3 * 0.02 / math.sqrt(3), rel=0.2)
    # to second order, position moves with the velocity
    moved = even.position + shift[:, None] * even.velocity
    np.testing.assert_allclose(uneven.position, moved, atol=0.5 * 0.006**2 * 40)


def test_kicks_keep_their_power_where_times_jitter():
    still = {"duration": 40.0, "sample_rate": 50.0, "seed": 3, "process_noise": 1.0, "substeps": 1}
    slow = PointMassVehicle(1e9)  # its velocity is the sum of its kicks
    even, uneven = (simulate_flight(None, slow, **still, time_jitter=j) for j in (0.0, 0.4))
    for flight in (even, uneven):
        kicks = np.diff(flight.velocity, axis=0) / np.sqrt(np.diff(flight.time) * 0.02)[:, None]
        assert kicks.std() == pytest.approx(1.0, rel=0.05)


def test_faults_that_leave_no_flight_are_refused():
    with pytest.raises(InputError, match="at least 3 samples: 2 of the 4000"):
        LogFaults(gaps=2000, gap_duration=200.0).spoil(LINE, SEED)
    with pytest.raises(InputError, match="time_jitter must be a number in"):
        simulate_flight(None, GLIDER, duration=1.0, sample_rate=10.0, seed=0, time_jitter=0.5)
