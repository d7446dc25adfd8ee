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
from dataclasses import dataclass, field

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.waves import AXIS, PAIR, RECTANGLE, SQUARE, WAVE, Pattern, Waves
from sparsefit.modes.choice import CLOSE, Ladder, chosen
from sparsefit.modes.lookout import Lookout
from sparsefit.modes.plane import descended
from sparsefit.modes.projection import Projection, project
from sparsefit.modes.rung import Family, Rung, as_pair, as_pattern
from sparsefit.modes.space import SearchSpace
from sparsefit.modes.wave_peaks import strengths

CELLS = (AXIS, SQUARE, RECTANGLE)
MOST = 4  # waves
ROUNDS = 8  # of the search around the best shape, at most
NEAR = 0.3  # of |Phi|^2: cells that leave less are looked around before the plane is scanned
FAR = 0.75  # of |Phi|^2: what leaves more has no shape around it that is the flow
SLIGHTLY, SLOWLY = 0.1, 0.95  # of BIC, and of RSS: a round that gains less is the last
SETTLED = 0.05  # of |Phi|^2: what is less is turbulence, or a vehicle that is another
INSTEAD = 4  # places that are tried for either wave of a pair


def climbed(
    space: SearchSpace, time: Array, cells: Projection, proposed: Array | None = None
) -> Ladder:
    """The ladder of a flight's samples at time (m,) [s], from cells that were fitted to them.

    proposed: wavevectors (p, 2) [1/m] of a back-end, strongest first, to start from as well.
    """
    climb = _Climb(Lookout.of(space, time))
    climb.bound(AXIS, cells.parameters[0])
    if climb.quiet or climb.left <= NEAR:
        climb.near()
    if proposed is not None and not climb.quiet:
        climb.join(proposed)
        climb.bind()
    for look in (climb.squares, climb.rectangles, climb.moving, climb.pairs, climb.several):
        if climb.quiet or climb.left <= SETTLED:
            break
        look()
    climb.instead()
    return climb.ladder()


def lowest(space: SearchSpace, time: Array, cells: Projection) -> Ladder:
    """Square cells along the axes alone, of a stream function of 4 amplitudes, from fitted ones."""
    climb = _Climb(Lookout.of(space, time))
    climb.pair(AXIS, cells.parameters[0])
    return climb.ladder(free=True)


def joined(space: SearchSpace, time: Array, proposed: Array) -> Ladder:
    """The waves that a back-end proposes (p, 2) [1/m], strongest first, where BIC falls.

    Where two are left, other places for either are tried too. There is one rung, of no wave, where
    the flight bears out none.
    """
    climb = _Climb(Lookout.of(space, time))
    climb.join(proposed)
    climb.instead()
    return climb.ladder(free=True)


@dataclass(frozen=True, eq=False)
class _Climb:
    """The rungs so far: the best of every shape, all that were tried, and those looked around."""

    lookout: Lookout
    rungs: dict[tuple[str, bool], Rung] = field(default_factory=dict)
    tried: list[Rung] = field(default_factory=list)
    surrounded: list[Rung] = field(default_factory=list)

    @property
    def best(self) -> Rung:
        return min(self.rungs.values(), key=lambda rung: rung.bic)

    @property
    def quiet(self) -> bool:
        return self.lookout.quiet(self.best.fit.rest)

    @property
    def left(self) -> float:
        """What the best rung leaves, of |Phi|^2."""
        return self.best.fit.residual / (float(np.sum(self.lookout.thin.target**2)) or 1.0)

    def hopeless(self, family: Family) -> float:
        """The RSS above which a flow of a family is no answer: another is better, and not close."""
        if not self.rungs:
            return math.inf
        return self.lookout.reaching(self.best.bic + CLOSE, family.parameters + family.size)

    def descended(self, family: Family, start: Array) -> Projection:
        """A flow of a family, moved from parameters (1, p) while it could be the answer."""
        goal = self.hopeless(family)
        return descended(family, self.lookout.thin, start, rough=True, goal=goal)

    def keep(self, family: Family, fit: Projection) -> Rung:
        """A rung, which stays where it is the best of its shape."""
        rung = Rung(family, fit, self.lookout.bic(family, fit))
        self.tried.append(rung)
        key = rung.shape, rung.drifting
        if key not in self.rungs or rung.bic < self.rungs[key].bic:
            self.rungs[key] = rung
        return rung

    def bound(self, pattern: Pattern, start: Array) -> None:
        """Cells of waves equally strong from a start (p,), by way of free ones."""
        free = self.descended(Waves(pattern), start[None])
        if free.residual <= self.hopeless(EqualWaves(pattern)):
            self._bound(pattern, free)

    def _bound(self, pattern: Pattern, free: Projection) -> Rung:
        family = EqualWaves(pattern)
        start = family.bound(free.parameters, free.weights)
        return self.keep(family, self.descended(family, start))

    def pair(self, pattern: Pattern, start: Array) -> Rung:
        """Two waves, each as strong as it fits, from a start (p,)."""
        family = Waves(pattern)
        return self.keep(family, self.descended(family, start[None]))

    def join(self, proposed: Array) -> None:
        """Waves that stand, which join one by one where BIC falls; all of them move together."""
        none = best = project(Waves(WAVE), self.lookout.thin, np.zeros((0, 2)))
        for wave in proposed:
            there = self._lower(best, np.vstack([best.parameters, wave]))
            while there is not None:  # the weakest leave where what is left does without
                best = there
                weakest = int(np.argmin(strengths(best.parameters, best.weights[..., 0])))
                there = self._lower(best, np.delete(best.parameters, weakest, axis=0))
        if not self.rungs:
            self.keep(Waves(WAVE), none)

    def _lower(self, best: Projection, waves: Array) -> Projection | None:
        """Waves (s, 2) that stand, moved and kept; None where BIC does not fall."""
        family, look = Waves(WAVE), self.lookout
        fit = descended(family, look.thin, waves, rough=True)
        if not look.bic(family, fit) < look.bic(family, best):
            return None
        if look.blown(fit) or look.close(fit):
            return None
        self.keep(*as_pair(fit))
        return fit

    def bind(self) -> None:
        """Cells of the two strongest of the waves that joined."""
        free = [rung for rung in self.rungs.values() if not rung.of_cells]
        if free:
            strongest = min(free, key=lambda rung: rung.bic).strongest
            for pattern in (SQUARE, RECTANGLE) if len(strongest) == 2 else ():
                self.bound(pattern, as_pattern(pattern, strongest))
        self.near()

    def near(self) -> None:
        """Every shape of two waves from the best one, where one could have a lower BIC."""
        for _ in range(ROUNDS):
            here, left, far = self.best, self.left, self.left > FAR and not self.quiet
            if here.shape == "several" or far or here in self.surrounded:
                return
            self.surrounded.append(here)
            self._simpler(here)
            self._freer(self.best)
            if here.bic - self.best.bic < SLIGHTLY:
                return
            if not self.quiet and self.left > SLOWLY * left:
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
        if not here.drifting and 2 * price < CLOSE:  # so short a flight that a drift stays a rival
            self._from(here.family.pattern.moving, here)

    def _gain(self, here: Rung, there: Rung, price: float) -> float:
        """2 ln(likelihood ratio) of one rung to another, less no price."""
        sizes = [rung.family.parameters + rung.family.size for rung in (here, there)]
        return here.bic - there.bic + (sizes[1] - sizes[0]) * price

    def _from(self, pattern: Pattern, rung: Rung) -> Rung:
        """A shape, started from another one of two waves."""
        start = as_pattern(pattern, rung.phases)
        if pattern.name == PAIR.name:
            return self.pair(pattern, start)
        return self._bound(pattern, project(Waves(pattern), self.lookout.thin, start[None]))

    def squares(self) -> None:
        """Squares that stand, from the peaks of a scan."""
        self._standing(SQUARE, self.lookout.squares())

    def rectangles(self) -> None:
        """Rectangles that stand, from pairs of peaks."""
        self._standing(RECTANGLE, self.lookout.rectangles())

    def _standing(self, pattern: Pattern, starts: Array) -> None:
        for start in self.lookout.ranked(Waves(pattern), starts):
            self.bound(pattern, start)
            if self.quiet:
                break
        self.near()

    def moving(self) -> None:
        """Square cells that drift, from pieces of the flight."""
        pieces, starts = self.lookout.drifting_squares()
        for start in starts:
            goal = self.hopeless(EqualWaves(SQUARE.moving))
            free = self.lookout.followed(pieces, start, goal)
            if free.residual <= goal:
                self._bound(SQUARE.moving, free)
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
            strong = self.lookout.strong(here.fit.rest, 1)
            more = np.pad(strong, ((0, 0), (0, pattern.parameters - 2)))
            fit = descended(family, thin, np.vstack([q, more]), rough=True)
            if self.lookout.blown(fit) or not len(strong):
                return
            there = self.keep(family, fit)
            if there.bic >= here.bic:
                return
            here, q = there, fit.parameters
            if self.lookout.quiet(here.fit.rest):
                return

    def instead(self) -> None:
        """Other places for either wave of the best pair, which may fit a track as well."""
        here, thin = self.best, self.lookout.thin
        if here.shape != PAIR.name or not self.quiet:
            return
        pattern = WAVE.moving if here.drifting else WAVE
        columns = Waves(pattern).values(thin.position, here.phases[:, : pattern.parameters])
        for wave, (own, weights) in enumerate(zip(columns, here.weights, strict=True)):
            without = here.fit.rest + (thin.averaged(own).T @ weights).reshape(2, -1).T
            for place in self.lookout.strong(without, INSTEAD):
                phases = here.phases.copy()
                phases[wave, :2] = place
                self.pair(here.family.pattern, as_pattern(here.family.pattern, phases))

    def ladder(self, *, free: bool = False) -> Ladder:
        """What all that was tried says; free: waves that make no cells are all there is."""
        every = list(self.rungs.values()), self.tried
        if self.quiet or free:
            return chosen(self.lookout, *every, quiet=self.quiet)
        # More than noise is left: turbulence, or another flow. Rows then count for less, and waves
        # that make no cells only follow the one or the other.
        rungs, tried = ([rung for rung in some if rung.of_cells] for some in every)
        rest = min(rungs, key=lambda rung: rung.bic).fit.rest
        return chosen(self.lookout.coloured(rest), rungs, tried, quiet=False)
