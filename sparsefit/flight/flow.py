"""Flows: the paper's cells (Eqs. 1-2), cells of any shape, and sums of flows.

Cells are two waves of equal energy,

    psi = A sin(p . xi) sin(q . xi) (1 + s sin(2 pi t/T + phase)),    xi = x - x0 - c t

p and q are normal to the two families of walls between the cells: |p| = pi/L_x, |q| = pi/L_y, at
the angle ``angle`` to each other. As waves, k = p - q and k = p + q have the amplitudes +-A/2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.cached import cached_property
from sparsefit.errors import InputError, finite, is_number, non_negative, pair, positive, store
from sparsefit.flight.waves import Flow, Formula, WaveFlow


class Cells(Flow):
    """Base of the flows that are an array of cells."""

    length_scale: float  #: sqrt(2) pi / sqrt(mean |k|^2) [m] of the two waves: L of square cells
    length_scales: tuple[float, float]  #: (L_x, L_y) [m], the distances between a cell's walls
    heading: float = 0.0
    drift: tuple[float, float] = (0.0, 0.0)

    @property
    def timescale(self) -> float:
        """The turnover time, length_scale / mean_velocity [s]."""
        return self.length_scale / self.mean_velocity

    @property
    def period(self) -> float:
        """Twice the longer side of a cell [m]."""
        return 2.0 * max(self.length_scales)

    @property
    def cells(self) -> tuple[Cells, ...]:
        """The components that are cells, which is this flow alone."""
        return (self,)


@dataclass(frozen=True)
class CellularFlow(Cells):
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
        store(self, positive, "m/s", "mean_velocity")
        store(self, positive, "m", "length_scale")
        object.__setattr__(self, "length_scales", (self.length_scale, self.length_scale))

    def formula(self, functions: Any) -> Formula:
        """Return Eq. 1, as of `Flow`."""
        k, speed = math.pi / self.length_scale, self.mean_velocity
        sin, cos = functions.sin, functions.cos

        def velocity(x: Any, y: Any, _: Any) -> tuple[Any, Any]:
            east, north = k * x, k * y
            return speed * sin(east) * cos(north), -(speed * cos(east) * sin(north))

        return velocity


@dataclass(frozen=True)
class ShapedCells(Cells):
    """Cells at any heading, stretched or skewed, with an offset, a drift and a periodic swell.

    Args:
        mean_velocity: U0 = sqrt(2 <|w|^2>) [m/s] without swell, > 0.
        length_scales: (L_x, L_y) [m], the distances between the walls of a cell along its own
            axes, > 0; one number: square cells.
        heading: of the cells, counter-clockwise [rad]: the direction of L_x of rectangles, of any
            shape the bisector of its two wavevectors.
        angle: between the two families of walls [rad], in (0, pi); pi/2: rectangles; else cells
            with L_x = L_y are rhombs.
        offset: the position of a corner of the cells at t = 0 [m], (x, y).
        drift: the velocity of the pattern [m/s], (x, y).
        swell: s, the relative amplitude of the oscillation of U0, in [0, 1).
        swell_period: T [s], > 0.
        swell_phase: [rad].

    Raises:
        InputError: if one of them is not a finite number in its range.
    """

    mean_velocity: float
    length_scales: tuple[float, float]
    heading: float = 0.0
    angle: float = math.pi / 2.0
    offset: tuple[float, float] = (0.0, 0.0)
    drift: tuple[float, float] = (0.0, 0.0)
    swell: float = 0.0
    swell_period: float = 20.0
    swell_phase: float = 0.0

    def __post_init__(self) -> None:
        """Check the parameters and store them as floats."""
        if is_number(self.length_scales):
            object.__setattr__(self, "length_scales", (self.length_scales, self.length_scales))
        store(self, pair, "m", "length_scales", "offset")
        for side in self.length_scales:
            positive("length_scales", side, "m")
        store(self, positive, "m/s", "mean_velocity")
        store(self, pair, "m/s", "drift")
        store(self, finite, "rad", "heading", "swell_phase")
        store(self, positive, "rad", "angle")
        store(self, positive, "s", "swell_period")
        store(self, non_negative, "", "swell")
        if self.angle >= math.pi:
            raise InputError(f"angle must lie between 0 and pi [rad]; got {self.angle!r}")
        if self.swell >= 1.0:
            raise InputError(f"swell is a share of mean_velocity, below 1; got {self.swell!r}")
        object.__setattr__(self, "length_scale", self.waves.length_scale)

    @cached_property
    def waves(self) -> WaveFlow:
        """The two waves of the cells, without their swell."""
        half = np.exp(0.5j * self.angle)  # vectors are x + i y
        p, q = np.pi / np.array(self.length_scales) * [half.conjugate(), half]
        waves = np.array([p - q, p + q])
        waves *= np.exp(1j * (self.heading - np.angle(waves).mean()))
        wavevectors = np.column_stack([waves.real, waves.imag])
        amplitude = self.mean_velocity / math.sqrt(2.0 * (abs(p) ** 2 + abs(q) ** 2))
        shift = wavevectors @ np.array(self.offset)
        signed = np.array([amplitude, -amplitude])
        return WaveFlow(
            wavevectors, signed * np.cos(shift), signed * np.sin(shift), wavevectors @ self.drift
        )

    def formula(self, functions: Any) -> Formula:
        """Return the two waves times their swell, as of `Flow`."""
        steady = self.waves.formula(functions)
        if not self.swell:
            return steady
        rate, phase, share = 2.0 * math.pi / self.swell_period, self.swell_phase, self.swell

        def swollen(x: Any, y: Any, t: Any) -> tuple[Any, Any]:
            u, v = steady(x, y, t)
            level = 1.0 + share * functions.sin(rate * t + phase)
            return u * level, v * level

        return swollen


@dataclass(frozen=True)
class SuperposedFlow(Flow):
    """The sum of several flows, such as cells of two length scales, and of a wind.

    Args:
        components: the flows; may be empty if there is a wind.
        wind: a steady uniform wind [m/s], (x, y); it carries the vehicle, not the patterns.

    Raises:
        InputError: if both are empty, a component is no flow or the wind not two numbers.
    """

    components: tuple[Flow, ...]
    wind: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        """Check the components and the wind, and store them as tuples."""
        given = self.components
        parts = tuple(given) if isinstance(given, tuple | list) else (None,)
        store(self, pair, "m/s", "wind")
        if not all(isinstance(part, Flow) for part in parts) or not (parts or any(self.wind)):
            raise InputError(
                "SuperposedFlow: components must be a tuple of flows, (CellularFlow(10.0, 4.0), "
                f"...), which may be empty beside a wind alone; got {given!r}"
            )
        object.__setattr__(self, "components", parts)
        speeds = (getattr(part, "mean_velocity", math.nan) for part in self.components)
        object.__setattr__(self, "mean_velocity", math.hypot(*speeds))  # no two share a wave

    @property
    def cells(self) -> tuple[Cells, ...]:
        """The components that are cells."""
        return tuple(cell for part in self.components for cell in part.cells)

    @property
    def period(self) -> float:
        """The longest period of its cells [m], of all components without cells, 0 of a wind."""
        return max((part.period for part in self.cells or self.components), default=0.0)

    def formula(self, functions: Any) -> Formula:
        """Return the sum of the components and the wind, as of `Flow`."""
        (east, north), parts = self.wind, [part.formula(functions) for part in self.components]

        def velocity(x: Any, y: Any, t: Any) -> tuple[Any, Any]:
            u, v = east, north
            for part in parts:
                more_u, more_v = part(x, y, t)
                u, v = u + more_u, v + more_v
            return u, v

        return velocity
