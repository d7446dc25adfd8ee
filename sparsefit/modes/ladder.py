"""The ladder of shapes: which waves of a stream function a flight bears out, by BIC.

    axis-aligned square cells  <  square at any heading  <  rectangular  <  any two waves  <  more,

each steady or drifting, the two waves of cells equally strong. Every rung holds the one before;
with n = 2 m / correlation rows worth counting and p parameters of its own,

    BIC = n ln RSS + p ln n,

the least wins (Schwarz, 1978). The lowest rung starts where the search for cells ended, the others
from there and from the peaks of a scan of the plane; what one more wave could explain of the rest
says whether to look further.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.waves import AXIS, PAIR, RECTANGLE, SQUARE, WAVE, Pattern, Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.lookout import Lookout
from sparsefit.modes.plane import descended
from sparsefit.modes.projection import Projection
from sparsefit.modes.space import SearchSpace

CELLS = (AXIS, SQUARE, RECTANGLE)
NEAR_AXIS = 0.1  # of heading [rad]: cells turned by less are tried along the axes
MOST = 4  # waves
ROUNDS = 8  # of the search around the best shape, at most
CLOSE = 10.0  # of BIC to the best: rungs that are fitted to all rows before one is chosen
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
    def drifting(self) -> bool:
        """Whether its waves move."""
        return self.family.pattern.drifting

    @property
    def phases(self) -> Array:
        """(k_x, k_y, omega) of every wave, (J, 3)."""
        pattern = self.family.pattern
        return pattern.phases(self.fit.parameters[:, : pattern.parameters]).reshape(-1, 3)


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
    """

    best: Rung
    rungs: tuple[Rung, ...]
    quiet: bool
    rows: Rows
    evidence: float
    chance: float

    @property
    def steady_cells(self) -> bool:
        """Whether the lowest rung won: cells as the search for cells sees them."""
        return self.best.shape == AXIS.name and not self.best.drifting


def climbed(space: SearchSpace, time: Array, cells: Projection) -> Ladder:
    """The ladder of a flight's samples at time (m,) [s], from cells that were fitted to them."""
    climb = _Climb(Lookout.of(space, time), {})
    climb.bound(AXIS, cells.parameters[0])
    climb.near()
    for look in (climb.standing, climb.moving, climb.pairs, climb.several):
        if climb.quiet:
            break
        look()
    return climb.ladder()


@dataclass(frozen=True, eq=False)
class _Climb:
    """The rungs so far, the best of every shape."""

    lookout: Lookout
    rungs: dict[tuple[str, bool], Rung]

    @property
    def best(self) -> Rung:
        return min(self.rungs.values(), key=lambda rung: rung.bic)

    @property
    def quiet(self) -> bool:
        return self.lookout.quiet(self.best.fit.rest)

    def keep(self, family: Family, fit: Projection) -> Rung:
        """A rung, which stays where it is the best of its shape."""
        rung = Rung(family, fit, self.lookout.bic(family, fit))
        key = rung.shape, rung.drifting
        if key not in self.rungs or rung.bic < self.rungs[key].bic:
            self.rungs[key] = rung
        return rung

    def bound(self, pattern: Pattern, start: Array) -> Rung:
        """Cells of waves equally strong from a start (p,), by way of free ones."""
        free = descended(Waves(pattern), self.lookout.thin, start[None], rough=True)
        return self._bound(pattern, free)

    def _bound(self, pattern: Pattern, free: Projection) -> Rung:
        family = EqualWaves(pattern)
        start = family.bound(free.parameters, free.weights)
        return self.keep(family, descended(family, self.lookout.thin, start, rough=True))

    def pair(self, pattern: Pattern, start: Array) -> Rung:
        """Any two waves from a start (p,)."""
        family = Waves(pattern)
        return self.keep(family, descended(family, self.lookout.thin, start[None], rough=True))

    def near(self) -> None:
        """Every shape of two waves from the best one, where one could have a lower BIC."""
        for _ in range(ROUNDS):
            here = self.best
            if here.shape == "several":
                return
            self._simpler(here)
            self._freer(self.best)
            if self.best is here:
                return

    def _simpler(self, here: Rung) -> None:
        """Shapes of fewer parameters than one: they win wherever they fit as well."""
        order = [pattern.name for pattern in (*CELLS, PAIR)]
        for pattern in reversed(CELLS[: order.index(here.shape)]):
            self._from(pattern.moving if here.drifting else pattern, self.best)
        if here.drifting:
            self._from(here.family.pattern.steady, self.best)

    def _freer(self, here: Rung) -> None:
        """Shapes of more: none can win unless the freest explains more than its price."""
        price = math.log(self.lookout.worth)
        gained = {
            pattern: self._gain(here, self._from(pattern, here), price)
            for pattern in (RECTANGLE.moving, PAIR.moving)
            if here.shape != PAIR.name or pattern.name == PAIR.name
        }
        if gained.get(RECTANGLE.moving, 0.0) > price:
            for pattern in CELLS:
                for moving in (pattern, pattern.moving):
                    self._from(moving, self.best)
        if gained[PAIR.moving] > 4 * price:
            self._from(PAIR, here)

    def _gain(self, here: Rung, there: Rung, price: float) -> float:
        """2 ln(likelihood ratio) of one rung to another, less no price."""
        sizes = [rung.family.parameters + rung.family.size for rung in (here, there)]
        return here.bic - there.bic + (sizes[1] - sizes[0]) * price

    def _from(self, pattern: Pattern, rung: Rung) -> Rung:
        """A shape, started from another one of two waves."""
        start = as_pattern(pattern, rung.phases)
        return (
            self.pair(pattern, start) if pattern.name == PAIR.name else self.bound(pattern, start)
        )

    def standing(self) -> None:
        """Squares, then rectangles that stand, from the peaks of a scan."""
        look = self.lookout
        for pattern, starts in ((SQUARE, look.squares), (RECTANGLE, look.rectangles)):
            for start in look.ranked(Waves(pattern), starts()):
                self.bound(pattern, start)
                if self.quiet:
                    break
            self.near()
            if self.quiet:
                return

    def moving(self) -> None:
        """Square cells that drift, from pieces of the flight."""
        pieces, starts = self.lookout.drifting_squares()
        for start in starts:
            self._bound(SQUARE.moving, self.lookout.followed(pieces, start))
            if self.quiet:
                break
        self.near()

    def pairs(self) -> None:
        """Any two waves that stand, the strongest and the strongest beside it."""
        for start in self.lookout.pairs():
            self.pair(PAIR, start)
        self.near()

    def several(self) -> None:
        """More waves, one by one, from what two leave."""
        here = self.best
        pattern = WAVE.moving if here.drifting else WAVE
        q = here.phases[:, : pattern.parameters]
        family, thin = Waves(pattern), self.lookout.thin
        while len(q) < MOST:
            more = np.zeros((1, pattern.parameters))
            more[0, :2] = self.lookout.strongest(here.fit.rest)
            fit = descended(family, thin, np.vstack([q, more]), rough=True)
            if self.lookout.blown(fit):
                return
            there = self.keep(family, fit)
            if there.bic >= here.bic:
                return
            here, q = there, fit.parameters
            if self.lookout.quiet(here.fit.rest):
                return

    def ladder(self) -> Ladder:
        """The rungs by BIC; those that are close are fitted to all rows before one is chosen.

        Where more than noise is left it is turbulence, or another flow: rows then count for less,
        and more waves only follow the one or the other.
        """
        look, quiet, rungs = self.lookout, self.quiet, list(self.rungs.values())
        if not quiet:
            look = look.coloured(self.best.fit.rest)
            rungs = [rung for rung in rungs if rung.shape != "several"]
        again = (replace(rung, bic=look.bic(rung.family, rung.fit)) for rung in rungs)
        ranked = sorted(again, key=lambda rung: rung.bic)
        close = [rung for rung in ranked if rung.bic - ranked[0].bic < CLOSE]
        best = min((_whole(look, rung) for rung in close), key=lambda rung: rung.bic)
        evidence = look.space.evidence(look.space.null_residual, best.fit.residual)
        chance = look.chance(best.family, best.fit)
        return Ladder(best, tuple(ranked), quiet, look.rows, evidence, chance)


def _whole(look: Lookout, rung: Rung) -> Rung:
    """A rung, fitted to all rows."""
    fit = descended(rung.family, look.rows, rung.fit.parameters)
    return replace(rung, fit=fit, bic=look.bic(rung.family, fit))


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
