"""The grid of wavevectors: rings of waves over half the plane, as fine as a flight can tell.

A wave of psi with wavevector k is the one with -k, so half a plane holds them all. Over a flight of
extent D waves nearer than pi/D are hardly told apart: rings of |k|, and waves along each ring, are
a share of that apart. Square cells of length scale L are two waves of |k| = sqrt(2) pi/L: a ring is
a length scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, integer_setting, positive

MAX_WAVES = 4_096  # k = 8192 columns: Z'Z alone is 0.5 GiB
FEWEST = 2  # waves of a ring: cells are two


@dataclass(frozen=True, eq=False)
class Rings:
    """Wavevectors (w, 2) [1/m], ring by ring, and the ring of each (w,); scales (g,) [m] of rings.

    Length scales ascend, so that the first ring is the one of the shortest waves.
    """

    wavevectors: Array
    ring: IntArray
    scales: Array


@dataclass(frozen=True)
class WaveGrid:
    """How fine the wavevectors of a wave library are, and how many there may be.

    The bounds of the length scale are those of the library's ``grid``.

    Args:
        step: between rings, and between the waves of a ring, as a share of pi / extent.
        most: waves that a flight may ask for; beyond it the library is refused.

    Raises:
        InputError: if the step is not above 0, or most is not from 2 to 4096.
    """

    step: float = 1.0
    most: int = 2_048

    def __post_init__(self) -> None:
        object.__setattr__(self, "step", positive("waves: step, a share of pi/extent,", self.step))
        integer_setting("waves", "most", self.most, least=FEWEST)
        if self.most > MAX_WAVES:
            raise InputError(
                f"waves: most must be {MAX_WAVES} or less, what memory holds; got {self.most}"
            )

    def rings(self, lower: float, upper: float, extent: float) -> Rings:
        """The rings between two length scales [m] for a flight of that extent [m].

        Raises:
            InputError: if the flight does not move, or the grid has more than ``most`` waves.
        """
        if not extent > 0:
            raise InputError("the flight does not move: no wave can be told; fly farther")
        least, largest = (math.sqrt(2.0) * math.pi / scale for scale in (upper, lower))
        apart = self.step * math.pi / extent
        # Before any ring is made: the half ring of area pi (b^2 - a^2)/2, at one wave a square.
        about = 0.5 * math.pi * (largest**2 - least**2) / apart**2
        if about > 2 * self.most:
            raise self._too_many(about, lower, extent)
        count = math.ceil((largest - least) / apart * (1 - 1e-12)) + 1
        sizes = np.linspace(largest, least, count)
        waves = np.maximum(np.ceil(math.pi * sizes / apart * (1 - 1e-12)), FEWEST).astype(int)
        if waves.sum() > self.most:
            raise self._too_many(float(waves.sum()), lower, extent)
        ring = np.repeat(np.arange(count), waves)
        place = np.arange(len(ring)) - np.repeat(np.cumsum(waves) - waves, waves)
        # Every other ring is half a step on, so that no direction is favoured.
        angle = math.pi * (place + 0.5 * (ring % 2)) / waves[ring]
        wavevectors = sizes[ring][:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return Rings(wavevectors, ring, math.sqrt(2.0) * math.pi / sizes)

    def _too_many(self, waves: float, lower: float, extent: float) -> InputError:
        return InputError(
            f"a flight of {extent:.3g} m resolves {waves:.0f} waves down to {lower:g} m, more than "
            f"the {self.most} of waves.most: raise the grid's lower bound to about "
            f"{lower * math.sqrt(waves / self.most):.2g} m, or waves.step, or use a piece of the "
            "flight"
        )
