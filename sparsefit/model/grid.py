"""The grids of a library: length scales (paper Eq. 18), and wavevectors over half the plane.

A flight of extent D resolves wavenumbers to about pi/D: a grid may be made for it. A wave of psi
with wavevector k is the one with -k, so half a plane holds them all; square cells of length scale L
are two waves of |k| = sqrt(2) pi/L, so a ring of waves is a length scale.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array, IntArray, box
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, integer, is_number, one_of, positive

Spacing = Literal["length-scale", "wavenumber", "flight"]

Bounds = tuple[float, float]

MAX_SCALES = 2_048  # k = 16 384 columns: Z'Z alone is 2 GiB
MAX_WAVES = 2_048  # k = 4096 columns
STEP = 0.2  # m, the paper's


def extent_of(position: Array) -> float:
    """The larger side of the bounding box of positions (m, 2) [m]."""
    low, high = box(position)
    return float((high - low).max())


def middle(position: Array) -> Array:
    """The middle of the bounding box of positions (m, c)."""
    low, high = box(position)
    centre: Array = 0.5 * (high + low)
    return centre


@dataclass(frozen=True)
class LengthScaleGrid:
    """The candidate length scales (Eq. 18), ascending [m].

    Uniform in length scale, L_lb, L_lb + dL, ..., L_ub (the paper's 1...12 m by 0.2 m is the
    default), or uniform in wavenumber k = pi/L with ``count`` scales between the same bounds, or
    with spacing ``flight``: `resolving` the extent of the flight, at ``fraction`` of its lobe.
    Raises InputError on settings that are out of range or do not belong together, and on more
    than 2048 scales.
    """

    lower: float = 1.0
    upper: float = 12.0
    step: float | None = None
    count: int | None = None
    spacing: Spacing = "length-scale"
    fraction: float = 0.25

    def __post_init__(self) -> None:
        one_of("spacing", self.spacing, get_args(Spacing))
        for name in ("lower", "upper"):
            positive(f"grid: {name}", getattr(self, name), "m")
        if self.upper < self.lower:
            raise InputError(
                f"grid: upper ({self.upper:g} m) is below lower ({self.lower:g} m); swap them"
            )
        if self.step is not None and self.count is not None:
            raise InputError("grid: give step or count, not both")
        if self.spacing == "wavenumber" and self.count is None:
            raise InputError("grid: spacing 'wavenumber' needs count (the number of scales)")
        if self.step is not None:
            positive("grid: step", self.step, "m")
        if self.count is not None:
            integer("grid: count", self.count, 1)
        if not is_number(self.fraction, 0.0, 1.0, open_low=True):
            raise InputError(f"grid: fraction of the lobe must be in (0, 1], not {self.fraction!r}")
        if self.spacing == "flight":
            if self.step is not None or self.count is not None:
                raise InputError("grid: spacing 'flight' takes fraction, not step or count")
            return
        if self.size > MAX_SCALES:
            raise InputError(
                f"grid: {self.size} length scales are more than the {MAX_SCALES} that can be "
                "held; use a larger step or a narrower range"
            )

    def resolving(self, extent: float) -> LengthScaleGrid:
        """This grid for a flight of that extent [m]: itself, or with spacing ``flight`` its own.

        The residual as a function of k has lobes of width 2 pi / extent; steps of a quarter of it,
        the default fraction, put a candidate in every lobe. Finer at small L than a grid uniform in
        L, and coarser at large L.
        """
        if self.spacing != "flight":
            return self
        span = np.pi / self.lower - np.pi / self.upper
        steps = np.ceil(span * extent / (2 * np.pi * self.fraction))
        count = int(min(steps, 1e15)) + 1
        return LengthScaleGrid(self.lower, self.upper, count=count, spacing="wavenumber")

    @property
    def size(self) -> int:
        """Number of length scales. Raises InputError where only a flight can tell it."""
        if self.spacing == "flight":
            raise InputError("grid: spacing 'flight' has scales of its own for every flight")
        if self.count is not None:
            return self.count
        # A hair of tolerance: (12 - 1)/0.2 is 54.99999999999999 in binary.
        steps = min((self.upper - self.lower) / (self.step or STEP), 1e15)  # beyond what is held
        return int(np.floor(steps + 1e-9)) + 1

    @cached_property
    def scales(self) -> Array:
        """The length scales [m], ascending, shape (g,)."""
        if self.spacing == "wavenumber":
            inverse = np.linspace(1.0 / self.upper, 1.0 / self.lower, self.size)
            return np.ascontiguousarray(1.0 / inverse[::-1])
        if self.count is not None:
            return np.linspace(self.lower, self.upper, self.count)
        # Rounding to 12 digits gives 4.2, not 4.200000000000001, as the scale that is reported.
        return np.round(self.lower + (self.step or STEP) * np.arange(self.size), 12)


def wave_rings(lower: float, upper: float, extent: float) -> tuple[Array, IntArray, Array]:
    """The rings between two length scales [m] for a flight of that extent [m].

    Returns wavevectors (w, 2) [rad/m], ring by ring, the ring of each (w,), and the length scale of
    each ring (g,) [m], ascending. Rings, and the waves of a ring, are a lobe, pi / extent, apart.

    Raises:
        InputError: if the flight does not move, or resolves more than `MAX_WAVES` waves.
    """
    if not extent > 0:
        raise InputError("the flight does not move: no wave can be told; fly farther")
    least, largest = (math.sqrt(2.0) * math.pi / scale for scale in (upper, lower))
    apart = math.pi / extent
    # Before any ring is made: the half ring of area pi (b^2 - a^2)/2, at one wave a square.
    about = 0.5 * math.pi * (largest**2 - least**2) / apart**2
    if about <= 2 * MAX_WAVES:
        count = math.ceil((largest - least) / apart * (1 - 1e-12)) + 1
        sizes = np.linspace(largest, least, count)
        # Two at least: cells are two waves.
        waves = np.maximum(np.ceil(math.pi * sizes / apart * (1 - 1e-12)), 2).astype(int)
        about = float(waves.sum())
    if about > MAX_WAVES:
        raise InputError(
            f"a flight of {extent:.3g} m resolves {about:.0f} waves down to {lower:g} m, more than "
            f"the {MAX_WAVES} that can be held: raise the grid's lower bound to about "
            f"{lower * math.sqrt(about / MAX_WAVES):.2g} m, or use a piece of the flight"
        )
    ring = np.repeat(np.arange(count), waves)
    place = np.arange(len(ring)) - np.repeat(np.cumsum(waves) - waves, waves)
    # Every other ring is half a step on, so that no direction is favoured.
    angle = math.pi * (place + 0.5 * (ring % 2)) / waves[ring]
    wavevectors = sizes[ring][:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return wavevectors, ring, math.sqrt(2.0) * math.pi / sizes
