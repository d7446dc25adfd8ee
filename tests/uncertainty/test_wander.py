"""A position that wanders: its variance by dense matrices, and intervals that hold it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import sparsefit as sf
from sparsefit.derivative import Derivative
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import Rows
from sparsefit.uncertainty.assessment import assess
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.influence import Influence
from sparsefit.uncertainty.noise import Observed
from sparsefit.uncertainty.reading import cellular
from sparsefit.uncertainty.wander import Wander, modulated
from tests.fits import cells_at, located
from tests.fleet import fly_together

FLOW = sf.CellularFlow(12.0, 4.0)
VEHICLE = PointMassVehicle(0.5, (5.0, 3.0))
KNOWN = Nuisance((), VEHICLE)
MEASURED = {"velocity_noise": 0.2, "position_noise": 0.05}
RMS, MEMORY = 0.2, 5.0


def wandering(flight, seed):
    """The flight with an autoregression in its position."""
    kept = np.exp(-float(np.mean(np.diff(flight.time))) / MEMORY)
    kicks = np.random.default_rng(seed).standard_normal(flight.position.shape)
    kicks[1:] *= np.sqrt(1 - kept**2)
    away = RMS * lfilter([1.0], [1.0, -kept], kicks, axis=0)
    return replace(flight, position=flight.position + away)


@pytest.fixture(scope="module")
def fit():
    flight = sf.simulate_flight(FLOW, VEHICLE, duration=3.0, sample_rate=100.0, seed=3, **MEASURED)
    samples = Derivative()(flight)
    return Filtered.of(samples, cells_at(Rows.of(samples, VEHICLE), FLOW.wavenumber), KNOWN)


def test_flights_without_it_have_none(fit):
    assert fit.wander == Wander()
    assert not modulated(fit.wander, fit.plain.gradient, 64).any()


def test_variances_are_those_of_the_whole_covariance(fit):
    told = Filtered(**{name: getattr(fit, name) for name in fit.__dataclass_fields__})
    told.__dict__["wander"] = Wander(RMS, 0.99)
    observed = Observed(told, fit.model.residual)
    by_theta = fit.model.information.solved(cellular(fit.model, KNOWN).gradients.T)
    found = Influence.of(observed, by_theta).by_source(np.zeros(2))[0]
    rows, gradient = fit.model.jacobian.times(by_theta), fit.model.gradient
    place, velocity, acceleration = fit.filters.raw[:, 0]
    phi, samples, window = velocity + 0.5 * acceleration, len(fit.samples.time), len(place)
    dense = np.zeros((len(rows), 2, samples + window - 1))
    for i in range(samples):  # noise of one axis: in both components, through the gradient
        bent = np.einsum("ft,at->fa", rows[:, :, i], gradient[:, :, i])
        dense[:, :, i : i + window] += rows[:, :, i, None] * phi - bent[:, :, None] * place
    covariance = toeplitz(RMS**2 * 0.99 ** np.arange(dense.shape[2]))
    expected = np.einsum("fai,ij,faj->f", dense, covariance, dense)
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_in_phi_it_has_the_power_of_the_gradient(fit):
    size = 1024
    spectrum = modulated(Wander(RMS, 0.9), fit.plain.gradient, size)
    whole = np.concatenate([spectrum, spectrum[1:-1]]).mean()
    square = np.mean(np.sum(fit.plain.gradient**2, axis=0))
    assert whole == pytest.approx(RMS**2 * square, rel=1e-6)


def test_intervals_hold_what_a_position_wanders():
    held, setting = [], {"duration": 12.0, "rate": 100.0, "seed": 70, **MEASURED}
    for seed, flight in enumerate(fly_together([(FLOW,)] * 16, VEHICLE, **setting)):
        samples = Derivative()(wandering(flight, seed))
        assert samples.agreement.wanders
        rows = Rows.of(samples, VEHICLE)
        fit = located(rows, [[FLOW.wavenumber]])
        (mode,) = assess(samples, rows, Cells(), fit, KNOWN, correct=True).modes
        (low, high), (least, most) = (
            getattr(mode.uncertainty, f"{name}_interval")
            for name in ("mean_velocity", "length_scale")
        )
        held.append((low < 12.0 < high, least < 4.0 < most))
    assert (np.sum(held, axis=0) >= 13).all()  # 4 misses of 16 at 95 % are 7 in 1000
