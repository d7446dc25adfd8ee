"""The grids of a library, and the columns of their candidates at positions.

A grid of length scales (Eq. 18) has the candidates of cells (Eq. 17), at each wavenumber k = pi/L
the single sines and cosines of the phases k x and k y, and their four products. A grid of
wavevectors over half the plane has the waves of a stream function, u = d psi/dy, v = -d psi/dx: of

    psi = sum_j a_j cos theta_j + b_j sin theta_j,    theta_j = k_j . x,

each wave has two columns, shared by both velocity components: rows are x before y of each
sample. With g = d/d theta of cos and of sin, they are (k_y, -k_x) g(theta). k is in rad/m, a and b
in m^2/s. The waves of k and -k are equal; square cells of length scale L are two waves of |k| =
sqrt(2) pi/L, so a ring of waves is a length scale.

A flight of extent D resolves wavenumbers to about pi/D; a grid may be adapted to it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array, IntArray, box
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, integer, is_number, one_of, positive, shown

Spacing = Literal["length-scale", "wavenumber", "flight"]
Bounds = tuple[float, float]

CANDIDATES = (
    *("sin x", "sin y", "cos x", "cos y"),
    *(f"{x} {y}" for x in ("sin x", "cos x") for y in ("sin y", "cos y")),
)
MOST = 2_048  # scales (16,384 columns, whose Gram matrix takes 2 GiB) or waves
BUILD_ROWS = 64  # of theta at once, to stay in cache


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

    Uniform in length scale, L_lb, L_lb + dL, ..., L_ub (default: the paper's 1...12 m by 0.2 m),
    or uniform in wavenumber k = pi/L with ``count`` scales between the same bounds, or with
    spacing ``flight``: uniform in k with a step of ``fraction`` of the flight's resolution.
    Raises InputError for settings that are out of range or contradict each other, and for more
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
        for name in ("lower", "upper", *["step"] * (self.step is not None)):
            positive(f"grid: {name}", getattr(self, name), "m")
        integer("grid: count", 1 if self.count is None else self.count, 1)
        problem = ""
        if self.upper < self.lower:
            problem = f"upper ({self.upper:g} m) is below lower ({self.lower:g} m); swap them"
        elif not 1e-9 <= self.lower <= self.upper <= 1e9:
            problem = f"no scale of a flow: {self.lower:g} ... {self.upper:g} m; change the unit"
        elif self.step is not None and self.count is not None:
            problem = "give step or count, not both"
        elif self.spacing == "wavenumber" and self.count is None:
            problem = "spacing 'wavenumber' needs count (the number of scales)"
        elif not is_number(self.fraction, 0.0, 1.0, open_low=True):
            problem = f"fraction of the lobe must be in (0, 1], not {shown(self.fraction)}"
        elif self.spacing == "flight" and (self.step, self.count) != (None, None):
            problem = "spacing 'flight' takes fraction, not step or count"
        elif self.spacing != "flight" and self.size > MOST:
            problem = (
                f"{self.size} scales are more than the {MOST} that can be held; use a larger step"
            )
        if problem:
            raise InputError(f"grid: {problem}")

    def resolving(self, extent: float) -> LengthScaleGrid:
        """This grid for a flight of that extent [m]; another one only with spacing ``flight``.

        The residual as a function of k has lobes of width 2 pi / extent: the default fraction
        puts four candidates into every lobe.
        """
        if self.spacing != "flight":
            return self
        span = np.pi / self.lower - np.pi / self.upper
        steps = np.ceil(span * extent / (2 * np.pi * self.fraction))
        count = int(min(steps, 1e15)) + 1
        return LengthScaleGrid(self.lower, self.upper, count=count, spacing="wavenumber")

    @property
    def size(self) -> int:
        """The number of length scales. Raises InputError with spacing ``flight``."""
        if self.spacing == "flight":
            raise InputError("grid: spacing 'flight' has scales of its own for every flight")
        if self.count is not None:
            return self.count
        # (12 - 1)/0.2 is 54.99999999999999 in binary, hence 1e-9.
        return int(min((self.upper - self.lower) / (self.step or 0.2), 1e15) + 1e-9) + 1

    @cached_property
    def scales(self) -> Array:
        """The length scales [m], ascending, shape (g,)."""
        if self.spacing == "wavenumber":
            inverse = np.linspace(1.0 / self.upper, 1.0 / self.lower, self.size)
            return np.ascontiguousarray(1.0 / inverse[::-1])
        if self.count is not None:
            return np.linspace(self.lower, self.upper, self.count)
        # Rounding to 12 digits gives 4.2, not 4.200000000000001, as the scale that is reported.
        return np.round(self.lower + (self.step or 0.2) * np.arange(self.size), 12)


def wave_rings(lower: float, upper: float, extent: float) -> tuple[Array, IntArray, Array]:
    """The rings of waves between two length scales [m] for a flight of that extent [m].

    Returns wavevectors (w, 2) [rad/m], ring by ring, the ring of each (w,), and the length scale of
    each ring (g,) [m], ascending. Rings, and the waves of a ring, are pi / extent apart.

    Raises:
        InputError: if the extent is 0, or more than 2048 waves are resolved.
    """
    if not extent > 0:
        raise InputError("the flight does not move: no wave can be told; fly farther")
    least, largest = (math.sqrt(2.0) * math.pi / scale for scale in (upper, lower))
    apart = math.pi / extent
    # An estimate first: the area pi (b^2 - a^2)/2 of the half ring over that of a grid cell.
    about = 0.5 * math.pi * (largest**2 - least**2) / apart**2
    if about <= 2 * MOST:
        count = math.ceil((largest - least) / apart * (1 - 1e-12)) + 1
        sizes = np.linspace(largest, least, count)
        # At least two: cells are two waves.
        waves = np.maximum(np.ceil(math.pi * sizes / apart * (1 - 1e-12)), 2).astype(int)
        about = float(waves.sum())
    if about > MOST:
        words = f"raise the grid's lower bound to about {lower * math.sqrt(about / MOST):.2g} m"
        raise InputError(
            f"a flight of {extent:.3g} m resolves {about:.0f} waves down to {lower:g} m, more than "
            f"{MOST}: {words}, or use a piece of the flight"
        )
    ring = np.repeat(np.arange(count), waves)
    place = np.arange(len(ring)) - np.repeat(np.cumsum(waves) - waves, waves)
    # Every other ring is shifted by half a step, so that no direction is favoured.
    angle = math.pi * (place + 0.5 * (ring % 2)) / waves[ring]
    wavevectors = sizes[ring][:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return wavevectors, ring, math.sqrt(2.0) * math.pi / sizes


def sines_and_cosines(phase: Array) -> tuple[Array, Array]:
    """sin and cos of phases [rad] of any shape, to 3 units of rounding of 1.

    Both are rational in the tangent of half the phase: with t = tan(phase / 2)

        sin = 2 t / (1 + t^2),   cos = 2 / (1 + t^2) - 1,

    one transcendental function instead of two, and one that NumPy vectorises.
    """
    half = np.tan(0.5 * phase)
    share = 2.0 / (1.0 + half * half)
    return half * share, share - 1.0


def candidate_columns(position: Array, scales: Array) -> Array:
    """Theta (m, 8 g) of Eq. 19, group-major, of length scales (g,) at positions (m, 2) [m]."""
    theta = np.empty((len(position), len(scales), len(CANDIDATES)))
    for start in range(0, len(theta), BUILD_ROWS):
        block, out = position[start : start + BUILD_ROWS], theta[start : start + BUILD_ROWS]
        (out[..., 0], out[..., 2]), (out[..., 1], out[..., 3]) = (
            sines_and_cosines(block[:, axis : axis + 1] * (np.pi / scales)) for axis in range(2)
        )
        for place, (first, second) in enumerate(((0, 1), (0, 3), (2, 1), (2, 3)), 4):
            np.multiply(out[..., first], out[..., second], out=out[..., place])
    return theta.reshape(len(position), -1)


def wave_columns(position: Array, wavevectors: Array) -> Array:
    """Theta (2 m, 2 w) of steady waves k (w, 2) [rad/m] at positions (m, 2) [m], x before y."""
    theta = np.empty((len(position), 2, len(wavevectors), 2))
    across = wavevectors.T[::-1, :, None] * np.array([1.0, -1.0])[:, None, None]  # (k_y, -k_x)
    for start in range(0, len(position), BUILD_ROWS):
        block = position[start : start + BUILD_ROWS]
        sine, cosine = sines_and_cosines(block @ wavevectors.T)
        theta[start : start + BUILD_ROWS] = across * np.stack([-sine, cosine], axis=2)[:, None]
    return theta.reshape(2 * len(position), -1)
