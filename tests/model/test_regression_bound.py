"""The bound of rows, by hand, by finite differences and by laws that it obeys."""

import math

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.model.regression_bound import cramer_rao, jacobian

FLOW = CellularFlow(12.0, 4.0)
VEHICLE = PointMassVehicle(0.5)


def wander(seed=0, samples=1200):
    """A path that drifts across cells and loops in them."""
    t, rng = np.linspace(0, 12, samples), np.random.default_rng(seed)
    phases = rng.uniform(0, 2 * np.pi, 2)
    loops = np.column_stack([np.sin(2.1 * t + phases[0]), np.cos(1.3 * t + phases[1])])
    return t[:, None] * [2.5, 1.7] + 2.0 * loops


def test_parametric_jacobian_is_the_finite_difference():
    position, h = wander(), 1e-5
    rows, _ = jacobian(position, FLOW, "parametric")

    def phi(speed, scale):
        return CellularFlow(speed, scale).velocity(*position.T).T.ravel()

    by_speed = (phi(12.0 + h, 4.0) - phi(12.0 - h, 4.0)) / (2 * h)
    by_scale = (phi(12.0, 4.0 + h) - phi(12.0, 4.0 - h)) / (2 * h)
    np.testing.assert_allclose(rows, np.column_stack([by_speed, by_scale]), atol=1e-6)


def test_the_bound_under_quadratic_drag_by_hand():
    # Against r = (3, 0) an error of v' is one of Phi by 1/(2 c |r|) along x, 1/(c |r|) along y.
    position = wander()
    velocity = FLOW.velocity(*position.T) - np.array([3.0, 0.0])
    quadratic = PointMassVehicle(math.inf, drag=0.25)
    rows, _ = jacobian(position, FLOW, "parametric")
    rows = rows * np.repeat([1.5, 0.75], len(position))[:, None]
    expected = np.sqrt(np.diagonal(np.linalg.inv(rows.T @ rows)))
    bounds = {
        model: cramer_rao(
            position, FLOW, quadratic, process_noise=1.0, model=model, velocity=velocity
        )
        for model in ("parametric", "semiparametric")
    }
    found = bounds["parametric"]
    assert [found.mean_velocity, found.length_scale] == pytest.approx(expected, rel=1e-9)
    assert bounds["semiparametric"].length_scale >= found.length_scale
    # Without quadratic drag to speak of, the bound is the linear one's.
    for model in ("parametric", "semiparametric"):
        slight = PointMassVehicle(0.5, drag=1e-12)
        bound = cramer_rao(
            position, FLOW, slight, process_noise=1.0, model=model, velocity=velocity
        )
        linear = cramer_rao(position, FLOW, VEHICLE, process_noise=1.0, model=model)
        assert bound.length_scale == pytest.approx(linear.length_scale, rel=1e-6)
    with pytest.raises(InputError, match="needs the velocities"):
        cramer_rao(position, FLOW, quadratic, process_noise=1.0)


def test_the_bound_is_that_of_the_full_jacobian():
    # By QR and singular values, which square no condition number.
    rows, gradients = jacobian(wander(), FLOW, "semiparametric")
    expected = 0.5 * np.linalg.norm(np.linalg.pinv(rows).T @ gradients.T, axis=0)
    bound = cramer_rao(wander(), FLOW, VEHICLE, process_noise=1.0, model="semiparametric")
    found = [bound.mean_velocity, bound.length_scale, bound.timescale]
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_hand_derived_case():
    # At (L/2, 0): f = (1, 0), df/dL = 0. At (L, 0): f = (0, 0), df/dL = pi/L (1, 0).
    # Fisher matrix diag(1, (U0 pi/L)^2) / (tau sigma)^2, so the two are uncorrelated.
    position = np.array([[2.0, 0.0], [4.0, 0.0]])
    bound = cramer_rao(position, FLOW, VEHICLE, process_noise=0.2)
    by_scale = 0.1 * 4.0 / (12.0 * math.pi)
    assert bound.mean_velocity == pytest.approx(0.1)
    assert bound.length_scale == pytest.approx(by_scale)
    expected = (4.0 / 12.0) * math.hypot(0.1 / 12.0, by_scale / 4.0)
    assert bound.timescale == pytest.approx(expected)


def test_bound_scales_with_the_noise_and_vanishes_without():
    one = cramer_rao(wander(), FLOW, VEHICLE, process_noise=1.0)
    three = cramer_rao(wander(), FLOW, VEHICLE, process_noise=3.0)
    assert three.length_scale == pytest.approx(3 * one.length_scale)
    assert cramer_rao(wander(), FLOW, VEHICLE, process_noise=0.0).timescale == 0.0


def test_free_weights_never_help():
    known = cramer_rao(wander(), FLOW, VEHICLE, process_noise=1.0)
    free = cramer_rao(wander(), FLOW, VEHICLE, process_noise=1.0, model="semiparametric")
    assert free.length_scale > known.length_scale
    assert free.mean_velocity > known.mean_velocity


def test_semiparametric_bound_does_not_move_by_periods():
    near = cramer_rao(wander(), FLOW, VEHICLE, process_noise=1.0, model="semiparametric")
    far = cramer_rao(wander() + 80.0, FLOW, VEHICLE, process_noise=1.0, model="semiparametric")
    assert far.length_scale == pytest.approx(near.length_scale, rel=1e-6)
    assert far.mean_velocity == pytest.approx(near.mean_velocity, rel=1e-6)


def test_what_the_path_cannot_tell_is_infinite():
    standing = cramer_rao(np.zeros((9, 2)), FLOW, VEHICLE, process_noise=1.0)  # w = 0 there
    assert standing.mean_velocity == standing.length_scale == standing.timescale == math.inf
    diagonal = np.linspace(0, 40, 900)[:, None] * [1.0, 1.0]
    free = cramer_rao(diagonal, FLOW, VEHICLE, process_noise=1.0, model="semiparametric")
    assert free.mean_velocity == math.inf


def test_refuses_bad_arguments():
    with pytest.raises(InputError, match="semiparametric"):
        cramer_rao(wander(), FLOW, VEHICLE, process_noise=1.0, model="semiparametrc")
    with pytest.raises(InputError):
        cramer_rao(wander(), FLOW, VEHICLE, process_noise=-1.0)
