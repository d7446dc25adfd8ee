"""One shape of waves, fitted, and what it says of the flow: the rungs of the ladder."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.waves import PAIR, RECTANGLE, WAVE, Pattern, Waves
from sparsefit.modes.projection import Projection
from sparsefit.modes.wave_peaks import strengths

FASTER, LONGER = 0.03, 0.01  # of U0 and L: what two rungs may differ by and still say the same
Family = Waves | EqualWaves


@dataclass(frozen=True, eq=False)
class Rung:
    """One shape, fitted: its family and where RSS is least.

    Args:
        family: of its waves.
        fit: of the rows it was last fitted to.
        bic: n ln RSS + p ln n.
    """

    family: Family
    fit: Projection
    bic: float

    @property
    def shape(self) -> str:
        """The name: of the pattern, or ``several`` waves."""
        return "several" if len(self.fit.parameters) > 1 else self.family.pattern.name

    @property
    def of_cells(self) -> bool:
        """Whether its waves make cells, equally strong."""
        return isinstance(self.family, EqualWaves)

    @property
    def drifting(self) -> bool:
        """Whether its waves move."""
        return self.family.pattern.drifting

    @property
    def phases(self) -> Array:
        """(k_x, k_y, omega) of every wave, (J, 3)."""
        pattern = self.family.pattern
        return pattern.phases(self.fit.parameters[:, : pattern.parameters]).reshape(-1, 3)

    @property
    def weights(self) -> Array:
        """The cosine and sine parts of every wave, (J, 2) [m^2/s]."""
        weights = self.fit.weights
        if isinstance(self.family, EqualWaves):
            weights = self.family.freed(self.fit.parameters, weights)[1]
        return weights.reshape(-1, 2)

    @property
    def strongest(self) -> Array:
        """The `phases` of the two strongest waves, or of fewer."""
        order = np.argsort(-strengths(self.phases[:, :2], self.weights), kind="stable")
        strongest: Array = self.phases[order[:2]]
        return strongest

    @property
    def mean_velocity(self) -> float:
        """U0 [m/s] of its waves, as the fitted rows have them."""
        squares = np.sum(self.phases[:, :2] ** 2, axis=1)
        return math.sqrt(float(squares @ np.sum(self.weights**2, axis=1)))

    @property
    def length_scale(self) -> float:
        """L [m] of its two strongest waves."""
        return math.pi * math.sqrt(2 / float(np.mean(np.sum(self.strongest[:, :2] ** 2, axis=1))))

    def alike(self, other: Rung) -> bool:
        """Whether both say the same U0 and, of as many waves, the same L."""
        speeds, scales = (
            sorted(getattr(rung, name) for rung in (self, other))
            for name in ("mean_velocity", "length_scale")
        )
        if speeds[1] > (1 + FASTER) * speeds[0]:
            return False
        return len(self.phases) != len(other.phases) or scales[1] <= (1 + LONGER) * scales[0]


def as_pair(fit: Projection) -> tuple[Waves, Projection]:
    """Single waves as what they are called: two of them are a pair."""
    if len(fit.parameters) != 2:
        return Waves(WAVE), fit
    parameters, moves = (one.reshape(1, -1) for one in (fit.parameters, fit.moves))
    weights = fit.weights.reshape(1, -1, 1)
    return Waves(PAIR), replace(fit, parameters=parameters, moves=moves, weights=weights)


def as_pattern(pattern: Pattern, phases: Array) -> Array:
    """Parameters (p,) of a pattern of two waves that come nearest to (k_x, k_y, omega) (2, 3).

    The heading of cells is that of k_1 + k_2, brought to (-pi/4, pi/4] by a quarter turn, which
    exchanges the waves.
    """
    if pattern.name == PAIR.name:
        waves: Array = phases[:, :2].ravel()
        return np.concatenate([waves, phases[:, 2]]) if pattern.drifting else waves
    first, second = phases
    if second[0] * first[1] < second[1] * first[0]:  # the first is counter-clockwise of the second
        first, second = second, first
    for _ in range(4):
        total = first + second
        heading = math.atan2(total[1], total[0])
        if -math.pi / 4 < heading <= math.pi / 4:
            break
        first, second = second, -first
    k_x, k_y = (0.5 * float(np.hypot(*one[:2])) for one in (first + second, first - second))
    wavenumbers = [k_x, k_y] if pattern.name == RECTANGLE.name else [math.sqrt(k_x * k_y)]
    frequencies = [first[2], second[2]] if pattern.drifting else []
    return np.array([*wavenumbers, *frequencies, *([heading] if pattern.turned else [])])
