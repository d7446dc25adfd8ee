"""Waves with amplitudes by piece of a flight: what is left of a pattern seen through short windows.

A wave that is slightly off keeps step with the flow over a piece if not over the flight, so that
parameters are found in reach from farther away; pieces are then joined until the flight is one.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.waves import WAVE, Pattern, Waves


@dataclass(frozen=True)
class PiecedWaves:
    """The columns of one pattern of waves in consecutive pieces of rows: what a projection needs.

    Weights (2 J P, 1) are those of the first of P pieces, then of the second, ...
    """

    name: ClassVar[str] = "pieced-waves"
    targets: ClassVar[int] = 1
    pattern: Pattern = WAVE
    pieces: int = 1

    @property
    def parameters(self) -> int:
        """The number p of parameters of the pattern."""
        return self.pattern.parameters

    @property
    def size(self) -> int:
        """The number of columns of a mode."""
        return 2 * self.pattern.size * self.pieces

    def values(self, position: Array, parameters: Array) -> Array:
        """Columns (s, 2 J P, 2 m) at positions (m, 2) or (m, 3), in time's order."""
        whole = Waves(self.pattern).values(position, parameters)
        parts, ends = whole.reshape(*whole.shape[:2], 2, -1), self._ends(len(position))
        values = np.zeros((len(whole), self.pieces, *parts.shape[1:]))
        for piece, (first, last) in enumerate(pairwise(ends)):
            values[:, piece, ..., first:last] = parts[..., first:last]
        return values.reshape(len(whole), self.size, -1)

    def bent(self, position: Array, parameters: Array, values: Array, weights: Array) -> Array:
        """The derivatives of each mode's flow by its parameters, (s, p, 2 m, 1)."""
        by_piece = weights.reshape(len(weights), self.pieces, -1).swapaxes(1, 2)
        by_row = np.repeat(by_piece, np.diff(self._ends(len(position))), axis=2)
        return Waves(self.pattern).bent(position, parameters, values, by_row)

    def _ends(self, rows: int) -> list[int]:
        """Where each piece of so many rows begins, and the last ends; the first are longer by 1."""
        own, more = divmod(rows, self.pieces)
        return [own * piece + min(piece, more) for piece in range(self.pieces + 1)]
