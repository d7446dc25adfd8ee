"""Named causes of a misfit: their columns by differences, their sizes where the truth is known."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.estimator import Doubt
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.uncertainty import Cause
from sparsefit.uncertainty.causes import columns
from sparsefit.uncertainty.filtered import Filtered
from tests.fits import cells_at

U0, L = 12.0, 4.0
VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
FLOW = sf.CellularFlow(U0, L)
STEP = 1e-5


@pytest.fixture(scope="module")
def fit():
    flight = sf.simulate_flight(FLOW, VEHICLE, duration=6.0, sample_rate=100.0, seed=2)
    samples = Derivative("savgol", 11, 4)(flight)
    rows = Rows.of(samples, VEHICLE)
    exact = replace(rows, target=FLOW.velocity(*rows.position.T))
    return Filtered.of(samples, cells_at(exact, FLOW.wavenumber), Nuisance((), VEHICLE))


def moved(cause, size, x, y, t):
    """The flow as a cause of this size makes it, by its definition."""
    if cause is Cause.DRIFT:
        return FLOW.velocity(x - size * t, y)
    if cause is Cause.TURN:
        cos, sin = math.cos(size), math.sin(size)
        along, across = FLOW.velocity(cos * x + sin * y, cos * y - sin * x).T
        return np.stack([cos * along - sin * across, sin * along + cos * across], axis=-1)
    if cause is Cause.STRETCH:  # psi(x (1 - s), y (1 + s)), u = psi_y, v = -psi_x
        return FLOW.velocity(x * (1 - size), y * (1 + size)) * np.array([1 + size, 1 - size])
    return FLOW.velocity(x, y) + np.array([size, 0.0])


@pytest.mark.parametrize("cause", [Cause.WIND, Cause.DRIFT, Cause.TURN, Cause.STRETCH])
def test_columns_are_the_derivatives_of_the_flow(fit, cause):
    x, y = fit.plain.rows.position.T
    time = fit.samples.time
    t = time - 0.5 * (time[0] + time[-1])
    ahead, behind = (moved(cause, size, x, y, t) for size in (STEP, -STEP))
    expected = ((ahead - behind) / (2 * STEP)).T
    np.testing.assert_allclose(columns(fit)[cause][0], expected, atol=1e-3 * U0)


@pytest.mark.parametrize("drag", [0.0, 0.2])
def test_the_column_of_drag_is_the_derivative_of_phi(drag):
    believed = PointMassVehicle(math.inf if drag else 0.5, (5.0, 3.0), drag)
    flight = sf.simulate_flight(FLOW, believed, duration=4.0, sample_rate=100.0, seed=2)
    samples = Derivative("savgol", 11, 4)(flight)
    exact = replace(Rows.of(samples, believed), target=FLOW.velocity(*samples.position.T))
    model = cells_at(exact, FLOW.wavenumber)
    own = Filtered.of(samples, model, Nuisance((), believed))
    # What the believed vehicle would have read, had the true one a little more drag of either kind.
    true = {
        Cause.DRAG: replace(believed, drag=drag + STEP),
        Cause.LINEAR_DRAG: replace(believed, response_time=1 / (believed.rate + STEP)),
    }
    for cause in (Cause.DRAG, Cause.LINEAR_DRAG) if drag else (Cause.DRAG,):
        read = [
            believed.flow_velocity(
                samples.velocity, vehicle.acceleration(samples.velocity, model.flow)
            )
            for vehicle in (true[cause], believed)
        ]
        expected = (read[0] - read[1]).T / STEP
        close = 2e-3 * np.abs(expected).max()
        np.testing.assert_allclose(columns(own)[cause][0], expected, rtol=2e-3, atol=close)
    assert (Cause.RESPONSE_TIME in columns(own)) == (drag == 0.0)


def test_the_column_of_the_response_time_is_the_derivative_of_phi(fit):
    longer = PointMassVehicle(0.5 + STEP, (5.0, 3.0))
    # What the vehicle would have read, were its response time believed too short by a step.
    acceleration = (FLOW.velocity(*fit.plain.rows.position.T) - fit.samples.velocity) / 0.5
    acceleration += np.array(VEHICLE.thrust_acceleration)
    pair = [one.flow_velocity(fit.samples.velocity, acceleration) for one in (longer, VEHICLE)]
    expected = -(pair[0] - pair[1]).T / STEP
    np.testing.assert_allclose(columns(fit)[Cause.RESPONSE_TIME][0], expected, rtol=1e-6)


WORLDS = {
    Cause.WIND: (sf.SuperposedFlow((FLOW,), (0.8, -0.4)), 0.5, (0.8, -0.4)),
    Cause.RESPONSE_TIME: (FLOW, 0.45, (0.05,)),
    Cause.SWELLING: (sf.ShapedCells(U0, L, swell=0.2, swell_period=9.0), 0.5, (0.14,)),
    Cause.DRIFT: (sf.ShapedCells(U0, L, drift=(0.03, -0.05)), 0.5, (0.03, -0.05)),
    Cause.TURN: (sf.ShapedCells(U0, L, heading=0.02), 0.5, (0.02,)),
    Cause.STRETCH: (sf.ShapedCells(U0, (L * 1.005, L * 0.995)), 0.5, (0.01,)),
}


@pytest.mark.parametrize("cause", WORLDS)
def test_a_cause_is_named_and_sized(cause):
    flow, believed, size = WORLDS[cause]
    noise = {"velocity_noise": 0.05, "position_noise": 0.01}
    flight = sf.simulate_flight(flow, VEHICLE, duration=12.0, sample_rate=100.0, seed=5, **noise)
    flight = replace(flight, vehicle=PointMassVehicle(believed, (5.0, 3.0)), flow=None)
    found = sf.Estimator(readout=sf.Readout(refine="variable-projection")).estimate(flight)
    suspect = found.goodness.suspect
    assert suspect.cause is cause
    np.testing.assert_allclose(suspect.size, size, rtol=0.35, atol=0.01)
    assert found.status == "misfit"
    assert found.doubt is Doubt.MISFIT
    assert found.to_dict()["goodness"]["suspect"]["cause"] == str(cause)


@pytest.mark.parametrize("cause", [Cause.DRIFT, Cause.TURN, Cause.STRETCH])
def test_what_the_default_reads_is_no_misfit(cause):
    flow = WORLDS[cause][0]
    noise = {"velocity_noise": 0.05, "position_noise": 0.01}
    flight = sf.simulate_flight(flow, VEHICLE, duration=12.0, sample_rate=100.0, seed=5, **noise)
    found = sf.Estimator().estimate(flight)
    assert found.status == "ok"
    assert found.heading == pytest.approx(0.02 if cause is Cause.TURN else 0.0, abs=0.001)
    drift = (0.03, -0.05) if cause is Cause.DRIFT else (0.0, 0.0)
    assert found.drift == pytest.approx(drift, abs=0.005)
    sides = (L * 1.005, L * 0.995) if cause is Cause.STRETCH else (L, L)
    assert found.length_scales == pytest.approx(sides, rel=0.001)


def test_what_is_freed_is_suspected_no_more():
    flow, _, wind = WORLDS[Cause.WIND]
    flight = sf.simulate_flight(
        flow, VEHICLE, duration=12.0, sample_rate=100.0, seed=5, velocity_noise=0.1
    )
    found = sf.Estimator().estimate(flight)
    assert found.reason.endswith('free it: unknown = ["wind"] (--unknown wind)')
    freed = sf.Estimator(library=sf.Library(unknown=("wind",))).estimate(flight)
    assert freed.status == "ok"
    assert freed.wind == pytest.approx(wind, abs=0.05)


@pytest.mark.parametrize("mean_velocity", ["peak", "paper"])
def test_no_reading_of_the_velocity_hides_a_misfit(mean_velocity):
    noise = {"velocity_noise": 0.05, "position_noise": 0.01}
    readout = sf.Readout(mean_velocity=mean_velocity)
    for flow, status in ((WORLDS[Cause.DRIFT][0], "misfit"), (FLOW, "ok")):
        flight = sf.simulate_flight(
            flow, VEHICLE, duration=12.0, sample_rate=100.0, seed=5, **noise
        )
        found = sf.Estimator(readout=readout).estimate(flight)
        assert found.status == status
        assert found.goodness.r_squared > 0.9
        assert found.uncertainty is None
