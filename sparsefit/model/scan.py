"""The Fourier scan: sums over rows that say, for a whole grid of wavevectors, what a wave explains.

With s_k = sum exp(i k.x) Phi the columns of a wave k have the inner products (k_y, -k_x) . s_k with
Phi, and their Gram matrix needs the sums of exp(i k.x) and exp(2 i k.x) alone: non-uniform Fourier
transforms (finufft; Barnett, Magland and af Klinteberg, 2019) give them at all k of a uniform grid,
along a line (1-D), over the plane (2-D), or with the frequency of waves that move (3-D).

A track that is long beside the waves is cut into pieces, each with amplitudes of its own: a piece
resolves less, and so needs fewer waves. There the Gram matrix is m/2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from sparsefit.arrays import Array, ComplexArray, IntArray
from sparsefit.cached import cached_property
from sparsefit.model.grid import Bounds, extent_of, middle
from sparsefit.model.shapes import FlowRows

FEWEST_PIECES = 4  # of a scan in pieces


def fourier_sums(
    place: Array,
    step: Array,
    half: tuple[int, ...],
    loads: Array | ComplexArray,
    *,
    times: int = 1,
    centre: float = 0.0,
    most_single: int = 2_048,
) -> ComplexArray:
    """Sums of loads times exp(i k.x) over rows, (..., 2 half + 1, ...), at all k of a grid.

    place: x of the rows (m, d), d of 1 to 3. step (d,), half: between wavenumbers along each axis,
    and the number of steps from the middle to either side. loads: of the rows, (m,) or (j, m).
    times: how many times k the sums are at. centre: of the grid, where d is 1; else 0. Up to
    most_single steps sums are in single precision, where they round to 1e-4 of the rows.
    """
    import finufft

    if centre:
        loads = loads * np.exp(1j * times * centre * place.sum(axis=1))
    single = max(half) <= most_single
    real, both = (np.float32, np.complex64) if single else (np.float64, np.complex128)
    size = tuple(2 * n + 1 for n in half)
    transform = (finufft.nufft1d1, finufft.nufft2d1, finufft.nufft3d1)[len(size) - 1]
    sums: ComplexArray = transform(
        *(times * step * place).T.astype(real, order="C"),
        np.ascontiguousarray(loads, dtype=both),
        size if len(size) > 1 else size[0],
        eps=1e-4,  # of the rows
        isign=1,
        nthreads=1,
        upsampfac=1.25 if single else 2.0,
    )
    return sums


def gain(load: ComplexArray, once: ComplexArray, twice: ComplexArray, count: float) -> Array:
    """b'G^-1 b of one wave at every k: the fall of RSS by its two columns, constants projected out.

    load: (k_y, -k_x)/|k| . s_k, of rows less their mean; once, twice: means of exp(i k.x) and of
    exp(2 i k.x) over ``count`` rows.
    """
    # The Gram matrix over m: of cos^2, sin cos and sin^2, less what constants take.
    first = 0.5 + 0.5 * twice.real - once.real**2
    last = 0.5 - 0.5 * twice.real - once.imag**2
    mixed = 0.5 * twice.imag - once.real * once.imag
    flat = 1e-2  # of m: eigenvalues below it are those of a constant
    least = np.maximum(flat * np.maximum(first, last), flat**3)
    determinant = np.maximum(first * last - mixed**2, least)
    gains = last * load.real**2 - 2 * mixed * load.real * load.imag + first * load.imag**2
    gains /= determinant * count
    return np.asarray(gains, dtype=np.float64)


def peaks(values: Array, most: int | None = None) -> IntArray:
    """Indices (p, d) of the local maxima above 0 of values of d dimensions, highest first."""
    around = np.pad(values, 1, constant_values=-np.inf)
    for _ in values.shape:  # each axis in turn comes first
        around = np.moveaxis(around, -1, 0)
        around = np.maximum(np.maximum(around[:-2], around[1:-1]), around[2:])
    places = np.argwhere((values >= around) & (values > 0))
    order = np.argsort(-values[tuple(places.T)], kind="stable")
    ordered: IntArray = places[order[:most]]
    return ordered


def line_steps(extent: float, bounds: Bounds) -> int:
    """The steps of a scan of square cells along the axes between bounds of k = pi/L [1/m].

    The phase of a row turns by half a radian a step at most.
    """
    return max(8, math.ceil((bounds[1] - bounds[0]) * extent / 0.5))


def axis_gains(rows: FlowRows, rest: Array, bounds: Bounds) -> tuple[Array, Array]:
    """The fall of RSS by square cells along the axes: k = pi/L (q,) [1/m] and the gains (q,).

    Their two waves k (1, 1) and k (1, -1) flow at right angles, so that their gains add up. rest:
    what is left of the rows (m, 2) [m/s], times their weight; bounds: of k [1/m].
    """
    position = rows.place[:, :2]
    half = (line_steps(extent_of(position), bounds) + 1) // 2
    step = np.array([0.5 * (bounds[1] - bounds[0]) / half or 1.0])
    own, total = rows.weight, np.zeros(2 * half + 1)
    count = float(own @ own)
    moved = own[:, None] * (rest - np.outer(own, own @ rest / count))
    x, y = (position - middle(position)).T
    for along, load in ((x + y, moved[:, 0] - moved[:, 1]), (x - y, moved[:, 0] + moved[:, 1])):
        sums = partial(fourier_sums, along[:, None], step, (half,), centre=sum(bounds) / 2)
        once, twice = (sums(own * own, times=times) / count for times in (1, 2))
        total += gain(sums(math.sqrt(0.5) * load), once, twice, count)
    return sum(bounds) / 2 + step * np.arange(-half, half + 1.0), total


@dataclass(frozen=True, eq=False)
class WaveScan:
    """The share of rows that one wave explains, over the wavevectors that the track resolves."""

    rows: FlowRows
    radii: Bounds  # the least and the largest |k| [rad/m]
    fastest: float = 0.0  # velocity of waves [m/s]; 0: they stand
    pieces: int = 1  # of the track, each with amplitudes of its own
    _memory: dict[str, Any] = field(default_factory=dict)  # of the last rows, often asked for twice

    @classmethod
    def of(cls, rows: FlowRows, radii: Bounds, fastest: float = 0.0) -> WaveScan | None:
        """The scan in the fewest pieces that take .1 s; None where these have too few rows."""
        pieces = FEWEST_PIECES if fastest else 1
        while True:
            scan = cls(rows, radii, fastest, pieces)
            most = (300_000 if fastest else 500_000) * (1 if pieces == 1 else FEWEST_PIECES)
            if math.prod(2 * half + 1 for half in scan.halves) * pieces <= most:
                return scan
            pieces = max(FEWEST_PIECES, pieces + pieces // 4)
            if len(rows.place) < 12 * pieces:
                return None

    @cached_property
    def steps(self) -> Array:
        """Between wavenumbers [rad/m] and frequencies [rad/s]: half a lobe of a piece, (3,)."""
        return self.rows.reach(self.pieces)

    @property
    def halves(self) -> tuple[int, ...]:
        """Steps from the middle of the grid to its sides, along k_x, k_y and omega."""
        half = math.ceil(self.radii[1] / self.steps[0])
        if not self.fastest:
            return half, half
        return half, half, math.ceil(self.radii[1] * self.fastest / self.steps[2])

    @cached_property
    def axis(self) -> Array:
        """The wavenumbers (n,) along either axis [rad/m]."""
        return np.asarray(self.steps[0] * np.arange(-self.halves[0], self.halves[0] + 1.0))

    @cached_property
    def radius(self) -> Array:
        """|k| of the grid (n, n) [rad/m]."""
        return np.asarray(np.hypot(self.axis[:, None], self.axis))

    @cached_property
    def inside(self) -> Array:
        """1 where a wavevector of the grid (n, n) is between the radii, else 0."""
        low, high = self.radii
        return ((self.radius >= low) & (self.radius <= high)).astype(float)

    def gains(self, rest: Array) -> tuple[Array, Array]:
        """The fall of RSS by one wave (n, n) of rows (m, 2) [m/s], and its omega (n, n) [rad/s]."""
        memory, total, dimensions = self._memory, np.zeros(1), len(self.halves)
        if memory.get("rest") is rest:
            gains: tuple[Array, Array] = memory["gains"]
            return gains
        parts = (self.rows.place, rest, self.rows.weight)
        cuts = (np.array_split(part, self.pieces) for part in parts)
        for place, errors, weight in zip(*cuts, strict=True):
            nodes = (place - middle(place))[:, :dimensions] * (1.0, 1.0, -1.0)[:dimensions]
            sums = partial(fourier_sums, nodes, self.steps[:dimensions], self.halves)
            squares = weight**2
            count = float(squares.sum())
            constant = np.outer(weight, weight @ errors / count)
            load = self._across(sums, weight[:, None] * (errors - constant))
            if self.pieces == 1 and dimensions == 2:
                if "means" not in memory:
                    memory["means"] = sums(squares) / count, sums(squares, times=2) / count
                once, twice = memory["means"]
                total = gain(load, once, twice, count)
            else:
                total = total + (2.0 / count) * (load.real**2 + load.imag**2)
        omega, best = np.zeros(1), np.zeros(total.shape[:2], dtype=np.intp)
        if dimensions == 3:
            half = self.halves[2]
            omega = self.steps[2] * np.arange(-half, half + 1.0)
            fastest = self.fastest * self.radius + self.steps[2]
            total = total * (np.abs(omega) <= fastest[..., None])
            best = total.argmax(axis=2)
            total = np.take_along_axis(total, best[..., None], axis=2)[..., 0]
        memory |= {"rest": rest, "gains": (self.inside * total, omega[best])}
        return self.inside * total, omega[best]

    def _across(self, sums: Callable[[ComplexArray], ComplexArray], errors: Array) -> ComplexArray:
        """(k_y, -k_x)/|k| . sum exp(i k.x) Phi (n, n, ...) of errors Phi (m, 2), k = 0 at 0."""
        both = sums(errors[:, 0] + 1j * errors[:, 1])
        back = np.conj(np.flip(both))
        k_y = self.axis.reshape(-1, *[1] * (both.ndim - 2)).astype(both.real.dtype)
        k_x = k_y[:, None]
        radius = np.hypot(k_x, k_y)
        radius[radius == 0] = 1.0
        # Sums of u are half of both + back, sums of v half of both - back over i.
        of_u, of_v = 0.5 * k_y / radius, 0.5j * (k_x / radius)
        load: ComplexArray = (of_u + of_v) * both + (of_u - of_v) * back
        return load

    def waves(self, gains: Array, most: int) -> Array:
        """The wavevectors (p, 2) [rad/m] of the highest peaks of gains, one of k and -k."""
        upper = np.where(self.axis >= 0, gains, 0.0)  # of k_y >= 0
        chosen: Array = self.axis[peaks(upper, most)]
        return chosen

    def squares(self, gains: Array, most: int) -> IntArray:
        """The places (p, 2) of the highest squares, two waves at right angles, one of four."""
        crossed = gains + gains[::-1].T
        return peaks(np.where((self.axis[:, None] > 0) & (self.axis >= 0), crossed, 0.0), most)
