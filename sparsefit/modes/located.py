"""What a search has found: the modes off the grid, and what they could be mistaken for."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.modes.projection import Projection
from sparsefit.modes.space import SIGNIFICANCE, WIND, SearchSpace


@dataclass(frozen=True)
class Rival:
    """The best other lobe of a mode at k: its own wavenumber [1/m], and RSS there [m^2/s^2]."""

    mode_wavenumber: float
    wavenumber: float
    residual: float


@dataclass(frozen=True, eq=False)
class Located:
    """The modes of a flight off the grid, and what they could be mistaken for.

    Args:
        space: that was searched.
        fit: of the modes, where RSS is least.
        candidates: the wavenumbers that proposed each mode (s,) [1/m].
        rival: the best other lobe; None where there is no other.
        left_over: the wavenumber of a flow that is left and was not proposed [1/m], or NaN.
        correlation: rows over which errors correlate, residuals considered.
        ends: where the descents of one mode ended [1/m], the deepest first: the lobes of a flight
            that goes on are near them.
    """

    space: SearchSpace
    fit: Projection
    candidates: tuple[float, ...]
    rival: Rival | None = None
    left_over: float = math.nan
    correlation: float = math.nan
    ends: tuple[float, ...] = ()

    @property
    def wavenumbers(self) -> Array:
        """k (s,) [1/m]."""
        return self.fit.parameters[:, 0]

    @property
    def edge(self) -> float:
        """The wavenumber of a mode on a bound of the search [1/m], NaN where none is."""
        at_bound = [k for k in self.wavenumbers.tolist() if k in self.space.bounds]
        return at_bound[0] if at_bound else math.nan

    @property
    def freedom(self) -> int:
        """The number of parameters of all modes beyond those of a uniform wind."""
        return self.space.parameters * len(self.candidates) - WIND

    @cached_property
    def detected(self) -> bool:
        """Whether the modes explain more than chance does beyond a uniform wind.

        With a false alarm in 1000 flights, over all lobes between the bounds.
        """
        gain = self.space.evidence(self.space.null_residual, self.fit.residual, self.correlation)
        return gain > self.space.by_chance(self.freedom)

    @property
    def beaten(self) -> bool:
        """Whether the rival fits better than what was proposed."""
        return self.rival is not None and self.rival.residual < self.fit.residual

    @property
    def evidence(self) -> float:
        """2 ln(likelihood ratio) to the rival; inf without one."""
        other = math.inf if self.rival is None else self.rival.residual
        return self.space.evidence(other, self.fit.residual, self.correlation)

    @property
    def distinct(self) -> bool:
        """Whether the data exclude the rival.

        A false lobe leads by a likelihood ratio c with probability <= 1/c; over all lobes the
        risk is 1 % at evidence = 2 ln(lobes / 0.01).
        """
        return self.evidence > exclusion(self.space)

    @property
    def identifiable(self) -> bool:
        """Whether there is a flow, within the bounds, and the data exclude its rivals."""
        return self.detected and math.isnan(self.edge) and self.distinct


def exclusion(space: SearchSpace) -> float:
    """The 2 ln(likelihood ratio) beyond which the data exclude a lobe, over all lobes."""
    return 2 * math.log(space.lobe_count / SIGNIFICANCE)
