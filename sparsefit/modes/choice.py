"""The choice among the rungs of a ladder by BIC, and what explains the flight nearly as well."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from sparsefit.library.waves import AXIS
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.lookout import Lookout
from sparsefit.modes.plane import descended
from sparsefit.modes.rung import Rung

CLOSE = 10.0  # of BIC to the best: rungs that are fitted to all rows, and could be the flow too


@dataclass(frozen=True, eq=False)
class Ladder:
    """What the flight bears out.

    Args:
        best: the rung with the least BIC, of all rows.
        rungs: the best of every shape that was tried, by rising BIC.
        quiet: whether no more than noise is left.
        rows: all rows, with the time as third coordinate.
        evidence: 2 ln(likelihood ratio) of the best to a uniform wind.
        chance: what that reaches in one flight of 1000 without a flow.
        rival: a fit with nearly the same BIC that says another U0 or L, where there is one.
    """

    best: Rung
    rungs: tuple[Rung, ...]
    quiet: bool
    rows: Rows
    evidence: float
    chance: float
    rival: Rung | None = None

    @property
    def left(self) -> float:
        """What the best leaves, of |Phi|^2."""
        return self.best.fit.residual / (float(np.sum(self.rows.target**2)) or 1.0)

    @property
    def steady_cells(self) -> bool:
        """Whether the lowest rung won: cells as the search for cells sees them."""
        return self.best.shape == AXIS.name and not self.best.drifting


def chosen(look: Lookout, rungs: list[Rung], tried: list[Rung], *, quiet: bool) -> Ladder:
    """The rungs by BIC; those that are close are fitted to all rows before one is chosen.

    Args:
        look: the rows, and how many of them count.
        rungs: the best of every shape.
        tried: all that were tried.
        quiet: whether the best leaves no more than noise.
    """
    whole = [_whole(look, rung) for rung in _close(_ranked(look, tried))]
    best, *others = sorted(whole, key=lambda rung: rung.bic)
    rivals = (rung for rung in others if rung.bic - best.bic < CLOSE and not rung.alike(best))
    evidence = look.space.evidence(look.space.null_residual, best.fit.residual)
    chance = look.chance(best.family, best.fit)
    ranked = _ranked(look, rungs)
    return Ladder(best, ranked, quiet, look.rows, evidence, chance, next(rivals, None))


def _ranked(look: Lookout, rungs: list[Rung]) -> tuple[Rung, ...]:
    """Rungs by BIC, which they get anew: rows may count for less than they did."""
    again = (replace(rung, bic=look.bic(rung.family, rung.fit)) for rung in rungs)
    return tuple(sorted(again, key=lambda rung: rung.bic))


def _close(ranked: tuple[Rung, ...]) -> list[Rung]:
    """Those that are close to the best, of alike ones of a shape the best."""
    found: list[Rung] = []
    for rung in ranked:
        if rung.bic - ranked[0].bic < CLOSE and not any(
            (rung.shape, rung.drifting) == (other.shape, other.drifting) and rung.alike(other)
            for other in found
        ):
            found.append(rung)
    return found


def _whole(look: Lookout, rung: Rung) -> Rung:
    """A rung, fitted to all rows."""
    fit = descended(rung.family, look.rows, rung.fit.parameters)
    return replace(rung, fit=fit, bic=look.bic(rung.family, fit))
