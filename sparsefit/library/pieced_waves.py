"""Waves with amplitudes by piece of a flight: what is left of a pattern seen through short windows.

A wave that is slightly off keeps step with the flow over a piece if not over the flight, so that
parameters are found in reach from farther away; pieces are then joined until the flight is one.
"""

from __future__ import annotations

from dataclasses import dataclass
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
        modes, own, _ = whole.shape
        parts, count = whole.reshape(modes, own, 2, -1), len(position)
        values = np.zeros((modes, self.pieces, own, 2, count))
        for piece, rows in enumerate(np.array_split(np.arange(count), self.pieces)):
            values[:, piece, ..., rows] = np.moveaxis(parts[..., rows], 3, 0)
        return values.reshape(modes, self.size, -1)

    def bent(self, position: Array, parameters: Array, values: Array, weights: Array) -> Array:
        """The derivatives of each mode's flow by its parameters, (s, p, 2 m, 1)."""
        free, modes = Waves(self.pattern), len(parameters)
        by_piece = weights.reshape(modes, self.pieces, free.size, 1)
        bent = []
        for piece, place in enumerate(np.array_split(position, self.pieces)):
            own = free.values(place, parameters)
            flow = free.bent(place, parameters, own, by_piece[:, piece])
            bent.append(flow.reshape(*flow.shape[:2], 2, -1))
        return np.concatenate(bent, axis=3).reshape(modes, self.parameters, -1, 1)
