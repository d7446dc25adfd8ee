"""Isotropic turbulence in the plane: random waves of a stream function, frozen or evolving.

The stream function has the spectral density S(k) ~ (a^2 + |k|^2)^-p, so that the longitudinal
velocity has, along any line, the spectrum ~ (a^2 + k1^2)^-(p - 3/2):

    Dryden         p = 5/2, a = 1/L             1 / (1 + (L k1)^2)
    von Karman     p = 7/3, a = 1/(1.339 L)     1 / (1 + (1.339 L k1)^2)^(5/6)

with L the integral length. Of the energy, a share 1 - (p-1) c^(p-2) + (p-2) c^(p-1) lies below
|k|, c = a^2/(a^2 + k^2). Every band of wavenumbers gets two waves, at right angles, with its
energy (Kraichnan, 1970, Phys. Fluids 13, 22). In evolving turbulence every wave has a frequency of
its own, normal, so that a velocity forgets itself as exp(-pi/4 (t/T)^2), of integral T.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, is_integer, one_of, positive
from sparsefit.flight.waves import PointVelocity, WaveFlow

BANDS = 64
LONGEST = 0.1  # |k|/a of the longest waves: less than 1e-4 of the energy is in longer ones
SHORTEST = 100.0  # |k| L of the shortest: 5 % (von Karman) or 1.5 % (Dryden) is in shorter ones
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


class Shape(NamedTuple):
    """A spectrum: its power p, and a times the integral length."""

    power: float
    knee: float


SPECTRA = {"dryden": Shape(5.0 / 2.0, 1.0), "von-karman": Shape(7.0 / 3.0, 1.0 / 1.339)}


@dataclass(frozen=True)
class Turbulence:
    """One field of random, divergence-free, isotropic turbulence in the plane.

    The waves are drawn from ``seed``: the same record is the same field. Waves shorter than
    length/16 are left out, and their energy is given to the others.

    Args:
        intensity: rms [m/s] of each velocity component, over the plane, > 0.
        length: the longitudinal integral length [m], > 0.
        memory: the integral time [s] for which the velocity at a place remembers itself, > 0;
            None: frozen.
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
        object.__setattr__(self, "intensity", positive("intensity", self.intensity, "m/s"))
        object.__setattr__(self, "length", positive("length", self.length, "m"))
        if self.memory is not None:
            object.__setattr__(self, "memory", positive("memory", self.memory, "s"))
        one_of("spectrum of turbulence", self.spectrum, SPECTRA)
        if not is_integer(self.seed, 0):
            raise InputError(f"seed must be an integer, 0 or above; got {self.seed!r}")

    @property
    def mean_velocity(self) -> float:
        """U0 = sqrt(2 <|w|^2>) [m/s]: twice the intensity."""
        return 2.0 * self.intensity

    @property
    def period(self) -> float:
        """2 pi times the integral length [m], in which most of its waves pass once."""
        return 2.0 * math.pi * self.length

    @property
    def cells(self) -> tuple[()]:
        """None: turbulence has no cells."""
        return ()

    @cached_property
    def waves(self) -> WaveFlow:
        """The waves of the field, two per band of wavenumbers."""
        place, turn, phase, tempo = self._streams()
        edges = self._edges()
        inside = place.random(BANDS)
        size = edges[:-1] ** (1.0 - inside) * edges[1:] ** inside
        heading = math.pi / 2.0 * (turn.random() + GOLDEN * np.arange(BANDS))
        headings = np.concatenate([heading, heading + math.pi / 2.0])
        sizes = np.tile(size, 2)
        amplitudes = self.intensity * np.sqrt(2.0 * np.tile(self._shares(edges), 2)) / sizes
        phases = phase.uniform(0.0, 2.0 * math.pi, 2 * BANDS)
        rates = tempo.standard_normal(2 * BANDS)
        return WaveFlow(
            sizes[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=1),
            amplitudes * np.cos(phases),
            amplitudes * np.sin(phases),
            rates * (math.sqrt(math.pi / 2.0) / self.memory if self.memory else 0.0),
        )

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m] and t [s].

        x, y and t are broadcast against each other to the shape (...).
        """
        return self.waves.velocity(x, y, t)

    def pointwise(self) -> PointVelocity:
        """Return the velocity [m/s] at one x, y [m] and t [s], as a function of plain floats."""
        return self.waves.pointwise()

    def _streams(self) -> list[np.random.Generator]:
        """A stream for each random quantity: memory does not change what is frozen."""
        return [np.random.default_rng([self.seed, stream]) for stream in range(4)]

    def _edges(self) -> Array:
        """The edges of the bands [rad/m], (BANDS + 1,), equal in ratio."""
        knee = SPECTRA[self.spectrum].knee
        edges: Array = np.geomspace(LONGEST * knee, SHORTEST, BANDS + 1) / self.length
        return edges

    def _shares(self, edges: Array) -> Array:
        """The share of the energy in each band, (BANDS,), with that of all others given to them."""
        power, knee = SPECTRA[self.spectrum]
        c = 1.0 / (1.0 + (edges * self.length / knee) ** 2)
        above = (power - 1.0) * c ** (power - 2.0) - (power - 2.0) * c ** (power - 1.0)
        shares: Array = (above[:-1] - above[1:]) / (above[0] - above[-1])
        return shares
