"""What is searched: the scan, its lobes, and descents of several modes at once."""

import math

import numpy as np
import pytest

from sparsefit.errors import InputError
from sparsefit.flight.flow import CellularFlow
from sparsefit.library.cells import candidate_columns
from sparsefit.modes.fitted_rows import centred
from sparsefit.modes.search import locate_one
from sparsefit.modes.space import SearchSpace
from tests.references import residual_curve

BOUNDS = (math.pi / 12, math.pi / 1)
TRUTH = np.pi / np.array([3.1, 4.4])


def path(seed=0, samples=1500):
    """A drifting, wobbling path [m] of some 100 m, centred."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 10, samples)
    wobble = np.cumsum(rng.normal(size=(samples, 2)), axis=0) * 0.05
    return centred(np.column_stack([9.0 * t, 5.3 * t]) + wobble)


def two_flows(position, noise=0.0):
    parts = CellularFlow(10.0, 3.1), CellularFlow(4.0, 4.4)
    phi = sum(part.velocity(position[:, 0] + 0.7, position[:, 1]) for part in parts)
    return phi + noise * np.random.default_rng(1).normal(size=phi.shape)


def fit_at(position, phi, k):
    return SearchSpace.plain(position, phi, BOUNDS).at(k)


def descend(position, phi, k, bounds=BOUNDS):
    return SearchSpace.plain(position, phi, bounds).descend(k)


def test_the_fit_is_least_squares_on_all_columns():
    position = path()
    phi = two_flows(position, noise=1.0)
    found = fit_at(position, phi, TRUTH * 1.01)
    theta = candidate_columns(position, np.pi / (TRUTH * 1.01))
    weights, squares, *_ = np.linalg.lstsq(theta, phi, rcond=None)
    assert found.residual == pytest.approx(squares.sum(), rel=1e-10)
    np.testing.assert_allclose(found.weights.reshape(16, 2), weights, atol=1e-7)
    np.testing.assert_allclose(found.rest, phi - theta @ weights, atol=1e-7)


def test_no_scale_explains_nothing():
    phi = two_flows(path())
    found = fit_at(path(), phi, np.empty(0))
    assert found.residual == pytest.approx(np.sum(phi**2))
    np.testing.assert_array_equal(found.rest, phi)
    assert descend(path(), phi, np.empty(0)).residual == found.residual


def test_the_moves_are_gauss_newtons():
    """Slope and curvature from differences of the projected residual, column by column."""
    position, h = path(), 1e-6
    phi, k = two_flows(position), TRUTH * (1 + 1e-4)
    here = fit_at(position, phi, k)
    jacobian = np.column_stack(
        [
            (fit_at(position, phi, k + e).rest - fit_at(position, phi, k - e).rest).ravel()
            / (2 * h)
            for e in h * np.eye(2)
        ]
    )
    expected = np.linalg.lstsq(-jacobian, here.rest.ravel(), rcond=None)[0]
    # Kaufman's curvature leaves out a part of the Jacobian of the size of the residual.
    np.testing.assert_allclose(here.moves[:, 0], expected, rtol=0.02)


def test_two_flows_without_noise_are_met_exactly():
    position = path()
    found = descend(position, two_flows(position), TRUTH * [1.002, 0.998])
    np.testing.assert_allclose(found.parameters[:, 0], TRUTH, rtol=1e-10)
    assert found.residual < 1e-12 * np.sum(two_flows(position) ** 2)


def test_the_residual_is_least_where_the_descent_ends():
    position = path()
    phi = two_flows(position, noise=1.0)
    found = descend(position, phi, TRUTH * [1.002, 0.998])
    assert found.residual <= fit_at(position, phi, TRUTH * [1.002, 0.998]).residual
    for step in np.random.default_rng(0).normal(size=(20, 2)) * 1e-4:
        assert fit_at(position, phi, found.parameters[:, 0] + step).residual >= found.residual


def test_one_scale_is_the_refinement_of_one():
    position = path()
    phi = CellularFlow(10.0, 3.1).velocity(*position.T) + np.random.default_rng(0).normal(
        size=position.shape
    )
    one = locate_one(SearchSpace.plain(position, phi, BOUNDS)).fit
    found = descend(position, phi, one.parameters[:, 0] * 1.001)
    assert found.parameters[:, 0][0] == pytest.approx(one.parameters[0, 0], rel=1e-9)
    assert found.residual == pytest.approx(one.residual, rel=1e-12)


def test_one_scale_alone_leans_towards_the_other():
    """What the joint fit is for."""
    position = path()
    alone = descend(position, two_flows(position), TRUTH[:1]).parameters[0, 0]
    together = descend(position, two_flows(position), TRUTH).parameters[0, 0]
    assert abs(alone / TRUTH[0] - 1) > 1e3 * abs(together / TRUTH[0] - 1)


def test_wavenumbers_stay_in_the_bounds():
    position = path()
    bounds = (float(TRUTH[1]) * 1.01, BOUNDS[1])
    found = descend(position, two_flows(position), TRUTH, bounds)
    assert found.parameters[:, 0].min() >= bounds[0]


def test_a_scale_given_twice_is_the_scale():
    position = path()
    phi = two_flows(position, noise=0.1)
    once = fit_at(position, phi, TRUTH)
    twice = fit_at(position, phi, TRUTH[[0, 0, 1]])
    assert twice.residual == pytest.approx(once.residual, rel=1e-6)
    assert np.isfinite(twice.moves).all()
    assert np.isfinite(descend(position, phi, TRUTH[[0, 0, 1]]).residual)


def test_residuals_of_one_mode_more_are_those_of_the_rows():
    position = path()
    phi = two_flows(position, noise=0.5)
    space = SearchSpace.plain(position, phi, BOUNDS)
    curve, k = space.residuals(space.empty), space.scan.wavenumbers
    assert k[0] == pytest.approx(BOUNDS[0])
    assert k[-1] == pytest.approx(BOUNDS[1])
    error = np.abs(curve[::20] - residual_curve(position, phi, k[::20]))
    assert error.max() < 1e-4 * np.sum(phi**2)
    assert np.median(error) < 1e-5 * np.sum(phi**2)


def test_without_a_mode_a_fit_leaves_what_the_others_do_not_explain():
    position = path()
    phi = two_flows(position, noise=0.5)
    space = SearchSpace.plain(position, phi, BOUNDS)
    fit = space.at(TRUTH)
    others = space.without(fit, 0)
    np.testing.assert_allclose(others.rest, phi - space.flow(fit, 1), atol=1e-9)
    np.testing.assert_allclose(others.parameters, fit.parameters[1:])
    np.testing.assert_allclose(fit.rest, phi - space.flow(fit), atol=1e-9)


def test_the_deepest_lobe_is_the_flow():
    position = path()
    phi = CellularFlow(10.0, 3.1).velocity(*position.T)
    k = SearchSpace.plain(position, phi, BOUNDS).minima
    assert k[0] == pytest.approx(math.pi / 3.1, abs=0.15 / np.ptp(position))
    assert k.min() >= BOUNDS[0]
    assert k.max() <= BOUNDS[1]


def test_too_many_lobes_are_refused():
    with pytest.raises(InputError, match="raise the grid's lower bound"):
        SearchSpace.plain(path(), two_flows(path()), (1.0, 1e6))


def test_a_flight_that_stands_still_has_no_lobes():
    with pytest.raises(InputError, match="does not move"):
        SearchSpace.plain(np.zeros((30, 2)), np.ones((30, 2)), BOUNDS)
