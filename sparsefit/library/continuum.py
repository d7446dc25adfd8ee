"""The continuum of cells behind a library's grid: columns at every wavenumber k = pi/L."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.library.cells import CANDIDATES, Cells, candidate_columns
from sparsefit.library.scan import Bounds, CellScan, extent_of, scan_steps

EQUATION_1 = np.zeros((8, 2))
"""The weights of Eq. 1 for U0 = 1 m/s."""
EQUATION_1[CANDIDATES.index("sin x cos y"), 0] = 1.0
EQUATION_1[CANDIDATES.index("cos x sin y"), 1] = -1.0


@dataclass(frozen=True, eq=False)
class CellContinuum:
    """The cells of any wavenumber, over the rows of one flight.

    Args:
        position: of every row (m, 2) [m].
        bounds: of k where none are asked for: those of the library's grid [1/m].
        pattern: the weights (8, n) of a target known up to its size, if it is.
        weight: of every row (m,), with which the target is multiplied; None: all are 1.
    """

    size: ClassVar[int] = Cells.size
    parameters: ClassVar[int] = Cells.parameters
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
        ends = (
            self.bounds[0] if upper is None else math.pi / upper,
            self.bounds[1] if lower is None else math.pi / lower,
        )
        return min(ends), max(ends)

    def scan_points(self, bounds: Bounds) -> int:
        """How many wavenumbers a scan takes: they grow with the extent and the interval."""
        return scan_steps(self.position, bounds) + 1

    def scan(self, bounds: Bounds) -> CellScan:
        """The scan of an interval of k [1/m]."""
        return CellScan.of(self.position, bounds, self.weight)

    def columns(self, places: Array) -> tuple[Array, Array, Array]:
        """The candidates (s, 8, m) and their derivatives by k, at k (s, 1) [1/m]."""
        cells, parameters = Cells(), np.reshape(places, (-1, 1))
        values = cells.values(self.position, parameters)
        slopes = cells.slopes(self.position, parameters, values)
        jet = values, slopes, cells.bends(self.position, parameters, values)
        if self.weight is None:
            return jet
        return jet[0] * self.weight, jet[1] * self.weight, jet[2] * self.weight

    def spans(self, places: Array) -> Array:
        """The extent [m], for every k (s, 1)."""
        return np.full(places.shape, self.extent)

    def images(self, places: Array) -> tuple[Array, Array]:
        """Every k (s, 1) means cells of its own."""
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
