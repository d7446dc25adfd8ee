"""The continuum behind a library's grid: the columns at every wavenumber or wavevector.

Back-ends that place groups of their own ask it for columns at any q and for a scan of all of them
(`sparsefit.regression.continuous_columns`). A group is a fixed mixture of cos and sin of k_j.x over
the waves j of a `Shape`: the 8 candidates of cells over four waves, q = k, or the two columns of
one wave of a stream function, q = (|k|, heading). Inner products with a residual are Fourier
sums over the rows, and so are their mean squares: products of two waves are waves.

A scan can miss little: positions lie within D of their middle, so that along any line a sum is
band-limited by D, and a peak falls by (d D)^2 / 2 of its height within a distance d (Bernstein).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array, ComplexArray, IntArray
from sparsefit.cached import cached_property
from sparsefit.model.columns import (
    CANDIDATES,
    candidate_columns,
    sines_and_cosines,
    wave_names,
    wave_theta,
)
from sparsefit.model.grid import Bounds, extent_of, middle
from sparsefit.model.scan import FourierSums, peaks
from sparsefit.model.shapes import CELLS, QUARTER, WAVE, Shape

EQUATION_1 = np.zeros((8, 2))
"""The weights of Eq. 1 for U0 = 1 m/s."""
EQUATION_1[CANDIDATES.index("sin x cos y"), 0] = 1.0
EQUATION_1[CANDIDATES.index("cos x sin y"), 1] = -1.0
STEP = 0.15  # of a scan of cells, in 1/extent: a thirtieth of a lobe
MISSED = 0.02  # of a peak's height: what a scan of waves may not show
ACCURACY = 1e-9  # of the sums, relative to the number of rows
UNKNOWN = 1e-6  # of a column's mean square: less is lost in the sums' error

# The 8 candidates from cos k s, then sin k s, of s = x, y, x + y, x - y, the waves of `CELLS`.
OF_LINES = np.zeros((8, 8))
OF_LINES[[0, 1, 2, 3], [4, 5, 0, 1]] = 1.0
OF_LINES[4, [3, 2]], OF_LINES[5, [6, 7]] = (0.5, -0.5), (0.5, 0.5)
OF_LINES[6, [6, 7]], OF_LINES[7, [3, 2]] = (0.5, -0.5), (0.5, 0.5)
# Their mean squares from 1 and the means of cos 2 k s.
SQUARES = np.zeros((8, 5))
SQUARES[:4, 0], SQUARES[4:, 0] = 0.5, 0.25
SQUARES[[0, 1, 2, 3], [1, 2, 1, 2]] = -0.5, -0.5, 0.5, 0.5
SQUARES[4:, 1], SQUARES[4:, 2] = (-0.25, -0.25, 0.25, 0.25), (-0.25, 0.25, -0.25, 0.25)
SQUARES[4:, 3] = SQUARES[4:, 4] = 0.125, -0.125, -0.125, 0.125


@dataclass(frozen=True, eq=False)
class CellScan:
    """Cells of every wavenumber of a uniform grid, over one flight's rows.

    Args:
        position: of the rows (m, 2) [m].
        wavenumbers: k (q,) [1/m], both bounds included, an odd number of them.
        step: between them [1/m].
        weight: of every row (m,), already in what is scanned; None: all are 1.
    """

    slack: ClassVar[float] = 0.02
    position: Array
    wavenumbers: Array
    step: float
    weight: Array | None = None

    def sums(self, loads: Array, times: int) -> ComplexArray:
        """Sums (4, j, q) of exp(i k s) over loads (j, m), for the four s, ``times`` k."""
        half, origin = len(self.wavenumbers) // 2, middle(self.position)
        centre, step = float(self.wavenumbers[half]), np.array([self.step])
        every = []
        for line in np.array(CELLS.waves)[:, :, 0]:
            along = (self.position - origin) @ line
            line_sums = FourierSums(along[:, None], step, (half,), centre, ACCURACY)
            shift = np.exp(1j * times * float(origin @ line) * self.wavenumbers)
            every.append(line_sums.of(loads, times).reshape(len(loads), -1) * shift)
        return np.stack(every)

    @cached_property
    def _squares(self) -> tuple[Array, float]:
        """1 and the means of cos 2 k s (5, q), and the sum of the squares of the weights."""
        own = np.ones(len(self.position)) if self.weight is None else self.weight
        mass = float(own @ own)
        means = self.sums((own * own)[None], 2)[:, 0].real / mass
        return np.vstack([np.ones(means.shape[1]), means]), mass

    def cross(self, loads: Array) -> Array:
        """Inner products (8, j, q) of the candidates with loads (j, m)."""
        sums = self.sums(loads if self.weight is None else loads * self.weight, 1)
        products: Array = np.tensordot(OF_LINES, np.concatenate([sums.real, sums.imag]), axes=1)
        return products

    def heights(self, residual: Array) -> Array:
        """|Z(k)'R|_F / m (q,) of a residual (m, n), Z the candidates in columns of unit rms."""
        rms = np.sqrt(np.maximum(SQUARES @ self._squares[0], UNKNOWN))
        scaled = self.cross(residual.T) / len(residual) / rms[:, None]
        heights: Array = np.sqrt(np.sum(scaled**2, axis=(0, 1)))
        return heights

    def tops(
        self, residual: Array, slack: float, pattern: Array | None = None
    ) -> tuple[Array, Array]:
        """k (j, 1) of local maxima of `heights` within slack of the highest, and the step.

        pattern: `EQUATION_1` f = C(k) S, whose <f, R> / |f| is scanned in their place, where > 0.
        """
        if pattern is None:
            heights = self.heights(residual)
        else:
            means, mass = self._squares
            product = np.einsum("ctq,ct->q", self.cross(residual.T), pattern)
            square = mass * (0.5 - 0.25 * (means[3] + means[4]))
            heights = np.maximum(product, 0.0) / np.sqrt(np.maximum(square, 1e-6 * len(residual)))
        tops = peaks(heights)[:, 0]
        places = self.wavenumbers[tops[heights[tops] >= (1 - slack) * heights.max()]][:, None]
        return places, np.full(places.shape, self.step)


@dataclass(frozen=True, eq=False)
class PlaneHeights:
    """|Z(k)'R| / 2m over a square grid of wavevectors, Z the two columns of a wave in unit rms.

    The group-LASSO by wave is optimal over the whole plane where this is alpha at most.

    Args:
        position: of the samples (m, 2) [m].
        bounds: of |k| [rad/m]; the grid ends a step beyond.
        step: between wavevectors along either axis [rad/m].
    """

    slack: ClassVar[float] = 3 * MISSED
    position: Array
    bounds: Bounds
    step: float

    @cached_property
    def _sums(self) -> FourierSums:
        half = math.ceil(self.bounds[1] / self.step) + 1
        place = self.position - middle(self.position)
        return FourierSums(place, np.full(2, self.step), (half, half), accuracy=ACCURACY)

    @property
    def axis(self) -> Array:
        """k_x, and k_y, of the grid (q,) [rad/m]."""
        return self._sums.axes[0]

    @cached_property
    def _rms(self) -> tuple[ComplexArray, Array]:
        """The turn of phases to the flight's own coordinates (q, q), and rms (3, q, q).

        Of psi = cos, of psi = sin, and the least of any phase between them, over |k|.
        """
        origin, k_x, k_y = middle(self.position), self.axis[:, None], self.axis
        turn = np.exp(1j * (origin[0] * k_x + origin[1] * k_y))
        doubled = self._sums.of(np.ones(len(self.position)), 2) / len(self.position)
        share = (doubled * turn * turn).real
        shares = np.stack([-share, share, -np.abs(doubled)])
        return turn, np.sqrt(np.maximum((1 + shares) / 4, UNKNOWN))

    def heights(self, residual: Array, *, highest: bool = False) -> Array:
        """The heights (q, q), 0 at k = 0, of a residual (2 m, 1) [m/s], u before v of a sample.

        highest: an upper bound instead, over all phases of the waves at the origin.
        """
        turn, rms = self._rms
        load = self._sums.across(residual.reshape(-1, 2)) * turn
        parts = np.abs(load)[None] if highest else np.stack([load.imag, load.real])
        scaled = parts / (rms[2:] if highest else rms[:2])
        heights: Array = np.sqrt(np.sum(scaled**2, axis=0)) / (2 * len(self.position))
        return heights

    def tops(
        self, residual: Array, slack: float, pattern: Array | None = None
    ) -> tuple[Array, Array]:
        """(|k|, heading) (j, 2) of local maxima within slack of the highest, and reaches (j, 2).

        Highest first; a reach is how far from each the peak may be, a step along and across.
        """
        radius = np.hypot(self.axis[:, None], self.axis)
        near = (radius > self.bounds[0] - self.step) & (radius < self.bounds[1] + self.step)
        near &= self.axis > -0.5 * self.step
        heights, bound = (
            np.where(near, self.heights(residual, highest=highest), 0.0)
            for highest in (False, True)
        )
        limit, places = (1 - slack) * heights.max(), np.concatenate([peaks(heights), peaks(bound)])
        tops = np.unique(places[bound[tuple(places.T)] >= limit], axis=0)
        tops = tops[np.argsort(-heights[tuple(tops.T)], kind="stable")]
        k = self._turned(self.axis[tops], residual)
        radii = np.clip(np.hypot(*k.T), *self.bounds)
        reach = np.column_stack([np.full(len(k), self.step), self.step / radii])
        return np.column_stack([radii, np.arctan2(k[:, 1], k[:, 0])]), reach

    def _turned(self, k: Array, residual: Array) -> Array:
        """Waves (j, 2) moved within a step to where their phases at the origin suit them best.

        Where a flight is far from its origin, cosine and sine of a wave change places, and with
        them the rms that each is divided by, faster than the step resolves.
        """
        origin, turns = middle(self.position), 9
        away = max(float(np.hypot(*origin)), 1e-300)
        half = min(self.step, max(0.5 * self.step, 0.5 * math.pi / away))
        tried = k[:, None] + half * np.linspace(-1.0, 1.0, turns)[:, None] * origin / away
        theta = wave_theta(self.position, tried.reshape(-1, 2))
        scale = np.sqrt(np.mean(theta**2, axis=0))
        products = theta.T @ residual / np.where(scale > 0, scale, np.inf)[:, None]
        heights = np.sum(products.reshape(len(k), turns, -1) ** 2, axis=2)
        best: Array = tried[np.arange(len(k)), heights.argmax(axis=1)]
        return best


@dataclass(frozen=True, eq=False)
class ShapeContinuum:
    """The columns of a family at any parameters q of its shape, over the rows of one flight.

    Args:
        shape: `CELLS`, q = k = pi/L, with the 8 candidates and a row per sample; or `WAVE`,
            q = (|k|, heading), with two columns and rows x before y of each sample.
        position: of every sample (m, 2) [m].
        bounds: of pi/L where none are asked for: those of the library's grid [1/m].
        pattern: the weights (8, n) of a target known up to its size, if it is.
        weight: of every row (m,), with which the target is multiplied; None: all are 1.
    """

    shape: Shape
    position: Array
    bounds: Bounds
    pattern: Array | None = None
    weight: Array | None = None

    @property
    def waves(self) -> bool:
        """Whether the columns are those of a wave of a stream function."""
        return self.shape == WAVE

    @property
    def size(self) -> int:
        """The columns of a group: 8 of cells, 2 of a wave."""
        return 2 if self.waves else len(CANDIDATES)

    @property
    def parameters(self) -> int:
        """The numbers of q."""
        return self.shape.parameters

    @property
    def extent(self) -> float:
        """The larger side of the flight's bounding box [m]."""
        return extent_of(self.position)

    def interval(self, lower: float | None, upper: float | None) -> Bounds:
        """Bounds of the wavenumber for bounds of the length scale [m]; None: the grid's own.

        k = pi/L of cells, and |k| = sqrt(2) pi/L of waves.
        """
        low = self.bounds[0] if upper is None else math.pi / upper
        high = self.bounds[1] if lower is None else math.pi / lower
        unit = math.sqrt(2.0) if self.waves else 1.0
        return unit * min(low, high), unit * max(low, high)

    @property
    def _step(self) -> float:
        """Between waves [rad/m]: what leaves at most MISSED of a peak between them."""
        away = self.position - middle(self.position)
        return 2 * math.sqrt(MISSED) / float(np.hypot(*away.T).max())

    def scan_points(self, bounds: Bounds) -> int:
        """The places of a scan: of waves they grow with the square of the extent."""
        if self.waves:
            return (2 * math.ceil(bounds[1] / self._step) + 3) ** 2
        steps = max(math.ceil((bounds[1] - bounds[0]) * self.extent / STEP), 8)
        return 2 * math.ceil(steps / 2) + 1 if bounds[1] > bounds[0] else 1

    def scan(self, bounds: Bounds) -> CellScan | PlaneHeights:
        """The scan between bounds of the wavenumber [rad/m]."""
        if self.waves:
            return PlaneHeights(self.position, bounds, self._step)
        count = self.scan_points(bounds)
        step = (bounds[1] - bounds[0]) / (count - 1) if count > 1 else STEP / self.extent
        wavenumbers: Array = bounds[0] + step * np.arange(count, dtype=np.float64)
        return CellScan(self.position, wavenumbers, step, self.weight)

    def columns(self, places: Array) -> tuple[Array, Array, Array]:
        """The columns (s, c, m) at q (s, p), and their first and second derivatives by q."""
        value, slope, bend = zip(*(self._jet(q) for q in places), strict=True)
        return np.stack(value), np.stack(slope), np.stack(bend)

    def _jet(self, q: Array) -> tuple[Array, ...]:
        phases, by_q = (part[..., :2] for part in self.shape.phases(q))
        twice = np.zeros((len(q), *by_q.shape))
        if self.shape.turned:
            twice[:, -1] = twice[-1] = by_q @ QUARTER
        sine, cosine = sines_and_cosines(phases @ self.position.T)
        turns = np.stack([[cosine, sine], [-sine, cosine], [-cosine, -sine], [sine, -cosine]])
        wave, late, later = turns[1:] if self.waves else turns[:3]
        if self.waves:  # each is (k_y, -k_x) of it
            a, by_a, twice_a = (part[..., ::-1] * (1.0, -1.0) for part in (phases, by_q, twice))
        else:
            a, by_a, twice_a = (part[..., :1] * 0.0 for part in (phases, by_q, twice))
            a = a + 1.0
        first, second = by_q @ self.position.T, twice @ self.position.T  # of the phases
        value = np.einsum("jd,hjm->hjmd", a, wave)
        slope = np.einsum("pjd,hjm->phjmd", by_a, wave)
        slope += np.einsum("jd,pjm,hjm->phjmd", a, first, late)
        crossed = np.einsum("pjd,rjm,hjm->prhjmd", by_a, first, late)
        bend = np.einsum("prjd,hjm->prhjmd", twice_a, wave) + crossed + crossed.swapaxes(0, 1)
        bend += np.einsum("jd,pjm,rjm,hjm->prhjmd", a, first, first, later)
        bend += np.einsum("jd,prjm,hjm->prhjmd", a, second, late)
        jets = []
        for part in (value, slope, bend):
            flat = part.reshape(*part.shape[:-4], 2 * len(phases), -1)
            flat = flat if self.waves else OF_LINES @ flat
            jets.append(flat if self.weight is None else flat * self.weight)
        return tuple(jets)

    def spans(self, places: Array) -> Array:
        """The extent [m] for every |k|, and |k| of it for every heading, (s, p)."""
        return self.extent * np.column_stack([np.ones(len(places)), places[:, :-1]])

    def images(self, places: Array) -> tuple[Array, Array]:
        """Every wave as it is and turned by half a turn either way, and signs; cells alone."""
        if not self.waves:
            return places[None], np.ones((1, self.size))
        turns = np.array([[0.0, 0.0], [0.0, math.pi], [0.0, -math.pi]])
        return places + turns[:, None], np.array([[1.0, 1.0], [1.0, -1.0], [1.0, -1.0]])

    def design(self, places: Array) -> tuple[Array, Array, Array, tuple[str, ...]]:
        """Theta (m, c s) at q (s, p), k (s, 1 or 2) [rad/m], length scales (s,) [m] and names."""
        if self.waves:
            size, heading = places.T
            k = size[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
            return wave_theta(self.position, k), k, math.sqrt(2.0) * math.pi / size, wave_names(k)
        scales = math.pi / places[:, 0]
        names = tuple(f"{name} (L = {scale:.6g} m)" for scale in scales for name in CANDIDATES)
        theta = candidate_columns(self.position, scales)
        if self.weight is not None:
            theta *= self.weight[:, None]
        return theta, places, scales, names

    def places(self, parameters: Array) -> Array:
        """The q (s, p) of modes with parameters as `design` gives them."""
        if not self.waves:
            return parameters
        x, y = parameters.T
        return np.column_stack([np.hypot(x, y), np.arctan2(y, x)])

    def at(self, rows: IntArray) -> ShapeContinuum | None:
        """The continuum of some rows (r,); None where they are not whole samples."""
        if self.waves:
            first, second = rows[::2], rows[1::2]
            whole = len(first) == len(second) and np.array_equal(first + 1, second)
            if not whole or np.any(first % 2):
                return None
            rows = first // 2
        weight = None if self.weight is None else self.weight[rows]
        return replace(self, position=self.position[rows], weight=weight)
