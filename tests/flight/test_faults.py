"""Faults of a log: each has the size it is said to have, and none touches what it is not of."""

import math

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle

VEHICLE = PointMassVehicle(0.5)
TIME = np.arange(4000) * 0.05
LINE = Flight(
    time=TIME, position=np.outer(TIME, [1.0, 2.0]), velocity=np.ones((4000, 2)), vehicle=VEHICLE
)
SEED = np.random.SeedSequence(5)


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
    np.testing.assert_array_equal(log.position, LINE.position)
    np.testing.assert_array_equal(log.time, LINE.time)


def test_jumps_stay():
    log = LogFaults(jumps=3, jump_size=2.0).spoil(LINE, SEED)
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
    even = simulate_flight(flow, VEHICLE, **options)
    uneven = simulate_flight(flow, VEHICLE, **options, time_jitter=0.3)
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
    with pytest.raises(InputError, match="at least 3 samples"):
        LogFaults(gaps=2000, gap_duration=200.0).spoil(LINE, SEED)
    with pytest.raises(InputError, match="time_jitter must be a number in"):
        simulate_flight(None, VEHICLE, duration=1.0, sample_rate=10.0, seed=0, time_jitter=0.5)
