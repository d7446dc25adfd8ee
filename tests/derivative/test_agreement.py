"""Position against the integral of velocity: noise, errors with a memory, other units."""

from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative.agreement import agreement_of

FLOW, VEHICLE = sf.CellularFlow(8.0, 4.0), sf.PointMassVehicle(0.5, (5.0, 3.0))


@pytest.fixture(scope="module")
def flight():
    return sf.simulate_flight(
        FLOW,
        VEHICLE,
        duration=20.0,
        sample_rate=100.0,
        seed=3,
        velocity_noise=0.2,
        position_noise=0.05,
    )


def wandering(flight, level, time, seed):
    """The flight with first-order autoregressive errors of the position."""
    memory, rng = np.exp(-0.01 / time), np.random.default_rng(seed)
    kicks = level * np.sqrt(1 - memory**2) * rng.standard_normal((flight.samples, 2))
    error = [level * rng.standard_normal(2)]
    for kick in kicks[1:]:
        error.append(memory * error[-1] + kick)
    return replace(flight, position=flight.position + error)


def test_white_noise_agrees_in_all_but_few():
    rng, step = np.random.default_rng(8), 0.01
    excess = []
    for _ in range(400):
        position = 0.05 * rng.standard_normal((1001, 2))
        left = np.diff(position, axis=0) - step * 0.2 * rng.standard_normal((1000, 2))
        found = agreement_of(left, np.ones_like(left), step, 0.05, 0.2)
        assert not found.sure
        excess.append(found.excess)
    assert np.mean(excess) == pytest.approx(1.0, abs=0.06)


def test_a_simulated_flight_agrees_and_a_wandering_one_tells_size_and_time(flight):
    assert not sf.Derivative()(flight).agreement.wanders
    found = [sf.Derivative()(wandering(flight, 0.3, 2.0, seed)).agreement for seed in range(6)]
    assert all(agreement.wanders and not agreement.broken for agreement in found)
    assert np.median([agreement.wander for agreement in found]) == pytest.approx(0.3, rel=0.3)
    assert 0.8 < np.median([agreement.wander_time for agreement in found]) < 5.0


@pytest.mark.parametrize(
    "spoil",
    [lambda v: 3.6 * v, lambda v: v[:, ::-1], lambda v: np.roll(v, 60, axis=0)],
    ids=["km/h", "axes", "late"],
)
def test_velocities_of_another_motion_are_doubted_by_name(flight, spoil):
    estimate = sf.Estimator().estimate(replace(flight, velocity=spoil(flight.velocity)))
    assert (estimate.status, str(estimate.doubt)) == ("unidentifiable", "disagreement")
    assert "check units, axes and time stamps" in estimate.reason


@pytest.mark.parametrize("seed", range(4))
def test_velocities_that_are_noise_throughout_leave_what_the_positions_tell(flight, seed):
    noise = 15.0 * np.random.default_rng(seed).standard_normal(flight.velocity.shape)
    estimate = sf.Estimator().estimate(replace(flight, velocity=noise))
    if estimate.status == "ok":
        assert estimate.length_scale == pytest.approx(4.0, rel=1e-2)
        assert estimate.mean_velocity == pytest.approx(8.0, rel=5e-2)
    else:
        assert estimate.status == "unidentifiable"


def test_a_velocity_of_zeros_disagrees_by_no_absurd_figure(flight):
    still = replace(flight, velocity=np.zeros_like(flight.velocity))
    estimate = sf.Estimator().estimate(still)
    assert str(estimate.doubt) == "disagreement"
    assert "more than 10 times the motion apart" in estimate.reason
