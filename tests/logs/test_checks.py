"""What a log is like, and logs that are refused by name before anything is made of them."""

from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.logs.checks import LogQuality, check_log
from tests.problems import VEHICLE, fly

FLOW = sf.CellularFlow(15.43, 4.21)


@pytest.fixture(scope="module")
def flight():
    return fly(FLOW, seed=7, noise=(0.2, 0.05))


def refused(flight, **options):
    with pytest.raises(sf.InputError) as caught:
        check_log(flight, **options)
    return str(caught.value)


@pytest.mark.parametrize("rate", [100.0, 10.0, 6.0])
@pytest.mark.parametrize("noise", [(0.0, 0.0), (0.5, 0.2)])
def test_flights_are_not_refused(rate, noise):
    for seed in range(4):
        check_log(fly(FLOW, seed=seed, rate=rate, noise=noise), smallest=1.0)


def test_a_gap_of_ten_minutes(flight):
    time = flight.time + 600.0 * (np.arange(flight.samples) > 300)
    late = replace(flight, time=time)
    assert refused(late).startswith("a gap of 600 s after t=3 s (row 300)")
    check_log(late, longest_gap=601.0)  # as the message says
    assert "longest gap of 601 s" in refused(late)


def test_longer_steps_are_no_gap_and_a_jump_of_the_receiver_is_left_to_the_repairs(flight):
    time = 900.0 * np.arange(40.0)
    position = 300.0 * np.column_stack([np.sin(time / 9e3), time / 9e3])
    check_log(sf.Flight.from_positions(time, position, VEHICLE))
    position = flight.position + 300.0 * (np.arange(flight.samples) > 500)[:, None]
    check_log(replace(flight, position=position))


def test_a_vehicle_that_stands_still(flight):
    assert "it stays within 0 m in 10 s" in refused(replace(flight, position=0 * flight.position))
    still = replace(flight, velocity=0 * flight.velocity)
    assert "the velocity is zero throughout" in refused(still)
    near = replace(flight, position=0.01 * flight.position, velocity=0.01 * flight.velocity)
    check_log(near)
    assert "stands still: it stays within 0.433 m in 10 s" in refused(near, smallest=1.0)
    brief = replace(near, time=0.1 * near.time, velocity=10 * near.velocity)
    check_log(brief, smallest=1.0)  # moves, and is only short


def test_samples_too_far_apart_for_what_is_sought(flight):
    check_log(flight, largest=12.0)
    far = replace(flight, position=1e3 * flight.position, velocity=1e3 * flight.velocity)
    assert "m apart, and the largest length scale sought is 12 m" in refused(far, largest=12.0)


@pytest.mark.parametrize("count", [2, 3])
def test_rows_of_vehicles_that_take_turns(flight, count):
    shift = np.array([[300.0, 0.0], [0.0, 0.0], [0.0, 250.0]])
    position = flight.position + shift[np.arange(flight.samples) % count]
    assert f"take turns between {count} tracks" in refused(replace(flight, position=position))


def test_quality_counts_what_is_there(flight):
    rows = np.r_[0:400, 450:1001]
    rng = np.random.default_rng(3)
    time = flight.time[rows] + 0.001 * rng.standard_normal(len(rows))
    cut = replace(flight, time=time, position=flight.position[rows],
                  velocity=flight.velocity[rows], frame="NED")  # fmt: skip
    quality = LogQuality(cut)
    assert quality.rate == pytest.approx(100.0, rel=0.01)
    assert quality.jitter == pytest.approx(np.sqrt(2) * 0.1, rel=0.1)  # of two times, of 10 ms
    assert (quality.gaps, quality.longest_gap) == (1, pytest.approx(0.51, abs=0.01))
    assert quality.extent == np.ptp(cut.position, axis=0).tolist()
    assert quality.frame == "NED"
    words = "100.1 Hz, jitter 14 %; 1 gap of up to 0.509 s; 39.6 × 43.3 m at 8.03 m/s rms"
    assert words in quality.words


def test_quality_of_a_slow_log_and_of_noise(flight):
    time = 900.0 * np.arange(5.0)
    slow = sf.Flight.from_positions(time, 2e4 * np.outer(time / 900, [1.0, 2.0]), VEHICLE)
    expected = "every 900 s, even steps; no gaps; 80 × 160 km at 49.7 m/s rms; noise not known"
    assert LogQuality(slow).words == expected
    quality = LogQuality(flight, sf.Derivative()(flight).smoothing)
    assert quality.velocity_noise == pytest.approx(0.2, rel=0.1)
    assert quality.position_noise == pytest.approx(0.05, rel=0.1)
    assert quality.words.endswith("; noise 0.19 m/s and 0.05 m")
