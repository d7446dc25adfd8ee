"""Turbulence along the path as noise: found where it is, free of charge where it is not."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.stack import Part
from sparsefit.uncertainty import bias
from sparsefit.uncertainty.assessment import assess, reader
from sparsefit.uncertainty.corrected import corrected
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.goodness import whiteness
from sparsefit.uncertainty.influence import Influence
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.noise import Observed
from sparsefit.uncertainty.reading import cellular
from sparsefit.uncertainty.turbulence import BLOCKS, Turbulence, jackknifed
from tests.fits import located

FLOW = sf.CellularFlow(12.0, 4.0)
VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
KNOWN = Nuisance((), VEHICLE)
MEASURED = {"velocity_noise": 0.2, "position_noise": 0.05}


@cache
def sampled(method="auto"):
    """Samples of 10 s in cells and noise of the sensors."""
    flight = sf.simulate_flight(FLOW, VEHICLE, duration=10.0, sample_rate=100.0, seed=3, **MEASURED)
    return Derivative(method)(flight)


def gusts(samples, speed, seed=0, memory=0.3):
    """What turbulence of this rms [m/s] that is forgotten over 0.3 s adds to Phi (m, 2)."""
    kept = math.exp(-float(np.mean(np.diff(samples.time))) / memory)
    kicks = np.random.default_rng(seed).standard_normal((len(samples.time), 2))
    kicks[1:] *= math.sqrt(1 - kept**2)
    return speed * lfilter([1.0], [1.0, -kept], kicks, axis=0)


@cache
def fitted(speed=0.0, method="auto", seed=0):
    """Samples, rows and fit, with turbulence of this rms [m/s] added to Phi."""
    samples = sampled(method)
    if speed:
        added = samples.acceleration + gusts(samples, speed, seed) / VEHICLE.response_time
        samples = replace(samples, acceleration=added)
    rows = Rows.of(samples.weak or samples, VEHICLE)
    return samples, rows, located(rows, [[FLOW.wavenumber]])


def left_of(*flight):
    samples, rows, fit = fitted(*flight)
    whole = Filtered.of(samples, Model.of(Cells(), rows, fit), KNOWN)
    return Turbulence(Observed(whole, bias.without_truncation(whole).at_samples))


def test_white_noise_pays_nothing():
    left = left_of()
    fit = left.observed.fit
    assert not left.found
    assert left.speed == 0.0
    gradients = reader(KNOWN)(fit.model).gradients
    influence = Influence.of(left.observed, fit.model.information.solved(gradients.T))
    plain = np.sqrt(left.observed.levels @ influence.by_noise)
    known = corrected([Part(fit.samples, KNOWN)], fit.model, reader(KNOWN), correct=True)
    assert np.isinf(known.freedom).all()
    np.testing.assert_allclose(known.errors, plain, rtol=0.02)  # bias, in quadrature
    assert whiteness(left) > 0.01


def test_turbulence_is_found_and_its_level_read():
    left = left_of(1.2)
    assert left.found
    assert left.speed == pytest.approx(1.2, rel=0.25)  # the forgetful 10 s hold 17 of its times
    assert whiteness(left) < 1e-4
    samples, rows, fit = fitted(1.2)
    (mode,) = assess(samples, rows, Cells(), fit, KNOWN, correct=True).modes
    known = mode.uncertainty
    assert all(2 <= freedom < 1000 for freedom in known.freedom)
    low, high = known.mean_velocity_interval
    assert high - low > 2 * 1.96 * known.mean_velocity  # Student's t is wider
    assert low < 12.0 < high


def test_intervals_hold_in_turbulence():
    missed = 0
    for seed in range(12):
        samples, rows, fit = fitted(1.2, "auto", seed)
        (mode,) = assess(samples, rows, Cells(), fit, KNOWN, correct=True).modes
        low, high = mode.uncertainty.mean_velocity_interval
        missed += not low < 12.0 < high
        assert high - low < 9.0
    assert missed <= 3  # 4 of 12 at 95 % are 2 in 1000


def test_the_jackknife_is_what_is_left_without_a_block():
    _, rows, fit = fitted(1.2)
    model = Model.of(Cells(), rows, fit)
    gradients = cellular(model, KNOWN).gradients
    dense = model.jacobian.times(np.eye(model.jacobian.size)).reshape(model.jacobian.size, -1).T
    errors = model.residual.T.ravel()
    theta = []
    for block in np.array_split(np.arange(len(rows.target)), BLOCKS):
        kept = np.ones((2, len(rows.target)), dtype=bool)
        kept[:, block] = False
        kept = kept.ravel()
        theta.append(np.linalg.lstsq(dense[kept], errors[kept], rcond=None)[0])
    away = np.array(theta) @ gradients.T
    expected = (BLOCKS - 1) * np.mean((away - away.mean(axis=0)) ** 2, axis=0)
    np.testing.assert_allclose(jackknifed(model, gradients), expected, rtol=1e-5)


def test_variances_add_the_spectrum_over_the_influence():
    left = left_of(1.2)
    model = left.observed.fit.model
    by_theta = model.information.solved(cellular(model, KNOWN).gradients.T)
    influence = Influence.of(left.observed, by_theta)
    # White errors of Phi: the sum of squares of what they are multiplied by.
    flat = np.ones((1, left.observed.passage.size // 2 + 1))
    np.testing.assert_allclose(influence.under(flat)[0], np.sum(influence.rows**2, axis=(1, 2)))
    variance, freedom = left.variances(influence)
    assert (variance > left.observed.levels @ influence.by_noise).all()
    assert ((freedom >= 2) & (freedom < 1e4)).all()
    louder = Turbulence(replace(left.observed, errors=2 * left.observed.errors))
    np.testing.assert_allclose(louder.variances(influence)[0], 4 * variance, rtol=0.02)
    np.testing.assert_allclose(louder.ratio, left.ratio, rtol=0.02)


def test_a_flight_without_noise_has_no_turbulence():
    flight = sf.simulate_flight(FLOW, VEHICLE, duration=8.0, sample_rate=100.0, seed=3)
    found = sf.Estimator().estimate(flight)
    assert found.status == "ok"
    assert found.goodness.turbulence == 0.0
    assert found.goodness.r_squared == pytest.approx(1.0, abs=1e-9)
    assert found.goodness.suspect is None
    assert math.isinf(found.uncertainty.freedom[0])


def test_the_generalised_step_is_weighted_least_squares_of_the_transforms():
    left = left_of(1.2)
    model, size = left.observed.fit.model, left.observed.passage.size
    dense = model.jacobian.times(np.eye(model.jacobian.size))  # (n, 2, m)
    upto = left.band.stop
    weight = np.sqrt(np.where(np.arange(upto) == 0, 1.0, 2.0) / left.spectrum[:upto])

    def weighed(rows):
        seen = (np.fft.rfft(rows, size)[..., :upto] * weight).reshape(*rows.shape[:-2], -1)
        return np.concatenate([seen.real, seen.imag], axis=-1)

    expected = np.linalg.lstsq(weighed(dense).T, weighed(left.observed.errors.T), rcond=None)[0]
    np.testing.assert_allclose(left.generalised_step, expected, rtol=1e-5, atol=1e-7)


def test_estimates_in_turbulence_move_by_the_generalised_step():
    away = []
    for seed in range(12):
        samples, rows, fit = fitted(1.2, "auto", seed)
        plain = cellular(Model.of(Cells(), rows, fit), KNOWN).values
        (mode,) = assess(samples, rows, Cells(), fit, KNOWN, correct=True).modes
        away.append((plain[1] - 4.0, mode.length_scale - 4.0))
    plain, moved = np.sqrt(np.mean(np.square(away), axis=0))
    assert moved < 0.9 * plain


def test_what_no_error_moves_is_certain():
    left = left_of(1.2)
    none = Influence.of(left.observed, np.zeros((left.observed.fit.model.jacobian.size, 1)))
    variance, freedom = left.variances(none)
    assert variance[0] == 0.0
    assert math.isinf(freedom[0])
