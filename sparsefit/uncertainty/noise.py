"""The variance of functions of theta from the noise of a flight, carried through its filters.

An error of a row is the raw noise after the filters: measured noise of position and velocity, and
noise of the acceleration itself (Eq. 7), each with a spectrum that the filters fix,

    e = Psi (n_v - grad w . n_x) + tau R n_a,    R: Psi and n_a the noise of the acceleration, or
                                                 the rate operator of the weak form and n_a = n_v.

How much of either there is, is read from what the fit leaves of Phi at the samples (Whittle's
likelihood, 1953); what it does to a function that moves by c.e, from c carried back through the
filters to the raw samples, where noise is white: var = sigma^2 |F'c|^2. An autocovariance of the
residuals, tapered, would need lags beyond the window, and then has few windows to average over:
it is what remains where no filters are known (Bartlett's; Newey and West, 1987).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.derivative import Samples, WeakRows
from sparsefit.derivative.filters import Filters, kicks_through
from sparsefit.derivative.transform import fast_length
from sparsefit.uncertainty.filtered import Filtered
from sparsefit.uncertainty.model import Model
from sparsefit.uncertainty.spectra import frequency_weights, power

LAGS = 20  # samples: twice the memory of a smoothing window of 11
PASSED = 0.05  # of the power: below it the spectrum is leakage
ROUNDS = 60  # of the multiplicative iteration; the level is stable to 1 % by then


@dataclass(frozen=True, eq=False)
class Passage:
    """What raw noise is in the filtered states, by frequency (size/2 + 1,).

    Args:
        size: of the transforms.
        place: raw position and velocity (2, ...) in the filtered position.
        velocity: the same in the filtered velocity.
        acceleration: the same in the filtered acceleration.
        kicks: the mean acceleration in a step, in the filtered acceleration.
    """

    size: int
    place: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    kicks: ComplexArray

    @classmethod
    def of(cls, filters: Filters, samples: int) -> Passage:
        """The passage of a number of filtered samples."""
        size = fast_length(samples + filters.raw.shape[2])
        place, velocity, acceleration = np.fft.rfft(filters.raw, size)
        return cls(size, place, velocity, acceleration, np.fft.rfft(filters.kicks, size))

    def of_flow_velocity(self, response_time: float) -> ComplexArray:
        """Raw position and velocity (2, ...) in Phi; tau [s]."""
        through: ComplexArray = self.velocity + response_time * self.acceleration
        return through


def carried(fit: Filtered, gradients: Array, errors: Array) -> tuple[Array, Array]:
    """Variances (f,) of functions of theta, gradients (f, n), and the noise levels (3,).

    errors (m, 2): what the fit leaves of Phi at the samples [m/s], even where weak rows were
    fitted: these overlap, and a sample tells more of the noise's spectrum than an average does.
    """
    passage = Passage.of(fit.filters, len(fit.samples.time))
    spectra = fit.plain.jacobian.spectra(passage.size)
    level = levels(fit, passage, spectra, errors)
    by_theta = fit.model.information.solved(gradients.T)
    influence = fit.model.jacobian.times(by_theta)
    if fit.samples.weak is None:
        of_influence = fit.model.jacobian.turned(by_theta, spectra)
        by_noise = powers(fit, passage, influence, of_influence)
    else:
        by_noise = weak_powers(fit, fit.samples.weak, passage, influence)
    return level @ by_noise, level


def powers(fit: Filtered, passage: Passage, influence: Array, spectra: ComplexArray) -> Array:
    """What unit noise of raw position, velocity and tau times acceleration adds, (3, f).

    influence c (f, 2, m) of the samples, and its transforms (f, 2, size/2 + 1).
    """
    bent = np.fft.rfft(_bent(fit.model, influence), passage.size)
    through = passage.of_flow_velocity(fit.response_time)
    weight, kicked = frequency_weights(passage.size), np.abs(passage.kicks) ** 2
    by_raw = [
        power(spectra * of_phi - bent * place, weight)
        for of_phi, place in zip(through, passage.place, strict=True)
    ]
    return np.array([*by_raw, power(spectra, weight * kicked)])


def weak_powers(fit: Filtered, weak: WeakRows, passage: Passage, influence: Array) -> Array:
    """As `powers`, for the influence (f, 2, q) of weak rows of the samples."""
    size, count = passage.size, len(fit.samples.time)
    flat, shape = influence.reshape(-1, influence.shape[2]).T, (*influence.shape[:2], count)
    mean = (weak.operator.T @ flat).T.reshape(shape)
    rate = (weak.rate.T @ flat).T.reshape(shape)
    bent = np.fft.rfft(_bent(fit.model, mean), size)
    total = np.fft.rfft(mean + fit.response_time * rate, size)
    by_raw = [
        power(total * velocity - bent * place, frequency_weights(size))
        for velocity, place in zip(passage.velocity, passage.place, strict=True)
    ]
    # A kick in every raw step moves the velocities after it, and the rate operator sees these.
    slope = np.fft.rfft(rate, size)[:, :, None]
    raw = np.fft.irfft(slope * passage.velocity, size)
    step = float(np.mean(np.diff(fit.samples.time)))
    kicked = [sum(np.sum(kicks_through(one, step) ** 2) for one in both) for both in raw]
    return np.array([*by_raw, kicked])


def _bent(model: Model, influence: Array) -> Array:
    """How errors of the positions of samples move functions, (f, 2, m), by c (f, 2, m) of Phi."""
    bent: Array = np.sum(influence[:, None] * model.gradient, axis=2)
    return bent


def levels(fit: Filtered, passage: Passage, spectra: ComplexArray, errors: Array) -> Array:
    """Variances (3,) of the raw position and velocity, and of tau times that of acceleration.

    spectra: the transforms of the columns of the Jacobian of the samples; errors (m, 2): residuals
    of Phi at the samples [m/s]. Where the derivative found the noise levels of position and
    velocity, their ratio is known and measured noise has one level; elsewhere only velocity is
    noisy.
    """
    steep = float(np.mean(np.sum(fit.plain.gradient**2, axis=0)))  # along an axis
    through, kicked = passage.of_flow_velocity(fit.response_time), np.abs(passage.kicks) ** 2
    measured = np.abs(through) ** 2 + steep * np.abs(passage.place) ** 2
    squares, filters = np.array([0.0, 1.0]), fit.filters
    if measured_noise_known(filters):
        squares = np.array([filters.sigma_position, filters.sigma_velocity]) ** 2
    passed = kicked > PASSED
    shapes = fit.plain.left(np.array([squares @ measured, kicked]), spectra, passage.size)
    observed = np.fft.rfft(np.ascontiguousarray(errors.T), passage.size)
    seen = np.sum(observed.real**2 + observed.imag**2, axis=0) / (2 * len(errors))
    level = likeliest(shapes[:, passed], seen[passed])
    return np.array([*(level[0] * squares), level[1]])


def measured_noise_known(filters: Filters) -> bool:
    """Whether the derivative found the noise levels of position and velocity."""
    return math.isfinite(filters.sigma_position) and math.isfinite(filters.sigma_velocity)


def likeliest(shapes: Array, observed: Array) -> Array:
    """Levels >= 0 of the spectra (n, q) that are likeliest given a periodogram (q,).

    Multiplicative iteration for sum(log s + I/s), s = levels . shapes (Fevotte et al., 2009).
    """
    size = shapes.mean(axis=1)
    size[size == 0] = 1.0
    scaled = shapes / size[:, None]
    level = np.full(len(shapes), observed.mean() / len(shapes))
    least = 1e-300 + 1e-12 * float(observed.max())
    for _ in range(ROUNDS):
        inverse = level @ scaled
        inverse += least
        np.reciprocal(inverse, out=inverse)
        below = scaled @ inverse
        inverse *= inverse
        inverse *= observed
        level = level * (scaled @ inverse) / below
    found: Array = level / size
    return found


def lagged(influence: Array, errors: Array, lags: int, used: float) -> Array:
    """Variances (f,) from the residuals (q, 2) alone, tapered to lags (Bartlett).

    With gamma(l) the autocovariance of the residuals at lag l, and rho(l) that of the influence
    c (f, 2, q): sum_l gamma(l) rho(l), component by component; used: parameters per component.
    """
    rows = len(errors)
    taper = 1 - np.arange(lags + 1) / (lags + 1)
    taper[1:] *= 2  # lags of either sign
    taper *= 1 / max(rows - used, 1.0)
    variance = np.zeros(len(influence))
    for t in range(2):
        variance += _products(influence[:, t], lags) @ (taper * _products(errors[:, t], lags))
    return variance


def overlap(samples: Samples) -> int:
    """Rows that share samples, twice: the lags at which errors of rows may correlate."""
    weak = samples.weak
    if weak is None or len(weak.time) < 2:
        return LAGS
    stride = float(np.median(np.diff(weak.time)) / np.median(np.diff(samples.time)))
    return int(np.ceil(2 * weak.window / max(stride, 1.0)))


def _products(series: Array, lags: int) -> Array:
    """Sums over time of the lagged products of series (..., q), lags 0..lags."""
    size = series.shape[-1] + lags
    products: Array = np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)
    return products[..., : lags + 1]
