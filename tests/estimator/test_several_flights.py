"""Several flights through one flow: one answer, that of one flight for a list of one."""

import re
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from tests.problems import SMALL_GRID, VEHICLE, fly, part

FLOW = sf.CellularFlow(mean_velocity=15.43, length_scale=4.21)
REFINED = sf.Readout(refine="variable-projection")


@cache
def flown(seed, duration=6.0, rate=100.0, tau=0.5, noise=0.2):
    vehicle, noises = sf.PointMassVehicle(tau, (5.0, 3.0)), (noise, 0.1 * noise)
    return fly(FLOW, vehicle, duration=duration, rate=rate, seed=seed, noise=noises)


FLEET = (flown(1), flown(2, 5.0, 50.0, 0.3, 0.1), flown(3, 8.0, noise=1.0))


def told(estimate):
    return [getattr(estimate, item.name) for item in fields(estimate) if item.name != "seconds"]


@pytest.mark.parametrize("readout", [REFINED, sf.Readout()], ids=["refined", "ladder"])
def test_a_list_of_one_flight_is_that_flight(readout):
    estimator = sf.Estimator(readout=readout)
    alone, listed = estimator.estimate(FLEET[0]), estimator.estimate([FLEET[0]])
    assert listed.flights == ()
    for one, other in zip(told(alone), told(listed), strict=True):
        assert repr(one) == repr(other)


@pytest.mark.parametrize("readout", [REFINED, sf.Readout()], ids=["refined", "ladder"])
def test_several_flights_know_more_than_the_best_of_them_whatever_their_order(readout):
    estimator = sf.Estimator(readout=readout)
    both, turned = estimator.estimate(list(FLEET)), estimator.estimate(FLEET[::-1])
    alone = [estimator.estimate(flight).uncertainty for flight in FLEET]
    assert both.status == "ok"
    for name in ("mean_velocity", "length_scale"):
        known = getattr(both.uncertainty, name)
        assert known < min(getattr(one, name) for one in alone)
        assert abs(getattr(both, name) - getattr(FLOW, name)) < 4 * known
        assert getattr(turned, name) == pytest.approx(getattr(both, name), rel=1e-9)
        assert getattr(turned.uncertainty, name) == pytest.approx(known, rel=1e-6)
    noise = [flight.noise for flight in both.flights]
    assert noise[1] < noise[0] < noise[2]  # the quiet one counts for most
    assert [flight.noise for flight in turned.flights] == pytest.approx(noise[::-1])


def test_what_flights_share_is_as_sure_in_each():
    first, second, _ = sf.Estimator(free=("growth", "latency")).estimate(list(FLEET)).flights
    assert first.causes["growth"] == second.causes["growth"]
    sure = [own.vehicle_uncertainty for own in (first, second)]
    assert sure[0].growth == sure[1].growth > 0.0
    assert sure[0].latency != sure[1].latency


def test_a_loud_flight_through_turned_cells_costs_the_quiet_one_nothing():
    flow = sf.flows.ShapedCells(9.0, 3.5, heading=0.4)
    loud = fly(flow, duration=12.0, rate=50.0, seed=60, noise=(0.6, 0.06))
    quiet = fly(flow, duration=12.0, rate=50.0, seed=2, noise=(0.02, 0.002))
    alone, both = sf.Estimator().estimate(quiet), sf.Estimator().estimate([loud, quiet])
    # Weights by what one mode along the axes leaves, which is no noise, gave 16 times the interval.
    assert both.status == "ok"
    assert both.uncertainty.mean_velocity < 1.1 * alone.uncertainty.mean_velocity
    assert both.mean_velocity == pytest.approx(9.0, abs=4 * both.uncertainty.mean_velocity)
    assert both.flights[0].noise > 3 * both.flights[1].noise


def test_a_flight_in_two_halves_is_the_flight_where_nothing_is_noise():
    whole = flown(5, 8.0, noise=0.0)
    halves = [part(whole, rows) for rows in (slice(0, 401), slice(400, None))]
    both = sf.Estimator(readout=REFINED).estimate(halves)
    assert both.mean_velocity == pytest.approx(FLOW.mean_velocity, rel=1e-6)
    assert both.length_scale == pytest.approx(FLOW.length_scale, rel=1e-6)


def test_equal_flights_stack_to_the_sum_of_their_gram_matrices():
    estimator = sf.Estimator(readout=REFINED)
    again = replace(FLEET[0], position=FLEET[0].position + 1e-12)
    one, two = estimator.prepare(FLEET[0]), estimator.prepare([FLEET[0], again])
    assert two.weights == pytest.approx((1.0, 1.0))
    double, single = (own.problem.theta.T @ own.problem.theta for own in (two, one))
    np.testing.assert_allclose(double, 2 * single, rtol=1e-9, atol=1e-6)
    single, double = (estimator.read(own, estimator.fit(own)) for own in (one, two))
    assert double.mean_velocity == pytest.approx(single.mean_velocity, rel=1e-3)
    ratio = single.uncertainty.length_scale / double.uncertainty.length_scale
    assert ratio == pytest.approx(np.sqrt(2), rel=0.01)  # bias is no noise


def test_every_flight_has_a_wind_of_its_own():
    shifted = sf.PointMassVehicle(0.5, (5.0 - 2.0 / 0.5, 3.0))  # of which a wind of 2 m/s makes up
    pushed = replace(flown(7), vehicle=shifted)
    estimator = sf.Estimator(library=sf.Library(unknown=("wind",)), readout=REFINED)
    found = estimator.estimate([FLEET[0], pushed])
    assert found.wind is None
    for flight, wind in zip(found.flights, ((0.0, 0.0), (2.0, 0.0)), strict=True):
        np.testing.assert_allclose(flight.wind, wind, atol=0.1)
        assert max(flight.vehicle_uncertainty.wind) < 0.1


def test_exact_positions_of_one_flight_are_no_misfit():
    exact = fly(FLOW, duration=8.0, rate=50.0, seed=4, noise=(0.1, 0.0))
    noisy = fly(FLOW, duration=8.0, rate=50.0, seed=3, noise=(0.1, 0.02))
    assert sf.Estimator().estimate([noisy, exact]).status == "ok"


@pytest.mark.parametrize(
    ("flights", "words"),
    [
        ([], "an empty list"),
        ("a.csv", "a str"),
        ([FLEET[0], "a.csv"], "flight 2 of the list must be a Flight, not a str"),
        ([FLEET[0], FLEET[1], FLEET[0]], "flights 1 and 3 are one and the same"),
        ([FLEET[0], replace(FLEET[0])], "flights 1 and 2 are one and the same"),
        ([FLEET[0], flown(4, 0.2)], "flight 2: 20 rows are too few to estimate its noise"),
    ],
)
def test_what_is_no_list_of_flights_is_told_in_one_line(flights, words):
    with pytest.raises(InputError, match=words):
        sf.Estimator().estimate(flights)


def test_the_repairs_of_an_estimate_are_those_of_its_one_flight():
    odd = replace(FLEET[0], velocity=FLEET[0].velocity + 30.0 * np.eye(601)[300][:, None])
    coarse = sf.Estimator(library=sf.Library(SMALL_GRID), readout=sf.Readout(refine="none"))
    alone, both = coarse.estimate(odd), coarse.estimate([odd, FLEET[1]])
    assert [own.repairs.outliers for own in (alone, both)] == [1, 0]


def test_the_command_line_reads_several_files(tmp_path, capsys):
    from sparsefit.cli import main

    paths = [str(tmp_path / f"{place}.csv") for place in range(2)]
    for path, flight in zip(paths, FLEET, strict=False):
        sf.write_flight(flight, path)
    assert main(["estimate", *paths, "--set", "readout.refine=variable-projection"]) == 0
    printed = capsys.readouterr().out
    for place, path in enumerate(paths, 1):
        assert f"flight {place}              {path}" in printed
    assert "change of U0" in printed
    assert main(["estimate", paths[0], paths[0]]) == 2
    assert "one and the same" in capsys.readouterr().err


OTHER = sf.CellularFlow(mean_velocity=15.43, length_scale=4.5)


@pytest.mark.parametrize(
    ("flow", "tau", "words"),
    [(OTHER, 0.5, "of flight 3"), (FLOW, 0.6, "flight 3: the response time seems 0.1")],
)
def test_a_flight_of_another_flow_or_vehicle_is_named(flow, tau, words):
    true = sf.PointMassVehicle(tau, (5.0, 3.0))
    odd = fly(flow, true, duration=6.0, seed=9, noise=(0.2, 0.02))
    believed = replace(odd, vehicle=VEHICLE)
    found = sf.Estimator(readout=REFINED).estimate([*FLEET[:2], believed])
    assert found.status == "misfit"
    assert re.search(words, found.reason), found.reason


def test_what_wanders_in_one_flight_is_that_flights():
    """Each has a level of its own: in two of one level, and none of the first, it was no cause."""
    steady, wandering = flown(21, 8.0, 50.0), flown(22, 8.0, 50.0)
    steps = np.random.default_rng(1).normal(0.0, 0.05, wandering.position.shape)
    wandering = replace(wandering, position=wandering.position + np.cumsum(steps, axis=0))
    found = sf.Estimator(readout=REFINED).estimate([steady, wandering])
    assert found.status == "ok", found.reason
    levels = [own.position_wander for own in found.flights]
    assert levels[0] < 0.01 < 0.1 < levels[1]


def test_every_flight_has_a_response_time_of_its_own():
    true = (0.5, 0.3)
    logs = [flown(11, tau=true[0]), flown(12, 4.0, 50.0, tau=true[1])]
    believed = sf.PointMassVehicle(1.0, (5.0, 3.0))
    flights = [replace(log, vehicle=believed) for log in logs]
    estimator = sf.Estimator(library=sf.Library(unknown=("response_time",)), readout=REFINED)
    found = estimator.estimate(flights)
    assert found.status == "ok"
    assert np.isnan(found.response_time)
    for flight, tau in zip(found.flights, true, strict=True):
        spread = flight.vehicle_uncertainty.response_time
        assert abs(flight.response_time - tau) < 4 * spread < 0.03
    alone = estimator.estimate(flights[1]).vehicle_uncertainty.response_time
    assert found.flights[1].vehicle_uncertainty.response_time < alone


def test_nobody_can_tell_a_vehicle_where_there_is_no_flow():
    still = {"flow": None, "duration": 3.0, "rate": 50.0, "noise": (0.2, 0.02)}
    calm = [fly(**still, seed=seed, initial_velocity=(3.0, 1.0)) for seed in range(2)]
    estimator = sf.Estimator(library=sf.Library(unknown=("response_time",)), readout=REFINED)
    found = estimator.estimate(calm)
    assert found.status == "unidentifiable"
    assert "estimate each flight alone" in found.reason


def test_goodness_is_the_flows_share_of_the_air():
    cells, gusts = sf.CellularFlow(10.0, 4.0), sf.flows.Turbulence(1.0, 8.0, seed=3)
    flow = sf.flows.SuperposedFlow((cells, gusts))
    flights = [fly(flow, rate=50.0, seed=seed, noise=(0.05, 0.01)) for seed in (1, 2)]
    found = sf.Estimator().estimate(flights)
    goodness, speed = found.goodness, found.mean_velocity
    # A component of cells has a mean square of U0^2/4; hardly any process noise is beside gusts.
    share = 1.0 / (1.0 + 4.0 * (goodness.turbulence / speed) ** 2)
    assert goodness.r_squared == pytest.approx(share, abs=1e-3)
    assert goodness.turbulence_share == pytest.approx(goodness.turbulence / speed)
    assert 0.5 < goodness.turbulence < 1.5
    assert np.mean([1 / own.r_squared for own in goodness.flights]) == pytest.approx(
        1 / goodness.r_squared, rel=1e-3
    )
