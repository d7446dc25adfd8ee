"""An unknown vehicle: columns that are never penalised, and what is read from them."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.errors import InputError
from sparsefit.library import builder as library
from sparsefit.library.builder import Library
from sparsefit.library.cells import Cells
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.library.nuisance import Nuisance, VehicleEstimate, project_out
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project
from sparsefit.modes.search import locate_one
from sparsefit.modes.space import SearchSpace
from sparsefit.regression.problem import RegressionProblem

GRID = LengthScaleGrid(2.0, 7.0, step=0.5)
VEHICLE = sf.PointMassVehicle(0.5, (5.0, 3.0))
WRONG = sf.PointMassVehicle(2.0, (-1.0, 7.0))
FLOW = sf.CellularFlow(15.0, 4.21)
WIND = (1.5, -2.0)
EVERY = [
    ("response_time",),
    ("thrust_acceleration",),
    ("wind",),
    ("response_time", "thrust_acceleration"),
    ("response_time", "wind"),
]


@cache
def truly(windy, **noise):
    flow = sf.SuperposedFlow((FLOW,), WIND) if windy else FLOW
    return sf.simulate_flight(flow, VEHICLE, duration=10.0, sample_rate=100.0, seed=7, **noise)


def flown(unknown=(), vehicle=WRONG, **noise):
    """A flight, in a wind where that is unknown, with a wrong vehicle in what is unknown."""
    flight = truly("wind" in unknown, **noise)
    tau = vehicle.response_time if "response_time" in unknown else 0.5
    thrust = vehicle.thrust_acceleration if "thrust_acceleration" in unknown else (5.0, 3.0)
    return replace(flight, vehicle=sf.PointMassVehicle(tau, thrust))


def rows_of(unknown, method="auto", **noise):
    flight = flown(unknown, **noise)
    samples = Derivative(method)(flight)
    return Rows.of(samples.weak or samples, flight.vehicle, unknown), samples, flight


def stacked(rows, k):
    """The joint design of both components, the slow way: 16 weights and the unknown columns."""
    value = rows.averaged(Cells().values(rows.position, np.array([[k]]))[0]).T
    zero = np.zeros_like(value)
    design = np.block([[value, zero], [zero, value]])
    return np.hstack([design, rows.nuisance.reshape(len(design), -1)]), rows.target.T.ravel()


@pytest.mark.parametrize("method", ["auto", "weak"])
@pytest.mark.parametrize("unknown", EVERY)
def test_without_noise_all_is_found(unknown, method):
    estimate = sf.Estimator(method, Library(GRID, unknown=unknown)).estimate(flown(unknown))
    assert estimate.status == "ok"
    assert estimate.length_scale == pytest.approx(FLOW.length_scale, rel=1e-8)
    assert estimate.timescale == pytest.approx(FLOW.timescale, rel=1e-6)
    if "response_time" in unknown:
        assert estimate.response_time == pytest.approx(0.5, rel=1e-6)
    else:
        assert math.isnan(estimate.response_time)
    for name, truth in (("thrust_acceleration", (5.0, 3.0)), ("wind", WIND)):
        found = getattr(estimate, name)
        assert found == (pytest.approx(truth, rel=1e-5) if name in unknown else None)


@pytest.mark.parametrize("refine", ["none", "variable-projection"])
def test_what_is_believed_of_the_unknown_changes_nothing(refine):
    unknown = ("response_time", "thrust_acceleration")
    estimator = sf.Estimator(
        library=Library(GRID, unknown=unknown), readout=sf.Readout(refine=refine)
    )
    flights = [flown(unknown, one, velocity_noise=0.3) for one in (VEHICLE, WRONG)]
    one, other = (estimator.estimate(flight) for flight in flights)
    assert other.mean_velocity == pytest.approx(one.mean_velocity, rel=1e-8)
    assert other.response_time == pytest.approx(one.response_time, rel=1e-8)
    assert other.thrust_acceleration == pytest.approx(one.thrust_acceleration, rel=1e-7)


def test_parameters_by_hand():
    # tau_0 = 2, tau = 1/2: 1 - tau_0/tau = -3; tau_0 (a - a_0) = 2 (5 + 1, 3 - 7) = (12, -8)
    both = Nuisance(("response_time", "thrust_acceleration"), WRONG)
    found = both.read(np.array([-3.0, 12.0, -8.0]))
    assert (found.response_time, found.thrust_acceleration) == (0.5, (5.0, 3.0))
    # (tau_0/tau) wind = 4 (1.5, -2) = (6, -8)
    found = Nuisance(("response_time", "wind"), WRONG).read(np.array([-3.0, 6.0, -8.0]))
    assert (found.response_time, found.wind) == (0.5, WIND)
    assert Nuisance(("wind",), WRONG).read(np.array([6.0, -8.0])).wind == (6.0, -8.0)
    assert not Nuisance(("response_time",), WRONG).read(np.array([1.0])).possible
    assert not VehicleEstimate(-0.5, (0.0, 0.0), (0.0, 0.0), ("response_time",)).possible


def test_projecting_out_is_the_joint_penalised_problem():
    cvxpy = pytest.importorskip("cvxpy")
    rng = np.random.default_rng(5)
    theta, free = rng.standard_normal((40, 6)), rng.standard_normal((40, 2))
    target = theta[:, :1] + free @ [[3.0], [-2.0]] + rng.standard_normal((40, 1))
    left, rest = project_out(np.linalg.qr(free)[0], theta, target)
    problem = RegressionProblem.from_arrays(left, rest)
    found = sf.fit(problem, sf.backends.get("lasso", alpha_fraction=0.2))
    alpha = (
        0.2 * float(np.abs(left.T @ rest / np.sqrt(np.mean(left**2, axis=0))[:, None]).max()) / 40
    )
    weights, loose = cvxpy.Variable((6, 1)), cvxpy.Variable((2, 1))
    size = cvxpy.norm1(cvxpy.multiply(np.sqrt(np.mean(left**2, axis=0))[:, None], weights))
    loss = cvxpy.sum_squares(target - theta @ weights - free @ loose) / 80
    cvxpy.Problem(cvxpy.Minimize(loss + alpha * size)).solve(solver="CLARABEL")
    np.testing.assert_allclose(found.weights, weights.value, atol=1e-5)


def at(rows, k):
    return project(Cells(), rows, np.array([[k]]))


@pytest.mark.parametrize("method", ["auto", "weak"])
@pytest.mark.parametrize("unknown", EVERY)
def test_the_fit_is_joint_least_squares(unknown, method):
    rows = rows_of(unknown, method, velocity_noise=0.3)[0]
    for k in (0.5, 0.7462, 1.2):
        design, target = stacked(rows, k)
        found, residual = np.linalg.lstsq(design, target)[:2]
        assert at(rows, k).residual == pytest.approx(residual[0], rel=1e-9)
        np.testing.assert_allclose(at(rows, k).weights.T.ravel(), found[:16], rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("unknown", EVERY)
def test_the_scan_is_the_residual(unknown):
    rows, samples, flight = rows_of(unknown, velocity_noise=0.3)
    space = SearchSpace.of(samples, flight.vehicle, (0.55, 0.95), unknown)
    curve = space.residuals(space.empty)
    expected = np.array([at(rows, k).residual for k in space.scan.wavenumbers.tolist()])
    size = float(np.sum(rows.target**2))
    np.testing.assert_allclose(curve, expected, rtol=2e-3, atol=1e-4 * size)
    assert curve.argmin() == expected.argmin()


@pytest.mark.parametrize("method", ["auto", "weak"])
def test_the_move_is_the_gauss_newton_step(method):
    unknown = ("response_time", "wind")
    rows, samples, flight = rows_of(unknown, method)
    bounds = (math.pi / 7.0, math.pi / 2.0)
    found = locate_one(SearchSpace.of(samples, flight.vehicle, bounds, unknown))
    k = float(found.wavenumbers[0])
    assert k + 1e-4 + at(rows, k + 1e-4).moves[0, 0] == pytest.approx(k, abs=1e-6)


@pytest.mark.parametrize("method", ["auto", "weak"])
def test_a_long_flight_is_projected_as_it_is_folded(method, monkeypatch):
    unknown = ("response_time", "thrust_acceleration")
    _, samples, flight = rows_of(unknown, method, velocity_noise=0.3)
    whole = Library(GRID, unknown=unknown).build(samples, flight.vehicle)
    monkeypatch.setattr(library, "STREAM_BYTES", 0)
    folded = Library(GRID, unknown=unknown).build(samples, flight.vehicle)
    assert folded.samples == whole.samples
    assert len(folded.theta) < len(whole.theta)
    np.testing.assert_allclose(
        folded.theta.T @ folded.theta, whole.theta.T @ whole.theta, atol=1e-8
    )
    np.testing.assert_allclose(
        folded.theta.T @ folded.target, whole.theta.T @ whole.target, atol=1e-7
    )


def test_still_air_is_still_whatever_is_believed():
    air = sf.CellularFlow(1e-12, 4.0)
    flight = sf.simulate_flight(
        air, VEHICLE, duration=10.0, sample_rate=100.0, seed=7, initial_velocity=(9, 4)
    )
    believed = replace(flight, vehicle=WRONG)
    estimator = sf.Estimator(
        library=Library(GRID, unknown=("response_time", "thrust_acceleration"))
    )
    estimate = estimator.estimate(believed)
    assert estimate.status == "unidentifiable"


def test_a_flight_run_backwards_has_no_response_time():
    # In reverse v' keeps its sign and v does not: tau comes out as -0.5 s.
    flight = flown()
    backwards = sf.Flight(
        time=flight.time,
        position=flight.position[::-1],
        velocity=-flight.velocity[::-1],
        vehicle=VEHICLE,
    )
    estimate = sf.Estimator(library=Library(GRID, unknown=("response_time",))).estimate(backwards)
    assert estimate.status == "unidentifiable"
    assert "response time that fits best is" in estimate.reason
    assert math.isnan(estimate.mean_velocity)


def test_a_straight_line_tells_no_vehicle():
    time = np.arange(500) / 100.0
    position = np.column_stack([10 * time + np.sin(time), np.full(500, 2.0)])
    velocity = np.column_stack([10 + np.cos(time), np.zeros(500)])
    flight = sf.Flight(time=time, position=position, velocity=velocity, vehicle=VEHICLE)
    with pytest.raises(InputError, match="too straight"):
        sf.Estimator(library=Library(GRID, unknown=("thrust_acceleration",))).estimate(flight)


@pytest.mark.parametrize(
    ("unknown", "words"),
    [
        (("thrust_acceleration", "wind"), "cannot both be unknown"),
        (("response_time", "thrust_acceleration", "wind"), "cannot both be unknown"),
        (("response-time",), 'did you mean "response_time"'),
        ("response_time", "must be a list of names"),
        (7, "must be a list of names"),
    ],
)
def test_refuses_what_cannot_be_told(unknown, words):
    with pytest.raises(InputError, match=words):
        Library(unknown=unknown)


def test_refuses_another_target():
    with pytest.raises(InputError, match="needs the target 'flow-velocity'"):
        Library(target="acceleration", unknown=("wind",))


def test_json_round_trip_and_order():
    estimator = sf.Estimator(library=Library(GRID, unknown=["wind", "response_time"]))
    assert estimator.library.unknown == ("response_time", "wind")
    assert sf.Estimator.from_json(estimator.to_json()) == estimator
    values = estimator.estimate(flown(("wind",))).to_dict()
    assert values["response_time"] == pytest.approx(0.5, rel=1e-6)
    assert values["thrust_acceleration"] is None
