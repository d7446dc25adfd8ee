"""Waves that drift, looked for in pieces of a flight: each (k, omega) with amplitudes by piece.

What a wave explains of a piece is nearly 2 |(k_y, -k_x) . s|^2 / (m |k|^2), s the sum of
exp(i (k.x - omega t)) Phi over its m rows, less their mean: three-dimensional non-uniform Fourier
transforms. Short pieces resolve little, and so need few waves; where a wave is seen, pieces are
joined, two by two, and the wave sharpened, until the flight is one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, box
from sparsefit.library.plane_scan import across
from sparsefit.library.scan import Bounds

MOST_WAVES = 300_000  # of the grid of one piece
FEWEST_PIECES = 4
FEW = 12  # rows of a piece, at least
ACCURACY = 1e-3  # of the sums, relative to the rows of a piece


@dataclass(frozen=True, eq=False)
class DriftScan:
    """The grid of (k_x, k_y, omega) of a flight's pieces.

    Args:
        position: (x, y, t) of the rows (m, 3) [m], [s].
        pieces: how many the flight is cut into.
        radii: the least and the largest |k| [1/m].
        fastest: the largest drift [m/s].
    """

    position: Array
    pieces: int
    radii: Bounds
    fastest: float

    @classmethod
    def of(cls, position: Array, radii: Bounds, fastest: float) -> DriftScan:
        """The scan with the fewest pieces whose grid is no larger than can be scanned.

        position: (x, y, t) of the rows (m, 3) [m], [s]; radii: bounds of |k| [1/m]; fastest [m/s].
        """
        scan = cls(position, FEWEST_PIECES, radii, fastest)
        while scan.size > MOST_WAVES and len(position) >= FEW * 2 * scan.pieces:
            scan = cls(position, scan.pieces + max(1, scan.pieces // 4), radii, fastest)
        return scan

    @property
    def size(self) -> int:
        """The number of waves of the grid."""
        return math.prod(2 * half + 1 for half in self._halves)

    @property
    def steps(self) -> Array:
        """Between wavenumbers [1/m] and omegas [1/s]: half a lobe of a piece, (3,)."""
        corners = [box(piece) for piece in _cut(self.position, self.pieces)]
        spans = np.array([high - low for low, high in corners])
        widest, longest = float(spans[:, :2].max()), float(spans[:, 2].max())
        return math.pi / np.array([widest, widest, longest])

    @property
    def _halves(self) -> tuple[int, int, int]:
        step, _, later = self.steps.tolist()
        half = math.ceil(self.radii[1] / step)
        return half, half, math.ceil(self.radii[1] * self.fastest / later)

    def gains(self, rest: Array) -> tuple[Array, tuple[Array, Array]]:
        """What one wave explains of rows (m, 2), over the grid (n, n, w); its k and omega axes."""
        import finufft

        halves, steps = self._halves, self.steps
        size = tuple(2 * half + 1 for half in halves)
        k, omega = (steps[i] * np.arange(-halves[i], halves[i] + 1.0) for i in (0, 2))
        right = np.zeros((halves[0] + 1, *size[1:]))  # of k_x >= 0; -k and -omega are the same wave
        plan = finufft.Plan(
            1, size, eps=ACCURACY, isign=1, nthreads=1, upsampfac=1.25, dtype="complex64"
        )
        for place, errors in zip(
            _cut(self.position, self.pieces), _cut(rest, self.pieces), strict=True
        ):
            middle = 0.5 * (place.max(axis=0) + place.min(axis=0))
            nodes = ((place - middle) * steps * (1, 1, -1)).T.astype(np.float32, order="C")
            moved = errors - errors.mean(axis=0)
            plan.setpts(*nodes)
            both = plan.execute((moved[:, 0] + 1j * moved[:, 1]).astype(np.complex64))
            load = across(both, k, halves[0])
            right += (2 / len(place)) * (load.real**2 + load.imag**2)
        gains = np.concatenate([right[:0:-1, ::-1, ::-1], right])
        radius = np.hypot(k[:, None], k)
        least, largest = self.radii
        gains *= ((radius >= least) & (radius <= largest))[..., None]
        gains *= np.abs(omega) <= (self.fastest * radius + steps[2])[..., None]
        return gains, (k, omega)


def _cut(rows: Array, pieces: int) -> list[Array]:
    return np.array_split(rows, pieces)
