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


def power(spectra: ComplexArray, weight: Array) -> Array:
    """Sums of squares in time (f,) of the spectra (f, 2, frequencies) of both components."""
    total: Array = (spectra.real**2 + spectra.imag**2).sum(axis=1) @ weight
    return total


def paired(values: Array) -> Array:
    """Sums (f,) of neighbours in (2 f,): of real and imaginary parts."""
    sums: Array = values[0::2] + values[1::2]
    return sums
