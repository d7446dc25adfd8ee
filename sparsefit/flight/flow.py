"""The flows a vehicle flies through: one cellular flow (Eqs. 1-2), or several superposed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.errors import InputError, pair, positive


@dataclass(frozen=True)
class CellularFlow:
    """A steady array of eddies that alternate in their direction of rotation (Eq. 1).

    ``w = U0 (sin(pi x/L) cos(pi y/L), -cos(pi x/L) sin(pi y/L))``: free of divergence, of
    period 2L in x and y, with ``|w| <= U0`` reached half-way along the cell edges.

    Args:
        mean_velocity: U0 [m/s], > 0.
        length_scale: L [m], the side of one eddy, > 0.

    Raises:
        InputError: if one of them is not a finite number above 0.
    """

    mean_velocity: float
    length_scale: float

    def __post_init__(self) -> None:
        """Check both parameters and store them as floats."""
        speed = positive("mean_velocity", self.mean_velocity, "m/s")
        scale = positive("length_scale", self.length_scale, "m")
        object.__setattr__(self, "mean_velocity", speed)
        object.__setattr__(self, "length_scale", scale)

    @property
    def timescale(self) -> float:
        """The turnover time L / U0 [s] (Eq. 2)."""
        return self.length_scale / self.mean_velocity

    @property
    def wavenumber(self) -> float:
        """The wavenumber pi / L [1/m]."""
        return math.pi / self.length_scale

    @property
    def components(self) -> tuple[CellularFlow, ...]:
        """The flow as a superposition of one."""
        return (self,)

    @property
    def wind(self) -> tuple[float, float]:
        """No steady wind [m/s]: a cellular flow has none of its own."""
        return (0.0, 0.0)

    def velocity(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the flow velocity w [m/s], shape (..., 2), at positions x, y [m] (Eq. 1).

        x and y are broadcast against each other to the shape (...).
        """
        east, north = np.broadcast_arrays(
            self.wavenumber * np.asarray(x, dtype=np.float64),
            self.wavenumber * np.asarray(y, dtype=np.float64),
        )
        shape = (np.sin(east) * np.cos(north), -np.cos(east) * np.sin(north))
        return self.mean_velocity * np.stack(shape, axis=-1)


@dataclass(frozen=True)
class SuperposedFlow:
    """The sum of several cellular flows, eddies within eddies, and of a steady wind.

    Args:
        components: the cellular flows; none are needed where there is a wind.
        wind: a steady wind that carries them all [m/s], (x, y).

    Raises:
        InputError: if there is neither, or a component is not a `CellularFlow`; if the wind is not
            two finite numbers.
    """

    components: tuple[CellularFlow, ...]
    wind: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the components and the wind, and store them as tuples."""
        given = self.components
        parts = tuple(given) if isinstance(given, (tuple, list)) else ()
        object.__setattr__(self, "wind", pair("wind", self.wind, "m/s"))
        only_wind = given == () and any(self.wind)
        cellular = bool(parts) and all(isinstance(part, CellularFlow) for part in parts)
        if not (only_wind or cellular):
            raise InputError(
                "SuperposedFlow needs a tuple of at least one CellularFlow, "
                f"SuperposedFlow((CellularFlow(10.0, 4.0), ...)); got {given!r}"
            )
        object.__setattr__(self, "components", parts)

    def velocity(self, x: ArrayLike, y: ArrayLike) -> Array:
        """Return the summed flow velocity [m/s], shape (..., 2), at positions x, y [m]."""
        shape = np.broadcast_shapes(np.shape(x), np.shape(y))
        total: Array = np.zeros((*shape, 2)) + self.wind
        for part in self.components:
            total += part.velocity(x, y)
        return total


Flow: TypeAlias = CellularFlow | SuperposedFlow
