"""The variance of any function of a `Superposed` fit, from the noise of its flight.

As `noise`, for the rows that were fitted: an error of a row is

    Psi (n_v - grad w . n_x) + tau R n_a,    R: Psi and n_a the noise of the acceleration, or
                                             the rate operator of the weak form and n_a = n_v,

with the noise n_x, n_v, n_a of the samples that of the raw ones after their filters. Where no
filters are known, a Bartlett sum over the rows that share samples (Newey and West, 1987).
"""

from __future__ import annotations

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.derivative import Samples
from sparsefit.derivative.filters import Filters, fast_length, kicks_through
from sparsefit.uncertainty.model import LAGS
from sparsefit.uncertainty.noise import levels, power
from sparsefit.uncertainty.spectra import frequency_weights
from sparsefit.uncertainty.superposed import Superposed


def noise_levels(plain: Superposed, filters: Filters, response_time: float, errors: Array) -> Array:
    """Variances (3,) as of `noise.levels`, from what a fit leaves of Phi at the samples (m, 2).

    plain: the model of the samples, even where weak rows were fitted: these overlap, and a sample
    tells more of the noise's spectrum than an average does.
    """
    steep = float(np.mean(np.sum(plain.gradient**2, axis=0)))
    return levels(filters, response_time, errors, steep, plain.left)


def powers(
    model: Superposed, samples: Samples, filters: Filters, response_time: float, influence: Array
) -> Array:
    """What unit noise of raw position, velocity and tau times acceleration adds, (3, f)."""
    weak, on_samples, rate = samples.weak, influence, influence
    if weak is not None:
        on_samples = np.stack([weak.operator.T @ one for one in influence])
        rate = np.stack([weak.rate.T @ one for one in influence])
    size = fast_length(len(samples.time) + filters.raw.shape[2])
    place, velocity, acceleration = np.fft.rfft(filters.raw, size)
    bent = np.einsum("imt,tmf->imf", model.gradient, on_samples)
    bent, level, slope = (np.fft.rfft(one, size, axis=1) for one in (bent, on_samples, rate))
    differenced = acceleration if weak is None else velocity
    weight = frequency_weights(size)
    found = []
    for raw in range(2):  # position, velocity
        total = level * velocity[raw, :, None] - bent * place[raw, :, None]
        total = total + response_time * slope * differenced[raw, :, None]
        found.append(power(total, weight))
    if weak is None:
        kicks = np.fft.rfft(filters.kicks, size)
        found.append(power(slope * kicks[:, None], weight))
    else:
        found.append(_kicked(slope, velocity, size, samples))
    return np.array(found)


def _kicked(slope: ComplexArray, velocity: Array, size: int, samples: Samples) -> Array:
    """Sum of squares (f,) of what a kick in every raw step does through the weak form."""
    step = float(np.mean(np.diff(samples.time)))
    raw = np.fft.irfft(slope[:, None] * velocity[None, :, :, None], size, axis=2)
    every = raw.transpose(0, 3, 1, 2).reshape(-1, 2, size)
    squares = [float(np.sum(kicks_through(one, step) ** 2)) for one in every]
    total: Array = np.array(squares).reshape(2, -1).sum(axis=0)
    return total


def lagged(influence: Array, errors: Array, lags: int, used: float) -> Array:
    """Variances (f,) from the residuals (q, 2) alone, tapered to lags (Bartlett)."""
    rows = len(errors)
    taper = 1 - np.arange(lags + 1) / (lags + 1)
    taper[1:] *= 2  # lags of either sign
    taper *= 1 / max(rows - used, 1.0)
    found = np.zeros(influence.shape[2])
    for error, part in zip(errors.T, influence, strict=True):
        found += (taper * _products(error[:, None], lags)[:, 0]) @ _products(part, lags)
    return found


def overlap(samples: Samples) -> int:
    """Rows that share samples, twice: the lags at which errors of rows may correlate."""
    weak = samples.weak
    if weak is None or len(weak.time) < 2:
        return LAGS
    stride = float(np.median(np.diff(weak.time)) / np.median(np.diff(samples.time)))
    return int(np.ceil(2 * weak.window / max(stride, 1.0)))


def _products(series: Array, lags: int) -> Array:
    """Sums over time of the lagged products of each column (m, n), lags 0..lags."""
    found = np.fft.rfft(series, len(series) + lags, axis=0)
    products: Array = np.fft.irfft(np.abs(found) ** 2, len(series) + lags, axis=0)[: lags + 1]
    return products
