"""Errors against the truth, worked by hand."""

import math

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.estimator import Estimate

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
