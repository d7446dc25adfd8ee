"""The projection: identities of variable projection, for any modes, rows and nuisances."""

import math

import numpy as np
import pytest

from sparsefit.derivative import Derivative
from sparsefit.flight import simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project

VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
UNKNOWN = ("response_time", "thrust_acceleration")
K = [[math.pi / 4.3], [1.4]]
STEP = 1e-6


def rows_of(method, unknown):
    flow = CellularFlow(12.0, 4.0)
    flight = simulate_flight(flow, VEHICLE, duration=8.0, sample_rate=50.0, seed=3)
    samples = Derivative(method)(flight)
    return Rows.of(samples.weak or samples, VEHICLE, unknown)


ROWS = [rows_of(method, unknown) for method in ("auto", "weak") for unknown in ((), UNKNOWN)]
kinds = pytest.mark.parametrize("rows", ROWS, ids=["plain", "unknown", "weak", "weak unknown"])
modes = pytest.mark.parametrize("count", [0, 1, 2])


@kinds
@modes
def test_it_is_the_least_squares_on_all_columns(rows, count):
    parameters = np.array(K[:count]).reshape(count, 1)
    values = Cells().values(rows.position, parameters).reshape(8 * count, len(rows.position))
    columns = rows.averaged(values).T
    zero = np.zeros_like(columns)
    stacked = np.block([[columns, zero, rows.nuisance[0]], [zero, columns, rows.nuisance[1]]])
    target = rows.target.T.ravel()
    weights = np.linalg.lstsq(stacked, target, rcond=None)[0]
    rest = target - stacked @ weights
    fit = project(Cells(), rows, parameters)
    size = np.linalg.norm(target)
    np.testing.assert_allclose(fit.rest.T.ravel(), rest, atol=1e-8 * size)
    assert fit.residual == pytest.approx(rest @ rest, abs=1e-10 * size**2)
    expected = weights[16 * count :]
    np.testing.assert_allclose(fit.coefficients, expected, rtol=1e-6, atol=1e-9)


@kinds
@modes
def test_the_move_is_that_of_gauss_newton(rows, count):
    """Its slope is the derivative of RSS/2; one move from near the optimum lands nearer."""
    parameters = np.array(K[:count]).reshape(count, 1)
    fit = project(Cells(), rows, parameters)
    if not count:
        assert fit.moves.shape == (0, 1)
        return
    ahead = [
        project(Cells(), rows, parameters + sign * STEP * fit.moves).residual for sign in (1, -1)
    ]
    falling = (ahead[0] - ahead[1]) / (2 * STEP)
    assert falling < 0


@kinds
def test_the_move_ends_where_the_flow_is(rows):
    k = math.pi / 4.0
    near = k + 1e-3
    move = project(Cells(), rows, np.array([[near]])).moves[0, 0]
    assert abs(near + move - k) < 0.02 * abs(near - k)
