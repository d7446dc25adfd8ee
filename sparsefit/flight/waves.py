"""Flows made of plane waves of a stream function, steady or moving.

    psi = sum_j a_j cos(phi_j) + b_j sin(phi_j),    phi_j = k_j . x - omega_j t,
    w = (d psi/dy, -d psi/dx)

A flow of a stream function has no divergence, whatever its waves. A pattern that drifts with the
velocity c has omega_j = k_j . c.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError

PointVelocity: TypeAlias = Callable[[float, float, float], tuple[float, float]]
FEW = 8  # waves: below this plain floats are faster than arrays


@dataclass(frozen=True, eq=False)
class WaveFlow:
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
        waves = _stored(self, "wavevectors", self.wavevectors, (2,))
        _stored(self, "cosine", self.cosine, ())
        _stored(self, "sine", self.sine, ())
        still = np.zeros(len(waves)) if self.frequencies is None else self.frequencies
        _stored(self, "frequencies", still, ())
        if not len(waves) or not np.hypot(*waves.T).all():
            raise InputError("WaveFlow needs at least one wave, and no wavevector may be (0, 0)")

    @property
    def mean_velocity(self) -> float:
        """U0 = sqrt(2 <|w|^2>) [m/s] of waves with different wavevectors."""
        squares = np.sum(self.wavevectors**2, axis=1) * (self.cosine**2 + self.sine**2)
        return math.sqrt(float(np.sum(squares)))

    @property
    def length_scale(self) -> float:
        """Return sqrt(2) pi / sqrt(mean |k|^2) [m]: of the two waves of square cells, their L."""
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

    @property
    def cells(self) -> tuple[()]:
        """None: waves of any kind are no cells."""
        return ()

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s].

        x, y and t are broadcast against each other to the shape (...).
        """
        east, north, time = (np.asarray(given, dtype=np.float64) for given in (x, y, t))
        total: Array = np.zeros((*np.broadcast_shapes(east.shape, north.shape, time.shape), 2))
        for (kx, ky, omega, shift), slopes in zip(self._phases, self._slopes.T, strict=True):
            total += np.sin(kx * east + ky * north - omega * time + shift)[..., None] * slopes
        return total

    def pointwise(self) -> PointVelocity:
        """Return the velocity [m/s] at one x, y [m] and t [s], as a function of plain floats."""
        return self._of_few() if len(self.cosine) <= FEW else self._of_many()

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

    def _of_few(self) -> PointVelocity:
        sin = math.sin
        waves = [(*phase, *slopes) for phase, slopes in
                 zip(self._phases.tolist(), self._slopes.T.tolist(), strict=True)]  # fmt: skip

        def velocity(x: float, y: float, t: float) -> tuple[float, float]:
            u = v = 0.0
            for kx, ky, omega, shift, of_u, of_v in waves:
                height = sin(kx * x + ky * y - omega * t + shift)
                u += of_u * height
                v += of_v * height
            return u, v

        return velocity

    def _of_many(self) -> PointVelocity:
        phases = np.ascontiguousarray(self._phases * (1.0, 1.0, -1.0, 1.0))
        slopes, sin = np.ascontiguousarray(self._slopes), np.sin

        def velocity(x: float, y: float, t: float) -> tuple[float, float]:
            u, v = slopes.dot(sin(phases.dot((x, y, t, 1.0)))).tolist()
            return u, v

        return velocity


def _stored(flow: WaveFlow, name: str, given: object, ending: tuple[int, ...]) -> Array:
    """Store a field of the flow as a read-only copy, one row per wave."""
    try:
        array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"WaveFlow: {name} must be an array of real numbers") from None
    waves = len(np.atleast_1d(np.asarray(flow.wavevectors)))
    if array.shape != (waves, *ending) or not np.isfinite(array).all():
        text = f"({waves}, 2)" if ending else f"({waves},)"
        raise InputError(
            f"WaveFlow: {name} must hold finite numbers, shape {text}, a row per wave; "
            f"got shape {array.shape}"
        )
    array.flags.writeable = False
    object.__setattr__(flow, name, array)
    return array
