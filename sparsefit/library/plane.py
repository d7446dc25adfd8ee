"""The plane of wavevectors behind a wave library's grid, and the certificate over all of it.

With R the residual of 2 m rows, u before v of each sample, and Z(k) the two columns of a wave in
unit rms, the group-LASSO by wave is optimal over the whole plane exactly where

    eta(k) = |Z(k)'R| / (2 m alpha) <= 1  for every k.

Z(k)'R are the imaginary and the real part of sum_x exp(i k.x) (k_y R_u - k_x R_v), and the rms of
the columns needs sum_x exp(2 i k.x): two-dimensional non-uniform Fourier transforms (finufft;
Barnett, Magland and af Klinteberg, 2019) give them at all k of a square grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.cached import cached_property
from sparsefit.library.scan import Bounds, extent_of

STEP = 0.4  # between wavevectors, in 1/extent: eta between them is at most 1 % higher
ACCURACY = 1e-9  # of the Fourier sums, relative to the number of samples
LEAST = 1e-6  # of |k|^2, the mean square of a column: what is less is lost in the sums' error


@dataclass(frozen=True, eq=False)
class PlaneGrid:
    """The waves of a square grid of wavevectors at the samples of one flight.

    Args:
        position: of the samples, from the middle of their box (m, 2) [m].
        bounds: of |k| [1/m].
        step: between wavevectors along either axis [1/m].
    """

    position: Array
    bounds: Bounds
    step: float

    @classmethod
    def of(cls, position: Array, bounds: Bounds) -> PlaneGrid:
        """The grid over bounds of |k| [1/m] that resolves positions (m, 2) [m]."""
        centre = 0.5 * (position.max(axis=0) + position.min(axis=0))
        return cls(position - centre, bounds, STEP / extent_of(position))

    @cached_property
    def axis(self) -> Array:
        """k_x, and k_y, of the grid (q,) [1/m], symmetric about 0; it ends beyond the bound."""
        half = math.ceil(self.bounds[1] / self.step) + 1
        return self.step * np.arange(-half, half + 1.0)

    @cached_property
    def radius(self) -> Array:
        """|k| [1/m] over the grid, (q, q), k_x by rows."""
        radius: Array = np.hypot(self.axis[:, None], self.axis)
        return radius

    def heights(self, residual: Array) -> Array:
        """|Z(k)'R|/(2 m) over the grid (q, q), 0 at k = 0, of R (m, 2) [m/s]."""
        sums_u, sums_v = (self._sums(along, 1) for along in residual.T)
        loads = self.axis * sums_u - self.axis[:, None] * sums_v
        twice = self._sums(np.ones(len(residual)), 2).real
        floor, count = LEAST * self.radius**2, len(residual)
        squares = np.zeros(self.radius.shape)
        for part, sign in ((loads.imag, -1.0), (loads.real, 1.0)):
            mean = self.radius**2 * (1.0 + sign * twice / count) / 4  # over both components
            mean = np.maximum(mean, floor)
            squares += np.divide(part**2, mean, out=np.zeros_like(mean), where=mean > 0)
        return np.sqrt(squares) / (2 * count)

    def _sums(self, loads: Array, times: int) -> ComplexArray:
        import finufft

        x, y = np.ascontiguousarray(times * self.step * self.position.T)
        size = len(self.axis)
        sums: Any = finufft.nufft2d1(
            x, y, loads.astype(complex), (size, size), eps=ACCURACY, isign=1, nthreads=1
        )
        return np.asarray(sums)
