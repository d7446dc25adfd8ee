"""The gridless group-LASSO: its certificate, its derivatives, and two flows told apart."""

import math

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.model.fitting import FlowRows, descended
from sparsefit.model.grid import LengthScaleGrid
from sparsefit.model.library import Library
from sparsefit.model.shapes import axis_cells
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Derivative
from sparsefit.solvers.continuous_dual import (
    Scanner,
    continuous_alpha_max,
    continuous_gap,
)
from sparsefit.solvers.gridless import GridlessGroupLasso
from sparsefit.solvers.lassos import GroupLasso
from sparsefit.solvers.sliding import Atoms, derivatives
from tests.problems import VEHICLE, flight, flight_problem
from tests.references import dual_certificate

GRID = LengthScaleGrid()
BOUNDS = (math.pi / 12, math.pi / 1)


def library_problem(flown, grid=GRID):
    return Library(grid).build(Derivative()(flown), flown.vehicle)


def two_flows(first, second, seed, velocities=(10.0, 6.0)):
    flow = sf.SuperposedFlow(tuple(map(sf.CellularFlow, velocities, (first, second))))
    vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(12.0, 7.0))
    return sf.simulate_flight(flow, vehicle, duration=30.0, sample_rate=100.0, seed=seed)


def group_norms(weights):
    return np.sqrt(np.sum(weights.reshape(-1, 16) ** 2, axis=1))


def test_scan_agrees_with_the_columns():
    problem = flight_problem()
    scan = problem.continuum.scan(BOUNDS)
    slow = dual_certificate(problem, problem.target, 1.0, scan.wavenumbers)
    np.testing.assert_allclose(scan.heights(problem.target), slow, atol=1e-6 * slow.max())


def test_no_wavenumber_exceeds_the_supremum_found():
    problem = flight_problem(seed=3)
    rng = np.random.default_rng(0)
    for residual in (problem.target, rng.normal(size=problem.target.shape)):
        top = Scanner.of(problem.continuum, BOUNDS).peaks(residual)[0].height
        fine = dual_certificate(problem, residual, top, np.linspace(*BOUNDS, 5000))
        assert 1 - 1e-3 < fine.max() <= 1 + 1e-12


@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_derivatives_of_the_slide(alpha):
    problem = flight_problem()
    rng = np.random.default_rng(0)
    start, spans = np.concatenate([[20.0, 36.0], rng.normal(size=32)]), np.full((2, 1), 40.0)

    def at(point):
        k, weights = point[:2, None] / 40.0, point[2:].reshape(2, 8, 2)
        return Atoms.at(problem.continuum, problem.target, k, weights, alpha)

    gradient, hessian = derivatives(at(start), alpha, spans)
    steps = 1e-5 * np.eye(len(start))
    slope = [(at(start + e).value - at(start - e).value) / 2e-5 for e in steps]
    bend = [
        (derivatives(at(start + e), alpha, spans)[0] - derivatives(at(start - e), alpha, spans)[0])
        / 2e-5
        for e in steps
    ]
    np.testing.assert_allclose(gradient, slope, atol=1e-7 * np.abs(gradient).max())
    np.testing.assert_allclose(hessian, bend, atol=1e-7 * np.abs(hessian).max())


@pytest.mark.parametrize("alpha_fraction", [0.5, 0.1, 0.02])
@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_gap_over_the_continuum(alpha_fraction, noise):
    problem = library_problem(flight(3.33, seed=4, velocity_noise=noise))
    backend = GridlessGroupLasso(alpha_fraction)
    solution = backend.solve(problem)
    assert solution.status == "ok"
    certificate = backend.certify(problem, solution)
    assert certificate.kind == "duality_gap"
    assert certificate.value < 1e-9
    alpha = alpha_fraction * continuous_alpha_max(problem.continuum, problem.target, BOUNDS)
    residual = problem.target - solution.problem.theta @ solution.weights
    eta = dual_certificate(problem, residual, alpha, np.linspace(*BOUNDS, 2000))
    assert eta.max() <= 1 + 1e-7
    at_scales = dual_certificate(problem, residual, alpha, np.pi / solution.problem.group_scales)
    np.testing.assert_allclose(at_scales, 1.0, atol=1e-6)


def test_certificate_sees_a_wrong_answer():
    problem = flight_problem()
    backend = GridlessGroupLasso()
    good = backend.solve(problem)
    for weights, found in (
        (1.01 * good.weights, good.problem),
        (good.weights, problem.at(math.pi / (good.problem.group_scales * 1.01))),
    ):
        wrong = Solution(weights, problem=found)
        assert backend.certify(problem, wrong).value > 1e-5


def test_gap_on_the_grid_bounds_the_gap_on_the_continuum():
    """One formula: with the dual norm over fewer scales, the gap can only be smaller."""
    problem = flight_problem()
    alpha = 0.1 * continuous_alpha_max(problem.continuum, problem.target, BOUNDS)
    weights = GroupLasso(0.1).solve(problem).weights
    penalty = GroupNorms(problem.groups, np.ones(len(problem.group_scales)))
    grid = duality_gaps(
        problem.design,
        problem.target,
        weights[None],
        np.array([alpha]),
        penalty,
    )[0]
    whole = continuous_gap(problem, weights, alpha, (math.pi / 7, math.pi / 2))
    assert whole.primal == pytest.approx(grid.primal)
    assert whole.value >= grid.value


def test_finer_grids_descend_to_the_gridless_optimum():
    problem = library_problem(flight(3.33, seed=4))
    backend = GridlessGroupLasso(0.1, lower=3.0, upper=4.0)
    bounds = (math.pi / 4, math.pi / 3)
    limit = backend.certify(problem, backend.solve(problem)).primal
    alpha = 0.1 * continuous_alpha_max(problem.continuum, problem.target, bounds)
    values = []
    for count in (5, 9, 33):
        grid = LengthScaleGrid(3.0, 4.0, count=count, spacing="wavenumber")
        fine = library_problem(flight(3.33, seed=4), grid)
        top = np.max(dual_certificate(fine, fine.target, 1.0, np.pi / fine.group_scales))
        weights = GroupLasso(alpha / float(top)).solve(fine).weights
        values.append(continuous_gap(fine, weights, alpha, bounds).primal)
    assert np.all(np.diff(values) < 0)
    assert limit <= values[-1]
    assert values[-1] == pytest.approx(limit, rel=1e-2)


def refined(problem, scales):
    """The wavenumbers of cells of a stream function that fit the rows best, from scales [m]."""
    place = problem.continuum.position - problem.continuum.position.mean(axis=0)
    rows = np.column_stack([place, np.zeros(len(place))])
    rows = FlowRows(rows, problem.target, np.zeros((len(rows), 2, 0)))
    return descended(rows, axis_cells(len(scales)), np.pi / np.array(scales)).q


@pytest.mark.parametrize("seed", range(3))
def test_single_flow_noise_free(seed):
    problem = library_problem(flight(3.33, seed=seed))
    solution = GridlessGroupLasso(0.1).solve(problem)
    scales = solution.problem.group_scales
    strongest = scales[np.argmax(group_norms(solution.weights))]
    assert strongest == pytest.approx(3.33, rel=0.01)
    np.testing.assert_allclose(np.pi / refined(problem, [strongest]), [3.33], rtol=2e-4)


@pytest.mark.parametrize(("ratio", "seed"), [(1.3, 0), (1.5, 1), (2.0, 2)])
def test_two_flows_within_one_percent(ratio, seed):
    truth = np.array([2.57, 2.57 * ratio])
    problem = library_problem(two_flows(*truth, seed))
    assert np.ptp(problem.continuum.position, axis=0).max() > 30 * truth[1]
    backend = GridlessGroupLasso(0.1)
    solution = backend.solve(problem)
    assert backend.certify(problem, solution).value < 1e-9
    scales = solution.problem.group_scales
    for scale in truth:
        near = np.abs(scales / scale - 1) < 0.01
        assert group_norms(solution.weights)[near].sum() > 3.0
    nearest = [scales[np.argmin(np.abs(scales - scale))] for scale in truth]
    np.testing.assert_allclose(np.pi / refined(problem, nearest), truth, rtol=1e-4)


def test_a_small_penalty_on_a_short_flight():
    """A new scale whose gain is near rounding must not be dropped round after round."""
    flow = sf.CellularFlow(15.0, 3.7889785439445482)
    for seed in (118, 119):
        flown = sf.simulate_flight(flow, VEHICLE, duration=10.0, sample_rate=100.0, seed=seed)
        problem = library_problem(flown)
        backend = GridlessGroupLasso(0.01)
        assert backend.certify(problem, backend.solve(problem)).value < 1e-9


def test_nothing_at_alpha_max():
    solution = GridlessGroupLasso(1.0).solve(flight_problem())
    assert solution.status == "ok"
    assert not solution.weights.any()


def test_scales_stay_in_the_bounds():
    problem = flight_problem(4.2)
    backend = GridlessGroupLasso(0.1, lower=4.5, upper=6.0)
    solution = backend.solve(problem)
    scales = solution.problem.group_scales
    assert scales.min() >= 4.5 * (1 - 1e-12)
    assert scales.max() <= 6.0 * (1 + 1e-12)
    assert backend.certify(problem, solution).value < 1e-8


def test_one_length_scale_is_the_grid_problem():
    problem = flight_problem(grid=LengthScaleGrid(4.0, 4.0, count=1))
    solution = GridlessGroupLasso(0.2).solve(problem)
    expected = GroupLasso(0.2).solve(problem).weights
    np.testing.assert_allclose(solution.problem.group_scales, [4.0])
    np.testing.assert_allclose(solution.weights, expected, atol=1e-6)


def test_the_origin_far_away():
    flown = flight(4.2)
    moved = sf.Flight(
        time=flown.time, position=flown.position + 1e4, velocity=flown.velocity, vehicle=VEHICLE
    )
    solution = GridlessGroupLasso(0.1).solve(library_problem(moved))
    strongest = np.argmax(group_norms(solution.weights))
    assert solution.status == "ok"
    assert solution.problem.group_scales[strongest] == pytest.approx(4.2, rel=0.01)


def test_without_positions_it_refuses():
    solution = GridlessGroupLasso().solve(
        RegressionProblem.from_arrays(np.eye(4)[:, :3] + 0.1, np.arange(4.0))
    )
    assert solution.status == "error"
    assert "position" in solution.reason
    assert solution.weights is None


@pytest.mark.parametrize(
    "settings", [{"alpha_fraction": 0.0}, {"lower": -1.0}, {"lower": 5.0, "upper": 2.0}]
)
def test_settings_out_of_range(settings):
    with pytest.raises(sf.InputError):
        GridlessGroupLasso(**settings)
