"""Errors against the truth, worked by hand."""

import math

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.estimator.estimate import Estimate
from sparsefit.score import strongest

FLOW = sf.CellularFlow(mean_velocity=10.0, length_scale=4.0)  # timescale 0.4 s
SCALES = np.array([3.0, 3.9, 4.3, 5.0])


def estimate(speed, scale, grid=None):
    timescale = scale / speed
    grid = scale if grid is None else grid
    return Estimate(speed, scale, timescale, "ok", "", "lasso", {}, grid_length_scale=grid)


def test_signed_and_absolute_errors_worked_by_hand():
    found = sf.score(estimate(8.0, 5.0), FLOW, SCALES)
    assert (found.mean_velocity.signed, found.mean_velocity.signed_percent) == (-2.0, -20.0)
    assert (found.mean_velocity.absolute, found.mean_velocity.absolute_percent) == (2.0, 20.0)
    assert (found.length_scale.signed, found.length_scale.signed_percent) == (1.0, 25.0)
    assert found.timescale.signed == pytest.approx(0.225)
    assert found.timescale.signed_percent == pytest.approx(56.25)


@pytest.mark.parametrize(("chosen", "hit"), [(3.9, True), (4.3, False), (3.0, False)])
def test_a_hit_is_the_candidate_nearest_the_truth(chosen, hit):
    assert sf.score(estimate(10.0, chosen), FLOW, SCALES).hit is hit


def test_a_refined_scale_is_a_hit_by_its_candidate():
    assert sf.score(estimate(10.0, 4.0, grid=3.9), FLOW, SCALES).hit


def test_no_estimate_has_no_error_and_is_no_hit():
    found = sf.score(estimate(math.nan, math.nan), FLOW, SCALES)
    assert not found.hit
    assert math.isnan(found.length_scale.signed)
    assert math.isnan(found.mean_velocity.absolute_percent)


def test_a_perfect_estimate_has_no_error():
    found = sf.score(estimate(10.0, 4.0), FLOW, np.array([4.0]))
    assert found.hit
    assert found.length_scale.absolute == found.mean_velocity.absolute == 0.0
    assert found.timescale.absolute == pytest.approx(0.0, abs=1e-16)


TWO = sf.SuperposedFlow((sf.CellularFlow(10.0, 4.0), sf.CellularFlow(5.0, 8.0)))


def of(*scales):
    """Scales (U0, L) as an estimate has them."""
    return tuple(sf.ScaleEstimate(speed, scale, scale / speed, scale) for speed, scale in scales)


def test_matched_missed_and_spurious_worked_by_hand():
    found = sf.score_scales(of((10.5, 4.04), (3.0, 6.0)), TWO)
    assert (found.true, found.found) == (2, 2)
    assert (found.detected, found.missed, found.spurious) == (1, 1, 1)
    assert found.length_scale_errors == pytest.approx((1.0,))
    assert found.mean_velocity_errors == pytest.approx((5.0,))
    assert not found.within(2.0)


def test_errors_are_in_the_order_of_the_flow_whatever_that_of_the_estimate():
    found = sf.score_scales(of((4.5, 8.08), (10.0, 3.96)), TWO)
    assert found.length_scale_errors == pytest.approx((-1.0, 1.0))
    assert found.mean_velocity_errors == pytest.approx((0.0, -10.0))
    assert found.max_length_scale_error == pytest.approx(1.0)
    assert found.max_mean_velocity_error == pytest.approx(10.0)
    assert found.within(1.01)
    assert not found.within(0.9)


def test_the_tolerance_is_of_the_wavenumber():
    # |k_est/k_true - 1| = |L/L_est - 1|: 4/4.2 = 0.952 is within 5 %, 4/3.8 = 1.053 is not.
    assert sf.score_scales(of((10.0, 4.2)), FLOW).detected == 1
    assert sf.score_scales(of((10.0, 3.8)), FLOW).detected == 0
    assert sf.score_scales(of((10.0, 3.8)), FLOW, tolerance=0.06).detected == 1


def test_an_estimate_belongs_to_one_scale_and_a_scale_to_one_estimate():
    near = sf.SuperposedFlow((sf.CellularFlow(10.0, 4.0), sf.CellularFlow(9.0, 4.1)))
    one = sf.score_scales(of((10.0, 4.08)), near)
    assert (one.detected, one.missed, one.spurious) == (1, 1, 0)
    assert one.length_scale_errors == pytest.approx((100 * (4.08 / 4.1 - 1),))
    twice = sf.score_scales(of((10.0, 4.0), (2.0, 4.01)), FLOW)
    assert (twice.detected, twice.missed, twice.spurious) == (1, 0, 1)
    assert twice.length_scale_errors == (0.0,)


def test_no_scale_has_no_error():
    found = sf.score_scales((), TWO)
    assert (found.detected, found.missed, found.spurious) == (0, 2, 0)
    assert math.isnan(found.max_length_scale_error)
    assert not found.within(100.0)


def test_an_estimate_is_scored_by_its_scales():
    assert sf.score_scales(estimate(10.0, 4.0), FLOW).found == 0


def test_a_tolerance_of_nothing_is_refused():
    with pytest.raises(sf.InputError, match="tolerance"):
        sf.score_scales((), FLOW, tolerance=0.0)


def test_of_superposed_flows_the_strongest_is_the_truth():
    assert sf.score(estimate(10.0, 4.0), TWO, SCALES).length_scale.signed == 0.0
    assert strongest(TWO) == FLOW
    equal = sf.SuperposedFlow((FLOW, sf.CellularFlow(10.0, 5.0)))
    assert strongest(equal) == FLOW
