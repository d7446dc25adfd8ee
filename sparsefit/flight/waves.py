"""Flows made of plane waves of a stream function, steady or moving: the base of every flow.

    psi = sum_j a_j cos(phi_j) + b_j sin(phi_j),    phi_j = k_j . x - omega_j t,
    w = (d psi/dy, -d psi/dx)

A flow of a stream function has no divergence, whatever its waves. A pattern that drifts with the
velocity c has omega_j = k_j . c. Cells are two waves of equal energy,

    psi = A sin(p . xi) sin(q . xi) (1 + s sin(2 pi t/T + phase)),    xi = x - x0 - c t

p and q stand on the two families of walls between the cells: |p| = pi/L_x, |q| = pi/L_y, q turned
from p by ``angle``. As waves, k = p - q and k = p + q with the amplitudes A/2 and -A/2.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError

PointVelocity: TypeAlias = Callable[[float, float, float], tuple[float, float]]
FEW = 8  # waves: below this plain floats are faster than arrays


class FlowField(Protocol):
    """Anything that has a flow velocity everywhere: a true flow, or an estimated one."""

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s]."""
        ...


class Flow:
    """Base of the flows of this package: waves of a stream function, and the cells among them.

    A subclass defines `waves`, or its own `formula`.
    """

    wind: tuple[float, float] = (0.0, 0.0)  # steady, beside the waves [m/s]

    if TYPE_CHECKING:  # fields of some subclasses, properties of others

        @property
        def mean_velocity(self) -> float:
            """U0 = sqrt(2 <|w|^2>) [m/s]."""

        @property
        def waves(self) -> WaveFlow:
            """The waves of the stream function."""

    @property
    def cells(self) -> tuple[Cells, ...]:
        """The parts of the flow that an estimator seeks."""
        return ()

    @property
    def period(self) -> float:
        """The side [m] of the square from which the start of a flight is drawn."""
        return self.waves.period

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s].

        x, y and t are broadcast against each other to the shape (...).
        """
        places = np.broadcast_arrays(*(np.asarray(given, np.float64) for given in (x, y, t)))
        return np.stack(np.broadcast_arrays(*self.formula(np)(*places), places[0])[:2], axis=-1)

    def pointwise(self) -> PointVelocity:
        """Return the velocity [m/s] at one x, y [m] and t [s], as a function of plain floats."""
        return self.formula(math)

    def formula(self, functions: Any) -> Callable[[Any, Any, Any], tuple[Any, Any]]:
        """Return w(x, y, t) as a function of floats or arrays.

        Args:
            functions: where it has its sines from: `math` for floats, `numpy` for arrays.
        """
        return self.waves.formula(functions)


@dataclass(frozen=True, eq=False)
class WaveFlow(Flow):
    """A flow whose stream function is a sum of plane waves.

    Args:
        wavevectors: k [rad/m], (n, 2), none of them 0.
        cosine: a [m^2/s], (n,), the amplitudes of cos(k.x - omega t).
        sine: b [m^2/s], (n,), the amplitudes of sin(k.x - omega t).
        frequencies: omega [rad/s], (n,); by default 0, a steady flow.

    Raises:
        InputError: if there is no wave, the shapes differ, a number is not finite, or a
            wavevector is 0.
    """

    wavevectors: Array
    cosine: Array
    sine: Array
    frequencies: Array | None = None

    def __post_init__(self) -> None:
        """Check the waves and store them as read-only arrays."""
        waves = len(np.atleast_1d(np.asarray(self.wavevectors)))
        if self.frequencies is None:
            object.__setattr__(self, "frequencies", np.zeros(waves))
        for name in ("wavevectors", "cosine", "sine", "frequencies"):
            try:
                array = np.array(getattr(self, name), dtype=np.float64)
            except (TypeError, ValueError):
                raise InputError(f"WaveFlow: {name} must be an array of real numbers") from None
            shape = (waves, 2) if name == "wavevectors" else (waves,)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(
                    f"WaveFlow: {name} must hold finite numbers, shape {shape}, a row per wave; "
                    f"got shape {array.shape}"
                )
            array.flags.writeable = False
            object.__setattr__(self, name, array)
        if not waves or not np.hypot(*self.wavevectors.T).all():
            raise InputError("WaveFlow needs at least one wave, and no wavevector may be (0, 0)")

    @property
    def waves(self) -> WaveFlow:
        """The flow itself."""
        return self

    @property
    def mean_velocity(self) -> float:
        """U0 = sqrt(2 <|w|^2>) [m/s] of waves with different wavevectors."""
        squares = np.sum(self.wavevectors**2, axis=1) * (self.cosine**2 + self.sine**2)
        return math.sqrt(float(np.sum(squares)))

    @property
    def length_scale(self) -> float:
        """The length sqrt(2) pi / sqrt(mean |k|^2) [m]: L of the two waves of square cells."""
        squares = np.sum(self.wavevectors**2, axis=1)
        return math.sqrt(2.0 / float(np.mean(squares))) * math.pi

    @property
    def timescale(self) -> float:
        """The turnover time, length_scale / mean_velocity [s]; infinite in a flow of no speed."""
        speed = self.mean_velocity
        return self.length_scale / speed if speed else math.inf

    @property
    def period(self) -> float:
        """The longest wavelength [m]."""
        return 2.0 * math.pi / float(np.min(np.hypot(*self.wavevectors.T)))

    @cached_property
    def _phases(self) -> Array:
        """(n, 4): kx, ky, omega and the shift that makes a wave a cosine with one amplitude."""
        shift = -np.arctan2(self.sine, self.cosine)
        assert self.frequencies is not None
        return np.column_stack([self.wavevectors, self.frequencies, shift])

    @cached_property
    def _slopes(self) -> Array:
        """(2, n): u and v [m/s] of a wave where the sine of its phase is 1."""
        amplitude = np.hypot(self.cosine, self.sine)
        slopes: Array = np.stack([-self.wavevectors[:, 1], self.wavevectors[:, 0]]) * amplitude
        return slopes

    def formula(self, functions: Any) -> Callable[[Any, Any, Any], tuple[Any, Any]]:
        """Return the sum of the waves, as of `Flow`."""
        if functions is math and len(self.cosine) > FEW:
            phases = np.ascontiguousarray(self._phases * (1.0, 1.0, -1.0, 1.0))
            slopes = np.ascontiguousarray(self._slopes)

            def of_many(x: float, y: float, t: float) -> tuple[float, float]:
                u, v = slopes.dot(np.sin(phases.dot((x, y, t, 1.0)))).tolist()
                return u, v

            return of_many
        sin = functions.sin
        waves = [(*phase, *slope) for phase, slope in
                 zip(self._phases.tolist(), self._slopes.T.tolist(), strict=True)]  # fmt: skip

        def of_few(x: Any, y: Any, t: Any) -> tuple[Any, Any]:
            u = v = 0.0
            for kx, ky, omega, shift, of_u, of_v in waves:
                height = sin(kx * x + ky * y - omega * t + shift)
                u = u + of_u * height
                v = v + of_v * height
            return u, v

        return of_few


class Cells(Flow):
    """Base of the flows that are an array of cells: two waves, of any heading, which may swell."""

    heading: float = 0.0
    angle: float = math.pi / 2.0
    offset: tuple[float, float] = (0.0, 0.0)
    drift: tuple[float, float] = (0.0, 0.0)
    swell: float = 0.0
    swell_period: float = 20.0
    swell_phase: float = 0.0

    if TYPE_CHECKING:

        @property
        def length_scale(self) -> float:
            """L [m] of square cells."""

        @property
        def length_scales(self) -> tuple[float, float]:
            """(L_x, L_y) [m]."""

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
        """The flow itself."""
        return (self,)

    @cached_property
    def waves(self) -> WaveFlow:
        """The two waves of the cells, without their swell."""

        def turned(vector: Array, angle: float) -> Array:
            cos, sin, (x, y) = math.cos(angle), math.sin(angle), vector
            return np.array([cos * x - sin * y, sin * x + cos * y])

        (p_size, q_size), half = math.pi / np.array(self.length_scales), 0.5 * self.angle
        p = p_size * np.array([math.cos(-half), math.sin(-half)])
        q = q_size * np.array([math.cos(half), math.sin(half)])
        bisector = np.mean([math.atan2(*wave[::-1]) for wave in (p - q, p + q)])
        p, q = (turned(wave, self.heading - float(bisector)) for wave in (p, q))
        wavevectors = np.stack([p - q, p + q])
        amplitude = self.mean_velocity / math.sqrt(2.0 * float(p @ p + q @ q))
        shift = wavevectors @ np.array(self.offset)
        signed = np.array([amplitude, -amplitude])
        return WaveFlow(
            wavevectors, signed * np.cos(shift), signed * np.sin(shift), wavevectors @ self.drift
        )

    def formula(self, functions: Any) -> Callable[[Any, Any, Any], tuple[Any, Any]]:
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
