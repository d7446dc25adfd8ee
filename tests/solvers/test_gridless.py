"""The gridless group-LASSO over cells and over the plane: derivatives, supremum, certificate."""

import math
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit import backends
from sparsefit.model import LengthScaleGrid, Library
from sparsefit.model.continuum import MISSED
from sparsefit.model.fitting import FlowRows, descended
from sparsefit.model.shapes import axis_cells
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.group_penalties import GroupNorms
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Derivative
from sparsefit.solvers.continuous_dual import Scanner, continuous_alpha_max, continuous_gap
from sparsefit.solvers.gridless import Atoms, GridlessGroupLasso
from sparsefit.solvers.lassos import GroupLasso
from tests.problems import VEHICLE, flight, flight_problem

TURNED = sf.flows.ShapedCells(12.0, 4.2, heading=math.radians(25.0), offset=(1.0, 0.5))
WAVES = Library(LengthScaleGrid(3.0, 8.0), family="waves", every=10)
BOUNDS = (math.pi / 12, math.pi)


GRID = LengthScaleGrid()


def library_problem(flown, grid=GRID):
    return Library(grid).build(Derivative()(flown), flown.vehicle)


@cache
def turned_flight():
    return sf.simulate_flight(
        TURNED, VEHICLE, duration=8.0, sample_rate=100.0, seed=7, velocity_noise=0.2,
        position_noise=0.05,
    )  # fmt: skip


@cache
def case(family):
    """A problem of the family, its continuum, bounds, and the grid that a study would narrow."""
    if family == "cells":
        problem = library_problem(flight(3.33, seed=4))
        grids = [LengthScaleGrid(3.0, 4.0, count=n, spacing="wavenumber") for n in (5, 9, 33)]
        libraries = [Library(grid) for grid in grids]
        samples, vehicle = Derivative()(flight(3.33, seed=4)), VEHICLE
    else:
        samples, vehicle = Derivative()(turned_flight()), VEHICLE
        problem = WAVES.build(samples, VEHICLE)
        narrow = replace(WAVES, grid=LengthScaleGrid(4.0, 4.4))
        libraries = [replace(narrow, waves=sf.model.WaveGrid(step)) for step in (1.0, 0.4, 0.16)]
    plane = problem.continuum
    return SimpleNamespace(
        problem=problem, continuum=plane, bounds=plane.interval(None, None),
        finer=[library.build(samples, vehicle) for library in libraries],
    )  # fmt: skip


BOTH = pytest.mark.parametrize("family", ["cells", "waves"])


def heights_at(continuum, residual, places):
    """|Z(q)'R|_F / m at places (s, p), from the columns themselves."""
    theta = continuum.design(places)[0]
    z = theta / np.sqrt(np.mean(theta**2, axis=0))
    return np.linalg.norm((z.T @ residual).reshape(len(places), -1), axis=1) / len(residual)


def anywhere(own, count=700):
    rng = np.random.default_rng(1)
    k = rng.uniform(*own.bounds, count)
    return np.column_stack([k, rng.uniform(0.0, math.pi, count)])[:, : own.continuum.parameters]


def two_flows(first, second, seed, velocities=(10.0, 6.0)):
    flow = sf.flows.SuperposedFlow(tuple(map(sf.CellularFlow, velocities, (first, second))))
    vehicle = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(12.0, 7.0))
    return sf.simulate_flight(flow, vehicle, duration=30.0, sample_rate=100.0, seed=seed)


def group_norms(weights):
    return np.sqrt(np.sum(weights.reshape(-1, 16) ** 2, axis=1))


def test_the_columns_of_the_plane_are_those_of_the_grid():
    own = case("waves")
    again = own.problem.at(own.continuum.places(own.problem.parameters))
    np.testing.assert_allclose(again.theta, own.problem.theta, atol=1e-9)
    np.testing.assert_allclose(again.group_scales, own.problem.group_scales)
    assert own.bounds == pytest.approx((math.sqrt(2) * math.pi / 8, math.sqrt(2) * math.pi / 3))


@BOTH
@pytest.mark.parametrize("offset", [0.0, 40.0])
def test_no_place_exceeds_the_supremum_found(family, offset):
    own, rng = case(family), np.random.default_rng(1)
    continuum = replace(own.continuum, position=own.continuum.position + offset)
    scanner = Scanner.of(continuum, own.bounds)
    for residual in (own.problem.target, rng.normal(size=own.problem.target.shape)):
        top = scanner.peaks(residual)[0][1]
        assert heights_at(continuum, residual, anywhere(own)).max() <= top * (1 + 1e-12)
        assert scanner.scan.heights(residual).max() >= top * (1 - 3 * MISSED)


@BOTH
@pytest.mark.parametrize("alpha", [0.0, 0.3])
def test_derivatives_of_the_slide(family, alpha):
    own, rng = case(family), np.random.default_rng(0)
    places = np.array([[0.5, 2.0], [0.9, 0.4]])[:, : own.continuum.parameters]
    spans, shape = own.continuum.spans(places), (2, own.continuum.size, own.problem.targets)
    start = np.concatenate([(places * spans).ravel(), rng.normal(size=math.prod(shape))])

    def at(point):
        q, weights = np.split(point, [places.size])
        weights = weights.reshape(shape)
        q = q.reshape(places.shape) / spans
        return Atoms.at(own.continuum, own.problem.target, q, weights, alpha)

    gradient, hessian = at(start).derivatives(alpha, spans)
    ends = [(at(start + e), at(start - e)) for e in 1e-5 * np.eye(len(start))]
    slope = [(above.value - below.value) / 2e-5 for above, below in ends]
    bend = [
        (above.derivatives(alpha, spans)[0] - below.derivatives(alpha, spans)[0]) / 2e-5
        for above, below in ends
    ]
    np.testing.assert_allclose(gradient, slope, atol=1e-6 * np.abs(gradient).max())
    np.testing.assert_allclose(hessian, bend, atol=1e-6 * np.abs(hessian).max())


@BOTH
@pytest.mark.parametrize("alpha_fraction", [0.5, 0.1, 0.02])
def test_the_gap_closes_over_the_continuum(family, alpha_fraction):
    own, backend = case(family), GridlessGroupLasso(alpha_fraction)
    solution = backend.solve(own.problem)
    assert solution.status == "ok"
    certificate = backend.certify(own.problem, solution)
    assert certificate.kind == "duality_gap"
    assert certificate.value < 1e-9
    top = continuous_alpha_max(own.continuum, own.problem.target, own.bounds)
    residual = own.problem.target - solution.problem.theta @ solution.weights
    eta = heights_at(own.continuum, residual, anywhere(own)) / (alpha_fraction * top)
    assert eta.max() <= 1 + 1e-7
    chosen = own.continuum.places(solution.problem.parameters)
    at_chosen = heights_at(own.continuum, residual, chosen) / (alpha_fraction * top)
    np.testing.assert_allclose(at_chosen, 1.0, atol=1e-6)


@BOTH
def test_the_certificate_sees_a_wrong_answer(family):
    own, backend = case(family), GridlessGroupLasso(0.1)
    good = backend.solve(own.problem)
    moved = own.continuum.places(good.problem.parameters) * [1.003, 1.0][: own.continuum.parameters]
    for weights, there in ((1.01 * good.weights, good.problem),
                           (good.weights, own.problem.at(moved))):  # fmt: skip
        wrong = Solution(weights, problem=there)
        assert backend.certify(own.problem, wrong).value > 1e-5


@BOTH
def test_finer_grids_descend_to_the_gridless_optimum(family):
    own = case(family)
    lower, upper = (3.0, 4.0) if family == "cells" else (4.0, 4.4)
    backend, bounds = GridlessGroupLasso(0.1, lower, upper), own.continuum.interval(lower, upper)
    limit = backend.certify(own.problem, backend.solve(own.problem)).primal
    alpha = 0.1 * continuous_alpha_max(own.continuum, own.problem.target, bounds)
    over = []
    for grid in own.finer:
        places = own.continuum.places(grid.parameters)
        top = heights_at(own.continuum, grid.target, places).max()
        weights = GroupLasso(alpha / float(top)).solve(grid).weights
        over.append(continuous_gap(grid, weights, alpha, bounds).primal - limit)
    assert over[0] > over[1] > over[2] > 0
    assert over[2] < 0.01 * limit


def test_gap_on_the_grid_bounds_the_gap_on_the_continuum():
    """One formula: with the dual norm over fewer scales, the gap can only be smaller."""
    problem = flight_problem()
    alpha = 0.1 * continuous_alpha_max(problem.continuum, problem.target, BOUNDS)
    weights = GroupLasso(0.1).solve(problem).weights
    penalty, alphas = GroupNorms(problem.groups, np.ones(len(problem.group_scales))), [alpha]
    grid = duality_gaps(problem.design, problem.target, weights[None], np.array(alphas), penalty)[0]
    whole = continuous_gap(problem, weights, alpha, (math.pi / 7, math.pi / 2))
    assert whole.primal == pytest.approx(grid.primal)
    assert whole.value >= grid.value


def refined(problem, scales):
    """The wavenumbers of cells of a stream function that fit the rows best, from scales [m]."""
    place = problem.continuum.position - problem.continuum.position.mean(axis=0)
    rows = np.column_stack([place, np.zeros(len(place))])
    rows = FlowRows(rows, problem.target, np.zeros((len(rows), 2, 0)))
    return descended(rows, axis_cells(len(scales)), np.pi / np.array(scales)).q


@pytest.mark.parametrize(("ratio", "seed"), [(1.3, 0), (2.0, 2)])
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
    problem, backend = flight_problem(4.2), GridlessGroupLasso(0.1, lower=4.5, upper=6.0)
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
    moved = replace(flown, position=flown.position + 1e4)
    solution = GridlessGroupLasso(0.1).solve(library_problem(moved))
    strongest = np.argmax(group_norms(solution.weights))
    assert solution.status == "ok"
    assert solution.problem.group_scales[strongest] == pytest.approx(4.2, rel=0.01)


@pytest.mark.parametrize("groups", ["ring", "nested"])
def test_groups_of_several_waves_are_refused(groups):
    problem = replace(WAVES, groups=groups).build(Derivative()(turned_flight()), VEHICLE)
    solution = GridlessGroupLasso(0.1).solve(problem)
    assert solution.status == "error"
    assert "in groups by wave" in solution.reason


def test_parametric_least_squares_knows_cells_alone():
    solution = backends.get("parametric-nls").solve(case("waves").problem)
    assert solution.status == "error"
    assert "family 'cells'" in solution.reason


def test_without_positions_it_refuses():
    problem = RegressionProblem.from_arrays(np.eye(4)[:, :3] + 0.1, np.arange(4.0))
    solution = GridlessGroupLasso().solve(problem)
    assert solution.status == "error"
    assert "position" in solution.reason
    assert solution.weights is None


@pytest.mark.parametrize(
    "settings", [{"alpha_fraction": 0.0}, {"lower": -1.0}, {"lower": 5.0, "upper": 2.0}]
)
def test_settings_out_of_range(settings):
    with pytest.raises(sf.InputError):
        GridlessGroupLasso(**settings)


def test_it_estimates_the_turned_cells():
    estimator = sf.Estimator(library=WAVES, backend="gridless-group-lasso")
    estimate = estimator.estimate(turned_flight())
    assert (estimate.status, estimate.shape) == ("ok", "square")
    assert estimate.mean_velocity == pytest.approx(12.0, rel=0.01)
    assert estimate.length_scale == pytest.approx(4.2, rel=0.002)
    assert math.degrees(estimate.heading) == pytest.approx(25.0, abs=0.2)
    backend, readout = GridlessGroupLasso(0.03), sf.Readout(refine="none")
    shrunk = replace(estimator, backend=backend, readout=readout).estimate(turned_flight())
    track = turned_flight().position.T
    truth = TURNED.velocity(*track)
    error = np.linalg.norm(shrunk.flow.velocity(*track) - truth)
    assert error < 0.08 * np.linalg.norm(truth)
