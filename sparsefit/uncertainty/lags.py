"""Sums over lags of time series, and the variance that residuals alone suggest."""

from __future__ import annotations

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples

LAGS = 20  # samples: twice the memory of a smoothing window of 11


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
        variance += products(influence[:, t], lags) @ (taper * products(errors[:, t], lags))
    return variance


def overlap(samples: Samples) -> int:
    """Rows that share samples, twice: the lags at which errors of rows may correlate."""
    weak = samples.weak
    if weak is None or len(weak.time) < 2:
        return LAGS
    stride = float(np.median(np.diff(weak.time)) / np.median(np.diff(samples.time)))
    return int(np.ceil(2 * weak.window / max(stride, 1.0)))


def products(series: Array, lags: int) -> Array:
    """Sums over time of the lagged products of series (..., q), lags 0..lags."""
    size = series.shape[-1] + lags
    products: Array = np.fft.irfft(np.abs(np.fft.rfft(series, size)) ** 2, size)
    return products[..., : lags + 1]
