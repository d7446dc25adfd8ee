"""Sums of squares in time, from real transforms."""

import numpy as np

from sparsefit.arrays import Array


def frequency_weights(size: int) -> Array:
    """What each frequency of a real transform counts for in a sum of squares in time."""
    twice = np.full(size // 2 + 1, 2.0 / size)  # of both signs but for 0 and the highest
    twice[0] = 1.0 / size
    if size % 2 == 0:
        twice[-1] = 1.0 / size
    return twice
