"""A measured thrust is taken out before a derivative, and put back after."""

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.derivative.carried import Carried
from sparsefit.derivative.repair import repaired, untouched
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle, turning

VEHICLE = PointMassVehicle(0.5, thrust_scale=1.2)
FLOW = sf.CellularFlow(8.0, 4.0)


@pytest.fixture(scope="module")
def circling():
    thrust = turning(6.0, 100.0, constant=(5.0, 3.0), size=9.0, period=3.0, phase=0.0)
    return sf.simulate_flight(FLOW, VEHICLE, duration=6.0, sample_rate=100.0, seed=2, thrust=thrust)


def test_the_path_of_a_ramp_by_hand():
    # s m = (2 t, 0) with s = 2: V = t^2, X = t^3/3.
    t = np.array([0.0, 0.5, 1.5, 2.0])
    still = np.zeros((4, 2))
    ramp = np.stack([t, 0 * t], axis=1)
    flight = Flight(t, still, still, PointMassVehicle(1.0, thrust_scale=2.0), thrust=ramp)
    carried = Carried.of(flight, untouched(flight))
    np.testing.assert_allclose(carried.velocity[:, 0], t**2, atol=1e-15)
    np.testing.assert_allclose(carried.position[:, 0], t**3 / 3, atol=1e-15)
    state, rate, measured = carried.restored(np.array([1.0]), np.zeros((1, 4)), np.zeros((1, 4)))
    np.testing.assert_allclose(state, [[1 / 3, 0, 1, 0]], atol=1e-15)
    np.testing.assert_allclose(rate, [[1, 0, 2, 0]], atol=1e-15)
    np.testing.assert_allclose(measured, [[1, 0]], atol=1e-15)


@pytest.mark.parametrize(
    ("rule", "error"),
    [("auto", 1e-8), ("savgol", 2e-5), ("central", 2e-2), ("midpoint", 2e-2), ("forward", 0.5)],
)
def test_no_rule_takes_anything_from_a_known_thrust(circling, rule, error):
    samples = Derivative(rule)(circling)
    phi = samples.flow_velocity(VEHICLE)
    assert np.abs(phi - FLOW.velocity(*samples.position.T)).max() < error


def test_pieces_of_a_log_start_anew(circling):
    kept = np.r_[0:200, 400:601]
    cut = Flight(
        circling.time[kept], circling.position[kept], circling.velocity[kept], VEHICLE,
        thrust=circling.thrust[kept],
    )  # fmt: skip
    log, _ = repaired(cut, even=True, shortest=21)
    carried = Carried.of(cut, log)
    assert not carried.velocity[log.starts].any()
    samples = Derivative()(cut)
    error = samples.flow_velocity(VEHICLE) - FLOW.velocity(*samples.position.T)
    assert np.abs(error).max() < 1e-7


def test_weak_averages_of_a_known_thrust_are_exact(circling):
    weak = Derivative("weak")(circling).weak
    flow = weak.operator @ FLOW.velocity(*weak.position.T)
    assert np.abs(weak.flow_velocity(VEHICLE) - flow).max() < 1e-6
