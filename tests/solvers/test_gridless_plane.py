"""The gridless group-LASSO over the plane of wavevectors: derivatives, bound, certificate."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.model.continuum import MISSED, WaveContinuum
from sparsefit.regression.backend import Solution
from sparsefit.rows import Derivative
from sparsefit.solvers.continuous_dual import Scanner
from sparsefit.solvers.gridless import GridlessGroupLasso
from sparsefit.solvers.lassos import GroupLasso
from sparsefit.solvers.sliding import Atoms, derivatives

VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
FLOW = sf.ShapedCells(12.0, 4.2, heading=math.radians(25.0), offset=(1.0, 0.5))
FLIGHT = sf.simulate_flight(
    FLOW, VEHICLE, duration=8.0, sample_rate=100.0, seed=7, velocity_noise=0.2, position_noise=0.05
)
WAVES = Library(LengthScaleGrid(3.0, 8.0), family="waves", every=10)
PROBLEM = WAVES.build(Derivative()(FLIGHT), VEHICLE)
PLANE = PROBLEM.continuum
BOUNDS = PLANE.interval(None, None)


def heights_at(continuum, residual, places):
    """|Z(q)'R|_F / m at places (s, 2), from the columns themselves."""
    theta = continuum.design(places)[0]
    z = theta / np.sqrt(np.mean(theta**2, axis=0))
    return np.linalg.norm((z.T @ residual).reshape(len(places), -1), axis=1) / len(residual)


def anywhere(rng, count, bounds=BOUNDS):
    return np.column_stack([rng.uniform(*bounds, count), rng.uniform(0.0, math.pi, count)])


def test_the_columns_of_the_plane_are_those_of_the_grid():
    found = PROBLEM.at(PLANE.places(PROBLEM.parameters))
    np.testing.assert_allclose(found.theta, PROBLEM.theta, atol=1e-9)
    np.testing.assert_allclose(found.parameters, PROBLEM.parameters, atol=1e-12)
    np.testing.assert_allclose(found.group_scales, PROBLEM.group_scales)
    assert pytest.approx((math.sqrt(2) * math.pi / 8, math.sqrt(2) * math.pi / 3)) == BOUNDS


def test_a_wave_turned_by_half_a_turn_is_the_same_with_another_sign_of_its_sine():
    images, signs = PLANE.images(np.array([[1.0, 0.3]]))
    first, *others = PLANE.columns(images[:, 0])[0]
    for other, sign in zip(others, signs[1:], strict=True):
        np.testing.assert_allclose(sign[:, None] * other, first, atol=1e-9)


def test_rows_that_are_not_whole_samples_have_no_continuum():
    kept = PLANE.at(np.arange(10, 20))
    np.testing.assert_array_equal(kept.position, PLANE.position[5:10])
    assert PLANE.at(np.arange(11, 21)) is None
    assert PLANE.at(np.arange(10, 15)) is None


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_derivatives_of_the_slide(alpha):
    rng = np.random.default_rng(0)
    spans = PLANE.spans(np.array([[0.8, 0.0], [1.2, 0.0]]))
    start = np.concatenate([[0.8, 2.0, 1.2, 0.4] * spans.ravel(), rng.normal(size=4)])

    def at(point):
        places, weights = point[:4].reshape(2, 2) / spans, point[4:].reshape(2, 2, 1)
        return Atoms.at(PLANE, PROBLEM.target, places, weights, alpha)

    gradient, hessian = derivatives(at(start), alpha, spans)
    steps = 1e-5 * np.eye(len(start))
    slope = [(at(start + e).value - at(start - e).value) / 2e-5 for e in steps]
    bend = [
        (derivatives(at(start + e), alpha, spans)[0] - derivatives(at(start - e), alpha, spans)[0])
        / 2e-5
        for e in steps
    ]
    np.testing.assert_allclose(gradient, slope, atol=1e-6 * np.abs(gradient).max())
    np.testing.assert_allclose(hessian, bend, atol=1e-6 * np.abs(hessian).max())


@pytest.mark.parametrize("offset", [0.0, 40.0])
def test_no_wave_of_the_plane_exceeds_the_supremum_found(offset):
    rng = np.random.default_rng(1)
    continuum = WaveContinuum(PLANE.position + offset, PLANE.cells)
    scanner = Scanner.of(continuum, BOUNDS)
    on_grid = scanner.scan.heights(PROBLEM.target)
    k = scanner.scan.axis[[3, 9]]
    places = np.array([[np.hypot(*k), np.arctan2(k[1], k[0])]])
    assert on_grid[3, 9] == pytest.approx(heights_at(continuum, PROBLEM.target, places)[0])
    for residual in (PROBLEM.target, rng.normal(size=PROBLEM.target.shape)):
        top = scanner.peaks(residual)[0].height
        assert heights_at(continuum, residual, anywhere(rng, 5_000)).max() <= top * (1 + 1e-12)
        assert scanner.scan.heights(residual).max() >= top * (1 - 3 * MISSED)


@pytest.mark.parametrize("alpha_fraction", [0.5, 0.1, 0.02])
def test_the_gap_closes_over_the_plane(alpha_fraction):
    backend = GridlessGroupLasso(alpha_fraction)
    solution = backend.solve(PROBLEM)
    assert solution.status == "ok"
    assert backend.certify(PROBLEM, solution).value < 1e-9
    alpha = alpha_fraction * Scanner.of(PLANE, BOUNDS).peaks(PROBLEM.target)[0].height
    residual = PROBLEM.target - solution.problem.theta @ solution.weights
    eta = heights_at(PLANE, residual, anywhere(np.random.default_rng(2), 5_000)) / alpha
    assert eta.max() <= 1 + 1e-7
    chosen = PLANE.places(solution.problem.parameters)
    np.testing.assert_allclose(heights_at(PLANE, residual, chosen) / alpha, 1.0, atol=1e-6)


def test_the_certificate_sees_a_wrong_answer():
    backend = GridlessGroupLasso(0.1)
    good = backend.solve(PROBLEM)
    moved = PLANE.places(good.problem.parameters) * np.array([1.003, 1.0])
    for weights, found in (
        (1.01 * good.weights, good.problem),
        (good.weights, PROBLEM.at(moved)),
    ):
        wrong = Solution(weights, problem=found)
        assert backend.certify(PROBLEM, wrong).value > 1e-5


def test_finer_grids_descend_to_the_gridless_optimum():
    backend = GridlessGroupLasso(0.1, lower=4.0, upper=4.4)
    limit = backend.certify(PROBLEM, backend.solve(PROBLEM)).primal
    bounds = PLANE.interval(4.0, 4.4)
    alpha = 0.1 * Scanner.of(PLANE, bounds).peaks(PROBLEM.target)[0].height
    over, samples = [], Derivative()(FLIGHT)
    for step in (1.0, 0.4, 0.16):
        library = replace(WAVES, grid=sf.LengthScaleGrid(4.0, 4.4), waves=sf.WaveGrid(step))
        grid = library.build(samples, VEHICLE)
        top = heights_at(PLANE, grid.target, PLANE.places(grid.parameters)).max()
        weights = GroupLasso(alpha / float(top)).solve(grid).weights
        norms = np.linalg.norm((weights[:, 0] * grid.statistics.rms).reshape(-1, 2), axis=1)
        rest = grid.target - grid.theta @ weights
        over.append(np.sum(rest**2) / (2 * len(rest)) + alpha * norms.sum() - limit)
    assert over[0] > over[1] > over[2] > 0
    assert over[2] < 0.01 * limit


@pytest.mark.parametrize("groups", ["ring", "nested"])
def test_groups_of_several_waves_are_refused(groups):
    problem = replace(WAVES, groups=groups).build(Derivative()(FLIGHT), VEHICLE)
    solution = GridlessGroupLasso(0.1).solve(problem)
    assert solution.status == "error"
    assert "in groups by wave" in solution.reason


def test_parametric_least_squares_knows_cells_alone():
    solution = backends.get("parametric-nls").solve(PROBLEM)
    assert solution.status == "error"
    assert "family 'cells'" in solution.reason


def test_it_estimates_the_turned_cells():
    backend = backends.get("gridless-group-lasso")
    found = sf.Estimator(library=WAVES, backend=backend).estimate(FLIGHT)
    assert (found.status, found.shape) == ("ok", "square")
    assert found.mean_velocity == pytest.approx(12.0, rel=0.01)
    assert found.length_scale == pytest.approx(4.2, rel=0.002)
    assert math.degrees(found.heading) == pytest.approx(25.0, abs=0.2)
    shrunk = sf.Estimator(
        library=WAVES, backend=backends.get("gridless-group-lasso", alpha_fraction=0.03),
        readout=sf.Readout(refine="none"),
    ).estimate(FLIGHT)  # fmt: skip
    truth = FLOW.velocity(*FLIGHT.position.T)
    assert np.linalg.norm(shrunk.flow.velocity(*FLIGHT.position.T) - truth) < 0.08 * np.linalg.norm(
        truth
    )
