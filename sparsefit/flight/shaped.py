"""Cells of any heading and shape, steady, drifting or swelling: two waves of a stream function.

    psi = A sin(p . xi) sin(q . xi) (1 + s sin(2 pi t/T + phase)),    xi = x - x0 - c t

p and q stand on the two families of walls between the cells: |p| = pi/L_x, |q| = pi/L_y, q turned
from p by ``angle``. As waves, k = p - q and k = p + q with equal amplitudes A/2. With L_x = L_y, a
right angle and no heading it is the paper's flow (Eq. 1).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, finite, is_number, non_negative, pair, positive
from sparsefit.flight.waves import PointVelocity, WaveFlow

THINNEST = 1e6  # the longer side of a cell over the other


@dataclass(frozen=True)
class ShapedCells:
    """Cells that may be turned, stretched or skewed, off the origin, drifting and swelling.

    Args:
        mean_velocity: U0 = sqrt(2 <|w|^2>) [m/s] without swell, > 0.
        length_scales: (L_x, L_y) [m], the distances between the walls of a cell along its own
            axes, > 0; one number: square cells.
        heading: by which the cells are turned counter-clockwise [rad]: rectangles so that L_x is
            along (cos, sin) of it, cells of any shape so that it halves the angle of their waves.
        angle: between the two families of walls [rad], in (0, pi); pi/2: rectangles; else cells
            with L_x = L_y are rhombs.
        offset: where a corner of the cells is at t = 0 [m], (x, y).
        drift: the velocity at which the pattern moves [m/s], (x, y).
        swell: s, the share of U0 by which it swells and ebbs, in [0, 1).
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
        given = self.length_scales
        sides = pair("length_scales", (given, given) if is_number(given) else given, "m")
        sides = (positive("length_scales", sides[0], "m"), positive("length_scales", sides[1], "m"))
        if max(sides) > THINNEST * min(sides):
            raise InputError(f"length_scales differ by more than {THINNEST:g} times: no cells")
        angle = positive("angle", self.angle, "rad")
        if angle >= math.pi:
            raise InputError(f"angle must lie between 0 and pi [rad]; got {angle!r}")
        swell = non_negative("swell", self.swell)
        if swell >= 1.0:
            raise InputError(f"swell is a share of mean_velocity, below 1; got {swell!r}")
        checked = {
            "mean_velocity": positive("mean_velocity", self.mean_velocity, "m/s"),
            "length_scales": sides,
            "heading": finite("heading", self.heading, "rad"),
            "angle": angle,
            "offset": pair("offset", self.offset, "m"),
            "drift": pair("drift", self.drift, "m/s"),
            "swell": swell,
            "swell_period": positive("swell_period", self.swell_period, "s"),
            "swell_phase": finite("swell_phase", self.swell_phase, "rad"),
        }
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @property
    def length_scale(self) -> float:
        """Return sqrt(2) pi / sqrt(mean |k|^2) [m], over the two waves: L of square cells."""
        return self.waves.length_scale

    @property
    def timescale(self) -> float:
        """The turnover time, length_scale / mean_velocity [s]."""
        return self.length_scale / self.mean_velocity

    @property
    def period(self) -> float:
        """Twice the longer side of a cell [m]."""
        return 2.0 * max(self.length_scales)

    @property
    def cells(self) -> tuple[ShapedCells, ...]:
        """The flow itself."""
        return (self,)

    @cached_property
    def waves(self) -> WaveFlow:
        """The two waves of the cells, without their swell."""
        (p_size, q_size), half = math.pi / np.array(self.length_scales), 0.5 * self.angle
        p, q = p_size * _direction(-half), q_size * _direction(half)
        bisector = np.mean([math.atan2(*wave[::-1]) for wave in (p - q, p + q)])
        p, q = (_turned(wave, self.heading - float(bisector)) for wave in (p, q))
        wavevectors = np.stack([p - q, p + q])
        amplitude = self.mean_velocity / math.sqrt(2.0 * float(p @ p + q @ q))
        shift = wavevectors @ np.array(self.offset)
        signed = np.array([amplitude, -amplitude])
        return WaveFlow(
            wavevectors, signed * np.cos(shift), signed * np.sin(shift), wavevectors @ self.drift
        )

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s].

        x, y and t are broadcast against each other to the shape (...).
        """
        steady = self.waves.velocity(x, y, t)
        if not self.swell:
            return steady
        phase = self._swell_rate * np.asarray(t, dtype=np.float64) + self.swell_phase
        swollen: Array = steady * (1.0 + self.swell * np.sin(phase))[..., None]
        return swollen

    def pointwise(self) -> PointVelocity:
        """Return the velocity [m/s] at one x, y [m] and t [s], as a function of plain floats."""
        steady = self.waves.pointwise()
        if not self.swell:
            return steady
        rate, phase, share, sin = self._swell_rate, self.swell_phase, self.swell, math.sin

        def velocity(x: float, y: float, t: float) -> tuple[float, float]:
            u, v = steady(x, y, t)
            level = 1.0 + share * sin(rate * t + phase)
            return u * level, v * level

        return velocity

    @property
    def _swell_rate(self) -> float:
        return 2.0 * math.pi / self.swell_period


def _direction(angle: float) -> Array:
    return np.array([math.cos(angle), math.sin(angle)])


def _turned(vector: Array, angle: float) -> Array:
    """A vector turned counter-clockwise by an angle [rad]."""
    (cos, sin), (x, y) = _direction(angle), vector
    return np.array([cos * x - sin * y, sin * x + cos * y])
