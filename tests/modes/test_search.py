import math

import numpy as np
import pytest

from sparsefit.derivative import Derivative
from sparsefit.errors import InputError
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import candidate_columns, rms_mean_velocity
from sparsefit.modes.search import locate_one
from sparsefit.modes.space import SearchSpace
from tests.references import residual_curve

VEHICLES = PointMassVehicle(0.1, (20.0, 12.0)), PointMassVehicle(0.5, (5.0, 3.0))
LOWER, UPPER = 1.0, 12.0


def draw(seed, vehicle):
    rng = np.random.default_rng(seed)
    scale, timescale, duration = rng.uniform(2, 10), rng.uniform(0.05, 1), rng.uniform(10, 15)
    flow = CellularFlow(scale / timescale, scale)
    return simulate_flight(flow, vehicle, duration=round(duration, 2), sample_rate=100.0, seed=seed)


def noisy(flight, seed):
    rng = np.random.default_rng([seed, 1])
    shape = flight.position.shape
    return Flight(
        time=flight.time,
        position=flight.position + 0.1 * rng.standard_normal(shape),
        velocity=flight.velocity + 0.5 * rng.standard_normal(shape),
        vehicle=flight.vehicle,
        flow=flight.flow,
    )


def measured(flight, derivative):
    samples = derivative(flight)
    return samples.position, samples.flow_velocity(flight.vehicle)


def refine(position, phi, start=None, *, lower=LOWER, upper=UPPER):
    space = SearchSpace.plain(position, phi, (math.pi / upper, math.pi / lower))
    return locate_one(space, None if start is None else math.pi / start)


def wavenumber(found):
    return float(found.wavenumbers[0])


def scale(found):
    return math.pi / wavenumber(found)


def rival(found):
    return math.pi / found.rival.wavenumber


def check(flight, seed):
    """Never worse than the truth; exact in the absence of noise; a wrong lobe is flagged."""
    true = flight.flow.length_scale
    exact, phi = measured(flight, Derivative("savgol", 5, 4))
    found = refine(exact, phi, lower=LOWER, upper=UPPER)
    assert found.identifiable
    assert scale(found) == pytest.approx(true, rel=1e-5)
    speed = rms_mean_velocity(found.fit.weights[0])
    assert speed == pytest.approx(flight.flow.mean_velocity, rel=2e-3)
    rough, phi = measured(noisy(flight, seed), Derivative("savgol", 11, 4))
    found = refine(rough, phi, lower=LOWER, upper=UPPER)
    at_truth = residual_curve(rough, phi, np.array([math.pi / true]))[0]
    assert found.fit.residual <= at_truth * (1 + 1e-9)
    lobe = math.pi / np.ptp(rough, axis=0).max()
    if abs(wavenumber(found) - math.pi / true) > lobe:
        assert not found.identifiable
        assert abs(math.pi / rival(found) - math.pi / true) < lobe


@pytest.fixture(scope="module")
def sample():
    return measured(draw(3, VEHICLES[1]), Derivative())


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("seed", range(8))
def test_finds_the_true_lobe(seed, vehicle):
    check(draw(seed, vehicle), seed)


@pytest.mark.slow
@pytest.mark.parametrize("vehicle", VEHICLES)
def test_finds_the_true_lobe_of_300_flights(vehicle):
    for seed in range(1000, 1150):
        check(draw(seed, vehicle), seed)


def test_curve_is_least_squares(sample):
    position, phi = sample
    ks = np.array([0.3, 0.8, 2.9])
    expected = [
        np.linalg.lstsq(candidate_columns(position, np.array([math.pi / k])), phi)[1].sum()
        for k in ks
    ]
    np.testing.assert_allclose(residual_curve(position, phi, ks), expected, rtol=1e-9)


def test_curve_does_not_move_with_the_origin(sample):
    position, phi = sample
    ks = np.linspace(0.3, 3, 20)
    np.testing.assert_allclose(
        residual_curve(position + np.array([713.0, -91.0]), phi, ks),
        residual_curve(position, phi, ks),
        rtol=1e-8,
    )


def test_move_is_the_gauss_newton_step(sample):
    found = refine(*sample)
    k = wavenumber(found)
    near = found.space.at(np.array([k + 1e-4]))
    assert k + 1e-4 + near.moves[0, 0] == pytest.approx(k, abs=1e-7)


def test_minimum_is_sharp(sample):
    found = refine(*sample, lower=LOWER, upper=UPPER)
    near = wavenumber(found) * (1 + np.array([-1e-6, 1e-6]))
    assert (residual_curve(*sample, near) > found.fit.residual).all()
    assert abs(found.fit.moves[0, 0]) < 1e-11


def test_start_does_not_change_the_answer(sample):
    free = refine(*sample, lower=LOWER, upper=UPPER)
    for start in (1.3, 4.0, 11.0):
        again = refine(*sample, start)
        assert wavenumber(again) == pytest.approx(wavenumber(free), rel=1e-12)


def test_scale_outside_the_interval_is_at_its_bound_or_has_rivals():
    flight = draw(3, VEHICLES[1])
    position, phi = measured(flight, Derivative())
    true = flight.flow.length_scale
    found = refine(position, phi, lower=true * 1.001, upper=true * 1.5)
    assert found.edge == wavenumber(found)
    assert not found.identifiable
    assert scale(found) == pytest.approx(true * 1.001)


def test_diagonal_flight_names_the_half_scale_as_rival():
    # On y = x, sin kx cos kx = sin(2kx)/2: L and L/2 fit alike.
    x = np.linspace(0, 60, 1500)
    position = np.column_stack([x, x])
    phi = CellularFlow(10.0, 4.0).velocity(x, x)
    phi = phi + 0.3 * np.random.default_rng(0).standard_normal(phi.shape)
    found = refine(position, phi, lower=LOWER, upper=6.0)
    assert not found.identifiable
    pair = sorted([scale(found), rival(found)])
    assert pair == pytest.approx([2.0, 4.0], rel=1e-2)


def test_flight_without_signal_is_not_identifiable(sample):
    position = sample[0]
    phi = np.random.default_rng(1).standard_normal(position.shape)
    assert not refine(position, phi, lower=LOWER, upper=UPPER).identifiable
    assert not refine(position, phi, lower=11.9, upper=12.0).identifiable  # one lobe, no rival
    assert not refine(position, np.zeros_like(phi), lower=LOWER, upper=UPPER).identifiable


def test_refuses_more_lobes_than_can_be_held(sample):
    with pytest.raises(InputError, match="too many lobes"):
        refine(*sample, lower=1e-6, upper=1.0)


def test_refuses_a_flight_that_stands_still():
    with pytest.raises(InputError, match="does not move"):
        refine(np.ones((50, 2)), np.ones((50, 2)), lower=LOWER, upper=UPPER)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_lobes_that_are_spared_would_change_nothing(seed, monkeypatch):
    flight = noisy(draw(seed, VEHICLES[seed % 2]), seed)
    seen = measured(flight, Derivative("savgol", 11, 4))
    quick = refine(*seen, 1.5)
    monkeypatch.setattr(SearchSpace, "least", lambda *_: 0.0)
    thorough = refine(*seen, 1.5)
    assert len(quick.ends) < len(thorough.ends)
    assert quick.fit.residual == thorough.fit.residual
    assert quick.rival == thorough.rival
