"""Errors against the truth, worked by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.estimator.estimate import Estimate
from sparsefit.score import strongest
from tests.problems import fly

FLOW = sf.CellularFlow(mean_velocity=10.0, length_scale=4.0)  # timescale 0.4 s
SCALES = np.array([3.0, 3.9, 4.3, 5.0])


def estimate(speed, scale, grid=None):
    timescale = scale / speed
    grid = scale if grid is None else grid
    return Estimate(speed, scale, timescale, grid, status="ok")


def test_errors_worked_by_hand():
    found = sf.score.score(estimate(8.0, 5.0), FLOW, SCALES)
    assert (found.mean_velocity, found.length_scale) == (-20.0, 25.0)
    assert found.timescale == pytest.approx(56.25)


@pytest.mark.parametrize(("chosen", "hit"), [(3.9, True), (4.3, False), (3.0, False)])
def test_a_hit_is_the_candidate_nearest_the_truth(chosen, hit):
    assert sf.score.score(estimate(10.0, chosen), FLOW, SCALES).hit is hit


def test_a_refined_scale_is_a_hit_by_its_candidate_and_no_estimate_is_none():
    assert sf.score.score(estimate(10.0, 4.0, grid=3.9), FLOW, SCALES).hit
    missing = sf.score.score(estimate(math.nan, math.nan), FLOW, SCALES)
    assert not missing.hit
    assert math.isnan(missing.length_scale + missing.mean_velocity)


TWO = sf.flows.SuperposedFlow((sf.CellularFlow(10.0, 4.0), sf.CellularFlow(5.0, 8.0)))


def of(*scales):
    return tuple(
        sf.estimator.ScaleEstimate(speed, scale, scale / speed, scale) for speed, scale in scales
    )


def test_matched_missed_and_spurious_worked_by_hand():
    found = sf.score.score_scales(of((10.5, 4.04), (3.0, 6.0)), TWO)
    assert found.true == 2
    assert (found.detected, found.missed, found.spurious) == (1, 1, 1)
    assert found.max_length_scale_error == pytest.approx(1.0)
    assert found.max_mean_velocity_error == pytest.approx(5.0)
    assert not found.within(2.0)


def test_errors_are_the_largest_of_either_sign():
    found = sf.score.score_scales(of((4.5, 8.08), (10.0, 3.96)), TWO)
    assert found.max_length_scale_error == pytest.approx(1.0)
    assert found.max_mean_velocity_error == pytest.approx(10.0)
    assert found.within(1.01)
    assert not found.within(0.9)


def test_the_tolerance_is_of_the_wavenumber():
    # |k_est/k_true - 1| = |L/L_est - 1|: 4/4.2 = 0.952 is within 5 %, 4/3.8 = 1.053 is not.
    assert sf.score.score_scales(of((10.0, 4.2)), FLOW).detected == 1
    assert sf.score.score_scales(of((10.0, 3.8)), FLOW).detected == 0
    assert sf.score.score_scales(of((10.0, 3.8)), FLOW, tolerance=0.06).detected == 1


def test_an_estimate_belongs_to_one_scale_and_a_scale_to_one_estimate():
    near = sf.flows.SuperposedFlow((sf.CellularFlow(10.0, 4.0), sf.CellularFlow(9.0, 4.1)))
    one = sf.score.score_scales(of((10.0, 4.08)), near)
    assert (one.detected, one.missed, one.spurious) == (1, 1, 0)
    assert one.max_length_scale_error == pytest.approx(100 * (1 - 4.08 / 4.1))
    twice = sf.score.score_scales(of((10.0, 4.0), (2.0, 4.01)), FLOW)
    assert (twice.detected, twice.missed, twice.spurious) == (1, 0, 1)
    assert twice.max_length_scale_error == 0.0


def test_no_scale_has_no_error_and_no_tolerance_is_refused():
    found = sf.score.score_scales((), TWO)
    assert (found.detected, found.missed, found.spurious) == (0, 2, 0)
    assert math.isnan(found.max_length_scale_error)
    assert not found.within(100.0)
    for value, counts in ((4.0, (1, 0, 0)), (5.0, (0, 1, 1)), (math.nan, (0, 1, 0))):
        one = sf.score.score_scales(estimate(10.0, value), FLOW)
        assert (one.detected, one.missed, one.spurious) == counts
    for wrong in (None, Offset(FLOW, (1.0, 0.0)), sf.flows.SuperposedFlow((), (1.0, 0.0))):
        with pytest.raises(InputError, match="must have cells"):
            sf.score.score(estimate(10.0, 4.0), wrong, [4.0])
    with pytest.raises(InputError, match="must be a flow of sparsefit"):
        sf.score.score_scales((), None)
    with pytest.raises(sf.InputError, match="tolerance"):
        sf.score.score_scales((), FLOW, tolerance=0.0)


def test_of_superposed_flows_the_strongest_is_the_truth():
    assert sf.score.score(estimate(10.0, 4.0), TWO, SCALES).length_scale == 0.0
    assert strongest(TWO) == FLOW
    equal = sf.flows.SuperposedFlow((FLOW, sf.CellularFlow(10.0, 5.0)))
    assert strongest(equal) == FLOW


class Offset:
    """The true flow and a wind that is not there."""

    def __init__(self, flow, wind):
        self.flow, self.wind = flow, np.array(wind)

    def velocity(self, x, y, t=0.0):
        return self.flow.velocity(x, y, t) + self.wind


def others(flow):
    return [fly(flow, duration=1.0, rate=20.0, seed=seed) for seed in (1, 2)]


def test_prediction_error_is_the_relative_miss_along_other_flights():
    flow = sf.flows.ShapedCells(10.0, 4.0, heading=0.2, drift=(0.5, 0.0))
    flights = others(flow)
    assert sf.score.prediction_error(flow, flights) == 0.0
    assert sf.score.prediction_error(flow, flights[0]) == 0.0
    assert sf.score.prediction_error(None, flights) == 1.0
    # doubled: |2 w - w| / |w|
    doubled = sf.flows.ShapedCells(20.0, 4.0, heading=0.2, drift=(0.5, 0.0))
    assert sf.score.prediction_error(doubled, flights) == pytest.approx(1.0, rel=1e-12)
    squares = sum(np.sum(flow.velocity(*f.position.T, f.time) ** 2) for f in flights)
    samples = sum(f.samples for f in flights)
    found = sf.score.prediction_error(Offset(flow, (3.0, 4.0)), flights)
    assert found == pytest.approx(np.sqrt(25.0 * samples / squares), rel=1e-12)
    still = sf.flows.ShapedCells(10.0, 4.0, heading=0.2)  # the time matters
    assert sf.score.prediction_error(still, flights) > 0.1


def test_prediction_needs_flights_that_know_their_flow():
    flight = others(sf.CellularFlow(10.0, 4.0))[0]
    for bad in ([], [replace(flight, flow=None)]):
        with pytest.raises(InputError, match="each with its true flow"):
            sf.score.prediction_error(None, bad)
    with pytest.raises(InputError, match="flow must be one of"):
        sf.score.prediction_error(estimate(10.0, 4.0), flight)


def test_an_estimate_predicts_its_flow():
    windy = sf.flows.SuperposedFlow((FLOW,), (1.0, -0.5))
    known = sf.Estimator(library=sf.Library(unknown=("wind",))).estimate(fly(windy, seed=4))
    assert known.status == "ok"
    assert sf.score.prediction_error(known.flow, others(windy)) < 1e-3
    on_grid = sf.Estimator(backend="least-squares", readout=sf.Readout(refine="none"))
    flight = fly(FLOW, seed=4)
    # the back-end's own weights fit the flight that they come from
    estimate = on_grid.estimate(flight)
    assert sf.score.prediction_error(estimate.flow, [flight]) < 0.1
