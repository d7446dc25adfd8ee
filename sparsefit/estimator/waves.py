"""What the weights of a wave library say on its grid."""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array
from sparsefit.modes.wave_peaks import strengths
from sparsefit.regression.fit import Fit

MOST_WAVES = 12  # that are read off the grid: six flows of square cells


def waves_of(fit: Fit) -> tuple[Array, Array]:
    """The wavevectors (w, 2) [1/m] of the columns and their weights a, b (w, 2) [m^2/s]."""
    assert fit.problem.parameters is not None
    return fit.problem.parameters, fit.weights.reshape(-1, 2)


def wavenumbers_of(wavevectors: Array) -> Array:
    """k = pi/L (w,) [1/m] of the square cells that waves (w, 2) would make."""
    wavenumbers: Array = np.linalg.norm(wavevectors, axis=1) / math.sqrt(2.0)
    return wavenumbers


def strengths_by_scale(fit: Fit) -> dict[float, float]:
    """The norm of the strengths [m/s] of the waves of each length scale [m]."""
    k, weights = waves_of(fit)
    rings, ring = np.unique(np.round(math.pi / wavenumbers_of(k), 9), return_inverse=True)
    squares = np.bincount(ring, strengths(k, weights) ** 2, len(rings))
    return dict(zip(rings.tolist(), np.sqrt(squares).tolist(), strict=True))
