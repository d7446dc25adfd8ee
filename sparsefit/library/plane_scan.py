"""Waves over the whole plane of wavevectors at once: what one wave, or a square of two, explains.

With s_k = sum exp(i k.x) Phi the columns of a wave k have the inner products b = (k_y, -k_x) . s_k
with Phi, and their Gram matrix G needs the sums of exp(i k.x) and exp(2 i k.x) alone: two-
dimensional non-uniform Fourier transforms (finufft; Barnett, Magland and af Klinteberg, 2019).
What a wave explains of the rows is b'G^-1 b, constants projected out. Two waves at right angles
explain nearly the sum of both: the grid turns into itself, and squares are scanned directly.

Waves that drift are looked for in short pieces of the flight, each with amplitudes of its own, by
transforms over (x, y, -t): a piece resolves less, and so needs fewer waves. There G is m/2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, ComplexArray, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError
from sparsefit.library.scan import Bounds, extent_of

ACCURACY = 1e-4  # of the sums, relative to the number of rows
FLAT = 1e-2  # of m: eigenvalues of the Gram matrix below it are those of a constant
FEW = 8  # rows of a piece
MOST_PLACES = 2e7  # wavevectors of a scan, which takes 2.5 GB then


@dataclass(frozen=True, eq=False)
class PlaneScan:
    """One flight's rows, and the square grid of wavevectors on which waves are looked for.

    Args:
        position: of the rows, from the middle of their box (m, 2) [m].
        radii: the least and the largest |k| [1/m].
        step: between wavevectors, along x and y [1/m].
        weight: of every row (m,), with which rows come already multiplied; None: all are 1.
    """

    position: Array
    radii: Bounds
    step: float
    weight: Array | None = None

    @classmethod
    def of(cls, position: Array, radii: Bounds, weight: Array | None = None) -> PlaneScan:
        """The scan of rows at position (m, 2) [m], at a step of pi / extent, half a lobe.

        Raises:
            InputError: where that is more wavevectors than can be looked at.
        """
        extent = extent_of(position[:, :2])
        scan = cls(position[:, :2], radii, math.pi / extent, weight)
        places = (2 * scan.half + 1.0) ** 2
        if places > MOST_PLACES:
            least = math.sqrt(2) * math.pi / radii[1]
            raise InputError(
                f"the track is {extent:.3g} m across and length scales down to {least:.3g} m are "
                f"sought: {places:.1g} waves to look at; raise the grid's bounds, the lower one to "
                f"{least * math.sqrt(places / MOST_PLACES):.2g} m or more"
            )
        return scan

    @property
    def half(self) -> int:
        """Steps from the middle of the grid to its sides."""
        return math.ceil(self.radii[1] / self.step)

    @cached_property
    def axis(self) -> Array:
        """The wavenumbers (n,) along either axis [1/m]."""
        return self.step * np.arange(-self.half, self.half + 1.0)

    @cached_property
    def inside(self) -> Array:
        """1 where |k| is between the radii, and 0 elsewhere, over the grid (n, n)."""
        radius = np.hypot(self.axis[:, None], self.axis)
        least, largest = self.radii
        return ((radius >= least) & (radius <= largest)).astype(float)

    @cached_property
    def _weights(self) -> Array:
        return np.ones(len(self.position)) if self.weight is None else self.weight

    @cached_property
    def _own(self) -> tuple[ComplexArray, ComplexArray]:
        """Means of exp(i k.x) and of exp(2 i k.x) over the rows, whatever is explained of these."""
        loads = (self._weights**2).astype(complex)
        return self._sums(loads, 1) / loads.sum(), self._sums(loads, 2) / loads.sum()

    def gains(self, rest: Array) -> Array:
        """What one wave explains of rows (m, 2) [m^2/s^2], over the grid (n, n)."""
        weight, moved = self._weights, rest - rest.mean(axis=0)
        if self.weight is not None:
            constant = weight @ rest / float(weight @ weight)
            moved = weight[:, None] * (rest - np.outer(weight, constant))
        count = float(np.sum(weight**2))
        both = self._sums(moved[:, 0] + 1j * moved[:, 1], 1)
        once, twice = self._own
        load = across(both, self.axis)
        # The Gram matrix over m: of cos^2, sin cos and sin^2, less what constants take.
        first = 0.5 + 0.5 * twice.real - once.real**2
        last = 0.5 - 0.5 * twice.real - once.imag**2
        mixed = 0.5 * twice.imag - once.real * once.imag
        determinant = np.maximum(first * last - mixed**2, FLAT * np.maximum(first, last))
        gain = last * load.real**2 - 2 * mixed * load.real * load.imag + first * load.imag**2
        gains: Array = self.inside * gain / (determinant * count)
        return gains

    def _sums(self, loads: ComplexArray, times: int) -> ComplexArray:
        import finufft

        x, y = (times * self.step * along for along in self.position.T)
        size = 2 * self.half + 1
        sums: ComplexArray = finufft.nufft2d1(
            np.ascontiguousarray(x), np.ascontiguousarray(y), loads, (size, size), eps=ACCURACY,
            isign=1, nthreads=1, upsampfac=1.25,
        )  # fmt: skip
        return sums


def across(both: ComplexArray, axis: Array, first: int = 0) -> ComplexArray:
    """(k_y, -k_x)/|k| . sum exp(i k.x) Phi of the sums (n, n, ...) of u + i v, Phi real.

    first: of the places along k_x for which it is asked.
    """
    kept, precision = both[first:], both.real.dtype
    back = np.conj(np.flip(both)[first:])
    k_y = axis.reshape(-1, *[1] * (both.ndim - 2)).astype(precision)
    k_x = k_y[first:, None]
    radius = np.hypot(k_x, k_y)
    radius[radius == 0] = 1.0
    # Sums of u are half of both + back, sums of v half of both - back over i.
    of_u, of_v = 0.5 * k_y / radius, 0.5j * (k_x / radius)
    load: ComplexArray = (of_u + of_v) * kept + (of_u - of_v) * back
    return load


def crossed(gains: Array) -> Array:
    """What squares of two waves explain, those at k and at k turned by a quarter, (n, n)."""
    return gains + gains[::-1].T


def peaks(gains: Array, count: int, *, square: bool = False) -> IntArray:
    """Indices (p, 2) of the highest local maxima of gains (n, n), highest first.

    Of k and -k one; of squares, whose gains a quarter turn leaves as they are, one of four.
    """
    from scipy.ndimage import maximum_filter

    half = len(gains) // 2
    tops = (gains >= maximum_filter(gains, size=3, mode="constant")) & (gains > 0)
    first = np.array([half + 1 if square else 0, half])
    places = np.argwhere(tops[first[0] :, half:]) + first
    order = np.argsort(-gains[tuple(places.T)], kind="stable")
    chosen: IntArray = places[order[:count]]
    return chosen
