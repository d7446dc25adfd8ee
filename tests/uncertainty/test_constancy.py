"""The rate at which U0 changes: what least squares of one column more says, and how sure it is."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.flight.flow import ShapedCells
from sparsefit.library.cells import Cells
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import project
from sparsefit.uncertainty.constancy import Constancy, Growth, Share
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.model import Model

VEHICLE = sf.PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
SPEED, SCALE, DURATION = 15.43, 4.21, 6.0
REFINED = sf.Estimator(readout=sf.Readout(refine="variable-projection"))


def growing(share, seed=1, noise=0.2, start=(1.0, 0.0)):
    """A flight through cells whose U0 grows by a share in a second: the rise of a slow sine."""
    swell = 0.9 if share else 0.0
    period = 2 * math.pi * swell / share if share else 20.0
    flow = ShapedCells(SPEED, (SCALE, SCALE), swell=swell, swell_period=period)
    return sf.simulate_flight(
        flow, VEHICLE, duration=DURATION, sample_rate=100.0, seed=seed, initial_position=start,
        velocity_noise=noise, position_noise=0.1 * noise,
    )  # fmt: skip


def fitted(flight):
    samples = Derivative()(flight)
    rows = Rows.of(samples, VEHICLE)
    model = Model.of(Cells(), rows, project(Cells(), rows, np.array([[math.pi / SCALE]])))
    return Filtered.of(samples, model, Nuisance((), VEHICLE))


def test_the_share_is_that_of_a_regression_with_one_column_more():
    fit = fitted(growing(0.004))
    growth = Growth.of([fit])
    model, time = fit.model, fit.samples.time
    grown = ((time - time.mean())[:, None] * model.flow).T[None]
    columns = np.concatenate([model.jacobian.times(np.eye(model.jacobian.size)), grown])
    flat = columns.reshape(len(columns), -1).T
    expected = np.linalg.lstsq(flat, model.residual.T.ravel(), rcond=1e-10)[0][-1]
    assert growth.share([model.residual], [fit]) == pytest.approx(expected, rel=1e-6)


def test_two_flights_alike_say_the_same_of_it():
    fit = fitted(growing(0.004))
    half = replace(fit, weight=math.sqrt(0.5))
    one, two = Growth.of([fit]), Growth.of([half, half])
    rest = fit.model.residual
    share = one.share([rest], [fit])
    assert two.share([rest, rest], [half, half]) == pytest.approx(share, rel=1e-6)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.02])
def test_the_rate_of_change_is_seen(share):
    found = REFINED.estimate(growing(share, noise=0.0 if share == 0.001 else 0.2)).constancy
    assert abs(found.rate - share * SPEED) < 3 * found.standard_error
    assert found.interval[0] < found.rate < found.interval[1]
    assert (found.p_value < 1e-4) == (share != 0.0)


def test_a_change_from_flight_to_flight_is_seen_where_clocks_are_one():
    first, second = growing(0.0), growing(0.0, seed=2, start=(-2.0, 1.0))
    later = sf.Flight(second.time + 60.0, second.position, second.velocity, VEHICLE)
    found = REFINED.estimate([first, later]).constancy
    assert abs(found.rate) < 3 * found.standard_error
    alone = REFINED.estimate(first).constancy
    assert found.standard_error < 0.1 * alone.standard_error  # 66 s tell more than 6


def test_p_values_and_intervals_are_of_one_law():
    at_edge = Constancy.of(Share(0.1, 0.1 / 2.2281388519649385, 10.0), 2.0)
    assert at_edge.p_value == pytest.approx(0.05, rel=1e-6)
    assert at_edge.interval[0] == pytest.approx(0.0, abs=1e-9)
    assert at_edge.rate == pytest.approx(0.2)
