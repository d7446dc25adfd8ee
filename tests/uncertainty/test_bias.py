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
from sparsefit.uncertainty.bias import Distortion, noisy_columns
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
