"""Candidates (Eqs. 17-19), grids, unknown vehicles, and the problems that libraries make."""

import math
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.waves import WaveFlow
from sparsefit.model import library as room
from sparsefit.model.grid import (
    CANDIDATES,
    LengthScaleGrid,
    sines_and_cosines,
    wave_columns,
    wave_rings,
)
from sparsefit.model.grid import candidate_columns as columns_of
from sparsefit.model.library import Library, UnknownColumns, project_out
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Derivative, Samples
from tests.problems import SMALL_GRID, VEHICLE, flight, fly

GRID = LengthScaleGrid(3.0, 8.0)
WAVES = Library(GRID, family="waves", every=10)
POSITION = np.random.default_rng(5).uniform(-20.0, 20.0, (40, 2))


def test_columns_are_the_formulas_of_eq_19_group_by_group():
    rng = np.random.default_rng(1)
    position, scales = rng.uniform(-40, 40, (150, 2)), np.array([1.0, 4.2, 12.0])
    theta = columns_of(position, scales)
    assert theta.shape == (150, 24)
    for j, scale in enumerate(scales):
        x, y = np.pi * position.T / scale
        parts = {"sin x": np.sin(x), "sin y": np.sin(y), "cos x": np.cos(x), "cos y": np.cos(y)}
        for c, name in enumerate(CANDIDATES):
            expected = parts[name[:5]] * parts.get(name[6:], 1.0)
            np.testing.assert_allclose(theta[:, 8 * j + c], expected, atol=1e-13)


def test_sines_and_cosines_are_those_of_numpy():
    phase = np.concatenate([np.linspace(-50.0, 50.0, 2001), np.pi * np.arange(-9, 10)])
    sine, cosine = sines_and_cosines(phase)
    np.testing.assert_allclose(sine, np.sin(phase), atol=7e-16 * 50)
    np.testing.assert_allclose(cosine, np.cos(phase), atol=7e-16 * 50)


def test_waves_are_those_of_a_flow():
    k = np.array([[0.7, -0.4], [0.2, 1.1]])
    a, b = np.array([[1.0, -0.5], [0.3, 0.8]])
    flow = WaveFlow(k, a, b).velocity(*POSITION.T)
    theta = wave_columns(POSITION, k)
    np.testing.assert_allclose(theta @ np.column_stack([a, b]).ravel(), flow.ravel(), atol=1e-13)


def test_grids_by_hand():
    paper = LengthScaleGrid()
    assert len(paper.scales) == paper.size == 56
    assert paper.scales.tolist() == [round(1 + 0.2 * i, 12) for i in range(56)]  # 4.2 exactly
    assert LengthScaleGrid(2.0, 4.0, count=5).scales == pytest.approx([2.0, 2.5, 3.0, 3.5, 4.0])
    assert LengthScaleGrid(3.0, 3.0).scales.tolist() == [3.0]
    assert LengthScaleGrid(3.0, 9.0, count=1).size == 1
    with pytest.raises(InputError, match="every flight"):
        _ = LengthScaleGrid(2.0, 8.0, spacing="flight").scales


@given(st.floats(0.1, 5.0), st.floats(0.0, 20.0), st.floats(0.05, 3.0))
def test_a_grid_by_step_stays_within_its_bounds(lower, width, step):
    grid = LengthScaleGrid(lower, lower + width, step=step)
    scales = grid.scales
    assert len(scales) == grid.size
    assert scales[0] == pytest.approx(lower, abs=1e-12)
    assert lower + width - step - 1e-9 <= scales[-1] <= lower + width + 1e-8
    assert np.all(np.diff(scales) > 0)


@given(st.floats(0.1, 5.0), st.floats(0.1, 20.0), st.integers(2, 300))
def test_a_grid_uniform_in_wavenumber_ascends_between_its_bounds(lower, width, count):
    scales = LengthScaleGrid(lower, lower + width, count=count, spacing="wavenumber").scales
    assert len(scales) == count
    assert scales[[0, -1]] == pytest.approx([lower, lower + width])
    steps = np.diff(np.pi / scales[::-1])
    np.testing.assert_allclose(steps, steps.mean(), rtol=1e-6)
    assert np.all(np.diff(scales) > 0)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        *(({"lower": bad}, "lower") for bad in (0.0, -1.0, float("nan"), "1")),
        ({"upper": float("inf")}, "upper"),
        ({"lower": 5.0, "upper": 4.0}, "swap"),
        *(({"step": bad}, "step") for bad in (0.0, float("nan"))),
        ({"step": 0.1, "count": 5}, "not both"),
        ({"count": 0}, "count"),
        ({"count": 2.5}, "integer"),
        ({"count": True}, "count"),
        ({"spacing": "wavenumber"}, "needs count"),
        ({"spacing": "wave-number"}, 'did you mean "wavenumber"'),
        ({"step": 1e-9}, "larger step"),
        ({"spacing": "flight", "step": 0.2}, "not step"),
        ({"spacing": "flight", "count": 3}, "not step or count"),
        ({"spacing": "flight", "fraction": 0.0}, "lobe"),
    ],
)
def test_bad_grids_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        LengthScaleGrid(**settings)


@pytest.mark.parametrize("target", ["flow-velocity", "acceleration", "state-derivative"])
def test_a_library_builds_theta_target_groups_and_names(target):
    samples = Derivative()(flight())
    problem = Library(SMALL_GRID, target).build([samples], [VEHICLE])
    scales = SMALL_GRID.scales
    columns = columns_of(samples.position, scales)
    np.testing.assert_allclose(problem.theta, columns, rtol=1e-6, atol=1e-14)
    expected = {
        "flow-velocity": 0.5 * (samples.acceleration - [5.0, 3.0]) + samples.velocity,
        "acceleration": samples.acceleration,
        "state-derivative": np.hstack([samples.position_rate, samples.acceleration]),
    }[target]
    np.testing.assert_allclose(problem.target, expected, rtol=1e-6, atol=1e-12)
    assert len(problem.target_names) == problem.targets
    assert problem.groups.tolist() == np.repeat(range(len(scales)), 8).tolist()
    assert problem.group_scales.tolist() == scales.tolist()
    assert problem.names[8] == "sin x (L = 2.5 m)"
    assert (problem.samples, problem.columns) == problem.theta.shape


def test_a_large_flight_is_compressed_to_the_same_inner_products(monkeypatch):
    for settings in ({}, {"unknown": ("response_time", "wind")}):
        for method in ("auto", "weak"):
            samples, library = Derivative(method)(flight()), Library(SMALL_GRID, **settings)
            whole = library.build([samples], [VEHICLE])
            monkeypatch.setattr(room, "STREAM_BYTES", 0)
            folded = library.build([samples], [VEHICLE])
            monkeypatch.undo()
            assert folded.samples == whole.samples
            assert len(folded.theta) <= whole.columns + whole.targets + 3  # of unknowns
            for name in ("theta", "target"):
                inner = (getattr(p, name).T @ p.theta for p in (folded, whole))
                np.testing.assert_allclose(*inner, atol=1e-7)


def test_rows_are_compressed_from_five_more_than_columns_on(monkeypatch):
    monkeypatch.setattr(room, "STREAM_BYTES", 0)
    samples, columns = Derivative()(flight()), 8 * len(SMALL_GRID.scales)
    for more, rows in ((0, columns), (4, columns + 4), (5, columns + 2)):  # 2 are of the target
        problem = Library(SMALL_GRID).build([samples.rows(slice(columns + more))], [VEHICLE])
        assert (problem.columns, problem.samples) == (columns, columns + more)
        assert len(problem.theta) == rows


def test_rows_of_several_flights_have_their_weights():
    samples = Derivative()(flight())
    library = Library(SMALL_GRID)
    alone = library.build([samples], [VEHICLE])
    both = library.build([samples] * 2, [VEHICLE] * 2, [1.0, 0.5])
    np.testing.assert_allclose(both.theta.T @ both.theta, 1.25 * alone.theta.T @ alone.theta)
    np.testing.assert_allclose(both.theta.T @ both.target, 1.25 * alone.theta.T @ alone.target)


def test_weak_rows_average_the_columns():
    samples = Derivative("weak")(flight())
    problem = Library(SMALL_GRID).build([samples], [VEHICLE])
    expected = samples.averages.operator @ columns_of(samples.averages.position, SMALL_GRID.scales)
    np.testing.assert_allclose(problem.theta, expected, atol=1e-13)
    np.testing.assert_array_equal(problem.target, samples.averages.flow_velocity(VEHICLE))


def test_a_grid_of_the_flight_is_resolved_when_the_library_is_built():
    flown = fly(CellularFlow(10.0, 4.0), duration=3.0, rate=50.0, seed=7)
    samples = Derivative("central")(flown)
    assert LengthScaleGrid(2.0, 8.0, spacing="flight").fraction == 0.25
    grid = LengthScaleGrid(2.0, 8.0, spacing="flight", fraction=0.5)
    problem = Library(grid).build([samples], [VEHICLE])
    extent = np.ptp(samples.position, axis=0).max()
    # Lobes are 2 pi / extent wide in k: half of one at most from scale to scale.
    count = int(np.ceil((1 / 2 - 1 / 8) * extent)) + 1
    assert len(problem.group_scales) == count
    np.testing.assert_allclose(np.diff(1 / problem.group_scales), -0.375 / (count - 1))
    assert grid.resolving(extent) == LengthScaleGrid(2.0, 8.0, count=count, spacing="wavenumber")
    plain = LengthScaleGrid(2.0, 8.0)
    assert plain.resolving(extent) is plain


@pytest.fixture(scope="module")
def samples():
    return Derivative()(flight(velocity_noise=0.1))


@pytest.fixture(scope="module")
def problem(samples):
    return WAVES.build([samples], [VEHICLE])


def test_rings_leave_no_wave_of_the_annulus_farther_than_a_lobe_allows():
    (k, _, _), apart = wave_rings(3.0, 8.0, 20.0), math.pi / 20.0
    rng = np.random.default_rng(1)
    size = math.sqrt(2.0) * math.pi / rng.uniform(3.0, 8.0, 300)
    angle = rng.uniform(0.0, math.pi, 300)
    anywhere = size[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    both = np.concatenate([k, -k])  # k and -k are one wave
    nearest = np.linalg.norm(anywhere[:, None] - both, axis=2).min(axis=1)
    assert nearest.max() <= apart / math.sqrt(2.0) * 1.001
    assert nearest.max() >= 0.5 * apart  # and it is no finer than asked


def test_rings_are_length_scales_of_square_cells_over_half_the_plane():
    k, ring, scales = wave_rings(3.0, 8.0, 20.0)
    sizes = np.linalg.norm(k, axis=1)
    assert math.sqrt(2.0) * math.pi / sizes == pytest.approx(scales[ring])
    assert scales[[0, -1]] == pytest.approx([3.0, 8.0])
    assert (np.diff(scales) > 0).all()
    angles = np.arctan2(*k.T[::-1])
    assert ((angles >= 0) & (angles < math.pi)).all()


def test_rows_are_x_and_y_of_one_sample_after_the_other(samples, problem):
    thin = slice(None, None, 10)
    phi = samples.flow_velocity(VEHICLE)[thin]
    np.testing.assert_array_equal(problem.target[:, 0], phi.ravel())
    assert problem.theta.shape == (2 * len(phi), 2 * len(problem.group_scales))
    assert problem.target_names == ("w_x w_y",)


@pytest.mark.parametrize("groups", ["wave", "nested"])
def test_groups_are_waves_or_rings_of_them(samples, problem, groups):
    built = Library(GRID, family="waves", every=10, groups=groups).build([samples], [VEHICLE])
    waves = np.arange(problem.columns) // 2
    sizes = math.sqrt(2.0) * math.pi / built.group_scales
    k = problem.parameters
    assert sizes[built.groups] == pytest.approx(np.linalg.norm(k, axis=1)[waves])
    if groups == "wave":
        np.testing.assert_array_equal(built.groups, waves)
    else:
        assert built.groups.max() + 1 == len(np.unique(built.group_scales))
    assert (built.subgroups is None) == (groups != "nested")
    if built.subgroups is not None:
        np.testing.assert_array_equal(built.subgroups, waves)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"family": "wave"}, 'unknown family of the library "wave": did you mean "waves"'),
        ({"family": "waves", "groups": "waves"}, 'did you mean "wave"'),
        ({"groups": "nested"}, "'groups' is a setting of family 'waves', not of 'cells'"),
        ({"family": "waves", "target": "acceleration"}, "needs family 'cells'"),
        ({"target": "flow-velocty"}, 'did you mean "flow-velocity"'),
        ({"unknown": ("wind",), "target": "acceleration"}, "needs the target 'flow-velocity'"),
        ({"grid": (1.0, 12.0)}, "grid must be a LengthScaleGrid, not a tuple"),
        ({"every": 0}, "every must be an integer, 1 or above"),
        ({"unknown": ("thrust_acceleration", "wind")}, "cannot both be unknown"),
        ({"unknown": ("response-time",)}, 'did you mean "response_time"'),
        ({"unknown": "response_time"}, "unknown parameter of the vehicle"),
    ],
)
def test_settings_that_cannot_be_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        Library(**settings)


def test_a_grid_too_large_says_how_many_waves_and_what_to_narrow():
    with pytest.raises(InputError, match=r"resolves 2.* waves down to 1 m, more than 2048: raise"):
        wave_rings(1.0, 12.0, 30.0)
    with pytest.raises(InputError, match="does not move"):
        wave_rings(1.0, 12.0, 0.0)
    for least, extent in ((1e-9, 1e9), (1.0, 60.0)):
        with pytest.raises(InputError, match="raise the grid's lower bound to about") as refused:
            wave_rings(least, 12.0, extent)
    lower = float(str(refused.value).split("about ")[1].split(" m")[0])
    assert len(wave_rings(1.05 * lower, 12.0, 60.0)[1]) <= 2048


def test_the_weak_form_is_not_thinned():
    library = Library(GRID, family="waves", every=2)
    with pytest.raises(InputError, match="'every' thins samples, but the weak form"):
        library.build([Derivative("weak")(flight())], [VEHICLE])


WRONG = sf.PointMassVehicle(2.0, (-1.0, 7.0))
FLOW, WIND = CellularFlow(15.0, 4.21), (1.5, -2.0)


@cache
def flown():
    return fly(sf.flows.SuperposedFlow((FLOW,), WIND), seed=7)


@pytest.mark.parametrize("method", ["auto", "weak"])
@pytest.mark.parametrize("thrust", [False, True])
def test_rows_of_a_wrong_vehicle_are_the_flow_and_the_columns(method, thrust):
    """Phi_0 = ratio * w + N b with the coefficients that `read` undoes."""
    unknown = ("response_time", "thrust_acceleration" if thrust else "wind")
    believed = sf.PointMassVehicle(2.0, (-1.0, 7.0) if thrust else (5.0, 3.0))
    samples = Derivative(method)(flown())
    source = samples.averages or samples
    columns = UnknownColumns(unknown, believed)
    wind = np.array(WIND if thrust else (0.0, 0.0))  # of the flow that is not sought
    flow = FLOW.velocity(*source.position.T) + wind
    flow = source.operator @ flow if method == "weak" else flow
    ratio = 2.0 / 0.5
    shift = 2.0 * (np.array([5.0, 3.0]) - [-1.0, 7.0]) if thrust else ratio * np.array(WIND)
    coefficients = np.array([1 - ratio, *shift])
    rows = ratio * flow + columns.columns(source) @ coefficients
    np.testing.assert_allclose(rows, source.flow_velocity(believed), atol=1e-4)
    vehicle, blowing, share = columns.read(coefficients)
    assert share == ratio
    assert vehicle.response_time == pytest.approx(0.5)
    assert vehicle.thrust_acceleration == pytest.approx((5.0, 3.0))
    assert blowing == pytest.approx((0.0, 0.0) if thrust else WIND)


def test_vehicles_that_cannot_be_are_those_believed():
    columns = UnknownColumns(("response_time",), WRONG)
    for value in (1.0, 3.0, np.nan):
        vehicle, wind, ratio = columns.read(np.array([value]))
        assert (vehicle, wind, np.isnan(ratio)) == (WRONG, (0.0, 0.0), True)
    alone, both = (SimpleNamespace(unknowns=(columns,) * count) for count in (1, 2))
    vehicles, wind, ratio = sf.model.Search.vehicles(both, np.array([3.0, -3.0]))
    assert (vehicles[0], wind, ratio) == (WRONG, (0.0, 0.0), 4.0)
    assert vehicles[1].response_time == pytest.approx(0.5)
    assert sf.model.Search.vehicles(alone, np.array([3.0])) == ((WRONG,), (0.0, 0.0), 1.0)


def test_quadratic_drag_and_a_measured_thrust_by_hand():
    # sqrt(c / c_0) = 2: c = 4 c_0; tau_0 (s - s_0) = 0.5 (1.2 - 1) = 0.1
    drag = UnknownColumns(("drag",), sf.PointMassVehicle(float("inf"), (0.0, 0.0), drag=0.1))
    assert drag.read(np.array([-1.0]))[0].drag == pytest.approx(0.4)
    scale = UnknownColumns(("thrust_scale",), sf.PointMassVehicle(0.5))
    assert scale.read(np.array([0.1]))[0].thrust_scale == pytest.approx(1.2)
    zeros = np.zeros((5, 2))
    samples = Samples(np.arange(5.0), zeros, zeros, zeros, zeros, push=np.ones((5, 2)))
    assert scale.columns(samples).tolist() == np.ones((5, 2, 1)).tolist()


def test_projecting_out_is_the_joint_penalised_problem():
    rng = np.random.default_rng(5)
    theta, free = rng.standard_normal((40, 6)), rng.standard_normal((40, 2))
    target = theta[:, :1] + free @ [[3.0], [-2.0]] + rng.standard_normal((40, 1))
    left, rest = project_out(np.linalg.qr(free)[0], theta, target)
    problem = RegressionProblem.from_arrays(left, rest)
    weights = sf.fit(problem, sf.backends.get("lasso", alpha_fraction=0.2)).weights
    # Optimal in the joint problem: no slope by free weights, and the penalty's by the others.
    residual = target - theta @ weights
    residual -= free @ np.linalg.lstsq(free, residual, rcond=None)[0]
    rms = np.sqrt(np.mean(left**2, axis=0))[:, None]
    slope, zero = (theta.T @ residual / rms).ravel(), weights.ravel() == 0
    alpha = 0.2 * np.abs(left.T @ rest / rms).max()
    assert 0 < zero.sum() < 6
    assert np.abs(slope[zero]).max() < alpha
    np.testing.assert_allclose(slope[~zero], alpha * np.sign(weights[~zero, 0]), rtol=1e-5)


@pytest.mark.parametrize("shared", [False, True])
def test_a_basis_spans_its_columns(shared):
    source = Derivative()(flown())
    columns = UnknownColumns(("response_time", "wind"), VEHICLE)
    basis = columns.basis(source, shared=shared)
    assert basis.shape[1] == 3
    np.testing.assert_allclose(basis.T @ basis, np.eye(3), atol=1e-12)
    both = columns.columns(source)
    spanned = both.reshape(-1, 3) if shared else np.hstack([source.velocity, both[:, :1, 1]])
    np.testing.assert_allclose(basis @ (basis.T @ spanned), spanned, atol=1e-10)


def test_a_straight_line_tells_no_vehicle():
    time = np.arange(500) / 100.0
    position = np.column_stack([10 * time + np.sin(time), np.full(500, 2.0)])
    velocity = np.column_stack([10 + np.cos(time), np.zeros(500)])
    line = sf.Flight(time=time, position=position, velocity=velocity, vehicle=VEHICLE)
    flights = [Derivative()(own) for own in (flight(), line)]
    with pytest.raises(InputError, match=r"^flight 2: a candidate .*too straight"):
        Library(SMALL_GRID, unknown=("thrust_acceleration",)).build(
            flights, [VEHICLE] * 2, (1.0, 1.0)
        )
