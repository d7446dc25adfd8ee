"""The ladder of shapes: where scans show waves, and the shapes that are fitted from there.

A Fourier scan of cells along the axes, and where these leave more than noise one of the whole
plane, shows where waves may be; from there shapes are fitted to the rows
(`sparsefit.model.fitting`), and around the best of them freer and simpler ones. With n rows worth
counting and p parameters,

    BIC = n ln RSS + p ln n,

orders them (Schwarz, 1978). All steps are bounded in number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.model.fitting import FlowRows, ShapeFit, descended, fitted, joined
from sparsefit.model.grid import Bounds, extent_of
from sparsefit.model.scan import WaveScan, axis_gains, peaks
from sparsefit.model.shapes import AXIS, PAIR, RECTANGLE, SQUARE, Shape, axis_cells, free_waves


@dataclass(frozen=True)
class ClimbEffort:
    """The number of starts and rounds of one climb."""

    lines: int = 5  # lobes along the axes that are descended into
    ranked: int = 20  # peaks of the plane that are ranked by their fit
    descended: int = 4  # of these that are descended into; 2 where the track is in pieces
    waves: int = 4  # waves of several
    instead: int = 4  # places that are tried for either wave of a pair
    around: int = 4  # rounds of the search around the best shape
    proposals: int = 10  # shapes that are proposed


@dataclass(frozen=True)
class ClimbLimits:
    """The thresholds of one climb, shares of |Phi|^2 unless said."""

    near: float = 0.3  # cells that leave less are looked around before the plane is scanned
    far: float = 0.75  # what leaves more has no shape around it that is the flow
    settled: float = 0.05  # what leaves less leaves gusts, or a vehicle that is another
    exact: float = 1e-6  # less is what smoothing takes, and tells no shape
    part: float = 0.05  # errors that are more could hide a flow
    false_alarm: float = 1e-3  # of a wave in such errors, over all places
    close: float = 10.0  # of BIC, to the best of all: a rival
    strongest: float = 6.0  # rms of Phi: a wave that strong is one of two that cancel
    loud: float = 2.0  # of the mean power: errors that have more where Phi has its own are a flow
    spread: float = 6.0  # standard deviations of that power, beside it
    fastest: float = 0.6  # of sqrt(2 <Phi^2>): drifts beyond it are not looked for


STAND = (AXIS, SQUARE, RECTANGLE)  # cells, the simplest first


@dataclass(frozen=True, eq=False)
class Lookout:
    """Rows of the flow velocity, and what scans say of them.

    Args:
        rows: thinned samples of one flight, or of several.
        bounds: of the wavenumber k = pi/L [1/m].
        worth: how many rows, of both components, count where errors correlate.
        limits: the thresholds of a climb.
    """

    rows: FlowRows
    bounds: Bounds
    worth: float
    limits: ClimbLimits = ClimbLimits()

    @property
    def extent(self) -> float:
        """The larger side of the bounding box of the rows [m]."""
        return extent_of(self.rows.place[:, :2])

    @cached_property
    def lobes(self) -> Array:
        """Wavenumbers k (l,) [1/m] of cells along the axes that leave least, deepest first."""
        return self.line(self.rows.rest)

    def line(self, rest: Array) -> Array:
        """The wavenumbers (l,) of the minima of what one mode of cells more leaves of errors."""
        if not self.bounds[0] < self.bounds[1]:
            return np.array([self.bounds[0]])
        k, gains = axis_gains(self.rows.place[:, :2], rest, self.bounds, self.rows.weight)
        places = peaks(gains)[:, 0]
        before, here, after = (
            gains[np.clip(places + shift, 0, len(k) - 1)] for shift in (-1, 0, 1)
        )
        bow = 2 * here - before - after  # of the parabola through three points, highest at:
        offset = np.where(bow > 0, 0.5 * (after - before) / np.where(bow > 0, bow, 1.0), 0.0)
        lobes: Array = np.clip(k[places] + (k[1] - k[0]) * np.clip(offset, -0.5, 0.5), *self.bounds)
        return lobes

    @cached_property
    def radii(self) -> Bounds:
        """The bounds of |k| of the waves of square cells [rad/m]."""
        return math.sqrt(2) * self.bounds[0], math.sqrt(2) * self.bounds[1]

    @cached_property
    def scan(self) -> WaveScan | None:
        """The scan of standing waves over the plane; None of a track that is too long."""
        return WaveScan.of(self.rows.place, self.radii, weight=self.rows.weight)

    def gains(self, rest: Array) -> Array:
        """The fall of RSS of errors (m, 2) by one standing wave over the plane."""
        return np.zeros((1, 1)) if self.scan is None else self.scan.gains(rest)[0]

    def strong(self, rest: Array, most: int) -> Array:
        """The standing waves (p, 2) [rad/m] that explain most of errors (m, 2), strongest first."""
        return np.zeros((0, 2)) if self.scan is None else self.scan.waves(self.gains(rest), most)

    def possible(self, fit: ShapeFit) -> bool:
        """Whether all waves are within the bounds, none are one, and none nearly cancel."""
        k, rms = fit.phases[:, :2], math.sqrt(float(np.mean(self.rows.rest**2)))
        step, sizes = 0.5 * math.pi / self.extent, np.hypot(*k.T)
        if sizes.min() < self.radii[0] - step or sizes.max() > self.radii[1] + step:
            return False
        first, second = np.triu_indices(len(k), 1)
        apart = [np.hypot(*(k[first] + sign * k[second]).T) for sign in (-1.0, 1.0)]
        return bool(
            np.min(apart, initial=math.inf) > step
            and fit.strengths.max() < self.limits.strongest * rms
        )

    @cached_property
    def power(self) -> Array:
        """The power (f,) of what is to be explained, by frequency."""
        return _power(self.rows.rest)

    def quiet(self, rest: Array) -> bool:
        """Whether errors (m, 2) have no more power where Phi has its own than elsewhere.

        Where they are a good part of Phi, no wave may explain more of them than chance does either.
        """
        whole = float(np.sum(rest**2))
        share = whole / (float(np.sum(self.rows.rest**2)) or 1.0)
        if share <= self.limits.exact or not self.power.any():
            return True
        own, power = self.power / self.power.sum(), _power(rest)
        spread = math.sqrt(0.5 * float(np.sum(own**2)))
        if float(own @ power) > (self.limits.loud + self.limits.spread * spread) * float(
            power.mean()
        ):
            return False
        if share < self.limits.part or self.scan is None:
            return True
        gain = float(self.gains(rest).max())
        most = 2 * math.log(self.scan.count / self.limits.false_alarm) + 8
        return -self.worth * math.log(max(1 - gain / whole, self.limits.exact)) < most


class Ladder:
    """One search: the shapes that were fitted so far, and those that were looked around."""

    def __init__(self, lookout: Lookout, effort: ClimbEffort = ClimbEffort()) -> None:
        self.lookout, self.rows, self.limits = lookout, lookout.rows, lookout.limits
        self.effort = effort
        self.tried: list[ShapeFit] = []
        self.surrounded: list[ShapeFit] = []

    @property
    def best(self) -> ShapeFit:
        """The fit of least BIC."""
        return min(self.tried, key=self.bic)

    @property
    def done(self) -> bool:
        """Whether no more than noise is left, or what is left is settled to be no waves."""
        return bool(self.tried) and (
            self.best.residual <= self.limits.settled * self.rows.square
            or self.lookout.quiet(self.best.rest)
        )

    def bic(self, fit: ShapeFit, worth: float | None = None) -> float:
        """N ln RSS + p ln n of a fit, RSS over |Phi|^2."""
        n = worth or self.lookout.worth
        share = max(fit.residual / self.rows.square, self.limits.exact)
        return n * math.log(share) + fit.shape.size * math.log(n)

    def descend(self, shape: Shape, q: Array) -> ShapeFit | None:
        """A shape moved from q (p,) while it could be the best of its kind; None if it is no flow.

        That is where a wave is beyond the bounds, or two are one or nearly cancel.
        """
        alike = [fit.residual for fit in self.tried if fit.shape == shape]
        goal = min(alike, default=math.inf) * math.exp(self.limits.close / self.lookout.worth)
        fit = descended(self.rows, shape, q, goal=goal)
        if fit.residual > goal or not self.lookout.possible(fit):
            return None
        self.tried.append(fit)
        return fit

    def from_waves(self, shape: Shape, phases: Array) -> ShapeFit | None:
        """A shape of two waves, from the nearest to waves (2, 3)."""
        return self.descend(shape, shape.nearest(phases))

    def lines(self, candidate: float) -> None:
        """Square cells along the axes, from the deepest lobes, and the one nearest a candidate."""
        lobes = self.lookout.lobes
        starts = lobes[: self.effort.lines].tolist()
        if candidate:
            starts.append(float(lobes[np.abs(lobes - candidate).argmin()]))
        for k in dict.fromkeys(starts):
            self.descend(AXIS, np.array([k]))
        if not self.tried:  # nothing in reach: the deepest lobe as it is
            self.tried.append(fitted(self.rows, AXIS, lobes[:1]))

    def climb(self, proposed: Array) -> None:
        """All shapes, from what is there, from proposed waves (p, 2), and from the plane."""
        if self.done or self.best.residual <= self.limits.near * self.rows.square:
            self.around()
        if len(proposed) and not self.done:
            self.join(proposed)
            self.around()
        scan = self.lookout.scan
        looks: tuple[Callable[[], None], ...] = (
            lambda: self.follow(SQUARE, scan, self.squares(scan)),
            self.moving,
            self.pairs,
            self.several,
        )
        for look in looks:
            if self.done:
                break
            look()
            self.around()
        self.instead()

    def around(self) -> None:
        """Every shape of two waves from the best one, where one could have a lower BIC."""
        price = self.lookout.worth ** (1 / self.lookout.worth)  # of RSS, for a parameter more
        for _ in range(self.effort.around):
            here = self.best
            far = here.residual > self.limits.far * self.rows.square and not self.lookout.quiet(
                here.rest
            )
            if len(here.phases) != 2 or far or any(here is fit for fit in self.surrounded):
                return
            self.surrounded.append(here)
            drifting = here.shape.drifting
            simpler = [shape for shape in STAND if shape.size < here.shape.steady.size]
            for shape in reversed(simpler):
                self.from_waves(shape.moving if drifting else shape, here.phases)
            if drifting:
                self.from_waves(here.shape.steady, here.phases)
            best = self.best
            free = self.from_waves(PAIR.moving, best.phases)
            least = self.limits.exact * self.rows.square
            if free is not None and max(best.residual, least) > max(free.residual, least) * price:
                for shape in reversed(STAND):
                    self.from_waves(shape.moving, free.phases)
                    self.from_waves(shape, free.phases)
                self.from_waves(PAIR, free.phases)
            if self.bic(here) - self.bic(self.best) < 0.1:
                return

    def squares(self, scan: WaveScan | None) -> list[Array]:
        """Two waves (2, 3) at right angles, k and its clockwise turn (k_y, -k_x), from a scan."""
        if scan is None:
            return []
        gains, omega = scan.gains(self.rows.rest)
        waves = []
        for i, j in scan.squares(gains, self.effort.ranked):
            x, y = scan.axis[[i, j]]
            waves.append(np.array([[x, y, omega[i, j]], [y, -x, omega[j, len(omega) - 1 - i]]]))
        return waves

    def follow(self, shape: Shape, scan: WaveScan | None, waves: list[Array]) -> None:
        """A shape from waves (2, 3) of most promise, from pieces of the track to the whole."""
        pieces = 1 if scan is None else scan.pieces
        fits = [fitted(self.rows, shape, shape.nearest(pair), pieces) for pair in waves]
        most = self.effort.descended if pieces == 1 else 2
        for fit in sorted(fits, key=lambda fit: fit.residual)[:most]:
            self.descend(shape, joined(self.rows, shape, fit.q, pieces))
            if self.done:
                break

    def moving(self) -> None:
        """Square cells that move, followed from pieces of the track to the whole."""
        speed = math.sqrt(2 * float(np.mean(np.sum(self.rows.rest**2, axis=1))))
        fastest = self.limits.fastest * speed
        scan = WaveScan.of(self.rows.place, self.lookout.radii, fastest, self.rows.weight)
        self.follow(SQUARE.moving, scan, self.squares(scan))

    def pairs(self) -> None:
        """Any two waves that stand: the strongest, and the strongest beside it."""
        scan, wave = self.lookout.scan, free_waves(1)
        for first in self.lookout.strong(self.rows.rest, 1):
            pieces = scan.pieces if scan else 1
            alone = descended(self.rows, wave, joined(self.rows, wave, first, pieces))
            for second in self.lookout.strong(alone.rest, 2):
                self.descend(PAIR, np.concatenate([alone.q, second]))

    def several(self) -> None:
        """More waves, one by one, from what the best leaves, moving or standing."""
        standing = [fit for fit in self.tried if not fit.shape.drifting]
        starts = [self.best, min(standing, key=self.bic)]
        for here in starts[: 1 + self.best.shape.drifting]:
            while len(here.phases) < self.effort.waves:
                more = self.lookout.strong(here.rest, 1)
                there = self.with_waves(here, np.vstack([here.phases[:, :2], more]))
                if there is None or not len(more):
                    break
                here = there

    def with_waves(self, here: ShapeFit, waves: Array) -> ShapeFit | None:
        """Waves k (j, 2) moved together; None where BIC does not fall, or two nearly cancel."""
        motion = here.q[-2:] if here.shape.drifting else np.zeros(0)
        shape = free_waves(len(waves), drifting=here.shape.drifting)
        fit = descended(self.rows, shape, np.concatenate([waves.ravel(), motion]))
        if self.bic(fit) >= self.bic(here) or not self.lookout.possible(fit):
            return None
        self.tried.append(fit)
        return fit

    def join(self, proposed: Array) -> None:
        """Waves that a back-end proposes (p, 2), joined one by one where BIC falls."""
        here = fitted(self.rows, free_waves(0), np.zeros(0)) if len(proposed) else None
        for wave in proposed:
            assert here is not None
            there = self.with_waves(here, np.vstack([here.phases[:, :2], wave]))
            while there is not None:  # the weakest leave where what is left does without
                here = there
                weakest = int(np.argmin(here.strengths))
                fewer = np.delete(here.phases[:, :2], weakest, axis=0)
                there = self.with_waves(here, fewer) if len(fewer) else None
        if here is not None and len(here.phases) >= 2:
            order = np.argsort(-here.strengths)[:2]
            for shape in (SQUARE, RECTANGLE):
                self.from_waves(shape, here.phases[order])

    def instead(self) -> None:
        """Other places for either wave of the best pair, which may fit a track as well."""
        here = self.best
        if here.shape.name != PAIR.name or not self.lookout.quiet(here.rest):
            return
        for wave in range(2):
            alone = fitted(self.rows, free_waves(1), here.phases[1 - wave, :2])
            for place in self.lookout.strong(alone.rest, self.effort.instead):
                phases = here.phases.copy()
                phases[wave, :2] = place
                self.from_waves(here.shape, phases)

    def length_scales(self, windows: tuple[tuple[float, float, float], ...]) -> None:
        """Cells along the axes of several length scales, one from each window where BIC falls."""
        here, unused = fitted(self.rows, free_waves(0), np.zeros(0)), list(windows)
        lobe = 2 * math.pi / self.lookout.extent
        while unused and len(here.q) < len(windows):
            offers = []
            for k in self.lookout.line(here.rest).tolist():
                inside = [w for w in unused if w[1] <= k <= w[2]]
                if inside and np.all(np.abs(here.q - k) > 0.5 * lobe):
                    offers.append((k, min(inside, key=lambda w: abs(w[0] - k))))
            fits = [
                (descended(self.rows, axis_cells(len(here.q) + 1), np.append(here.q, k)), window)
                for k, window in offers[:2]
            ]
            fits = [pair for pair in fits if np.all(np.diff(np.sort(pair[0].q)) > 0.5 * lobe)]
            if not fits:
                break
            there, window = min(fits, key=lambda pair: pair[0].residual)
            if len(here.q) and self.bic(there) + 2 * math.log(len(self.lookout.lobes)) > self.bic(
                here
            ):
                break
            here = there
            unused.remove(window)
        if not len(here.q):
            here = descended(self.rows, AXIS, np.array([windows[0][0]]))
        speeds = np.hypot(*here.strengths.reshape(-1, 2).T)
        fast = speeds >= 0.05 * speeds.max()  # systematic errors of a derivative are 2 %
        if not fast.all():
            here = descended(self.rows, axis_cells(int(fast.sum())), here.q[fast])
        self.tried.append(here)

    def ranked(self) -> list[tuple[ShapeFit, float]]:
        """The best fit of every shape, and rivals close to the best of all, with BIC, in order.

        Where more than noise is left rows count for less: as many as white errors of the highest
        power in the residual's spectrum would be.
        """
        if not self.tried:
            return []
        worth, rest = self.lookout.worth, self.best.rest
        if not self.lookout.quiet(rest):
            power = np.cumsum(np.concatenate([[0.0], _power(rest)]))
            bins = min(16, len(power) - 1)  # averaged: the level is then known to 18 %
            highest = float((power[bins:] - power[:-bins]).max()) / bins
            worth = min(worth, 2 * len(rest) * float(power[-1] / (len(power) - 1)) / highest)
        pairs = sorted(
            ((fit, self.bic(fit, worth)) for fit in self.tried), key=lambda pair: pair[1]
        )
        distinct: list[tuple[ShapeFit, float]] = []
        for fit, bic in pairs:
            kinds = {other.shape for other, _ in distinct}
            rival = bic - pairs[0][1] <= self.limits.close
            if (not rival and fit.shape in kinds) or (distinct and len(fit.phases) < 2):
                continue
            if not any(self.alike(fit, other) for other, _ in distinct):
                distinct.append((fit, bic))
        return distinct[: self.effort.proposals]

    def alike(self, fit: ShapeFit, other: ShapeFit) -> bool:
        """Whether two fits are of one shape and in one lobe."""
        if fit.shape != other.shape:
            return False
        near = 0.3 * self.rows.reach()
        return all(
            any(
                np.all(np.abs(wave - sign * there) < near)
                for there in other.phases
                for sign in (-1, 1)
            )
            for wave in fit.phases
        )


def _power(values: Array) -> Array:
    """The power (f,) of both components of values (m, 2), by frequency."""
    spectra = np.fft.rfft(values, axis=0)
    power: Array = np.sum(spectra.real**2 + spectra.imag**2, axis=1)
    return power
