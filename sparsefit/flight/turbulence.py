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

import numpy as np

from sparsefit.cached import cached_property
from sparsefit.errors import InputError, is_integer, one_of, positive
from sparsefit.flight.waves import Flow, WaveFlow

BANDS = 64
LONGEST = 0.1  # |k|/a of the longest waves: less than 1e-4 of the energy is in longer ones
SHORTEST = 100.0  # |k| L of the shortest: 5 % (von Karman) or 1.5 % (Dryden) is in shorter ones
GOLDEN = (math.sqrt(5.0) - 1.0) / 2.0


# the power p of a spectrum, and a times the integral length
SPECTRA = {"dryden": (5.0 / 2.0, 1.0), "von-karman": (7.0 / 3.0, 1.0 / 1.339)}


@dataclass(frozen=True)
class Turbulence(Flow):
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

    @cached_property
    def waves(self) -> WaveFlow:
        """The waves of the field, two per band of wavenumbers; a stream for each quantity."""
        place, turn, phase, tempo = (np.random.default_rng([self.seed, i]) for i in range(4))
        power, knee = SPECTRA[self.spectrum]
        edges = np.geomspace(LONGEST * knee, SHORTEST, BANDS + 1) / self.length
        c = 1.0 / (1.0 + (edges * self.length / knee) ** 2)
        above = (power - 1.0) * c ** (power - 2.0) - (power - 2.0) * c ** (power - 1.0)
        shares = (above[:-1] - above[1:]) / (above[0] - above[-1])
        inside = place.random(BANDS)
        size = edges[:-1] ** (1.0 - inside) * edges[1:] ** inside
        heading = math.pi / 2.0 * (turn.random() + GOLDEN * np.arange(BANDS))
        headings = np.concatenate([heading, heading + math.pi / 2.0])
        sizes = np.tile(size, 2)
        amplitudes = self.intensity * np.sqrt(2.0 * np.tile(shares, 2)) / sizes
        phases = phase.uniform(0.0, 2.0 * math.pi, 2 * BANDS)
        rates = tempo.standard_normal(2 * BANDS)
        return WaveFlow(
            sizes[:, None] * np.stack([np.cos(headings), np.sin(headings)], axis=1),
            amplitudes * np.cos(phases),
            amplitudes * np.sin(phases),
            rates * (math.sqrt(math.pi / 2.0) / self.memory if self.memory else 0.0),
        )
