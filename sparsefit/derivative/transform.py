"""Sums over a sliding window by the Fourier transform, where windows are long."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sparsefit.arrays import Array, ComplexArray

KEPT = 256  # lengths


@dataclass(frozen=True, eq=False)
class Transformed:
    """Channels of rows of samples, of which one kernel after another takes weighted sums.

    The error of a sum is of the order of the rounding of the largest sample of its row, not of
    those in the window.

    Args:
        size: samples m of a row.
        length: of the transform, at least m.
        spectra: of the rows (channels, rows, length // 2 + 1).
    """

    size: int
    length: int
    spectra: ComplexArray

    @classmethod
    def of(cls, rows: Array) -> Transformed:
        """The transform of rows (channels, rows, m)."""
        size = rows.shape[2]
        length = fast_length(size)
        return cls(size, length, np.fft.rfft(rows, length))

    def windows(self, kernels: Array, used: list[int]) -> Array:
        """The sums (rows, m - n + 1) of kernels (channels, n), added over the channels in use."""
        weights = np.fft.rfft(kernels[used], self.length).conj()
        product = np.einsum("cq,crq->rq", weights, self.spectra[used])
        return np.fft.irfft(product, self.length)[:, : self.size - kernels.shape[1] + 1]


@lru_cache(maxsize=KEPT)
def fast_length(samples: int) -> int:
    """The least 2^i 3^j 5^l, of few 3 and 5, not below ``samples``: other transforms are slow."""
    best = 1 << math.ceil(math.log2(samples))
    for factor in (3, 5, 9, 15, 25, 27, 45, 75, 135):
        best = min(best, factor << max(math.ceil(math.log2(samples / factor)), 0))
    return best
