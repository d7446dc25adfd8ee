"""Unknown vehicles: columns that are never penalised, and what is read from them."""

from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.errors import InputError
from sparsefit.model.grid import LengthScaleGrid
from sparsefit.model.library import Library, UnknownColumns, project_out, read_vehicles
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Derivative, Samples

GRID = LengthScaleGrid(2.0, 7.0, step=0.5)
VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
WRONG = sf.PointMassVehicle(2.0, (-1.0, 7.0))
FLOW = sf.CellularFlow(15.0, 4.21)
WIND = (1.5, -2.0)


@cache
def flown():
    flow = sf.flows.SuperposedFlow((FLOW,), WIND)
    return sf.simulate_flight(flow, VEHICLE, duration=10.0, sample_rate=100.0, seed=7)


@pytest.mark.parametrize("method", ["auto", "weak"])
@pytest.mark.parametrize("thrust", [False, True])
def test_rows_of_a_wrong_vehicle_are_the_flow_and_the_columns(method, thrust):
    """Phi_0 = ratio * w + N b with the coefficients that `read` undoes."""
    unknown = ("response_time", "thrust_acceleration" if thrust else "wind")
    believed = sf.PointMassVehicle(2.0, (-1.0, 7.0) if thrust else (5.0, 3.0))
    source = Derivative(method)(flown()).source
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
        vehicle, _, ratio = columns.read(np.array([value]))
        assert vehicle == WRONG
        assert np.isnan(ratio)
    vehicles, wind, ratio = read_vehicles((columns, columns), np.array([3.0, -3.0]))
    assert vehicles[0] == WRONG
    assert vehicles[1].response_time == pytest.approx(0.5)
    assert (wind, ratio) == ((0.0, 0.0), 4.0)
    assert read_vehicles((columns,), np.array([3.0])) == ((WRONG,), (0.0, 0.0), 1.0)


def test_quadratic_drag_and_a_measured_thrust_by_hand():
    # sqrt(c / c_0) = 2: c = 4 c_0; tau_0 (s - s_0) = 0.5 (1.2 - 1) = 0.1
    drag = UnknownColumns(("drag",), sf.PointMassVehicle(float("inf"), (0.0, 0.0), drag=0.1))
    assert drag.read(np.array([-1.0]))[0].drag == pytest.approx(0.4)
    scale = UnknownColumns(("thrust_scale",), sf.PointMassVehicle(0.5))
    assert scale.read(np.array([0.1]))[0].thrust_scale == pytest.approx(1.2)
    zeros = np.zeros((5, 2))
    samples = Samples(np.arange(5.0), zeros, zeros, zeros, zeros, push=np.ones((5, 2)))
    assert scale.columns(samples).tolist() == np.ones((5, 2, 1)).tolist()
    with pytest.raises(InputError, match="needs a measured thrust"):
        scale.columns(Samples(np.arange(5.0), zeros, zeros, zeros, zeros))


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
    flight = sf.Flight(time=time, position=position, velocity=velocity, vehicle=VEHICLE)
    with pytest.raises(InputError, match="too straight"):
        Library(GRID, unknown=("thrust_acceleration",)).build([Derivative()(flight)], [VEHICLE])


@pytest.mark.parametrize(
    ("unknown", "words"),
    [
        (("thrust_acceleration", "wind"), "cannot both be unknown"),
        (("response-time",), 'did you mean "response_time"'),
        ("response_time", "must be a list of names"),
    ],
)
def test_refuses_what_cannot_be_told(unknown, words):
    with pytest.raises(InputError, match=words):
        Library(unknown=unknown)


def test_drag_that_cannot_be_sought_is_refused():
    quadratic = sf.PointMassVehicle(float("inf"), (0.0, 0.0), drag=0.1)
    both = sf.PointMassVehicle(0.5, (0.0, 0.0), drag=0.1)
    for unknown, vehicle, words in (
        (
            ("response_time",),
            both,
            "with linear and quadratic drag, whose rows.* in wind alone",
        ),
        (
            ("response_time",),
            quadratic,
            "with quadratic drag, whose rows.* in drag and wind alone",
        ),
        (
            ("thrust_acceleration",),
            quadratic,
            "with quadratic drag, whose rows",
        ),
        (("drag",), VEHICLE, "without quadratic drag, whose rows"),
    ):
        with pytest.raises(InputError, match=words):
            UnknownColumns(unknown, vehicle)
