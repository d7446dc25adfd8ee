"""The standard error of a flow of waves anywhere: derivatives, coverage, where there is none."""

import math
from functools import cache

import numpy as np
import pytest

import sparsefit as sf

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
BELIEVED = sf.PointMassVehicle(0.53, (5.0, 3.0))
FLOW = sf.ShapedCells(11.0, 4.2, heading=0.4, offset=(1.0, 0.5), drift=(0.4, -0.3))


@cache
def flown(flow=FLOW, seed=0, noise=0.2, vehicle=VEHICLE):
    flight = sf.simulate_flight(
        flow, VEHICLE, duration=12.0, sample_rate=50.0, seed=seed,
        velocity_noise=noise, position_noise=0.25 * noise,
    )  # fmt: skip
    return sf.Flight(flight.time, flight.position, flight.velocity, vehicle)


@pytest.mark.parametrize("unknown", [(), ("response_time",), ("wind",)])
def test_slopes_are_the_differences_of_the_flow(unknown):
    windy = sf.SuperposedFlow((FLOW,), (1.0, -0.5)) if unknown == ("wind",) else FLOW
    vehicle = BELIEVED if unknown == ("response_time",) else VEHICLE
    found = sf.Estimator(library=sf.Library(unknown=unknown)).estimate(
        flown(windy, vehicle=vehicle)
    )
    sure, rng = found.flow_uncertainty, np.random.default_rng(1)
    assert found.shape == "square"
    assert len(sure.covariance) == 8 + {(): 0, ("response_time",): 1, ("wind",): 2}[unknown]
    place = np.column_stack([rng.uniform(-5.0, 5.0, (7, 2)), rng.uniform(0.0, 9.0, 7)])

    def velocity(theta):
        """Of the fitted waves, their weights over 1 - b_v, and the wind."""
        parameters, weights, rest = np.split(theta, [4, 8])
        columns = sure.family.values(place, parameters[None])[0]
        ratio = 1.0 - rest[0] if sure.shared else 1.0
        wind = rest[-2:] if sure.windy else np.array(sure.wind)
        return ((weights @ columns).reshape(2, -1) + wind[:, None]) / ratio

    free = [0.0] * sure.shared + [*sure.wind] * sure.windy
    theta = np.concatenate([sure.parameters.ravel(), sure.weights.ravel(), free])
    at = place + sure.origin
    np.testing.assert_allclose(velocity(theta).T, found.flow.velocity(*at.T), atol=1e-9)
    steps = 1e-6 * np.eye(len(theta))
    slopes = np.array([(velocity(theta + e) - velocity(theta - e)) / 2e-6 for e in steps])
    variance = np.einsum("idm,ij,jdm->md", slopes, sure.covariance, slopes)
    np.testing.assert_allclose(sure.standard_error(*at.T), np.sqrt(variance), rtol=1e-5)


def test_errors_of_the_flow_are_as_large_as_is_said():
    ratios, steady = [], sf.ShapedCells(11.0, 4.2, heading=0.4)
    for seed in range(10):
        flight = flown(steady, seed=seed)
        found = sf.Estimator().estimate(flight)
        rows = np.arange(10, 600, 45)
        place = (*(flight.position[rows] + 1.0).T, flight.time[rows])
        off = found.flow.velocity(*place) - steady.velocity(*place)
        ratios.append(off / found.flow_uncertainty.standard_error(*place))
    assert 0.75 < math.sqrt(np.mean(np.square(ratios))) < 1.25
    assert np.mean(np.abs(ratios) < 1.96) > 0.9


def test_far_from_the_flight_the_flow_is_less_sure_and_shapes_broadcast():
    sure = sf.Estimator().estimate(flown()).flow_uncertainty
    x, y = np.linspace(0.0, 500.0, 4)[:, None], np.zeros(3)
    errors = sure.standard_error(sure.origin[0] + x, sure.origin[1] + y, sure.origin[2])
    assert errors.shape == (4, 3, 2)
    assert np.linalg.norm(errors[3]) > 5 * np.linalg.norm(errors[0])


def test_of_too_many_numbers_it_is_not_told(monkeypatch):
    monkeypatch.setattr("sparsefit.uncertainty.flow.MOST", 1000)
    found = sf.Estimator().estimate(flown(sf.CellularFlow(11.0, 4.2)))
    assert found.flow_uncertainty is None
    assert found.uncertainty.mean_velocity > 0


def test_flows_of_free_candidates_have_none_and_json_leaves_it_out():
    readout = sf.Readout(refine="variable-projection")
    found = sf.Estimator(readout=readout).estimate(flown(sf.CellularFlow(11.0, 4.2)))
    assert found.flow_uncertainty is None
    assert "flow_uncertainty" not in sf.Estimator().estimate(flown()).to_dict()
