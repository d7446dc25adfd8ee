"""What is searched for modes: the rows of one flight, bounds of the parameter, and a scan.

At wavenumber k the residual RSS(k) of one mode more has lobes of width ~ 2 pi / extent: one flow,
many minima. So the whole interval is scanned at a step that resolves them before any is descended
into, by Gauss-Newton with all modes moving together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sparsefit.arrays import Array, local_maxima
from sparsefit.cached import cached_property
from sparsefit.derivative import Samples
from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.cells import Cells
from sparsefit.library.family import Family
from sparsefit.library.nuisance import Nuisance, regressed
from sparsefit.library.scan import Bounds, CellScan, extent_of, scan_steps
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import ROUNDING, Projection, left_beside, project, secant
from sparsefit.modes.stack import (
    CORRELATION,
    Pair,
    Part,
    correlation_of,
    rows_of,
    samples_of,
    series_of,
)

MAX_STEPS = 500_000  # of a scan, 0.5 GB
ITERATIONS, HALVINGS = 60, 12  # of a descent, and of one of its moves
FOLLOWED = 2  # moves of a lobe that was known: what it has not reached is left to the next answer
END = 1e-15  # of a parameter: moves below it are rounding
FLOOR = 1e-15  # of |Phi|^2: residuals below it are rounding
# Of |Phi|^2: on 400 flights descents ended at most a sixth of this below the scan's point of their
# lobe, but for the deepest one where it is of long waves, which the scan's ridge damps.
BELOW = 0.03
ROUGH = 1e-2  # in scan steps, 1e-7 of a lobe's depth: where a rival's descent may stop
FALSE_ALARM = 1e-3  # of a detection, over all lobes of a flight
SIGNIFICANCE = 0.01  # of a lobe being mistaken for another
WIND = 2  # coefficients of a uniform wind, which a flow has to do better than
BINS = 16  # of the residuals' spectrum, averaged: its level is then known to 18 %


@dataclass(frozen=True, eq=False)
class SearchSpace:
    """The rows of a flight, and where its modes may be.

    Args:
        family: of the columns.
        rows: that are fitted.
        sampled: samples of Phi at which the scan looks, the same rows where these are no averages.
        bounds: of the wavenumber [1/m].
        correlation: rows over which the errors of Phi correlate, at least.
        pairs: which series each coefficient of the nuisance columns multiplies, in x and in y.
        series: that these are made of, at the scanned samples (j, m).
        known: wavenumbers (l,) [1/m] of the lobes of one mode, deepest first, where an earlier scan
            has found them; None: they are scanned for.
    """

    family: Family
    rows: Rows
    sampled: Rows
    bounds: Bounds
    correlation: float = CORRELATION
    pairs: tuple[Pair, ...] = ()
    series: Array = field(default_factory=lambda: np.zeros((0, 0)))
    known: Array | None = None

    def __post_init__(self) -> None:
        if not self.extent > 0:
            raise InputError("the flight does not move: no length scale can be told; fly farther")
        if scan_steps(self.sampled.position, self.bounds) > MAX_STEPS:
            raise InputError(
                f"a length scale of {math.pi / self.bounds[1]:.3g} m is too small for a flight of "
                f"{self.extent:.3g} m: too many lobes; raise the grid's lower bound"
            )

    @classmethod
    def of(
        cls,
        samples: Samples,
        vehicle: PointMassVehicle,
        bounds: Bounds,
        unknown: tuple[str, ...] = (),
    ) -> SearchSpace:
        """The space of a flight's samples between bounds of k [1/m].

        Raises InputError where the flight does not move, or has too many lobes to look into.
        """
        return cls.of_flights([Part(samples, Nuisance(unknown, vehicle))], bounds)

    @classmethod
    def of_flights(cls, parts: Sequence[Part], bounds: Bounds) -> SearchSpace:
        """The same of several flights through one flow."""
        sampled = rows = samples_of(parts)
        if parts[0].samples.weak is not None:
            rows = rows_of(parts)
        pairs, series = series_of(parts, sampled)
        return cls(Cells(), rows, sampled, bounds, correlation_of(parts, rows), pairs, series)

    @classmethod
    def plain(cls, position: Array, flow_velocity: Array, bounds: Bounds) -> SearchSpace:
        """The space of samples of Phi (m, 2) [m/s] at positions (m, 2) [m], nothing unknown."""
        rows = Rows.plain(position, flow_velocity)
        return cls(Cells(), rows, rows, bounds)

    @cached_property
    def scan(self) -> CellScan:
        """The columns of one mode at every wavenumber."""
        return CellScan.of(self.sampled.position, self.bounds, self.sampled.scale)

    @cached_property
    def empty(self) -> Projection:
        """The fit of no mode: what the nuisance columns leave of Phi."""
        return project(self.family, self.rows, np.zeros((0, self.family.parameters)))

    @cached_property
    def null_residual(self) -> float:
        """RSS [m^2/s^2] of a uniform wind, and the nuisance columns."""
        wind = np.zeros((2, len(self.rows.target), WIND))
        wind[0, :, 0] = wind[1, :, 1] = 1.0 if self.rows.scale is None else self.rows.scale
        both = np.concatenate([self.rows.nuisance, wind], axis=2)
        return float(np.sum(left_beside(both, self.rows.target)[0] ** 2))

    @cached_property
    def extent(self) -> float:
        """The larger side of the flight's bounding box [m]."""
        return extent_of(self.sampled.position)

    @property
    def lobe(self) -> float:
        """The width of a lobe of the residual [1/m]."""
        return 2 * math.pi / self.extent

    @cached_property
    def lobe_count(self) -> int:
        """The number of separate minima of one mode's residual between the bounds."""
        return len(self.minima)

    @cached_property
    def minima(self) -> Array:
        """Wavenumbers (l,) [1/m] of the lobes of one mode's residual, the deepest first."""
        return self.lobes_of(self._curve) if self.known is None else self.known

    @cached_property
    def _curve(self) -> Array:
        """RSS (q,) of one mode at the scanned wavenumbers."""
        return self.residuals(self.empty)

    def least(self, wavenumber: float) -> float:
        """What a descent of one mode from a scanned lobe [1/m] leaves, at least; 0: not known."""
        if self.known is not None or self.sampled is not self.rows:
            return 0.0
        place = round((wavenumber - self.scan.wavenumbers[0]) / self.scan.step)
        return float(self._curve[place]) - BELOW * float(np.sum(self.rows.target**2))

    def lobes(self, fit: Projection) -> Array:
        """Wavenumbers (l,) [1/m] where one mode more explains most of what a fit leaves."""
        return self.lobes_of(self.residuals(fit))

    def lobes_of(self, curve: Array) -> Array:
        """The same of RSS (q,) at the scanned wavenumbers."""
        scan = self.scan
        places = local_maxima(-curve)
        inner = places[(places > 0) & (places < len(curve) - 1)]
        before, here, after = (curve[inner + shift] for shift in (-1, 0, 1))
        bow = before - 2 * here + after  # of the parabola through three points, lowest at:
        offset = np.zeros(len(curve))
        offset[inner] = 0.5 * (before - after) / np.where(bow > 0, bow, np.inf)
        k: Array = scan.wavenumbers[places] + scan.step * offset[places]
        return np.clip(k, *self.bounds)

    def residuals(self, fit: Projection) -> Array:
        """RSS (q,) at the scanned wavenumbers of one mode more, the others as they are."""
        rest = fit.rest
        if self.sampled is not self.rows:
            loose = np.einsum("tmj,j->mt", self.sampled.nuisance, fit.coefficients)
            rest = self.sampled.target - self.flow(fit) - loose
        if not self.pairs:
            freed = self.scan.freed(np.ascontiguousarray(rest.T))
            return np.asarray(np.trace(freed, axis1=1, axis2=2))
        return regressed(self.scan.freed(np.vstack([rest.T, self.series])), list(self.pairs))

    def flow(self, fit: Projection, mode: int | None = None) -> Array:
        """What all modes of a fit, or one, say of the scanned samples (m, 2) [m/s]."""
        chosen = slice(None) if mode is None else slice(mode, mode + 1)
        values = self.family.values(self.sampled.position, fit.parameters[chosen])
        if self.sampled.scale is not None:
            values = self.sampled.averaged(values.reshape(-1, values.shape[-1])).reshape(
                values.shape
            )
        flow = np.einsum("scr,scn->rn", values, fit.weights[chosen])
        return self.sampled.unstacked(flow)

    def without(self, fit: Projection, mode: int) -> Projection:
        """The fit less one mode, everything else as it is: what a scan for its rival looks at."""
        kept = np.arange(len(fit.parameters)) != mode
        values = self.family.values(self.rows.position, fit.parameters[[mode]])[0]
        own = self.rows.averaged(values).T @ fit.weights[mode]
        return replace(
            fit,
            parameters=fit.parameters[kept],
            weights=fit.weights[kept],
            moves=fit.moves[kept],
            rest=fit.rest + self.rows.unstacked(own),
        )

    def at(self, wavenumbers: Array) -> Projection:
        """The fit at wavenumbers (s,) [1/m]."""
        return project(self.family, self.rows, np.asarray(wavenumbers, dtype=float).reshape(-1, 1))

    def descend(
        self, wavenumbers: Array, *, rough: bool = False, start: Projection | None = None
    ) -> Projection:
        """All modes moved from (s,) [1/m] to the least RSS in reach, within the bounds.

        A wavenumber moves at most a scan step at a time: within its lobe. ``rough`` ends where no
        move is longer than a hundredth of a scan step, or, of a lobe that was known before, after a
        few. start: the fit at the wavenumbers, where it is there already: to go on from.
        """
        reach, tolerance = self.scan.step, ROUGH * self.scan.step if rough else 0.0
        here = start or self.at(np.clip(wavenumbers, *self.bounds))
        size, damping = math.sqrt(float(np.sum(self.rows.target**2))), 1.0
        followed = rough and self.known is not None and start is None
        for _ in range(FOLLOWED if followed else ITERATIONS):
            longest = float(np.abs(here.moves).max(initial=0.0))
            moves = here.moves * min(damping, reach / longest) if longest > 0 else here.moves
            slack = ROUNDING * size * math.sqrt(here.residual)
            there = None
            for halving in range(HALVINGS):
                k = np.clip(here.parameters + moves * 0.25**halving, *self.bounds)
                if np.all(np.abs(k - here.parameters) <= np.maximum(END * k, tolerance)):
                    break
                tried = self.at(k)
                if tried.residual < here.residual:
                    there = tried
                    break
                if tried.residual <= here.residual + slack:
                    # Rounding hides the fall of RSS: moves that shrink still lead to its least.
                    shrinks = float(np.abs(tried.moves).max()) < 0.25 * longest
                    there = tried if shrinks and not halving else None
                    break
            if there is None:
                return here
            damping = min(1.0, secant(here, there))
            here = there
        return here

    def evidence(self, other: float, residual: float, correlation: float | None = None) -> float:
        """2 ln(likelihood ratio) of RSS = residual to RSS = other."""
        floor = FLOOR * float(np.sum(self.rows.target**2)) or 1.0
        ratio = max(other, floor) / max(residual, floor)
        return 2 * len(self.rows.target) * math.log(ratio) / (correlation or self.correlation)

    def by_chance(self, parameters: int) -> float:
        """What evidence for so many parameters reaches by chance in one flight of 1000.

        Without a flow 2 ln(likelihood ratio) is chi-squared in each lobe.
        """
        from scipy.special import chdtri

        return float(chdtri(parameters, FALSE_ALARM / self.lobe_count))

    @property
    def parameters(self) -> int:
        """The number of parameters of a mode: of its place, and its weights."""
        return self.family.parameters + self.family.size * self.family.targets


def concentration(errors: Array) -> float:
    """The highest power of the spectrum of errors (m, 2) over its mean: 1 for white noise.

    A column takes from the residual what noise has at its own frequencies: m samples of such
    errors are worth m / concentration white ones to whoever fits where the power is highest.
    """
    power = np.sum(np.abs(np.fft.rfft(errors, axis=0)) ** 2, axis=1)
    total, bins = np.cumsum(np.concatenate([[0.0], power])), min(BINS, len(power))
    highest = float((total[bins:] - total[:-bins]).max()) / bins
    return highest / float(power.mean()) if highest > 0 else 1.0
