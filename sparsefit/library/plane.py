"""The plane of wavevectors behind a wave library's grid, and the certificate over all of it.

With R the residual of 2 m rows, u before v of each sample, and Z(k) the two columns of a wave in
unit rms, the group-LASSO by wave is optimal over the whole plane exactly where

    eta(k) = |Z(k)'R| / (2 m alpha) <= 1  for every k.

Z(k)'R are the imaginary and the real part of sum_x exp(i k.x) (k_y R_u - k_x R_v), and the rms of
the columns needs sum_x exp(2 i k.x): two-dimensional non-uniform Fourier transforms (finufft;
Barnett, Magland and af Klinteberg, 2019) give them at all k of a square grid, to be drawn, or of
rings, to be searched.

What a scan can miss: positions lie within D of their middle, so that along any line a sum is
band-limited by D, and a peak falls by (d D)^2 / 2 of its height within a distance d (Bernstein). No
k is farther than d = h / sqrt(2) from a ring's wave, at steps h = 2 sqrt(MISSED) / D along and
across: MISSED of a peak, at most. `WaveScan.slack` is three times that, which also holds for what
the rms and the direction (k_y, -k_x) change in between where the flight is longer than the waves.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sparsefit.arrays import Array, ComplexArray
from sparsefit.cached import cached_property
from sparsefit.library.scan import Bounds, extent_of, middle

MISSED = 0.02  # of a peak's height: what a scan's grid may not show
STEP = 0.4  # between wavevectors, in 1/extent: eta between them is at most 1 % higher
ACCURACY = 1e-9  # of the Fourier sums, relative to the number of samples
LEAST = 1e-6  # of |k|^2, the mean square of a column: what is less is lost in the sums' error


@dataclass(frozen=True, eq=False)
class PlaneGrid:
    """The waves of a square grid of wavevectors at the samples of one flight.

    Args:
        position: of the samples, from the middle of their box (m, 2) [m].
        centre: that middle, (2,) [m].
        bounds: of |k| [1/m].
        step: between wavevectors along either axis [1/m].
    """

    position: Array
    centre: Array
    bounds: Bounds
    step: float

    @classmethod
    def of(cls, position: Array, bounds: Bounds) -> PlaneGrid:
        """The grid over bounds of |k| [1/m] that resolves positions (m, 2) [m]."""
        return cls(*_centred(position), bounds, STEP / extent_of(position))

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
        waves = np.stack(np.meshgrid(self.axis, self.axis, indexing="ij"), axis=-1)
        sums = np.stack([self._sums(along, 1) for along in residual.T])
        twice = self._sums(np.ones(len(residual)), 2)
        return _heights(waves, sums, twice, self.centre, len(residual))

    def _sums(self, loads: Array, times: int) -> ComplexArray:
        import finufft

        x, y = np.ascontiguousarray(times * self.step * self.position.T)
        size = len(self.axis)
        sums: Any = finufft.nufft2d1(
            x, y, loads.astype(complex), (size, size), eps=ACCURACY, isign=1, nthreads=1
        )
        return np.asarray(sums)


@dataclass(frozen=True, eq=False)
class WaveScan:
    """The waves of rings over half the plane, at which eta may peak.

    Args:
        position: of the samples, from the middle of their box (m, 2) [m].
        centre: that middle, to which the columns' phases do not refer, (2,) [m].
        radii: |k| (a,) [1/m], both bounds included.
        headings: of k (b,) [rad], of half a turn.
        step: between waves, along and across, at most [1/m].
    """

    slack: ClassVar[float] = 3 * MISSED
    position: Array
    centre: Array
    radii: Array
    headings: Array
    step: float

    @classmethod
    def of(cls, position: Array, bounds: Bounds) -> WaveScan:
        """The scan between bounds of |k| [1/m] that resolves positions (m, 2) [m]."""
        radii, headings = cls.shape_of(position, bounds)
        return cls(
            *_centred(position),
            np.linspace(*bounds, radii),
            math.pi / headings * np.arange(headings, dtype=np.float64),
            _step(position),
        )

    @staticmethod
    def shape_of(position: Array, bounds: Bounds) -> tuple[int, int]:
        """How many rings a scan of positions (m, 2) [m] takes, and how many waves each has."""
        step = _step(position)
        rings = math.ceil((bounds[1] - bounds[0]) / step * (1 - 1e-12)) + 1
        return rings, max(2, math.ceil(math.pi * bounds[1] / step))

    @cached_property
    def waves(self) -> Array:
        """The wavevectors (a, b, 2) [1/m]."""
        across = np.stack([np.cos(self.headings), np.sin(self.headings)], axis=1)
        waves: Array = self.radii[:, None, None] * across
        return waves

    @cached_property
    def _plan(self) -> Any:
        return self._planned(1, 2)

    @cached_property
    def _twice(self) -> ComplexArray:
        sums = self._planned(2, 1).execute(np.ones(len(self.position), complex))
        return np.asarray(sums).reshape(self.waves.shape[:2])

    def _planned(self, times: int, loads: int) -> Any:
        import finufft

        plan = finufft.Plan(3, 2, n_trans=loads, eps=ACCURACY, isign=1, nthreads=1)
        x, y = np.ascontiguousarray(self.position.T)
        s, t = np.ascontiguousarray(times * self.waves.reshape(-1, 2).T)
        plan.setpts(x, y, s=s, t=t)
        return plan

    def heights(self, residual: Array) -> Array:
        """|Z(k)'R|/(2 m) at every wave (a, b) of R (2 m, 1) [m/s], u before v of each sample."""
        loads = np.ascontiguousarray(residual.reshape(-1, 2).T.astype(complex))
        sums = np.asarray(self._plan.execute(loads)).reshape(2, *self.waves.shape[:2])
        return _heights(self.waves, sums, self._twice, self.centre, len(self.position))

    def tops(self, residual: Array, slack: float) -> tuple[Array, Array]:
        """(|k|, heading) (j, 2) of local maxima of `heights` within slack of the highest.

        Highest first, and how far (j, 2) from each the peak may be: a step along and across.
        """
        from scipy.ndimage import maximum_filter

        heights = self.heights(residual)
        around = maximum_filter(heights, size=3, mode=("nearest", "wrap"))
        rings, turns = np.nonzero((heights >= around) & (heights >= (1 - slack) * heights.max()))
        order = np.argsort(-heights[rings, turns], kind="stable")
        radii, headings = self.radii[rings[order]], self.headings[turns[order]]
        reach = np.column_stack([np.full(len(radii), self.step), self.step / radii])
        return np.column_stack([radii, headings]), reach


def _centred(position: Array) -> tuple[Array, Array]:
    """Positions (m, 2) [m] from the middle of their box, and that middle."""
    centre = middle(position)
    return position - centre, centre


def _step(position: Array) -> float:
    """Between waves [1/m]: what leaves at most MISSED of a peak between them."""
    farthest = float(np.linalg.norm(_centred(position)[0], axis=1).max())
    return 2 * math.sqrt(MISSED) / farthest


def _heights(
    waves: Array, sums: ComplexArray, twice: ComplexArray, centre: Array, count: int
) -> Array:
    """|Z(k)'R|/(2 m) of waves k (..., 2) [1/m], 0 at k = 0.

    Args:
        waves: k.
        sums: of exp(i k.x) R_u and of exp(i k.x) R_v (2, ...), x from the centre (2,) [m].
        twice: sums of exp(2 i k.x) (...).
        centre: to which x refers; the columns' phases are those in the flight's own coordinates.
        count: the number m of samples.
    """
    turned = np.exp(1j * (waves @ centre))
    loads = (waves[..., 1] * sums[0] - waves[..., 0] * sums[1]) * turned
    square = np.sum(waves**2, axis=-1)
    share = (twice * turned * turned).real / count
    heights = np.zeros(square.shape)
    for part, sign in ((loads.imag, -1.0), (loads.real, 1.0)):
        mean = np.maximum(square * (1.0 + sign * share) / 4, LEAST * square)  # of both components
        heights += np.divide(part**2, mean, out=np.zeros_like(mean), where=mean > 0)
    return np.sqrt(heights) / (2 * count)
