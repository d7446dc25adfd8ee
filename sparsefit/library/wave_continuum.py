"""The plane of wavevectors behind a wave library's grid: the columns of any wave.

A wave is q = (|k|, its heading), so that bounds of the length scale L = sqrt(2) pi/|k| bound the
first number alone. Turned by half a turn it is the same wave, with another sign of its sine.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.library.columns import single_waves
from sparsefit.library.plane import WaveScan
from sparsefit.library.scan import Bounds, extent_of
from sparsefit.library.waves import POLAR, Waves


@dataclass(frozen=True, eq=False)
class WaveContinuum:
    """The waves of any wavevector, over the samples of one flight; rows are x before y of each.

    Args:
        position: of every sample (m, 2) [m].
        cells: bounds of pi/L where none are asked for, those of the library's grid [1/m].
    """

    size: ClassVar[int] = 2
    parameters: ClassVar[int] = POLAR.parameters
    position: Array
    cells: Bounds

    @property
    def extent(self) -> float:
        """The larger side of the flight's bounding box [m]."""
        return extent_of(self.position)

    def interval(self, lower: float | None, upper: float | None) -> Bounds:
        """Bounds of |k| [1/m] for bounds of the length scale [m]; None: the grid's own."""
        ends = (
            self.cells[0] if upper is None else math.pi / upper,
            self.cells[1] if lower is None else math.pi / lower,
        )
        return math.sqrt(2.0) * min(ends), math.sqrt(2.0) * max(ends)

    def scan_points(self, bounds: Bounds) -> int:
        """How many wavevectors a scan takes: they grow with the square of the extent."""
        radii, headings = WaveScan.shape_of(self.position, bounds)
        return radii * headings

    def scan(self, bounds: Bounds) -> WaveScan:
        """The scan of the plane between bounds of |k| [1/m]."""
        return WaveScan.of(self.position, bounds)

    def columns(self, places: Array) -> tuple[Array, Array, Array]:
        """The columns (s, 2, 2 m) of waves (s, 2) and their derivatives by |k| and heading."""
        family = Waves(POLAR)
        values = family.values(self.position, places)
        slopes = family.slopes(self.position, places, values)
        bends = family.bends(self.position, places, values)
        return _by_sample(values), _by_sample(slopes), _by_sample(bends)

    def spans(self, places: Array) -> Array:
        """The extent [m] for every |k|, and |k| of it for every heading, (s, 2)."""
        return self.extent * np.column_stack([np.ones(len(places)), places[:, 0]])

    def images(self, places: Array) -> tuple[Array, Array]:
        """Every wave as it is and turned by half a turn either way, (3, s, 2), and signs (3, 2)."""
        turns = np.array([[0.0, 0.0], [0.0, math.pi], [0.0, -math.pi]])
        return places + turns[:, None], np.array([[1.0, 1.0], [1.0, -1.0], [1.0, -1.0]])

    def design(self, places: Array) -> tuple[Array, Array, Array, tuple[str, ...]]:
        """Theta (2 m, 2 s) of waves (s, 2), k (s, 2) [1/m], length scales (s,) [m] and names."""
        size, heading = places.T
        k = size[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        columns = single_waves(k, math.sqrt(2.0) * math.pi / size)
        return columns.at(self.position), k, columns.scales, columns.names

    def places(self, parameters: Array) -> Array:
        """(|k|, heading) (s, 2) of wavevectors k (s, 2) [1/m]."""
        x, y = parameters.T
        return np.column_stack([np.hypot(x, y), np.arctan2(y, x)])

    def at(self, rows: IntArray) -> WaveContinuum | None:
        """The continuum of some rows (r,); None where they are not whole samples."""
        first, second = rows[::2], rows[1::2]
        whole = len(first) == len(second) and np.array_equal(first + 1, second)
        if not whole or np.any(first % 2):
            return None
        return replace(self, position=self.position[first // 2])


def _by_sample(values: Array) -> Array:
    """Columns (..., 2 m) with all of x before all of y as rows with x before y of each sample."""
    both = values.reshape(*values.shape[:-1], 2, -1)
    rows: Array = np.ascontiguousarray(both.swapaxes(-1, -2)).reshape(values.shape)
    return rows
