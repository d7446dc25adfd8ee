"""The ladder of shapes: flows proposed to the likelihood, which starts from them.

From the peaks of scans (`sparsefit.model.search`) shapes are fitted to the rows
(`sparsefit.model.shapes`), and around the best of them shapes with more and fewer parameters. With
n effective rows and p parameters,

    BIC = n ln RSS + p ln n,

orders them (Schwarz, 1978). All steps are bounded in number. The likelihood refines the parameters
and chooses among proposals with similar BIC. Shares below are of |Phi|^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from sparsefit.arrays import Array
from sparsefit.model.scan import WaveScan
from sparsefit.model.search import CLOSE, EXACT, Proposal, Search, spectrum
from sparsefit.model.shapes import (
    AXIS,
    PAIR,
    RECTANGLE,
    SQUARE,
    STAND,
    Shape,
    ShapeFit,
    axis_cells,
    descended,
    fitted,
    free_waves,
    joined,
)

Window = tuple[float, float, float]  # a candidate's wavenumber and the bounds around it [1/m]


@dataclass(frozen=True)
class Start:
    """The start of a search that a back-end's weights propose; hashable, for caching."""

    refine: str = "ladder"  # or "variable-projection"
    lobe: float = 0.0  # the scan's wavenumber [1/m] nearest to a candidate scale; 0: none
    windows: tuple[Window, ...] = ()  # of several length scales, strongest first
    waves: tuple[tuple[float, float], ...] = ()  # k [rad/m] of a wave library, strongest first


class Ladder:
    """The state of one search: the shapes fitted so far, and those whose neighbours were tried."""

    def __init__(self, search: Search) -> None:
        self.search, self.rows = search, search.rows
        self.tried: list[ShapeFit] = []
        self.surrounded: list[ShapeFit] = []

    @property
    def best(self) -> ShapeFit:
        """The fit of least BIC."""
        return min(self.tried, key=self.search.bic)

    @property
    def done(self) -> bool:
        """Whether the residual is noise, or at most 5 % (gusts, or a wrong vehicle)."""
        here = self.best
        return here.residual <= 0.05 * self.rows.square or self.search.quiet(here.rest)

    def descend(self, shape: Shape, q: Array) -> ShapeFit | None:
        """The fit of a shape from q (p,); None if implausible, or worse than another of it."""
        alike = [fit.residual for fit in self.tried if fit.shape == shape]
        goal = min(alike, default=math.inf) * math.exp(CLOSE / self.search.worth)
        fit = descended(self.rows, shape, q, goal=goal)
        if fit.residual > goal or not self.search.possible(fit):
            return None
        self.tried.append(fit)
        return fit

    def nearest(self, phases: Array, *shapes: Shape) -> None:
        """Fit shapes, each from its parameters nearest to two waves (k_x, k_y, omega), (2, 3)."""
        for shape in shapes:
            self.descend(shape, shape.nearest(phases))

    def lines(self, candidate: float) -> None:
        """Fit square cells along the axes, from the deepest lobes and the lobe of a candidate."""
        lobes = self.search.lobes
        for k in dict.fromkeys([*lobes[:5].tolist(), candidate or float(lobes[0])]):
            self.descend(AXIS, np.array([k]))
        if not self.tried:  # no plausible fit: the deepest lobe as it is
            self.tried.append(fitted(self.rows, AXIS, lobes[:1]))

    def climb(self, proposed: Array) -> None:
        """Fit all shapes, from the best so far, proposed waves (p, 2) and scans of the plane."""
        if self.done or self.best.residual <= 0.3 * self.rows.square:
            self.around()
        if len(proposed) and not self.done:
            self.join(proposed)
            self.around()
        fastest = 0.6 * math.sqrt(2 * float(np.mean(np.sum(self.rows.rest**2, axis=1))))
        moving = partial(self.squares, fastest)
        for look in (self.squares, moving, self.pairs, self.beside, self.several):
            if self.done:
                break
            look()
            self.around()
        self.instead()

    def around(self) -> None:
        """Fit every shape of two waves from the best one, if any could have a lower BIC."""
        price = self.search.worth ** (1 / self.search.worth)  # the ratio of RSS per parameter
        least = EXACT * self.rows.square
        for _ in range(4):
            here = self.best
            far = here.residual > 0.75 * self.rows.square and not self.search.quiet(here.rest)
            if len(here.phases) != 2 or far or any(here is fit for fit in self.surrounded):
                return
            self.surrounded.append(here)
            shape, drifting = here.shape, here.shape.drifting
            simpler = [own for own in reversed(STAND) if own.size < shape.steady.size]
            self.nearest(here.phases, *(own.moving if drifting else own for own in simpler))
            if drifting:
                self.nearest(here.phases, shape.steady)
            best = self.best
            free = self.descend(PAIR.moving, PAIR.moving.nearest(best.phases))
            if free and max(best.residual, least) > price * max(free.residual, least):
                freer = [own for shape in reversed(STAND) for own in (shape.moving, shape)]
                self.nearest(free.phases, *freer, PAIR)
            if self.search.bic(here) - self.search.bic(self.best) < 0.1:
                return

    def squares(self, fastest: float = 0.0) -> None:
        """Fit square cells from a scan of the plane, from pieces of the track to the whole.

        Their waves are k and (k_y, -k_x), a quarter turn clockwise; each moves at up to fastest.
        """
        rows, scan, shape = self.rows, self.search.scan, SQUARE
        if fastest:
            scan, shape = WaveScan.of(rows, self.search.radii, fastest), SQUARE.moving
        if scan is None:
            return
        gains, omega = scan.gains(rows.rest)
        fits = []
        for i, j in scan.squares(gains, 20):
            x, y = scan.axis[[i, j]]
            waves = np.array([[x, y, omega[i, j]], [y, -x, omega[j, len(omega) - 1 - i]]])
            fits.append(fitted(rows, shape, shape.nearest(waves), scan.pieces))
        fits.sort(key=lambda fit: fit.residual)
        for fit in fits[: 4 if scan.pieces == 1 else 2]:
            self.descend(shape, joined(rows, shape, fit.q, scan.pieces))
            if self.done:
                break

    def pairs(self) -> None:
        """Fit any two steady waves: the strongest, and the strongest in its residual."""
        wave, scan = free_waves(1), self.search.scan
        for first in self.search.strong(self.rows.rest, 1):
            assert scan is not None
            alone = descended(self.rows, wave, joined(self.rows, wave, first, scan.pieces))
            for second in self.search.strong(alone.rest, 2):
                self.descend(PAIR, np.concatenate([alone.q, second]))

    def beside(self) -> None:
        """Try square cells along the axes of two length scales: the best, and in its residual."""
        fits = sorted((fit for fit in self.tried if fit.shape == AXIS), key=self.search.bic)
        for first in fits[:1]:
            for k in self.search.line(first.rest)[:3]:
                self.descend(axis_cells(2), np.append(first.q, k))

    def several(self) -> None:
        """Add waves one by one, up to four, from the residual of the best fits."""
        standing = [fit for fit in self.tried if not fit.shape.drifting]
        starts = [self.best, min(standing, key=self.search.bic)]
        for here in starts[: 1 + self.best.shape.drifting]:
            while len(here.phases) < 4:
                more = self.search.strong(here.rest, 1)
                there = self.with_waves(here, np.vstack([here.phases[:, :2], more]))
                if there is None or not len(more):
                    break
                here = there

    def with_waves(self, here: ShapeFit, waves: Array) -> ShapeFit | None:
        """The fit of waves k (j, 2); None if BIC does not fall, or two waves nearly cancel."""
        motion = here.q[-2:] if here.shape.drifting else np.zeros(0)
        shape = free_waves(len(waves), drifting=here.shape.drifting)
        fit = descended(self.rows, shape, np.concatenate([waves.ravel(), motion]))
        if self.search.bic(fit) >= self.search.bic(here) or not self.search.possible(fit):
            return None
        self.tried.append(fit)
        return fit

    def join(self, proposed: Array) -> None:
        """Add the waves that a back-end proposes (p, 2) one by one where BIC falls."""
        here = fitted(self.rows, free_waves(0), np.zeros(0))
        for wave in proposed:
            there = self.with_waves(here, np.vstack([here.phases[:, :2], wave]))
            while there is not None:  # remove the weakest while BIC falls
                here = there
                weakest = int(np.argmin(here.strengths))
                fewer = np.delete(here.phases[:, :2], weakest, axis=0)
                there = self.with_waves(here, fewer) if len(fewer) else None
        if len(here.phases) >= 2:
            self.nearest(here.phases[np.argsort(-here.strengths)[:2]], SQUARE, RECTANGLE)

    def instead(self) -> None:
        """Try other wavevectors for either wave of the best pair."""
        here = self.best
        if here.shape.name != PAIR.name or not self.search.quiet(here.rest):
            return
        for wave in range(2):
            alone = fitted(self.rows, free_waves(1), here.phases[1 - wave, :2])
            for place in self.search.strong(alone.rest, 4):
                phases = here.phases.copy()
                phases[wave, :2] = place
                self.nearest(phases, here.shape)

    def length_scales(self, windows: Sequence[Window]) -> None:
        """Fit cells along the axes of several length scales, one per window while BIC falls."""
        here, unused = fitted(self.rows, free_waves(0), np.zeros(0)), list(windows)
        apart = math.pi / self.search.extent  # half a lobe
        while unused:
            fits: list[tuple[ShapeFit, Window]] = []
            for k in self.search.line(here.rest).tolist():
                inside = [window for window in unused if window[1] <= k <= window[2]]
                if len(fits) < 2 and inside and np.all(np.abs(here.q - k) > apart):
                    more = descended(self.rows, axis_cells(len(here.q) + 1), np.append(here.q, k))
                    fits.append((more, min(inside, key=lambda window: abs(window[0] - k))))
            fits = [pair for pair in fits if np.all(np.diff(np.sort(pair[0].q)) > apart)]
            if not fits:
                break
            there, window = min(fits, key=lambda pair: pair[0].residual)
            price = 2 * math.log(len(self.search.lobes)) if len(here.q) else -math.inf
            if self.search.bic(there) + price > self.search.bic(here):
                break
            here = there
            unused.remove(window)
        if not len(here.q):
            here = descended(self.rows, AXIS, np.array([windows[0][0]]))
        speeds = np.hypot(*here.strengths.reshape(-1, 2).T)
        fast = speeds >= 0.05 * speeds.max()  # systematic errors of derivatives are 2 %
        if not fast.all():
            here = descended(self.rows, axis_cells(int(fast.sum())), here.q[fast])
        self.tried.append(here)

    def ranked(self) -> list[tuple[ShapeFit, float]]:
        """The best fit of every shape, and rivals of the best one, with their BIC, in order.

        If the residual is more than noise the number of effective rows is reduced, by the ratio of
        the mean to the highest power of its spectrum. Of fits of a shape in one lobe one is kept.
        """
        worth, rest, near = self.search.worth, self.best.rest, 0.3 * self.rows.reach()
        if not self.search.quiet(rest):
            power = np.cumsum(np.concatenate([[0.0], spectrum(rest)]))
            bins = min(16, len(power) - 1)  # averaged, to 18 % each
            highest = float((power[bins:] - power[:-bins]).max()) / bins
            worth = min(worth, 2 * len(rest) * float(power[-1] / (len(power) - 1)) / highest)
        fits = [(fit, self.search.bic(fit, worth)) for fit in self.tried]
        fits.sort(key=lambda pair: pair[1])
        ranked: list[tuple[ShapeFit, float]] = []
        for fit, bic in fits:
            others = [other for other, _ in ranked if other.shape == fit.shape]
            alike = False
            for other in others:  # all waves near to those of another, up to sign
                signed = np.array([-1.0, 1.0])[:, None, None, None] * other.phases
                close = (np.abs(fit.phases[:, None] - signed) < near).all(axis=3)
                alike |= bool(np.any(close, axis=(0, 2)).all())
            rival = bic - fits[0][1] <= CLOSE or not others
            if rival and not alike and (not ranked or len(fit.phases) >= 2):
                ranked.append((fit, bic))
        return ranked[:10]


def propose(search: Search, start: Start) -> tuple[Proposal, ...]:
    """The flows that explain the rows of a search, by ascending BIC, rivals of the best included.

    start: the lobe, the windows or the waves that a back-end's weights propose. Empty if the
    scan of the rows has no lobe, or no flow is plausible.
    """
    ladder = Ladder(search)
    if start.windows:
        ladder.length_scales(start.windows)
    else:
        if not len(search.lobes):
            return ()
        ladder.lines(start.lobe)
        if start.refine == "ladder":
            ladder.climb(np.array(start.waves).reshape(-1, 2))
        elif start.waves:
            ladder.tried.clear()
            ladder.join(np.array(start.waves))
    if not ladder.tried:
        return ()
    return tuple(search.proposal(fit, bic) for fit, bic in ladder.ranked())
