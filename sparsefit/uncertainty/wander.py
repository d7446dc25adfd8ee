"""What a position wanders: a first-order autoregression, and what it is in Phi.

Of rms s and r = exp(-dt/T) it has the autocovariance s^2 r^l, and goes the way of all raw noise of
the position (`noise`). In what is left of Phi it comes modulated by the gradient: its
autocovariance is that of n times that of grad w.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.uncertainty.lags import products


@dataclass(frozen=True)
class Wander:
    """A first-order autoregression in the logged position.

    Args:
        rms: of either component [m], 0 where none was seen.
        kept: its correlation from sample to sample.
    """

    rms: float = 0.0
    kept: float = 0.0

    @classmethod
    def of(cls, samples: Samples) -> Wander:
        """What position and velocity of a flight say of it; nothing where they do not agree."""
        seen = samples.agreement
        if seen is None or not seen.wanders or seen.broken or not seen.expected[0] > 0:
            return cls()
        rms, memory = seen.expected
        step = float(np.median(np.diff(samples.time)))
        return cls(rms, math.exp(-step / memory))

    def covariance(self, lags: int) -> Array:
        """Its autocovariance (lags,) [m^2]."""
        return np.asarray(self.rms**2 * self.kept ** np.arange(lags), dtype=np.float64)


def modulated(wander: Wander, gradient: Array, size: int) -> Array:
    """The spectrum (size/2 + 1,) in Phi of a position that wanders, by a gradient (2, 2, m)."""
    samples = gradient.shape[2]
    if not wander.rms:
        return np.zeros(size // 2 + 1)
    alike = products(gradient.reshape(4, samples), samples - 1).sum(axis=0) / (2 * samples)
    covariance = alike * wander.covariance(samples)
    folded = np.zeros(size)
    folded[:samples] += covariance
    folded[-np.arange(1, samples) % size] += covariance[1:]
    spectrum: Array = np.maximum(np.fft.rfft(folded).real, 0.0)
    return spectrum
