"""The continua behind a library's grid: the columns at every wavenumber or wavevector.

Back-ends that place groups of their own ask a continuum for columns at any q and for a scan of all
of them (`sparsefit.regression.continuum`). Inner products of columns with a residual are Fourier
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
from sparsefit.model.cells import CANDIDATES, candidate_columns, candidate_jet
from sparsefit.model.grid import Bounds, extent_of, middle
from sparsefit.model.scan import FourierSums, peaks
from sparsefit.model.waves import polar_jet, wave_theta

EQUATION_1 = np.zeros((8, 2))
"""The weights of Eq. 1 for U0 = 1 m/s."""
EQUATION_1[CANDIDATES.index("sin x cos y"), 0] = 1.0
EQUATION_1[CANDIDATES.index("cos x sin y"), 1] = -1.0
STEP, FEWEST = 0.15, 8  # of a scan of cells, in 1/extent: a thirtieth of a lobe; steps at least
MISSED = 0.02  # of a peak's height: what a scan of waves may not show
TURNS = 9  # places within a step of a wave that are tried
ACCURACY = 1e-9  # of the sums, relative to the number of rows
UNKNOWN = 1e-6  # of a column's mean square: less is lost in the sums' error

# The 8 candidates from cos k s, then sin k s, of s = x, y, x + y, x - y.
LINES = ((1, 0), (0, 1), (1, 1), (1, -1))
OF_LINES = np.zeros((8, 8))
OF_LINES[[0, 1, 2, 3], [4, 5, 0, 1]] = 1.0
OF_LINES[4, [3, 2]], OF_LINES[5, [6, 7]] = (0.5, -0.5), (0.5, 0.5)
OF_LINES[6, [6, 7]], OF_LINES[7, [3, 2]] = (0.5, -0.5), (0.5, 0.5)


@dataclass(frozen=True, eq=False)
class CellScan:
    """Cells of every wavenumber of a uniform grid, over one flight's rows.

    Args:
        position: of the rows (m, 2) [m].
        wavenumbers: k (q,) [1/m], both bounds included, an odd number of them.
        step: between them [1/m].
        weight: of every row (m,), already in what is scanned; None: all are 1.
    """

    slack: ClassVar[float] = 0.02  # peaks this close to the highest may hold the supremum
    position: Array
    wavenumbers: Array
    step: float
    weight: Array | None = None

    def sums(self, loads: Array, times: int) -> ComplexArray:
        """Sums (4, j, q) of exp(i k s) over loads (j, m), for s of `LINES`, ``times`` k."""
        half, origin = len(self.wavenumbers) // 2, middle(self.position)
        centre, step = float(self.wavenumbers[half]), np.array([self.step])
        every = []
        for line in np.array(LINES, dtype=float):
            along = (self.position - origin) @ line
            line_sums = FourierSums(along[:, None], step, (half,), centre, ACCURACY)
            shift = np.exp(1j * times * float(origin @ line) * self.wavenumbers)
            every.append(line_sums.of(loads, times).reshape(len(loads), -1) * shift)
        return np.stack(every)

    @cached_property
    def _squares(self) -> tuple[Array, float]:
        """Means of cos 2 k s (4, q) of `LINES`, and the sum of the squares of the weights."""
        own = np.ones(len(self.position)) if self.weight is None else self.weight
        mass = float(own @ own)
        return self.sums((own * own)[None], 2)[:, 0].real / mass, mass

    @cached_property
    def rms(self) -> Array:
        """The rms of each candidate (q, 8); a thousandth where the sums cannot tell it from 0."""
        c_x, c_y, c_plus, c_minus = self._squares[0]
        pair, cross = c_x + c_y, 0.5 * (c_plus + c_minus)
        squares = [(1 - c_x) / 2, (1 - c_y) / 2, (1 + c_x) / 2, (1 + c_y) / 2]
        squares += [(1 - pair + cross) / 4, (1 - c_x + c_y - cross) / 4]
        squares += [(1 + c_x - c_y - cross) / 4, (1 + pair + cross) / 4]
        rms: Array = np.sqrt(np.maximum(np.stack(squares, axis=-1), UNKNOWN))
        return rms

    def cross(self, loads: Array) -> Array:
        """Inner products (8, j, q) of the candidates with loads (j, m)."""
        sums = self.sums(loads if self.weight is None else loads * self.weight, 1)
        products: Array = np.tensordot(OF_LINES, np.concatenate([sums.real, sums.imag]), axes=1)
        return products

    def heights(self, residual: Array) -> Array:
        """|Z(k)'R|_F / m (q,) of a residual (m, n), Z the candidates in columns of unit rms."""
        scaled = self.cross(residual.T) / len(residual) / self.rms.T[:, None]
        heights: Array = np.sqrt(np.sum(scaled**2, axis=(0, 1)))
        return heights

    def tops(self, residual: Array, slack: float) -> tuple[Array, Array]:
        """k (j, 1) of local maxima of `heights` within slack of the highest, and the step."""
        heights = self.heights(residual)
        tops = peaks(heights)[:, 0]
        places = self.wavenumbers[tops[heights[tops] >= (1 - slack) * heights.max()]][:, None]
        return places, np.full(places.shape, self.step)

    def matched(self, pattern: Array, target: Array) -> tuple[Array, Array]:
        """<f, Y> and <f, f> (q,) of Eq. 1, f = C(k) S, S the pattern (8, n), and Y (m, n)."""
        product = np.einsum("ctq,ct->q", self.cross(target.T), pattern)
        means, mass = self._squares
        return product, mass * (0.5 - 0.25 * (means[2] + means[3]))


@dataclass(frozen=True, eq=False)
class CellContinuum:
    """The cells of any wavenumber, over the rows of one flight.

    Args:
        position: of every row (m, 2) [m].
        bounds: of k where none are asked for: those of the library's grid [1/m].
        pattern: the weights (8, n) of a target known up to its size, if it is.
        weight: of every row (m,), with which the target is multiplied; None: all are 1.
    """

    size: ClassVar[int] = len(CANDIDATES)
    parameters: ClassVar[int] = 1
    position: Array
    bounds: Bounds
    pattern: Array | None = None
    weight: Array | None = None

    @property
    def extent(self) -> float:
        """The larger side of the flight's bounding box [m]."""
        return extent_of(self.position)

    def interval(self, lower: float | None, upper: float | None) -> Bounds:
        """[pi/upper, pi/lower] [1/m] for bounds of the length scale [m]; None: the grid's own."""
        low = self.bounds[0] if upper is None else math.pi / upper
        high = self.bounds[1] if lower is None else math.pi / lower
        return min(low, high), max(low, high)

    def scan_points(self, bounds: Bounds) -> int:
        """The wavenumbers of a scan: they grow with the extent and the interval."""
        steps = math.ceil((bounds[1] - bounds[0]) * self.extent / STEP)
        return 2 * math.ceil(max(steps, FEWEST) / 2) + 1 if bounds[1] > bounds[0] else 1

    def scan(self, bounds: Bounds) -> CellScan:
        """The scan of an interval of k [1/m]."""
        count = self.scan_points(bounds)
        step = (bounds[1] - bounds[0]) / (count - 1) if count > 1 else STEP / self.extent
        wavenumbers: Array = bounds[0] + step * np.arange(count, dtype=np.float64)
        return CellScan(self.position, wavenumbers, step, self.weight)

    def columns(self, places: Array) -> tuple[Array, Array, Array]:
        """The candidates (s, 8, m) and their derivatives by k, at k (s, 1) [1/m]."""
        value, slope, bend = candidate_jet(self.position, np.ravel(places))
        own = 1.0 if self.weight is None else self.weight
        return value * own, slope[:, None] * own, bend[:, None, None] * own

    def spans(self, places: Array) -> Array:
        """The extent [m], for every k (s, 1)."""
        return np.full(places.shape, self.extent)

    def images(self, places: Array) -> tuple[Array, Array]:
        """Every k (s, 1) alone: each means cells of its own."""
        return places[None], np.ones((1, self.size))

    def design(self, places: Array) -> tuple[Array, Array, Array, tuple[str, ...]]:
        """Theta (m, 8 s) at k (s, 1) [1/m], k, the length scales (s,) [m] and the names."""
        scales = math.pi / places[:, 0]
        names = tuple(f"{name} (L = {scale:.6g} m)" for scale in scales for name in CANDIDATES)
        columns = candidate_columns(self.position, scales)
        if self.weight is not None:
            columns *= self.weight[:, None]
        return columns, places, scales, names

    def places(self, parameters: Array) -> Array:
        """k (s, 1) [1/m], the parameter of cells."""
        return parameters

    def at(self, rows: IntArray) -> CellContinuum:
        """The continuum of some rows (r,) of the flight."""
        weight = None if self.weight is None else self.weight[rows]
        return replace(self, position=self.position[rows], weight=weight)


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

        Of psi = cos, of psi = sin, and the least of any phase between them.
        """
        origin, k_x, k_y = middle(self.position), self.axis[:, None], self.axis
        turn = np.exp(1j * (origin[0] * k_x + origin[1] * k_y))
        square, count = k_x**2 + k_y**2, len(self.position)
        doubled = self._sums.of(np.ones(count), 2) / count
        share = (doubled * turn * turn).real
        shares = np.stack([-share, share, -np.abs(doubled)])
        return turn, np.sqrt(np.maximum(square * (1 + shares) / 4, UNKNOWN * square))

    def heights(self, residual: Array, *, highest: bool = False) -> Array:
        """The heights (q, q), 0 at k = 0, of a residual (2 m, 1) [m/s], u before v of a sample.

        highest: an upper bound instead, over all phases of the waves at the origin.
        """
        turn, rms = self._rms
        of_u, of_v = self._sums.of(np.ascontiguousarray(residual.reshape(-1, 2).T))
        load = (self.axis * of_u - self.axis[:, None] * of_v) * turn
        parts = np.abs(load)[None] if highest else np.stack([load.imag, load.real])
        least = rms[2:] if highest else rms[:2]
        scaled = np.divide(parts, least, out=np.zeros_like(parts), where=least > 0)
        heights: Array = np.sqrt(np.sum(scaled**2, axis=0)) / (2 * len(self.position))
        return heights

    def tops(self, residual: Array, slack: float) -> tuple[Array, Array]:
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
        origin = middle(self.position)
        away = max(float(np.hypot(*origin)), 1e-300)
        half = min(self.step, max(0.5 * self.step, 0.5 * math.pi / away))
        tried = k[:, None] + half * np.linspace(-1.0, 1.0, TURNS)[:, None] * origin / away
        theta = wave_theta(self.position, tried.reshape(-1, 2))
        scale = np.sqrt(np.mean(theta**2, axis=0))
        products = theta.T @ residual / np.where(scale > 0, scale, np.inf)[:, None]
        heights = np.sum(products.reshape(len(k), TURNS, -1) ** 2, axis=2)
        best: Array = tried[np.arange(len(k)), heights.argmax(axis=1)]
        return best


@dataclass(frozen=True, eq=False)
class WaveContinuum:
    """The waves of any wavevector, over the samples of one flight; rows are x before y of each.

    A wave is q = (|k|, its heading), so that bounds of the length scale L = sqrt(2) pi/|k| bound
    the first number alone.

    Args:
        position: of every sample (m, 2) [m].
        cells: bounds of pi/L where none are asked for, those of the library's grid [1/m].
    """

    size: ClassVar[int] = 2
    parameters: ClassVar[int] = 2
    position: Array
    cells: Bounds

    @property
    def extent(self) -> float:
        """The larger side of the flight's bounding box [m]."""
        return extent_of(self.position)

    @property
    def _step(self) -> float:
        """Between waves [rad/m]: what leaves at most MISSED of a peak between them."""
        away = self.position - middle(self.position)
        return 2 * math.sqrt(MISSED) / float(np.hypot(*away.T).max())

    def interval(self, lower: float | None, upper: float | None) -> Bounds:
        """Bounds of |k| [rad/m] for bounds of the length scale [m]; None: the grid's own."""
        low = self.cells[0] if upper is None else math.pi / upper
        high = self.cells[1] if lower is None else math.pi / lower
        return math.sqrt(2.0) * min(low, high), math.sqrt(2.0) * max(low, high)

    def scan_points(self, bounds: Bounds) -> int:
        """The wavevectors of a scan: they grow with the square of the extent."""
        return (2 * math.ceil(bounds[1] / self._step) + 3) ** 2

    def scan(self, bounds: Bounds) -> PlaneHeights:
        """The scan of the plane between bounds of |k| [rad/m]."""
        return PlaneHeights(self.position, bounds, self._step)

    def columns(self, places: Array) -> tuple[Array, Array, Array]:
        """The columns (s, 2, 2 m) of waves (s, 2) and their derivatives by |k| and heading."""
        return polar_jet(self.position, places)

    def spans(self, places: Array) -> Array:
        """The extent [m] for every |k|, and |k| of it for every heading, (s, 2)."""
        return self.extent * np.column_stack([np.ones(len(places)), places[:, 0]])

    def images(self, places: Array) -> tuple[Array, Array]:
        """Every wave as it is and turned by half a turn either way, (3, s, 2), and signs (3, 2)."""
        turns = np.array([[0.0, 0.0], [0.0, math.pi], [0.0, -math.pi]])
        return places + turns[:, None], np.array([[1.0, 1.0], [1.0, -1.0], [1.0, -1.0]])

    def design(self, places: Array) -> tuple[Array, Array, Array, tuple[str, ...]]:
        """Theta (2 m, 2 s) of waves (s, 2), k (s, 2) [rad/m], scales (s,) [m] and names."""
        size, heading = places.T
        k = size[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        scales = math.sqrt(2.0) * math.pi / size
        return wave_theta(self.position, k), k, scales, wave_names(k)

    def places(self, parameters: Array) -> Array:
        """(|k|, heading) (s, 2) of wavevectors k (s, 2) [rad/m]."""
        x, y = parameters.T
        return np.column_stack([np.hypot(x, y), np.arctan2(y, x)])

    def at(self, rows: IntArray) -> WaveContinuum | None:
        """The continuum of some rows (r,); None where they are not whole samples."""
        first, second = rows[::2], rows[1::2]
        whole = len(first) == len(second) and np.array_equal(first + 1, second)
        if not whole or np.any(first % 2):
            return None
        return replace(self, position=self.position[first // 2])


def wave_names(wavevectors: Array) -> tuple[str, ...]:
    """The names of the two columns of each of waves k (w, 2) [rad/m]."""
    parts = ("cos", "sin")
    return tuple(
        f"psi = {part} k.x (k = {x:.4g}, {y:.4g} 1/m)" for x, y in wavevectors for part in parts
    )
