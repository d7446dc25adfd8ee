"""The default estimator as a user meets it: accurate, and plain about what it cannot tell."""

import dataclasses
from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.errors import InputError

VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
TIME = np.arange(600) * 0.01


@cache
def flown(length_scale=4.21, seed=7, **noise):
    flow = sf.CellularFlow(mean_velocity=15.43, length_scale=length_scale)
    return sf.simulate_flight(flow, VEHICLE, duration=10.0, sample_rate=100.0, seed=seed, **noise)


def moved(position, velocity):
    return sf.Flight(time=TIME, position=position, velocity=velocity, vehicle=VEHICLE)


@pytest.mark.parametrize("seed", range(3))
def test_without_noise_errors_are_below_a_millionth(seed):
    found = sf.Estimator().estimate(flown(seed=seed))
    assert found.status == "ok"
    assert found.length_scale == pytest.approx(4.21, rel=1e-6)
    assert found.mean_velocity == pytest.approx(15.43, rel=1e-6)
    assert found.timescale == pytest.approx(4.21 / 15.43, rel=1e-6)
    assert found.grid_length_scale == 4.2


def test_every_back_end_that_lands_anywhere_is_refined_to_the_same_scale():
    flight = flown(velocity_noise=0.1, position_noise=0.02)
    estimator = sf.Estimator()
    prepared = estimator.prepare(flight)
    found = []
    for name in ("stlsq", "lasso", "group-lasso", "best-scale"):
        one = dataclasses.replace(estimator, backend=name)
        found.append(one.read(prepared, one.fit(prepared)).length_scale)
    assert found == pytest.approx([found[0]] * len(found), rel=1e-9)
    assert found[0] == pytest.approx(4.21, rel=1e-3)


def test_uniform_wind_is_no_cellular_flow():
    drift = np.column_stack([10.0 * TIME, 5.0 * TIME + 1.0])
    found = sf.Estimator().estimate(moved(drift, np.tile([10.0, 5.0], (600, 1))))
    assert found.status == "unidentifiable"
    assert "no cellular flow" in found.reason


def test_still_air_is_no_cellular_flow():
    end = 0.5 * np.array([5.0, 3.0])  # the vehicle speeds up to tau a
    decay = np.exp(-TIME / 0.5)[:, None]
    path = end * (TIME[:, None] - 0.5 * (1 - decay)) + 1.0
    found = sf.Estimator().estimate(moved(path, end * (1 - decay)))
    assert found.status == "unidentifiable"
    assert "still" in found.reason


def test_a_flight_along_an_axis_is_refused_in_its_own_words():
    along = np.column_stack([TIME * 5, np.zeros(600)])
    with pytest.raises(InputError, match="stays on the line y = 0"):
        sf.Estimator().estimate(moved(along, np.tile([5.0, 0.0], (600, 1))))


def test_the_grid_for_a_flight_puts_candidates_in_every_lobe():
    flight = flown()
    grid = sf.model.LengthScaleGrid(2.0, 10.0, spacing="flight").resolving(flight.extent)
    steps = np.diff(np.sort(np.pi / grid.scales))
    assert grid.scales[[0, -1]] == pytest.approx([2.0, 10.0])
    assert steps.max() <= 0.25 * 2 * np.pi / flight.extent * (1 + 1e-12)
    assert np.ptp(steps) < 1e-9 * steps[0]
    with pytest.raises(InputError, match="fraction"):
        sf.model.LengthScaleGrid(spacing="flight", fraction=0.0)


def test_settings_that_share_a_factorisation_are_each_charged_for_it():
    problem = sf.Estimator().prepare(flown()).problem
    first = sf.fit(problem, backends.get("least-squares"))
    second = sf.fit(problem, backends.get("least-squares", rcond=0.01))
    assert second.seconds >= problem.spectrum.seconds
    assert first.seconds >= problem.spectrum.seconds


@pytest.mark.parametrize("level", [0.03, 0.3])
def test_process_noise_alone_is_no_misfit(level):
    """A position that process noise moves by micrometres a step has no noise of its own."""
    flow, vehicle = sf.CellularFlow(9.9, 4.79), sf.PointMassVehicle(0.5, (5.0, 3.0))
    flight = sf.simulate_flight(
        flow, vehicle, duration=20.0, sample_rate=100.0, seed=2, process_noise=level
    )
    assert sf.Estimator().estimate(flight).status == "ok"
