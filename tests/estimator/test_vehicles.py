"""Vehicles beyond the paper's, estimated: quadratic drag, a measured thrust, unknowns of both."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.estimator.estimate import flight_fields
from sparsefit.flight.vehicle import turning
from sparsefit.likelihood import FlightLog, Model, StreamPattern
from tests.problems import VEHICLE, fly

FLOW = sf.CellularFlow(8.0, 4.0)
QUADRATIC = sf.PointMassVehicle(math.inf, (5.0, 3.0), 0.3)
LINEAR = sf.PointMassVehicle(0.5)
NOISE = {"noise": (0.1, 0.02)}
GRID = sf.model.LengthScaleGrid(2.0, 7.0, step=0.5)
PLAIN = sf.Readout(refine="variable-projection")


@cache
def flown(vehicle, *, circling=False, **noise):
    thrust = turning(
        np.arange(15 * 50 + 2) / 50, constant=(5.0, 3.0), size=6.0, period=4.0, phase=0.0
    )
    thrust = thrust if circling else None
    return fly(FLOW, vehicle, duration=15.0, rate=50.0, seed=5, thrust=thrust, **noise)


def estimated(flight, *unknown, derivative="auto"):
    library = sf.Library(grid=GRID, unknown=unknown)
    return sf.Estimator(
        derivative=derivative, library=library, backend="best-scale", readout=PLAIN
    ).estimate(flight)


def test_quadratic_drag_without_noise():
    flight = flown(QUADRATIC)
    estimate = estimated(flight)
    assert estimate.status == "ok"
    assert estimate.mean_velocity == pytest.approx(8.0, rel=1e-3)
    assert estimate.length_scale == pytest.approx(4.0, rel=1e-4)
    both = sf.PointMassVehicle(1.0, (5.0, 3.0), 0.3)
    assert estimated(flown(both)).mean_velocity == pytest.approx(8.0, rel=1e-4)


@pytest.mark.parametrize("believed", [0.1, 0.3, 2.0])
def test_drag_that_is_sought_does_not_depend_on_what_is_believed(believed):
    flight = replace(flown(QUADRATIC, **NOISE), vehicle=replace(QUADRATIC, drag=believed))
    estimate = estimated(flight, "drag")
    assert estimate.status == "ok"
    low, high = estimate.vehicle_uncertainty.drag_interval
    assert low < 0.3 < high
    assert abs(estimate.mean_velocity - 8.0) < 3 * estimate.uncertainty.mean_velocity
    assert estimate.drag == pytest.approx(estimated(flown(QUADRATIC, **NOISE), "drag").drag)


def test_a_measured_thrust_and_its_own_unknowns():
    flight = flown(LINEAR, circling=True, thrust_noise=0.1, **NOISE)
    wrong = replace(flight, vehicle=sf.PointMassVehicle(2.0, (0.3, -0.2), thrust_scale=1.3))
    names = ("response_time", "thrust_scale", "thrust_acceleration")
    estimate = estimated(wrong, *names)
    assert estimate.status == "ok"
    true = {"response_time": 0.5, "thrust_scale": 1.0}
    for name, value in true.items():
        spread = getattr(estimate.vehicle_uncertainty, name)
        assert 0 < spread < 0.05
        assert abs(getattr(estimate, name) - value) < 4 * spread
    spreads = np.array(estimate.vehicle_uncertainty.thrust_acceleration)
    assert (np.abs(estimate.thrust_acceleration) < 4 * spreads).all()
    # The same flight whose thrust was not logged is no flight of this vehicle.
    assert estimated(replace(flight, thrust=None)).status != "ok"


def test_an_interval_holds_where_noise_of_the_thrust_is_weak_process_noise():
    flight = flown(LINEAR, circling=True, thrust_noise=0.1, **NOISE)
    other, right = replace(flight, vehicle=replace(LINEAR, thrust_scale=2.0)), estimated(flight)
    assert abs(right.mean_velocity - 8.0) < 4 * right.uncertainty.mean_velocity
    noises = [FlightLog.of_flight(own).thrust_noise for own in (flight, other)]
    assert noises == pytest.approx([0.1, 0.2], rel=0.1)


@pytest.mark.parametrize("period", [4.0, 8.0])
def test_noise_of_the_thrust_does_not_make_gusts_of_the_thrust_itself(period):
    """Where all else is exact, gusts of a slow walk would explain a log without its thrust."""
    flow = sf.CellularFlow(4.5, 4.25)
    thrust = turning(
        np.arange(20 * 50 + 2) / 50, constant=(5.0, 3.0), size=6.0, period=period, phase=1.0
    )
    settings = {"thrust": thrust, "thrust_noise": 0.2}
    flight = fly(flow, LINEAR, duration=20.0, rate=50.0, seed=8, **settings)
    wrong = replace(flight, vehicle=sf.PointMassVehicle(0.6, thrust_scale=1.2))
    estimate = estimated(wrong, "response_time", "thrust_scale", "thrust_acceleration")
    assert estimate.status == "ok"
    assert abs(estimate.mean_velocity - 4.5) < 3.0 * estimate.uncertainty.mean_velocity < 0.15
    assert abs(estimate.thrust_scale - 1.0) < 3.0 * estimate.vehicle_uncertainty.thrust_scale


def test_what_cannot_be_sought_is_refused():
    flight = flown(QUADRATIC)
    both = replace(flight, vehicle=sf.PointMassVehicle(0.5, drag=0.1))
    for name in ("response_time", "thrust_acceleration", "thrust_scale"):
        with pytest.raises(InputError, match=r"with quadratic drag, .* in drag and wind alone"):
            estimated(flight, name)
    for name in ("response_time", "drag"):
        with pytest.raises(InputError, match=r"linear and quadratic drag, whose .* in wind alone"):
            estimated(both, name)
    with pytest.raises(InputError, match="without quadratic drag, whose rows"):
        estimated(flown(LINEAR), "drag")
    with pytest.raises(InputError, match="needs a measured thrust"):
        estimated(flown(LINEAR), "thrust_scale")
    with pytest.raises(InputError, match="weak form"):
        estimated(flight, derivative="weak")


def test_the_wrong_law_of_drag_is_named():
    noisy = flown(QUADRATIC, **NOISE)
    linear = replace(noisy, vehicle=VEHICLE)
    assert "more quadratic" in estimated(linear, "response_time").reason
    other = replace(flown(VEHICLE, **NOISE), vehicle=QUADRATIC)
    assert estimated(other, "drag").status != "ok"
    cells, drag = sf.CellularFlow(15.0, 7.8), replace(QUADRATIC, drag=0.12)
    exact = replace(fly(cells, drag, duration=20.0, rate=50.0, seed=5), vehicle=VEHICLE)
    unknown = sf.Library(unknown=("response_time",))
    assert "more quadratic" in sf.Estimator(library=unknown).estimate(exact).reason


def test_a_vehicle_is_read_off_the_elements_of_its_flight():
    """The second of two: a constant thrust is in its log, a measured one in no element."""
    elements = {"thrust_bias_x": 0.1, "thrust_bias_y": -0.2, "quadratic_drag": 0.05, "growth": 0.01}
    pattern = StreamPattern("axis", (8.0, 4.0, 0.0, 0.0))
    model = Model(pattern, {"response_time": 0.5, **elements}).free(*elements)
    errors = {f"{name}@2": 0.1 * size for name, size in elements.items()} | {"growth": 0.002}
    for push, base in ((np.ones((4, 2)), (5.0, 3.0)), (np.outer(np.arange(4), [0, 1]), (0.0, 0.0))):
        leg = SimpleNamespace(model=model, push=push)
        found = flight_fields(SimpleNamespace(legs=(leg, leg), error=errors.get), 1, VEHICLE)
        assert found["thrust_acceleration"] == pytest.approx((base[0] + 0.1, base[1] - 0.2))
    assert (found["drag"], found["causes"]) == (pytest.approx(0.1), {"growth": 0.01})
    sure = found["vehicle_uncertainty"]
    assert (sure.drag, *sure.thrust_acceleration) == pytest.approx((0.01, 0.01, -0.02))
    assert sure.growth_interval == pytest.approx((0.01 - 0.00392, 0.01 + 0.00392), rel=1e-4)
    assert sure.response_time is None  # it was not sought


@pytest.mark.parametrize("free", [(), ("drag",)])
def test_turbulence_does_not_hide_the_wrong_law_of_drag_in_a_log_without_noise(free):
    cells, settings = sf.CellularFlow(15.0, 7.0), {"duration": 20.0, "rate": 25.0, "seed": 5}
    flight = replace(fly(cells, QUADRATIC, **settings), vehicle=VEHICLE)
    estimate = sf.Estimator(free=free).estimate(flight)
    assert estimate.status == ("unidentifiable" if free else "misfit"), estimate.reason
    assert free or "more quadratic" in estimate.reason
    air = sf.flows.SuperposedFlow((cells, sf.flows.Turbulence(0.5, 8.0, seed=1)))
    assert sf.Estimator().estimate(fly(air, **settings)).status == "ok"


STEADY = {"duration": 12.0, "rate": 50.0}
# Slow turbulence explains this log by 37,000 of log L, the response time by more.
GUSTY = {"duration": 20.0, "seed": 0, "initial_position": (2.13299589, 5.25816715)}


@pytest.mark.parametrize(
    ("ratio", "flow", "options"),
    [*((ratio, (12.0, 4.0), STEADY) for ratio in (1.05, 1.2)), (1.2, (4.826126, 2.899105), GUSTY)],
)
def test_a_wrong_vehicle_is_named_in_a_log_without_noise(ratio, flow, options):
    flight = fly(sf.CellularFlow(*flow), **options)
    believed = replace(VEHICLE, response_time=0.5 * ratio)
    estimate = sf.Estimator().estimate(replace(flight, vehicle=believed))
    assert (estimate.status, estimate.goodness.suspect.cause) == ("misfit", "response-time")
    assert sf.Estimator().estimate(flight).status == "ok"
