"""What smoothing and noisy columns take from a fit."""

import math

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative, Samples
from sparsefit.derivative.filters import Filters
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows, centred
from sparsefit.uncertainty.bias import Distortion, _load_of_averages, noisy_columns
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.reading import cellular
from tests.fits import cells_at, located

FLOW = sf.CellularFlow(12.0, 4.0)
VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
KNOWN = Nuisance((), VEHICLE)
SMOOTHER = Derivative("savgol", 21, 4)


@pytest.fixture(scope="module")
def exact():
    return sf.simulate_flight(FLOW, VEHICLE, duration=8.0, sample_rate=100.0, seed=3)


def with_position_noise(model, sigma):
    """A fit of samples whose positions are noisy, and nothing else."""
    raw = np.zeros((3, 2, 1))
    raw[0, 0], raw[1, 1] = 1.0, 1.0
    filters = Filters(raw, np.ones(1), None, None, sigma, 0.0)
    position = model.rows.position
    samples = Samples(np.arange(len(position)) * 0.01, position, position, position, position)
    return Filtered(samples, filters, model, model, PointMassVehicle(0.5), 0.5, shared=False)


@pytest.mark.parametrize(
    "rule", [Derivative("forward"), Derivative("midpoint"), SMOOTHER], ids=lambda rule: rule.method
)
def test_truncation_is_found_without_the_truth(rule, exact):
    samples = rule(exact)
    model = cells_at(Rows.of(samples, VEHICLE), FLOW.wavenumber)
    distortion = Distortion.of(model.rows.position, samples.velocity, Filters.of(samples))
    lost = distortion.of_samples(model, Filtered.of(samples, model, KNOWN))
    known = (lost != 0).any(axis=1)
    true = model.rows.target - FLOW.velocity(*samples.position.T)
    assert distortion.share == pytest.approx(len(lost) / known.sum())
    assert np.std((lost - true)[known]) < 0.05 * np.std(true[known])


def test_position_noise_attenuates_a_plane_wave():
    # Evenly over whole cells: C'e = -s^2 |kappa|^2/2 C'C W, so each weight loses its share.
    s, axis = 0.1, np.arange(64) * 0.25 - 7.875
    points = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    weights = np.zeros((1, 8, 2))
    weights[0, 0, 0], weights[0, 5, 0], weights[0, 6, 1] = 2.0, 12.0, -12.0
    rows = Rows.plain(points, np.zeros(points.shape))
    model = Model(Cells(), rows, np.array([[FLOW.wavenumber]]), weights, np.zeros(0))
    score = noisy_columns(with_position_noise(model, s))[1:].reshape(2, 8)
    k2, m = FLOW.wavenumber**2, len(points)
    assert score[0, 5] == pytest.approx(-(s**2) * k2 * 12.0 * m / 4)  # C'C: m/4 of a product,
    assert score[0, 0] == pytest.approx(-0.5 * s**2 * k2 * 2.0 * m / 2)  # m/2 of a single


def test_position_noise_shifts_the_fit_as_a_monte_carlo_says(exact):
    # Noise of the position alone, Phi exact: an ill-determined flight loses more than a wave does.
    s, phi = 0.05, FLOW.velocity(*exact.position.T)
    rows = Rows.plain(exact.position, phi)
    model = cells_at(rows, FLOW.wavenumber)
    before = cellular(model, KNOWN).values
    shifted = model.moved(noisy_columns(with_position_noise(model, s)))
    expected = cellular(shifted, KNOWN).values - before
    rng, shifts = np.random.default_rng(5), []
    for _ in range(60):
        noise = s * rng.standard_normal(phi.shape)
        for sign in (-1, 1):  # antithetic: the first order cancels
            moved = Rows(centred(rows.position + sign * noise), phi, rows.nuisance)
            fit = located(moved, [[FLOW.wavenumber]])
            shifts.append(cellular(Model.of(Cells(), moved, fit), KNOWN).values - before)
    mean, error = np.mean(shifts, axis=0), np.std(shifts, axis=0) / math.sqrt(len(shifts))
    assert abs(mean[0] - expected[0]) < 4 * error[0] + 0.1 * abs(expected[0])
    assert abs(expected[0]) > 10 * error[0]


def test_noise_that_averages_share_is_that_of_whole_matrices():
    noise = {"velocity_noise": 0.2, "position_noise": 0.05}
    flight = sf.simulate_flight(FLOW, VEHICLE, duration=3.0, sample_rate=100.0, seed=3, **noise)
    samples = Derivative("weak")(flight)
    fit = Filtered.of(samples, cells_at(Rows.of(samples.weak, VEHICLE), FLOW.wavenumber), KNOWN)
    variances = np.array([[fit.filters.sigma_position], [fit.filters.sigma_velocity]]) ** 2
    count, size = len(samples.time), fit.filters.raw.shape[2]
    place, velocity = np.zeros((2, 2, count, count + size - 1))  # of raw samples, by channel
    for i in range(count):
        place[:, i, i : i + size], velocity[:, i, i : i + size] = fit.filters.raw[:2]
    of_place, of_velocity = (
        np.sum(variances[:, :, None] * place @ other.swapaxes(1, 2), axis=0)
        for other in (place, velocity)
    )
    mean, rate = samples.weak.operator.toarray(), samples.weak.rate.toarray()
    load = _load_of_averages(fit, samples.weak, variances)
    for axis, component in np.ndindex(2, 2):
        shared = -of_place @ (mean * fit.model.gradient[axis, component]).T
        if axis == component:
            shared += of_velocity @ (mean + VEHICLE.response_time * rate).T
        expected = np.sum(mean.T * shared, axis=1)
        np.testing.assert_allclose(load[axis, component], expected, atol=1e-12 * abs(load).max())


def test_noisy_columns_attenuate_averages_where_the_path_tells_little():
    vehicle, flow = PointMassVehicle(0.1, (20.0, 12.0)), sf.CellularFlow(7.8, 4.3)
    exact = sf.simulate_flight(flow, vehicle, duration=15.0, sample_rate=100.0, seed=30027)
    away, rng = [], np.random.default_rng(0)
    for _ in range(12):
        place, speed = (s * rng.standard_normal(exact.position.shape) for s in (0.05, 0.2))
        noisy = sf.Flight(exact.time, exact.position + place, exact.velocity + speed, vehicle)
        samples, known = Derivative("weak")(noisy), Nuisance((), vehicle)
        rows = Rows.of(samples.weak, vehicle)
        model = Model.of(Cells(), rows, located(rows, [[flow.wavenumber]]))
        better = model.moved(-noisy_columns(Filtered.of(samples, model, known)))
        away.append([cellular(one, known).values[0] - 7.8 for one in (model, better)])
    mean, doubt = np.mean(away, axis=0), np.std(away, axis=0) / math.sqrt(12)
    assert mean[0] < -4 * doubt[0]
    assert abs(mean[1]) < 0.4 * abs(mean[0])
