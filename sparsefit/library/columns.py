"""The columns of a library: those of a family, at the parameters of its grid.

Families whose velocity components share their weights have a row for each component, that of x
before that of y, sample after sample: whole pieces of the rows are whole pieces of the flight.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.derivative import Samples, WeakRows
from sparsefit.errors import InputError
from sparsefit.library.cells import CANDIDATES, MAX_THETA_BYTES, Cells, candidate_columns
from sparsefit.library.family import Family
from sparsefit.library.wave_grid import Rings
from sparsefit.library.waves import AXIS, WAVE, Waves
from sparsefit.regression.statistics import row_blocks


@dataclass(frozen=True, eq=False)
class LibraryColumns:
    """The columns of theta before any flight is put into them.

    Args:
        family: of the columns.
        parameters: of the modes on the grid, (s, p); the columns of a mode stand together.
        group: of each mode (s,).
        scales: the length scale of each group (g,) [m].
        names: of the columns (k,).
        nested: whether the modes are groups within their groups.
    """

    family: Family
    parameters: Array
    group: IntArray
    scales: Array
    names: tuple[str, ...]
    nested: bool = False

    @property
    def size(self) -> int:
        """The number k of columns."""
        return len(self.parameters) * self.family.size

    @property
    def components(self) -> int:
        """Rows of a sample: 2 where the velocity components share their weights."""
        return 2 // self.family.targets

    @property
    def groups(self) -> IntArray:
        """The group of each column (k,)."""
        return np.repeat(self.group, self.family.size)

    @property
    def subgroups(self) -> IntArray | None:
        """The mode of each column (k,), where modes are groups within their groups."""
        if not self.nested:
            return None
        return np.repeat(np.arange(len(self.parameters)), self.family.size)

    def at(self, position: Array) -> Array:
        """Theta at positions (m, 2) [m]: (m r, k), r the rows of a sample.

        Raises InputError where it would not fit in memory.
        """
        if isinstance(self.family, Cells):
            return candidate_columns(position, self.scales)
        size = len(position) * self.components * self.size
        if size * 8 > MAX_THETA_BYTES:
            raise InputError(
                f"a library of {len(position)} samples x {len(self.parameters)} modes needs "
                f"{size * 8 / 2**30:.1f} GiB; use fewer waves, scales or samples"
            )
        theta = np.empty((len(position), self.components, self.size))
        start = 0
        for (block,) in row_blocks(position):
            values = self.family.values(block, self.parameters)
            rows = values.reshape(self.size, self.components, len(block)).transpose(2, 1, 0)
            theta[start : start + len(block)] = rows
            start += len(block)
        return theta.reshape(-1, self.size)

    def blocks(self, source: Samples | WeakRows) -> Iterator[tuple[slice, Array]]:
        """Rows of theta in blocks, of samples or of averages of them, and which they are."""
        per = self.components
        if isinstance(source, WeakRows):
            for rows, weights, position in source.blocks():
                values = self.at(position).reshape(len(position), -1)
                averages = (weights @ values).reshape(-1, self.size)
                yield slice(per * rows.start, per * rows.stop), averages
            return
        start = 0
        for (position,) in row_blocks(source.position):
            values = self.at(position)
            yield slice(start, start + len(values)), values
            start += len(values)


def cell_columns(scales: Array) -> LibraryColumns:
    """The paper's 8 candidates (Eq. 17) at length scales (g,) [m], a group each."""
    at = [f" (L = {scale:g} m)" for scale in scales.tolist()]
    names = tuple(name + scale for scale in at for name in CANDIDATES)
    return LibraryColumns(Cells(), math.pi / scales[:, None], np.arange(len(scales)), scales, names)


def stream_columns(scales: Array) -> LibraryColumns:
    """The stream functions of cells at length scales (g,) [m], a group each.

    Waves along both diagonals, which span the four products of sin and cos of k x and k y.
    """
    parts = ("cos k(x + y)", "sin k(x + y)", "cos k(x - y)", "sin k(x - y)")
    names = tuple(f"psi = {name} (L = {scale:g} m)" for scale in scales for name in parts)
    family = Waves(AXIS)
    return LibraryColumns(family, math.pi / scales[:, None], np.arange(len(scales)), scales, names)


def wave_columns(rings: Rings, groups: str) -> LibraryColumns:
    """Waves of psi in rings, grouped by ``wave``, by ``ring``, or ``nested``: waves in rings."""
    if groups == "wave":
        return single_waves(rings.wavevectors, rings.scales[rings.ring])
    k, nested = rings.wavevectors, groups == "nested"
    return LibraryColumns(Waves(WAVE), k, rings.ring, rings.scales, _wave_names(k), nested)


def single_waves(k: Array, scales: Array) -> LibraryColumns:
    """Waves of psi with wavevectors k (w, 2) [1/m] and length scales (w,) [m], a group each."""
    return LibraryColumns(Waves(WAVE), k, np.arange(len(k)), scales, _wave_names(k))


def _wave_names(k: Array) -> tuple[str, ...]:
    parts = ("cos", "sin")
    return tuple(f"psi = {part} k.x (k = {x:.4g}, {y:.4g} 1/m)" for x, y in k for part in parts)
