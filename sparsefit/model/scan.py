"""The Fourier scan: the reduction of RSS by one wave, for a whole grid of wavevectors.

With s_k = sum exp(i k.x) Phi the columns of a wave k have the inner products (k_y, -k_x) . s_k with
Phi, and their Gram matrix depends only on the sums of exp(i k.x) and exp(2 i k.x): non-uniform
Fourier transforms (finufft; Barnett, Magland and af Klinteberg, 2019) give them at all k of a
uniform grid, along a line (1-D), over the plane (2-D), or with the frequency of waves that move
(3-D).

A track much longer than the waves is cut into pieces with separate amplitudes: a piece has a lower
resolution, and so needs fewer waves. Its Gram matrix is approximated by m/2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial

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
    most_single: int = 2_048,
) -> ComplexArray:
    """Sums of loads times exp(i k.x) over rows, (..., 2 half + 1, ...), at all k of a grid about 0.

    place: x of the rows (m, d), d = 1, 2 or 3. step (d,): the spacing of wavenumbers along each
    axis; half: the number of steps to either side. loads: of the rows, (m,) or (j, m). times: an
    integer factor of k. Up to most_single steps the sums are in single precision, with errors of
    1e-4 of the rows.
    """
    import finufft

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
    """The reduction of RSS by the two columns of one wave at every k, b'G^-1 b, beside constants.

    load: (k_y, -k_x)/|k| . s_k, of rows less their mean; once, twice: means of exp(i k.x) and of
    exp(2 i k.x) over ``count`` rows.
    """
    # The Gram matrix over m, of cos^2, sin cos and sin^2, constants projected out.
    first = 0.5 + 0.5 * twice.real - once.real**2
    last = 0.5 - 0.5 * twice.real - once.imag**2
    mixed = 0.5 * twice.imag - once.real * once.imag
    flat = 1e-2  # of m: smaller eigenvalues are those of a constant
    least = np.maximum(flat * np.maximum(first, last), flat**3)
    determinant = np.maximum(first * last - mixed**2, least)
    gains = last * load.real**2 - 2 * mixed * load.real * load.imag + first * load.imag**2
    gains /= determinant * count
    return np.asarray(gains, dtype=np.float64)


def peaks(values: Array, most: int | None = None) -> IntArray:
    """Indices (p, d) of the local maxima above 0 of values of d dimensions, highest first."""
    around = np.pad(values, 1, constant_values=-np.inf)
    for _ in values.shape:  # each axis in turn
        around = np.moveaxis(around, -1, 0)
        around = np.maximum(np.maximum(around[:-2], around[1:-1]), around[2:])
    places = np.argwhere((values >= around) & (values > 0))
    order = np.argsort(-values[tuple(places.T)], kind="stable")
    ordered: IntArray = places[order[:most]]
    return ordered


def line_steps(extent: float, bounds: Bounds) -> int:
    """The steps of a scan along a line between bounds of k = pi/L [1/m], half a radian each."""
    return max(8, math.ceil((bounds[1] - bounds[0]) * extent / 0.5))


def axis_gains(rows: FlowRows, rest: Array, bounds: Bounds) -> tuple[Array, Array]:
    """The reduction of RSS by square cells along the axes: k = pi/L (q,) [1/m] and gains (q,).

    The flows of their two waves k (1, 1) and k (1, -1) are at right angles, so that their gains
    add up. rest: residual of the rows (m, 2) [m/s], times their weight; bounds: of k [1/m].
    """
    position, centre = rows.place[:, :2], sum(bounds) / 2
    half = (line_steps(extent_of(position), bounds) + 1) // 2
    step = np.array([0.5 * (bounds[1] - bounds[0]) / half or 1.0])
    own, total = rows.weight, np.zeros(2 * half + 1)
    count = float(own @ own)
    moved = own[:, None] * (rest - np.outer(own, own @ rest / count))
    x, y = (position - middle(position)).T
    for along, load in ((x + y, moved[:, 0] - moved[:, 1]), (x - y, moved[:, 0] + moved[:, 1])):
        sums = partial(fourier_sums, along[:, None], step, (half,))
        turn = np.exp(1j * centre * along)
        once, twice = (sums(own * own * turn**n, times=n) / count for n in (1, 2))
        total += gain(sums(math.sqrt(0.5) * load * turn), once, twice, count)
    return centre + step * np.arange(-half, half + 1.0), total


@dataclass(frozen=True, eq=False)
class WaveScan:
    """The scan of the rows by one wave, over the wavevectors that the track resolves."""

    rows: FlowRows
    radii: Bounds  # the least and the largest |k| [rad/m]
    fastest: float  # velocity of waves [m/s]; 0: steady
    pieces: int  # of the track, with separate amplitudes
    steps: Array  # between wavenumbers [rad/m] and frequencies [rad/s]: half a lobe of a piece
    halves: tuple[int, ...]  # steps to the sides of the grid, along k_x, k_y and omega

    @classmethod
    def of(cls, rows: FlowRows, radii: Bounds, fastest: float = 0.0) -> WaveScan | None:
        """The scan in the fewest pieces that take about .1 s; None if these have too few rows."""
        pieces = FEWEST_PIECES if fastest else 1
        while True:
            steps = rows.reach(pieces)[: 3 if fastest else 2]
            ends = np.array([radii[1], radii[1], radii[1] * fastest])[: len(steps)]
            halves = tuple(np.ceil(ends / steps).astype(int).tolist())
            most = (300_000 if fastest else 500_000) * (1 if pieces == 1 else FEWEST_PIECES)
            if math.prod(2 * half + 1 for half in halves) * pieces <= most:
                return cls(rows, radii, fastest, pieces, steps, halves)
            pieces = max(FEWEST_PIECES, pieces + pieces // 4)
            if len(rows.place) < 12 * pieces:
                return None

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
        """1 for wavevectors of the grid (n, n) between the radii, else 0."""
        low, high = self.radii
        return ((self.radius >= low) & (self.radius <= high)).astype(float)

    @cached_property
    def means(self) -> tuple[ComplexArray, ComplexArray]:
        """The means of exp(i k.x) and of exp(2 i k.x) over the rows of a track in one piece."""
        squares = self.rows.weight**2
        node = self.rows.place[:, :2] - middle(self.rows.place[:, :2])
        sums = partial(fourier_sums, node, self.steps, self.halves, squares / squares.sum())
        return sums(), sums(times=2)

    def gains(self, rest: Array) -> tuple[Array, Array]:
        """The reduction of RSS of rows (m, 2) by one wave (n, n), and its omega (n, n) [rad/s]."""
        total, moving = np.zeros(1), len(self.halves) == 3
        # (k_y, -k_x) . s_k / |k|, from the sums of u + i v at k and at -k
        turn = (self.axis + 1j * self.axis[:, None]) / np.maximum(self.radius, 1e-300)
        turn = turn.reshape(*turn.shape, *[1] * moving)
        parts = (self.rows.place, rest, self.rows.weight)
        cuts = (np.array_split(part, self.pieces) for part in parts)
        for place, errors, weight in zip(*cuts, strict=True):
            nodes = ((place - middle(place)) * (1.0, 1.0, -1.0))[:, : len(self.halves)]
            count = float(weight @ weight)
            constant = np.outer(weight, weight @ errors / count)
            u, v = (weight[:, None] * (errors - constant)).T
            both = fourier_sums(nodes, self.steps, self.halves, u + 1j * v)
            turned = (0.5 * turn).astype(both.dtype)
            load = turned * both + np.conj(turned * np.flip(both))
            if self.pieces > 1:
                total = total + (2.0 / count) * (load.real**2 + load.imag**2)
            else:
                total = gain(load, *self.means, count)
        omega, best = np.zeros(1), np.zeros(total.shape[:2], dtype=np.intp)
        if moving:
            half = self.halves[2]
            omega = self.steps[2] * np.arange(-half, half + 1.0)
            fastest = self.fastest * self.radius + self.steps[2]
            total = total * (np.abs(omega) <= fastest[..., None])
            best = total.argmax(axis=2)
            total = np.take_along_axis(total, best[..., None], axis=2)[..., 0]
        return self.inside * total, omega[best]

    def waves(self, gains: Array, most: int) -> Array:
        """The wavevectors (p, 2) [rad/m] of the highest peaks of gains, one of k and -k."""
        upper = np.where(self.axis >= 0, gains, 0.0)  # of k_y >= 0
        chosen: Array = self.axis[peaks(upper, most)]
        return chosen

    def squares(self, gains: Array, most: int) -> IntArray:
        """The places (p, 2) of the highest squares, two waves at right angles, one of four."""
        crossed = gains + gains[::-1].T
        return peaks(np.where((self.axis[:, None] > 0) & (self.axis >= 0), crossed, 0.0), most)
