"""The variance of U0, L and tau_w from the noise of a flight, carried through its filters.

Errors of Phi are the raw noise after the filters: measured noise of position and velocity, and
noise of the acceleration itself (Eq. 7), each with a spectrum that the filters fix. How much of
either there is, is read from the residuals (Whittle's likelihood, 1953); what it does to an
estimate sum c e, from c carried back through the filters to the raw samples, where noise is
white: var = sigma^2 |F'c|^2. An autocovariance of the residuals, tapered, would need lags beyond
the window, and then has few windows to average over.
"""

import math
from collections.abc import Callable

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.derivative.filters import Filters, fast_length
from sparsefit.uncertainty.model import Fitted
from sparsefit.uncertainty.spectra import frequency_weights

PASSED = 0.05  # of the power: below it the spectrum is leakage
ROUNDS = 60  # of the multiplicative iteration; the level is stable to 1 % by then


def variance(fitted: Fitted, filters: Filters, response_time: float, errors: Array) -> Array:
    """Variances (3,) of U0, L and tau_w; errors (m, 2) the residuals [m/s], tau [s]."""
    size = fast_length(len(errors) + filters.raw.shape[2])
    place, velocity, acceleration = np.fft.rfft(filters.raw, size)
    through = velocity + response_time * acceleration  # (2, frequencies): what raw noise is in Phi
    mean = np.abs(np.fft.rfft(filters.kicks, size)) ** 2
    influence = np.fft.rfft(fitted.influence, size, axis=1)
    bent = np.fft.rfft(np.einsum("imt,tmf->imf", fitted.gradient, fitted.influence), size, axis=1)
    weight = frequency_weights(size)
    carried = [
        power(influence * a[:, None] - bent * b[:, None], weight)
        for a, b in zip(through, place, strict=True)
    ]
    carried.append(power(influence * np.sqrt(mean)[:, None], weight))
    steep = float(np.mean(np.sum(fitted.gradient**2, axis=0)))
    found: Array = levels(filters, response_time, errors, steep) @ np.array(carried)
    return found


def levels(
    filters: Filters,
    response_time: float,
    errors: Array,
    steep: float,
    left: Callable[[Array, int], Array] | None = None,
) -> Array:
    """Variances (3,) of the raw position and velocity, and of tau times that of acceleration.

    errors (m, 2): residuals of Phi at the samples [m/s]; steep: the mean square of the flow's
    gradient along an axis [1/s^2]; left: what the fit leaves of spectra, given them and the size
    of the transform, or None: all but 17/2 parameters per component. Where the derivative found
    the noise levels of position and velocity, their ratio is known and measured noise has one
    level; elsewhere only velocity is noisy.
    """
    samples = len(errors)
    size = fast_length(samples + filters.raw.shape[2])
    place, velocity, acceleration = np.fft.rfft(filters.raw, size)
    through = velocity + response_time * acceleration
    mean = np.abs(np.fft.rfft(filters.kicks, size)) ** 2
    shapes = [*(np.abs(through) ** 2 + steep * np.abs(place) ** 2), mean]
    known = math.isfinite(filters.sigma_position) and math.isfinite(filters.sigma_velocity)
    squares = np.array([0.0, 1.0])
    if known:
        squares = np.array([filters.sigma_position, filters.sigma_velocity]) ** 2
    shapes = [squares[0] * shapes[0] + squares[1] * shapes[1], mean]
    passed = mean > PASSED
    if left is not None:
        shapes = list(left(np.array(shapes), size))
    observed = np.sum(np.abs(np.fft.rfft(errors, size, axis=0)) ** 2, axis=1) / (2 * samples)
    level = _levels(np.array(shapes)[:, passed], observed[passed])
    if left is not None:
        return np.array([*(level[0] * squares), level[1]])
    independent = 2 * np.count_nonzero(passed) * samples / size  # per component
    found: Array = np.array([*(level[0] * squares), level[1]])
    return found * independent / max(independent - 8.5, 1.0)


def _levels(shapes: Array, observed: Array) -> Array:
    """Levels >= 0 of the spectra (n, q) that are likeliest given a periodogram (q,).

    Multiplicative iteration for sum(log s + I/s), s = levels . shapes (Fevotte et al., 2009).
    """
    size = shapes.mean(axis=1)
    size[size == 0] = 1.0
    scaled = shapes / size[:, None]
    levels = np.full(len(shapes), observed.mean() / len(shapes))
    least = 1e-300 + 1e-12 * float(observed.max())
    for _ in range(ROUNDS):
        inverse = 1.0 / (levels @ scaled + least)
        levels = levels * (scaled @ (observed * inverse**2)) / (scaled @ inverse)
    found: Array = levels / size
    return found


def power(spectrum: ComplexArray, weight: Array) -> Array:
    """Sum of squares in time (f,) of spectra (2, frequencies, f)."""
    total: Array = weight @ np.sum(spectrum.real**2 + spectrum.imag**2, axis=0)
    return total
