"""The noise of a flight, carried through its filters and read from what a fit leaves."""

import math
from dataclasses import replace

import numpy as np
import pytest

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.derivative.filters import Filters
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows, centred
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.influence import Influence, powers, weak_powers
from sparsefit.uncertainty.lags import lagged, overlap
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.noise import Observed, Passage
from sparsefit.uncertainty.reading import cellular
from tests.fits import cells_at

FLOW = sf.CellularFlow(12.0, 4.0)
VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
KNOWN = Nuisance((), VEHICLE)
SMOOTHER = Derivative("savgol", 21, 4)


def flown(duration=8.0, **noise):
    return sf.simulate_flight(FLOW, VEHICLE, duration=duration, sample_rate=100.0, seed=3, **noise)


def filtered_of(samples):
    rows = Rows.of(samples.weak or samples, VEHICLE)
    return Filtered.of(samples, cells_at(rows, FLOW.wavenumber), KNOWN)


def test_variance_is_that_of_white_noise_through_the_filters():
    # The variance of sum c e, e = through(noise) - grad w . place(noise), by brute force.
    exact = flown()
    fit = filtered_of(SMOOTHER(exact))
    filters = replace(fit.filters, sigma_position=0.02, sigma_velocity=0.3)
    fit = replace(fit, filters=filters)
    gradients = cellular(fit.model, KNOWN).gradients
    influence = fit.model.influence(gradients)
    sums, rng = [], np.random.default_rng(8)
    for _ in range(400):
        noise = [sigma * rng.standard_normal(exact.position.shape) for sigma in (0.02, 0.3)]

        def read(kernel, noise=noise):
            return sum(
                np.column_stack([np.correlate(column, one, "valid") for column in values.T])
                for one, values in zip(kernel, noise, strict=True)
            )

        place, velocity, acceleration = (read(kernel) for kernel in filters.raw)
        errors = velocity + VEHICLE.response_time * acceleration
        errors = errors - np.einsum("itm,mi->mt", fit.model.gradient, place)
        sums.append(np.einsum("ftm,mt->f", influence, errors))
    # The level is read from one draw of the errors.
    observed = Observed(fit, errors)
    level = observed.levels
    by_theta = fit.model.information.solved(gradients.T)
    variance = level @ Influence.of(observed, by_theta).by_noise
    np.testing.assert_allclose(variance, np.var(sums, axis=0), rtol=0.35)
    assert level[0] / level[1] == pytest.approx((0.02 / 0.3) ** 2)


def test_levels_are_those_of_the_noise_without_counting_parameters():
    # 40 draws: what 17 columns took of the residuals is known, so the mean level has no bias.
    exact, rng, found = flown(), np.random.default_rng(4), []
    fit = filtered_of(Derivative("midpoint")(exact))
    fit = replace(fit, filters=replace(fit.filters, sigma_position=0.0, sigma_velocity=0.3))
    _, velocity, acceleration = fit.filters.raw
    kernel = velocity[1] + VEHICLE.response_time * acceleration[1]
    for _ in range(40):
        noise = 0.3 * rng.standard_normal(exact.velocity.shape)
        errors = np.stack([np.correlate(row, kernel, "valid") for row in noise.T], axis=1)
        by_theta = fit.model.information.solved(fit.model.jacobian.score(errors))
        left = errors - fit.model.jacobian.times(by_theta[:, None])[0].T
        found.append(Observed(fit, left).levels[1])
    assert np.mean(found) == pytest.approx(0.3**2, rel=0.02)


@pytest.mark.parametrize("method", ["auto", "weak"])
def test_noise_reaches_the_rows_through_every_filter(method):
    # A unit of noise in every raw sample in turn, by dense matrices.
    samples = Derivative(method)(flown(duration=3.0, velocity_noise=0.1))
    filters, m = Filters.of(samples), len(samples.time)
    window = filters.raw.shape[2]
    dense = np.zeros((3, 2, m, m + window - 1))
    for i in range(m):
        dense[:, :, i, i : i + window] = filters.raw
    place, velocity, acceleration = dense
    weak = samples.weak
    mean, rate = np.eye(m), acceleration
    if weak:
        mean, rate = weak.operator.toarray(), weak.rate.toarray() @ velocity
    weights = np.random.default_rng(1).standard_normal((1, 8, 2))
    rows = Rows.of(weak or samples, VEHICLE)
    assert len(rows.position) == m
    np.testing.assert_array_equal(rows.position, centred(samples.position))
    model = Model(Cells(), rows, np.array([[FLOW.wavenumber]]), weights, np.zeros(0))
    fit = Filtered.of(samples, model, KNOWN)
    influence = np.random.default_rng(2).standard_normal((2, 2, len(mean)))
    passage = Passage.of(filters, m)
    if weak:
        found = weak_powers(fit, weak, passage, influence)
    else:
        found = powers(fit, passage, influence, np.fft.rfft(influence, passage.size))
    steps, h = m + window - 2, 0.01
    time = np.arange(steps + 1) * h
    kicked = np.clip(time[:, None] - time[None, :-1], 0.0, h)  # velocity after a unit of V'
    moved = np.where(kicked > h / 2, h * (time[:, None] - time[None, :-1] - h / 2), 0.0)
    np.fill_diagonal(moved, 0.0)
    by_kick = np.tensordot(rate[0], moved, (1, 0)) + np.tensordot(rate[1], kicked, (1, 0))
    expected = np.zeros((3, 2))
    for f in range(2):
        for component in range(2):
            expected[2, f] += np.sum((influence[f, component] @ by_kick) ** 2)
        for raw in range(2):
            for axis in range(2):  # noise of one axis: of both components, through the gradient
                total = -sum((influence[f, t] @ mean) * model.gradient[axis, t] for t in range(2))
                row = total @ place[raw]
                row = row + influence[f, axis] @ (mean @ velocity[raw] + 0.5 * rate[raw])
                expected[raw, f] += np.sum(row**2)
    np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_white_residuals_have_the_white_variance():
    rng = np.random.default_rng(4)
    influence, errors = rng.standard_normal((3, 2, 4000)), 0.3 * rng.standard_normal((4000, 2))
    variance = lagged(influence, errors, 0, 0.0)
    by_hand = sum(np.mean(errors[:, t] ** 2) * np.sum(influence[:, t] ** 2, axis=1) for t in (0, 1))
    np.testing.assert_allclose(variance, by_hand, rtol=1e-9)
    smooth = np.ones(influence.shape)  # the variance of a sum of errors that correlate over 5
    averaged = np.stack([np.convolve(e, np.ones(5), "same") for e in errors.T], axis=1)
    wide, narrow = (lagged(smooth, averaged, lags, 0.0)[0] for lags in (40, 0))
    assert 3.5 < wide / narrow < 5.5  # 5 of independent ones


def test_rows_that_overlap_by_their_windows():
    # windows of 21 samples, every 2nd: 10.5 rows share a sample, twice that is 21
    samples = Derivative("weak", window=21)(flown())
    assert overlap(samples) == 21
    assert math.isnan(SMOOTHER(flown()).smoothing.sigma_position)
