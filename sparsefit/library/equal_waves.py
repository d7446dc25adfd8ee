"""Waves of one amplitude: cells whose crossing waves are equally strong, as those of Eq. 1 are.

    psi = Re (A - iB) (exp(i theta_1) + exp(i (theta_2 - delta)) + ...)

Two weights A, B in place of two a wave; the phase differences delta join the parameters. A path
that is nearly periodic on the cells' lattice cannot tell k from k + G where amplitudes are free,
G a wavevector of that lattice; where they are one, it can.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.phase import sines_and_cosines
from sparsefit.library.waves import ACROSS, AXIS, Pattern, Waves, along_path


@dataclass(frozen=True)
class EqualWaves:
    """The columns of one pattern of waves of one amplitude: q = (the pattern's, J - 1 deltas).

    It is what a projection needs, no family: the derivatives of its columns by x and by y are
    no combinations of them. What is read from it is read from the waves that it binds (`freed`).
    """

    name: ClassVar[str] = "equal-waves"
    targets: ClassVar[int] = 1
    size: ClassVar[int] = 2
    pattern: Pattern = AXIS

    @property
    def parameters(self) -> int:
        """The number p of parameters."""
        return self.pattern.parameters + self.pattern.size - 1

    @property
    def waves(self) -> Waves:
        """The family of the same waves with amplitudes of their own."""
        return Waves(self.pattern)

    def values(self, position: Array, parameters: Array) -> Array:
        """Columns (s, 2, 2 m) at positions (m, 2) or (m, 3), for parameters (s, p)."""
        phases = self.pattern.phases(self._of_pattern(parameters))
        theta = along_path(phases, position) - self._delays(parameters)
        sine, cosine = sines_and_cosines(theta)
        both = np.stack([-sine, cosine], axis=1)  # g of cos and of sin
        values: Array = (phases @ ACROSS).swapaxes(1, 2)[:, None] @ both
        return values.reshape(len(phases), 2, 2 * len(position))

    def bent(self, position: Array, parameters: Array, values: Array, weights: Array) -> Array:
        """The derivatives of each mode's flow by its parameters, (s, p, 2 m, 1)."""
        of_pattern, delays = self._of_pattern(parameters), self._delays(parameters)
        bent, late = self.waves.bent_and_late(position, of_pattern, weights, delays)
        return np.concatenate([bent, -late[:, 1:]], axis=1)

    def bound(self, parameters: Array, weights: Array) -> Array:
        """Parameters (s, p) that come nearest to free waves' (s, p), weights (s, 2 J, 1)."""
        phases = np.arctan2(weights[:, 1::2, 0], weights[:, ::2, 0])
        return np.concatenate([parameters, phases[:, 1:] - phases[:, :1]], axis=1)

    def freed(self, parameters: Array, weights: Array) -> tuple[Array, Array, Array]:
        """One mode as free waves: parameters (1, p), weights (1, 2 J, 1), and the tangent.

        tangent (n, l): how free parameters and weights move with these (1, p) and (1, 2, 1).
        """
        of_pattern = self._of_pattern(parameters)
        mixed, slopes = (one[0] for one in _mixed(self._deltas(parameters)))
        own, deltas = self.pattern.parameters, self.pattern.size - 1
        tangent = np.zeros((own + len(mixed), own + deltas + 2))
        tangent[:own, :own] = np.eye(own)
        tangent[own:, own : own + deltas] = (slopes @ weights[0])[..., 0].T
        tangent[own:, own + deltas :] = mixed
        return of_pattern, mixed @ weights, tangent

    def _of_pattern(self, parameters: Array) -> Array:
        return parameters[:, : self.pattern.parameters]

    def _deltas(self, parameters: Array) -> Array:
        return parameters[:, self.pattern.parameters :]

    def _delays(self, parameters: Array) -> Array:
        """What is taken from the phases of all waves, (s, J, 1)."""
        deltas = self._deltas(parameters)
        return np.concatenate([np.zeros((len(deltas), 1)), deltas], axis=1)[:, :, None]


def _mixed(deltas: Array) -> tuple[Array, Array]:
    """Weights (s, 2 J, 2) of free waves by A and B, and their slopes (s, J - 1, 2 J, 2)."""
    modes, others = deltas.shape
    turns = np.concatenate([np.zeros((modes, 1)), deltas], axis=1)
    cos, sin = np.cos(turns), np.sin(turns)
    mixed = np.stack([cos, -sin, sin, cos], axis=-1).reshape(modes, 2 * others + 2, 2)
    slopes = np.zeros((modes, others, others + 1, 4))
    slope = np.stack([-sin, -cos, cos, -sin], axis=-1)
    for j in range(others):
        slopes[:, j, j + 1] = slope[:, j + 1]
    return mixed, slopes.reshape(modes, others, 2 * others + 2, 2)
