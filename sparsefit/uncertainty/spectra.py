"""Sums of squares in time, from real transforms."""

import numpy as np

from sparsefit.arrays import Array, ComplexArray


def frequency_weights(size: int) -> Array:
    """What each frequency of a real transform counts for in a sum of squares in time."""
    twice = np.full(size // 2 + 1, 2.0 / size)  # of both signs but for 0 and the highest
    twice[0] = 1.0 / size
    if size % 2 == 0:
        twice[-1] = 1.0 / size
    return twice


def forms(spectra: ComplexArray, weight: Array) -> Array:
    """Weighted products (k, k) of the spectra (k, 2, frequencies) of both components."""
    parts = np.ascontiguousarray(spectra).view(np.float64).reshape(len(spectra), -1)
    products: Array = (parts * np.tile(np.repeat(weight, 2), 2)) @ parts.T
    return products


def mixed(form: Array, mix: Array | None) -> Array:
    """Squares (f,) under a form (k, k), of mixes (k, f) of what it is of; None: of each itself."""
    squares: Array = np.diagonal(form) if mix is None else np.sum(mix * (form @ mix), axis=0)
    return squares


def paired(values: Array) -> Array:
    """Sums (f,) of neighbours in (2 f,): of real and imaginary parts."""
    sums: Array = values[0::2] + values[1::2]
    return sums
