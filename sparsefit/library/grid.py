"""The grid of candidate length scales (paper Eq. 18), and the one that a flight resolves."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, integer_setting, is_number, one_of, positive
from sparsefit.flight import Flight

Spacing = Literal["length-scale", "wavenumber", "flight"]

MAX_SCALES = 2_048  # k = 16 384 columns: Z'Z alone is 2 GiB


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
            integer_setting("grid", "count", self.count, least=1)
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

    @classmethod
    def for_flight(
        cls, flight: Flight, lower: float = 1.0, upper: float = 12.0, *, fraction: float = 0.25
    ) -> "LengthScaleGrid":
        """The grid that resolves a flight: uniform in wavenumber, at a fraction of the lobe.

        The residual as a function of k has lobes of width 2 pi / extent; steps of a quarter of
        it, the default, put a candidate in every lobe. Finer at small L than a grid uniform in
        L, and coarser at large L.
        """
        return cls(lower, upper, spacing="flight", fraction=fraction).resolving(flight.extent)

    def resolving(self, extent: float) -> "LengthScaleGrid":
        """This grid for a flight of that extent [m]: itself, or with spacing ``flight`` its own."""
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
        steps = min((self.upper - self.lower) / self._step, 1e15)  # beyond any that can be held
        return int(np.floor(steps + 1e-9)) + 1

    @property
    def _step(self) -> float:
        return 0.2 if self.step is None else self.step

    @cached_property
    def scales(self) -> Array:
        """The length scales [m], ascending, shape (g,)."""
        if self.spacing == "wavenumber":
            return np.ascontiguousarray(
                1.0 / np.linspace(1.0 / self.upper, 1.0 / self.lower, self.size)[::-1]
            )
        if self.count is not None:
            return np.linspace(self.lower, self.upper, self.count)
        # Rounding to 12 digits gives 4.2, not 4.200000000000001, as the scale that is reported.
        return np.round(self.lower + self._step * np.arange(self.size), 12)
