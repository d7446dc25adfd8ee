"""Flows made of plane waves of a stream function, steady or moving: the base of every flow.

    psi = sum_j a_j cos(phi_j) + b_j sin(phi_j),    phi_j = k_j . x - omega_j t,
    w = (d psi/dy, -d psi/dx)

A flow of a stream function has no divergence, whatever its waves. A pattern that moves with the
velocity c has omega_j = k_j . c.

Isotropic turbulence in the plane is a sum of random waves whose stream function has the spectral
density S(k) ~ (a^2 + |k|^2)^-p, so that the longitudinal velocity has, along any line, the
spectrum ~ (a^2 + k1^2)^-(p - 3/2):

    Dryden         p = 5/2, a = 1/L             1 / (1 + (L k1)^2)
    von Karman     p = 7/3, a = 1/(1.339 L)     1 / (1 + (1.339 L k1)^2)^(5/6)

with L the integral length. Of the energy, a share 1 - (p-1) c^(p-2) + (p-2) c^(p-1) lies below
|k|, c = a^2/(a^2 + k^2). Every band of wavenumbers gets two waves, at right angles, with its
energy (Kraichnan, 1970, Phys. Fluids 13, 22). If the field evolves, every wave has its own normally
distributed frequency: the velocity at a place has the correlation exp(-pi/4 (t/T)^2), of integral
T.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, frozen
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, integer, one_of, positive, shown, store

Formula: TypeAlias = Callable[[Any, Any, Any], tuple[Any, Any]]
SPECTRA = {  # the power p of a spectrum, and a times the integral length
    "dryden": (5.0 / 2.0, 1.0),
    "von-karman": (7.0 / 3.0, 1.0 / 1.339),
}


class FlowField(Protocol):
    """Anything that has a flow velocity everywhere: a true flow, or an estimated one."""

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s]."""
        ...


def check_flow(flow: object) -> None:
    """Raise `InputError` unless it is a flow, or None."""
    if flow is not None and not callable(getattr(flow, "velocity", None)):
        raise InputError(
            "flow must be one of CellularFlow, ShapedCells, WaveFlow, Turbulence, SuperposedFlow, "
            f"None, or an object with velocity(x, y, t); got {shown(flow)}"
        )


class Flow(ABC):
    """Base of the flows of this package: waves of a stream function, and the cells among them."""

    mean_velocity: float  #: U0 = sqrt(2 <|w|^2>) [m/s] of waves with different wavevectors

    @property
    def cells(self) -> tuple[Any, ...]:
        """The components that are cells."""
        return ()

    @property
    @abstractmethod
    def period(self) -> float:
        """The side [m] of the square from which the start of a flight is drawn."""

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s].

        x, y and t are broadcast against each other to the shape (...).
        """
        places = np.broadcast_arrays(*(np.asarray(given, np.float64) for given in (x, y, t)))
        return np.stack(np.broadcast_arrays(*self.formula(np)(*places), places[0])[:2], axis=-1)

    @abstractmethod
    def formula(self, functions: Any) -> Formula:
        """Return w(x, y, t) [m/s] by the sines of `math`, of floats, or `numpy`, of arrays."""


@dataclass(frozen=True, eq=False)
class WaveFlow(Flow):
    """A flow whose stream function is a sum of plane waves; its U0 is ``mean_velocity`` [m/s].

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
        store(self, frozen, ("m", 2), "wavevectors")
        count = len(self.wavevectors)
        if self.frequencies is None:
            object.__setattr__(self, "frequencies", np.zeros(count))
        store(self, frozen, (count,), "cosine", "sine", "frequencies")
        if not count or not np.hypot(*self.wavevectors.T).all():
            raise InputError("WaveFlow needs at least one wave, and no wavevector may be (0, 0)")
        squares = np.sum(self.wavevectors**2, axis=1) * (self.cosine**2 + self.sine**2)
        object.__setattr__(self, "mean_velocity", math.sqrt(float(np.sum(squares))))

    @property
    def length_scale(self) -> float:
        """The length sqrt(2) pi / sqrt(mean |k|^2) [m]: L of the two waves of square cells."""
        squares = np.sum(self.wavevectors**2, axis=1)
        return math.sqrt(2.0 / float(np.mean(squares))) * math.pi

    @property
    def period(self) -> float:
        """The longest wavelength [m]."""
        return 2.0 * math.pi / float(np.min(np.hypot(*self.wavevectors.T)))

    def formula(self, functions: Any) -> Formula:
        """Return the sum of the waves, each a cosine with one amplitude and a shift."""
        assert self.frequencies is not None
        shift = -np.arctan2(self.sine, self.cosine)
        phases = np.column_stack([self.wavevectors, -self.frequencies, shift])
        normals = np.stack([-self.wavevectors[:, 1], self.wavevectors[:, 0]])
        slopes = normals * np.hypot(self.cosine, self.sine)  # (u, v) where a phase's sine is 1
        if functions is math and len(shift) > 8:  # of fewer waves plain floats are faster

            def of_many(x: float, y: float, t: float) -> tuple[float, float]:
                u, v = slopes.dot(np.sin(phases.dot((x, y, t, 1.0)))).tolist()
                return u, v

            return of_many
        sin, waves = functions.sin, np.column_stack([phases, slopes.T]).tolist()

        def of_few(x: Any, y: Any, t: Any) -> tuple[Any, Any]:
            u = v = 0.0
            for kx, ky, rate, shift, of_u, of_v in waves:
                height = sin(kx * x + ky * y + rate * t + shift)
                u = u + of_u * height
                v = v + of_v * height
            return u, v

        return of_few


@dataclass(frozen=True)
class Turbulence(Flow):
    """A realisation of random, divergence-free, isotropic turbulence in the plane.

    The waves are drawn from ``seed``: equal records are equal fields. Waves shorter than length/16
    are left out; the others carry their energy.

    Args:
        intensity: rms [m/s] of each velocity component, over the plane, > 0.
        length: the longitudinal integral length [m], > 0.
        memory: the integral time scale [s] of the velocity at a place, > 0; None: frozen.
        spectrum: ``dryden`` or ``von-karman``.
        seed: a non-negative integer.

    Raises:
        InputError: if a number is not in its range or the spectrum has another name.
    """

    intensity: float
    length: float
    memory: float | None = None
    spectrum: str = "dryden"
    seed: int = 0

    def __post_init__(self) -> None:
        """Check the parameters and store the numbers as floats."""
        store(self, positive, "m/s", "intensity")
        object.__setattr__(self, "mean_velocity", 2.0 * self.intensity)
        store(self, positive, "m", "length")
        if self.memory is not None:
            store(self, positive, "s", "memory")
        one_of("spectrum of turbulence", self.spectrum, SPECTRA)
        store(self, integer, 0, "seed")

    @property
    def period(self) -> float:
        """2 pi times the integral length [m], in which most of its waves pass once."""
        return 2.0 * math.pi * self.length

    @cached_property
    def waves(self) -> WaveFlow:
        """The waves of the field, two per band of wavenumbers; a stream for each quantity."""
        place, turn, phase, tempo = (np.random.default_rng([self.seed, i]) for i in range(4))
        (power, knee), bands = SPECTRA[self.spectrum], 64
        # Less than 1e-4 of the energy is in longer waves, 5 % (von Karman) or 1.5 % in shorter.
        edges = np.geomspace(0.1 * knee, 100.0, bands + 1) / self.length
        c = 1.0 / (1.0 + (edges * self.length / knee) ** 2)
        above = (power - 1.0) * c ** (power - 2.0) - (power - 2.0) * c ** (power - 1.0)
        shares = (above[:-1] - above[1:]) / (above[0] - above[-1])
        inside = place.random(bands)
        size = edges[:-1] ** (1.0 - inside) * edges[1:] ** inside
        golden = (math.sqrt(5.0) - 1.0) / 2.0
        heading = math.pi / 2.0 * (turn.random() + golden * np.arange(bands))
        headings = np.concatenate([heading, heading + math.pi / 2.0])
        sizes = np.tile(size, 2)
        amplitudes = self.intensity * np.sqrt(2.0 * np.tile(shares, 2)) / sizes
        phases = phase.uniform(0.0, 2.0 * math.pi, 2 * bands)
        rates = tempo.standard_normal(2 * bands)
        return WaveFlow(
            sizes[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=1),
            amplitudes * np.cos(phases),
            amplitudes * np.sin(phases),
            rates * (math.sqrt(math.pi / 2.0) / self.memory if self.memory else 0.0),
        )

    def formula(self, functions: Any) -> Formula:
        """Return the sum of the waves, as of `Flow`."""
        return self.waves.formula(functions)
