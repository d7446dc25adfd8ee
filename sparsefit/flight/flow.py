"""The flows a vehicle flies through: one cellular flow (Eqs. 1-2), or flows of any kind superposed.

Every flow is a frozen record with ``velocity(x, y, t)``, ``pointwise()`` (the same on plain floats,
for the integrator), ``cells`` (what in it an estimator seeks) and ``period`` [m], the side of the
square from which a flight's start is drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.errors import InputError, pair, positive
from sparsefit.flight.shaped import ShapedCells
from sparsefit.flight.turbulence import Turbulence
from sparsefit.flight.waves import PointVelocity, WaveFlow


class FlowField(Protocol):
    """Anything that has a flow velocity everywhere: a true flow, or an estimated one."""

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s]."""
        ...


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
    def length_scales(self) -> tuple[float, float]:
        """(L, L) [m]: the cells are square."""
        return (self.length_scale, self.length_scale)

    @property
    def heading(self) -> float:
        """0 rad: the cells lie along the axes."""
        return 0.0

    @property
    def drift(self) -> tuple[float, float]:
        """(0, 0) m/s: the cells stay where they are."""
        return (0.0, 0.0)

    @property
    def components(self) -> tuple[CellularFlow, ...]:
        """The flow as a superposition of one."""
        return (self,)

    @property
    def wind(self) -> tuple[float, float]:
        """No steady wind [m/s]: a cellular flow has none of its own."""
        return (0.0, 0.0)

    @property
    def cells(self) -> tuple[CellularFlow, ...]:
        """The flow itself."""
        return (self,)

    @property
    def period(self) -> float:
        """The period 2 L [m]."""
        return 2.0 * self.length_scale

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity w [m/s], shape (..., 2), at positions x, y [m] (Eq. 1).

        x, y and t [s], which changes nothing, are broadcast against each other to the shape (...).
        """
        east, north, _ = np.broadcast_arrays(
            self.wavenumber * np.asarray(x, dtype=np.float64),
            self.wavenumber * np.asarray(y, dtype=np.float64),
            t,
        )
        shape = (np.sin(east) * np.cos(north), -np.cos(east) * np.sin(north))
        return self.mean_velocity * np.stack(shape, axis=-1)

    def pointwise(self) -> PointVelocity:
        """Return the velocity [m/s] at one x, y [m] and t [s], as a function of plain floats."""
        k, speed, sin, cos = self.wavenumber, self.mean_velocity, math.sin, math.cos

        def velocity(x: float, y: float, _: float) -> tuple[float, float]:
            east, north = k * x, k * y
            return speed * sin(east) * cos(north), -(speed * cos(east) * sin(north))

        return velocity


Cells: TypeAlias = CellularFlow | ShapedCells
Part: TypeAlias = CellularFlow | ShapedCells | WaveFlow | Turbulence
PARTS = (CellularFlow, ShapedCells, WaveFlow, Turbulence)


@dataclass(frozen=True)
class SuperposedFlow:
    """The sum of several flows, eddies within eddies or in turbulence, and of a steady wind.

    Args:
        components: the flows, `CellularFlow`, `ShapedCells`, `WaveFlow` or `Turbulence`; none are
            needed where there is a wind.
        wind: a steady wind beside them [m/s], (x, y); it carries the vehicle, and no pattern.

    Raises:
        InputError: if there is neither, or a component is no flow or itself superposed; if the
            wind is not two finite numbers.
    """

    components: tuple[Part, ...]
    wind: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the components and the wind, and store them as tuples."""
        given = self.components
        parts = tuple(given) if isinstance(given, (tuple, list)) else ()
        object.__setattr__(self, "wind", pair("wind", self.wind, "m/s"))
        only_wind = given == () and any(self.wind)
        flows = bool(parts) and all(isinstance(part, PARTS) for part in parts)
        if not (only_wind or flows):
            raise InputError(
                "SuperposedFlow needs a tuple of at least one CellularFlow or other flow, "
                f"SuperposedFlow((CellularFlow(10.0, 4.0), ...)); got {given!r}"
            )
        object.__setattr__(self, "components", parts)

    @property
    def mean_velocity(self) -> float:
        """U0 = sqrt(2 <|w|^2>) [m/s] of the components, no two of which share a wave."""
        return math.hypot(*(part.mean_velocity for part in self.components))

    @property
    def cells(self) -> tuple[Cells, ...]:
        """The components that are cells."""
        return tuple(cell for part in self.components for cell in part.cells)

    @property
    def period(self) -> float:
        """The longest period of its cells [m], of all components without cells, 0 of a wind."""
        return max((part.period for part in self.cells or self.components), default=0.0)

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the summed flow velocity [m/s], shape (..., 2), at positions x, y [m] and t [s].

        x, y and t are broadcast against each other to the shape (...).
        """
        shape = np.broadcast_shapes(np.shape(x), np.shape(y), np.shape(t))
        total: Array = np.zeros((*shape, 2)) + self.wind
        for part in self.components:
            total += part.velocity(x, y, t)
        return total

    def pointwise(self) -> PointVelocity:
        """Return the velocity [m/s] at one x, y [m] and t [s], as a function of plain floats."""
        east, north = self.wind
        parts = [part.pointwise() for part in self.components]

        def velocity(x: float, y: float, t: float) -> tuple[float, float]:
            u, v = east, north
            for part in parts:
                more_u, more_v = part(x, y, t)
                u += more_u
                v += more_v
            return u, v

        return velocity


Flow: TypeAlias = Part | SuperposedFlow
FLOWS = (*PARTS, SuperposedFlow)
