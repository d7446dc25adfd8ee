"""What smoothing and noisy positions take from the weights, to first order.

Truncation. Phi is read through the filters of `sparsefit.derivative.filters`: along the path, with
V' = (w - v)/tau + a, it is away from w by

    b = (P - 1)(w - v) + (S - 1) v - grad w . (X_s - x),

all of it known once w is: C'b is taken from the fit's normal equations, twice, as w itself moves.

Noise of the position (variance s^2 per axis after smoothing, covariance q with that of Phi): the
columns stand at x + n, and with e = Phi - C w the normal equations are off by

    E C'e = s^2/2 C'(|kappa|^2 w) - s^2 sum_a (d_a C)'(d_a w) + q (d_t C_t)' 1,

which over many cells attenuates a plane wave kappa by exp(-|kappa|^2 s^2 / 2), and more where the
path leaves a combination of columns ill determined (Carroll et al., 2006).
"""

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.derivative.filters import Filters, fast_length
from sparsefit.uncertainty.model import Fitted, along_x, along_y
from sparsefit.uncertainty.superposed import Superposed

WAVES = np.array([1.0] * 4 + [2.0] * 4)[:, None]  # |kappa|^2 / k^2 of each candidate


def truncation(
    fitted: Fitted | Superposed, velocity: Array, filters: Filters
) -> tuple[Array, float]:
    """b (m, 2) [m/s], 0 at the ends where samples lack; and samples over those that have it."""
    lost, path, mean = np.zeros(velocity.shape), filters.path, filters.mean
    samples = len(velocity)
    if path is None or mean is None or samples < 2 * len(mean):
        return lost, 1.0
    excess, half = fitted.flow - velocity, len(mean) // 2
    inner = slice(half, samples - half)
    size = fast_length(samples)
    spectra = [np.fft.rfft(one, size, axis=0) for one in (fitted.position, velocity, excess)]

    def filtered(kernels: list[Array], parts: list[ComplexArray]) -> Array:
        total = sum(
            np.fft.rfft(kernel, size).conj()[:, None] * part
            for kernel, part in zip(kernels, parts, strict=True)
        )
        found: Array = np.fft.irfft(total, size, axis=0)[: samples - 2 * half]
        return found

    place = filtered(list(path[0]), spectra[:2]) - fitted.position[inner]
    lost[inner] = filtered([mean], spectra[2:]) - excess[inner]
    lost[inner] += filtered(list(path[1]), spectra[:2]) - velocity[inner]
    lost[inner] -= np.einsum("imt,mi->mt", fitted.gradient[:, inner], place)
    return lost, samples / (samples - 2 * half)


def noisy_positions(fitted: Fitted, filters: Filters, response_time: float) -> Array:
    """E J'e (17,) of the noise in the positions; response_time tau [s]."""
    variances = np.array([[filters.sigma_position], [filters.sigma_velocity]]) ** 2
    place, velocity, acceleration = filters.raw
    square = float(np.sum(variances * place**2))
    shared = float(np.sum(variances * place * (velocity + response_time * acceleration)))
    k, c, (cx, cy) = fitted.wavenumber, fitted.columns, fitted.slopes
    bowed = 0.5 * square * k * k * (c.T @ (WAVES * fitted.weights))
    score = c @ bowed
    steep = square * fitted.gradient
    score -= k * (cx @ steep[0] + cy @ steep[1])
    score += shared * k * np.column_stack([cx.sum(axis=1), cy.sum(axis=1)])
    x, y = fitted.position.T
    turned = [
        (slope + k * (x * along_x(slope) + y * along_y(slope))).T @ fitted.weights
        for slope in (cx, cy)
    ]
    by_scale = np.sum(fitted.bend * bowed) - np.sum(np.stack(turned) * steep)
    by_scale += shared * (turned[0][:, 0].sum() + turned[1][:, 1].sum())
    return np.concatenate([[by_scale], score.T.ravel()])
