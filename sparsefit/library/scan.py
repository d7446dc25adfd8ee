"""The cells of every length scale at once: inner products on a grid of wavenumbers.

Entries of C(k)'C(k) and C(k)'w are sums of exp(i k s) over the rows, with or without weights w,
s = p x + q y: non-uniform Fourier transforms give them for all k of a uniform grid (finufft;
Barnett, Magland and af Klinteberg, 2019). The span of the 8 candidates is that of cos k s and
sin k s for four plane waves s, in which the Gram matrix is made; `CANDIDATES_OF_WAVES` leads back.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from sparsefit.arrays import Array, ComplexArray, box, local_maxima
from sparsefit.cached import cached_property
from sparsefit.library.cells import WAVES
from sparsefit.library.phase import sines_and_cosines

STEP = 0.15  # of a scan, in 1/extent: 0.6 steps over lobes of the residual
FEWEST = 8  # steps of a scan, however narrow the interval
SLACK = 0.02  # grid peaks this close to the highest may hold the supremum: three times that
ACCURACY = 1e-9  # of the Fourier sums, relative to the number of rows
RIDGE = 1e-6  # of the Gram matrix: above the error of its sums, and 2e-6 of |w|^2 at most
UNKNOWN_RMS = 1e-6  # the square below which a column's mean square is lost in the sums' error
OF_GRAM = [(i // 5 - 2, i % 5 - 2) for i in range(12)]  # waves; (-p, -q) is the conjugate of (p, q)
Bounds = tuple[float, float]

# The 8 candidates from cos k s, then sin k s, of s = x, y, x + y, x - y.
CANDIDATES_OF_WAVES = np.zeros((8, 8))
CANDIDATES_OF_WAVES[[0, 1, 2, 3], [4, 5, 0, 1]] = 1.0
for _candidate, _waves, _signs in (
    (4, (3, 2), (0.5, -0.5)),
    (5, (6, 7), (0.5, 0.5)),
    (6, (6, 7), (0.5, -0.5)),
    (7, (3, 2), (0.5, 0.5)),
):
    CANDIDATES_OF_WAVES[_candidate, list(_waves)] = _signs


@dataclass(frozen=True, eq=False)
class CellScan:
    """The columns of one mode of cells at every wavenumber of a grid, over one flight's rows.

    Args:
        position: of the rows, from the middle of their bounding box (m, 2) [m].
        centre: the middle of the box, to which the candidates' phases refer, (2,) [m].
        wavenumbers: k (q,) [1/m], uniform, both bounds included.
        step: between them [1/m].
        weight: of every row (m,), with which loads come already multiplied; None: all are 1.
    """

    slack: ClassVar[float] = SLACK
    position: Array
    centre: Array
    wavenumbers: Array
    step: float
    weight: Array | None = None

    @classmethod
    def of(cls, position: Array, bounds: Bounds, weight: Array | None = None) -> CellScan:
        """The scan over bounds of k [1/m] at a step that resolves the lobes of the rows.

        position (m, 2) [m]: the phases of the candidates are those at these positions. The rows
        must not all be in one place.
        """
        low, high = bounds
        steps = scan_steps(position, bounds)
        centre = middle(position)
        step = (high - low) / steps if steps else STEP / extent_of(position)
        wavenumbers: Array = low + step * np.arange(steps + 1, dtype=float)
        return cls(position - centre, centre, wavenumbers, step, weight)

    @property
    def squares(self) -> Array:
        """The square of the weight of every row, (1, m)."""
        ones = np.ones((1, len(self.position)))
        return ones if self.weight is None else ones * self.weight**2

    @property
    def mass(self) -> float:
        """The sum of these: how many rows there are, weighted."""
        return len(self.position) if self.weight is None else float(self.squares.sum())

    @cached_property
    def _phases(self) -> list[list[ComplexArray]]:
        """exp(i p k x) and exp(i p k y) (m,) by p of -2 to 2, at the k about which sums are taken.

        That is the middle of the grid.
        """
        k = float(self.wavenumbers[len(self.wavenumbers) // 2])
        return [_powers(k * place) for place in self.position.T]

    @cached_property
    def _shifts(self) -> list[list[ComplexArray]]:
        """The same of the middle of the box, at every wavenumber (q,)."""
        return [_powers(place * self.wavenumbers) for place in self.centre.tolist()]

    @cached_property
    def _plans(self) -> dict[int, Any]:
        """Transforms by their number of loads, made when they are first asked for."""
        return {}

    def _plan(self, loads: int) -> Any:
        import finufft

        if loads not in self._plans:
            size = (len(self.wavenumbers),)
            self._plans[loads] = finufft.Plan(
                1, size, n_trans=loads, eps=ACCURACY, isign=1, nthreads=1
            )
        return self._plans[loads]

    def sums(self, wave: tuple[int, int], loads: Array) -> ComplexArray:
        """Sums of w exp(i k s), s = p x + q y for wave (p, q), of loads w (j, m): (j, q).

        p and q are -2 to 2.
        """
        (p, q), (x, y) = wave, self.position.T
        plan = self._plan(len(loads))
        plan.setpts((self.step * p) * x + (self.step * q) * y)
        turned = np.ascontiguousarray(loads * (self._phases[0][p] * self._phases[1][q]))
        sums: ComplexArray = plan.execute(turned if len(loads) > 1 else turned[0])
        sums = sums.reshape(len(loads), -1)
        return sums * (self._shifts[0][p] * self._shifts[1][q]) if self.centre.any() else sums

    def ones(self, wave: tuple[int, int]) -> ComplexArray:
        """Sums (q,) of exp(i k s) for a wave, taken once: what the Gram matrix is made of."""
        if wave not in self._ones:
            self._ones[wave] = self.sums(wave, self.squares)[0]
        return self._ones[wave]

    @cached_property
    def _ones(self) -> dict[tuple[int, int], ComplexArray]:
        return {}

    @cached_property
    def factor(self) -> Array:
        """Cholesky factors (8, 8, q) of the Gram matrices of the waves, with a ridge."""
        factor = self.gram
        factor[range(8), range(8)] += RIDGE * self.mass
        for i in range(8):  # a column of the factor, for all k at once
            factor[i:, i] -= np.einsum("ijq,jq->iq", factor[i:, :i], factor[i, :i])
            factor[i:, i] /= np.sqrt(factor[i, i])
            factor[i, i + 1 :] = 0.0
        return factor

    @property
    def gram(self) -> Array:
        """Gram matrices (8, 8, q) of the cosines and sines of the waves.

        Products of two waves a and b are waves of a + b and a - b.
        """
        sums = {wave: self.ones(wave) for wave in OF_GRAM} | {(0, 0): np.array(self.mass + 0j)}
        sums |= {(-p, -q): values.conj() for (p, q), values in sums.items()}
        gram = np.empty((8, 8, len(self.wavenumbers)))
        for i, j in zip(*np.tril_indices(4), strict=True):
            minus, plus = (sums[tuple((WAVES[i] + sign * WAVES[j]).tolist())] for sign in (-1, 1))
            gram[i, j] = gram[j, i] = 0.5 * (plus.real + minus.real)
            gram[4 + i, 4 + j] = gram[4 + j, 4 + i] = 0.5 * (minus.real - plus.real)
            gram[4 + i, j] = gram[j, 4 + i] = 0.5 * (plus.imag + minus.imag)
            gram[i, 4 + j] = gram[4 + j, i] = 0.5 * (plus.imag - minus.imag)
        return gram

    def cross(self, loads: Array) -> Array:
        """Inner products (8, j, q) of the waves' cosines and sines with loads (j, m)."""
        loads = loads if self.weight is None else loads * self.weight
        return crossed([self.sums((p, q), loads) for p, q in WAVES.tolist()])

    def freed(self, loads: Array, cross: Array | None = None) -> Array:
        """Inner products (q, j, j) of loads (j, m) less what the columns at each k explain.

        cross: the `cross` of the loads, where it is known; it is overwritten.
        """
        cross, factor = self.cross(loads) if cross is None else cross, self.factor
        for i in range(8):  # forward substitution, for all k at once
            cross[i] -= np.einsum("lq,ljq->jq", factor[i, :i], cross[:i])
            cross[i] /= factor[i, i]
        left: Array = loads @ loads.T - np.einsum("ijq,ilq->qjl", cross, cross)
        return left

    @cached_property
    def rms(self) -> Array:
        """The rms of each candidate (q, 8); a thousandth where the sums cannot tell it from 0."""
        waves = (2 * WAVES).tolist()
        doubled = (self.ones((p, q)).real / self.mass for p, q in waves)
        c_x, c_y, c_plus, c_minus = doubled
        pair, cross = c_x + c_y, 0.5 * (c_plus + c_minus)
        squares = [(1 - c_x) / 2, (1 - c_y) / 2, (1 + c_x) / 2, (1 + c_y) / 2]
        squares += [(1 - pair + cross) / 4, (1 - c_x + c_y - cross) / 4]
        squares += [(1 + c_x - c_y - cross) / 4, (1 + pair + cross) / 4]
        rms: Array = np.sqrt(np.maximum(np.stack(squares, axis=-1), UNKNOWN_RMS))
        return rms

    def heights(self, residual: Array) -> Array:
        """|Z(k)'R|_F / m (q,) of a residual (m, n), Z the candidates in columns of unit rms."""
        cross = self.cross(np.ascontiguousarray(residual.T) / len(residual))
        scaled = np.tensordot(CANDIDATES_OF_WAVES, cross, axes=1) / self.rms.T[:, None]
        heights: Array = np.sqrt(np.sum(scaled**2, axis=(0, 1)))
        return heights

    def tops(self, residual: Array, slack: float) -> tuple[Array, Array]:
        """k (j, 1) of local maxima of `heights` within slack of the highest, and the step."""
        heights = self.heights(residual)
        highest = heights.max()
        tops = [i for i in local_maxima(heights) if heights[i] >= (1 - slack) * highest]
        places = self.wavenumbers[tops][:, None]
        return places, np.full(places.shape, self.step)

    def matched(self, pattern: Array, target: Array) -> tuple[Array, Array]:
        """<f, Y> and <f, f> (q,) of f = C(k) S, for weights S (8, n) and a target Y (m, n)."""
        in_waves = CANDIDATES_OF_WAVES.T @ pattern
        cross = self.cross(np.ascontiguousarray(target.T))
        product = np.einsum("ctq,ct->q", cross, in_waves)
        square = np.einsum("cdq,cd->q", self.gram, in_waves @ in_waves.T)
        return product, square


def crossed(sums: list[ComplexArray]) -> Array:
    """Inner products (8, j, q) of the waves' cosines and sines, from the sums of each wave."""
    every = np.stack(sums)
    return np.concatenate([every.real, every.imag])


def _powers(phase: Array) -> list[ComplexArray]:
    """exp(i p phase) by p: 0, 1, 2 and, from the end, -1, -2."""
    sine, cosine = sines_and_cosines(phase)
    once = cosine + 1j * sine
    twice = once * once
    return [np.ones_like(once), once, twice, twice.conj(), once.conj()]


def extent_of(position: Array) -> float:
    """The larger side of the bounding box of positions (m, 2) [m]."""
    low, high = box(position)
    return float((high - low).max())


def middle(position: Array) -> Array:
    """The middle of the bounding box of positions (m, 2)."""
    low, high = box(position)
    centre: Array = 0.5 * (high + low)
    return centre


def scan_steps(position: Array, bounds: Bounds) -> int:
    """The steps of a scan over bounds of k [1/m] of positions (m, 2) [m]: they grow with both."""
    steps = math.ceil((bounds[1] - bounds[0]) * extent_of(position) / STEP * (1 - 1e-12))
    return max(steps, FEWEST) if bounds[1] > bounds[0] else 0
