"""The rows of the search, scans of them, the test of a residual for noise, and proposed flows.

Rows are thinned samples of the flow velocity Phi. Fourier scans of cells along the axes and of the
whole plane show candidate waves. The residual of a fit counts as noise if it has no more power at
the frequencies of Phi than elsewhere, and no wave explains more of it than by chance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.model.grid import Bounds, extent_of, middle
from sparsefit.model.library import Library, Pair, UnknownColumns, side_by_side
from sparsefit.model.scan import WaveScan, axis_gains, line_steps, peaks
from sparsefit.model.shapes import (
    AXIS,
    STAND,
    FlowRows,
    ShapeFit,
    WaveCells,
    fitted,
    free_waves,
    read_cells,
)
from sparsefit.rows import Samples

EXACT = 1e-6  # share of |Phi|^2, the error of smoothing: smaller residuals are equivalent
CLOSE = 10.0  # difference of BIC to the best: a rival


@dataclass(frozen=True, eq=False)
class Proposal:
    """A flow fitted to the rows: psi = sum a cos(phi) + b sin(phi), phi = k.(x - c t)."""

    shape: str  # axis, square, rectangle, pair or several
    wavevectors: Array  # k (j, 2) [rad/m]
    cosine: Array  # a (j,) [m^2/s], in the flight's own coordinates and time
    sine: Array  # b (j,) [m^2/s]
    velocity: Pair | None  # c [m/s]; None: steady
    residual: float  # RSS of the rows over |Phi|^2
    bic: float  # n ln RSS + p ln n
    vehicles: tuple[PointMassVehicle, ...]  # of each flight, its unknowns as fitted
    background: Pair = (0.0, 0.0)  # velocity of the air beside the flow [m/s]

    def lobe(self, extent: float) -> tuple[str, bytes]:
        """A key that is equal for proposals whose phases agree to about 1e-6 over an extent [m]."""
        phases = np.append(self.wavevectors * extent, self.velocity or ())
        return self.shape, (np.round(phases, 6) + 0.0).tobytes()

    @property
    def cells(self) -> WaveCells:
        """The cells of these waves: mean velocity U0 [m/s], length scale L [m] and shape."""
        return read_cells(self.wavevectors, np.column_stack([self.cosine, self.sine]))


@dataclass(frozen=True, eq=False)
class Search:
    """The search for a library's flow in one flight, or in several through one flow."""

    rows: FlowRows  # thinned samples, counted from the origin
    bounds: Bounds  # of the wavenumber k = pi/L [1/m]
    worth: float  # the number of effective rows of both components, as errors correlate
    origin: Array  # (x, y, t) of the origin of the rows
    unknowns: tuple[UnknownColumns, ...]  # of each flight
    counts: tuple[int, ...]  # the rows of each flight

    @classmethod
    def of(
        cls,
        flights: Sequence[Samples],
        vehicles: Sequence[PointMassVehicle],
        library: Library,
        weights: Sequence[float] = (),
    ) -> Search:
        """The search for a library's flow in flights; weights: of the rows of each.

        Raises InputError if the flights do not move, or are too long for the least length scale.
        """
        position = np.concatenate([samples.position for samples in flights])
        extent, least = extent_of(position), library.grid.lower
        if line_steps(extent, library.bounds) > 150_000:  # bounds the time
            words = f"a length scale of {least:.3g} m is too small for a flight of {extent:.3g} m"
            raise InputError(f"{words}: too many lobes; check units, or raise the lower bound")
        time = np.concatenate([samples.time for samples in flights])
        origin = np.array([*middle(position), 0.5 * (time.min() + time.max())])
        thin, worth = [], 0.0
        for samples in flights:
            # The correlation length of errors of smoothed derivatives and of positions, in rows:
            smoothing = samples.smoothing
            correlation = max(5.0, smoothing.rate_window / (smoothing.order + 1))
            worth += 2 * len(samples.time) / correlation
            way = np.hypot(*np.diff(samples.position, axis=0).T)
            far = max(1, int(0.25 * least / max(float(np.median(way)), 1e-300)))
            # 1,500 rows where they are a quarter of the least length scale apart, 6,000 of any.
            most = 1_500 // len(flights) + 1
            stride = max(int(0.5 * correlation), min(far, len(way) // most))
            thin.append(samples.rows(slice(None, None, max(1, stride, len(way) // 6_000))))
        counts = tuple(len(samples.time) for samples in thin)
        own = np.repeat(np.array(weights or [1.0] * len(flights), dtype=float), counts)
        place = np.vstack([np.column_stack([rows.position, rows.time]) for rows in thin]) - origin
        if not extent > 0 or (len(place) > 1 and not extent_of(place[:, :2]) > 0):
            raise InputError("the flight does not move: no length scale can be told; fly farther")
        phi = np.vstack([own.flow_velocity(by) for own, by in zip(thin, vehicles, strict=True)])
        unknowns = tuple(UnknownColumns(library.unknown, vehicle) for vehicle in vehicles)
        beside = own[:, None, None] * side_by_side(unknowns, thin)
        rows = FlowRows(place, own[:, None] * phi, beside, own)
        return cls(rows, library.bounds, min(worth, 2.0 * len(own)), origin, unknowns, counts)

    @cached_property
    def extent(self) -> float:
        """The larger side of the bounding box of the rows [m]."""
        return extent_of(self.rows.place[:, :2])

    @cached_property
    def lobes(self) -> Array:
        """Wavenumbers k (l,) [1/m] of cells along the axes at minima of RSS, deepest first."""
        return self.line(self.rows.rest)

    def line(self, rest: Array) -> Array:
        """The wavenumbers (l,) [1/m] of cells along the axes at minima of RSS of errors (m, 2)."""
        if not self.bounds[0] < self.bounds[1]:
            return np.array([self.bounds[0]])
        k, gains = axis_gains(self.rows, rest, self.bounds)
        places = peaks(gains)[:, 0]
        before, here, after = gains[np.clip(places + np.array([[-1], [0], [1]]), 0, len(k) - 1)]
        bow = 2 * here - before - after  # of the parabola through three points, highest at:
        offset = np.where(bow > 0, 0.5 * (after - before) / np.where(bow > 0, bow, 1.0), 0.0)
        lobes: Array = np.clip(k[places] + (k[1] - k[0]) * np.clip(offset, -0.5, 0.5), *self.bounds)
        return lobes

    @property
    def radii(self) -> Bounds:
        """The bounds of |k| of the waves of square cells [rad/m]."""
        return math.sqrt(2) * self.bounds[0], math.sqrt(2) * self.bounds[1]

    @cached_property
    def scan(self) -> WaveScan | None:
        """The scan of steady waves over the plane; None if the track is too long."""
        return WaveScan.of(self.rows, self.radii)

    def strong(self, rest: Array, most: int) -> Array:
        """The steady waves (p, 2) [rad/m] that explain most of errors (m, 2), strongest first."""
        if self.scan is None:
            return np.zeros((0, 2))
        return self.scan.waves(self.scan.gains(rest)[0], most)

    def possible(self, fit: ShapeFit) -> bool:
        """Whether all waves are within the bounds, distinct, and none nearly cancel."""
        k, step = fit.phases[:, :2], 0.5 * math.pi / self.extent
        sizes = np.hypot(*k.T)
        if sizes.min() < self.radii[0] - step or sizes.max() > self.radii[1] + step:
            return False
        first, second = np.triu_indices(len(k), 1)
        apart = [np.hypot(*(k[first] + sign * k[second]).T) for sign in (-1.0, 1.0)]
        strongest = 6.0 * math.sqrt(float(np.mean(self.rows.rest**2)))
        return bool(np.min(apart, initial=math.inf) > step and fit.strengths.max() < strongest)

    @cached_property
    def power(self) -> Array:
        """The power spectrum (f,) of Phi, unknowns projected out."""
        return spectrum(self.rows.rest)

    def quiet(self, rest: Array) -> bool:
        """Whether errors (m, 2) have no more power at the frequencies of Phi than elsewhere.

        The threshold is twice their mean power plus 6 standard deviations. If the errors are more
        than 5 % of Phi, also no wave may explain more of them than by chance, at a level of 1e-3.
        """
        whole = float(np.sum(rest**2))
        share = whole / (float(np.sum(self.rows.rest**2)) or 1.0)
        if share <= EXACT or not self.power.any():
            return True
        own, power = self.power / self.power.sum(), spectrum(rest)
        spread = math.sqrt(0.5 * float(np.sum(own**2)))
        if float(own @ power) > (2.0 + 6.0 * spread) * float(power.mean()):
            return False
        if share < 0.05 or self.scan is None:
            return True
        gain = float(self.scan.gains(rest)[0].max())
        waves = max(1.0, 0.5 * float(self.scan.inside.sum()))  # resolved by the scan
        most = 2 * math.log(waves / 1e-3) + 8
        return -self.worth * math.log(max(1 - gain / whole, EXACT)) < most

    def vehicles(self, coefficients: Array) -> tuple[tuple[PointMassVehicle, ...], Pair, float]:
        """The vehicle of each flight from coefficients (f p,), the air, and the mean tau_0/tau.

        A vehicle that is not physical is the assumed one; the air's velocity is that of one flight.
        """
        shares = np.array_split(coefficients, len(self.unknowns))
        reads = [own.read(share) for own, share in zip(self.unknowns, shares, strict=True)]
        possible = [own for own in reads if own[2] > 0] or [(reads[0][0], (0.0, 0.0), 1.0)]
        ratio = float(np.mean([own[2] for own in possible]))
        return tuple(own[0] for own in reads), possible[0][1], ratio

    def bic(self, fit: ShapeFit, worth: float | None = None) -> float:
        """The BIC n ln RSS + p ln n of a fit with p parameters, RSS over |Phi|^2.

        worth: the effective number n of rows, by default that of the search.
        """
        n = worth or self.worth
        share = max(fit.residual / self.rows.square, EXACT)
        return n * math.log(share) + fit.shape.size * math.log(n)

    def proposal(self, fit: ShapeFit, bic: float) -> Proposal:
        """The flow of a fit in the flight's coordinates and time."""
        vehicles, uniform, ratio = self.vehicles(fit.coefficients)
        shift = fit.phases * (1.0, 1.0, -1.0) @ self.origin
        a = (fit.weights[::2] - 1j * fit.weights[1::2]) * np.exp(-1j * shift) / ratio
        velocity = (float(fit.q[-2]), float(fit.q[-1])) if fit.shape.drifting else None
        waves = fit.phases[:, :2], a.real, -a.imag, velocity
        residual = fit.residual / self.rows.square
        return Proposal(fit.shape.name, *waves, residual, bic, vehicles, uniform)

    def proposed_at(self, other: Proposal, phases: Array) -> Proposal | None:
        """The proposal of waves (k_x, k_y, omega) (j, 3) in the shape of another proposal.

        None if the rows exclude it: if its residual is larger by `CLOSE` of BIC, or it is no flow.
        """
        shape = {own.name: own for own in STAND}.get(other.shape, free_waves(len(phases)))
        shape = shape.moving if other.velocity else shape
        fit = fitted(self.rows, shape, shape.nearest(phases))
        most = other.residual * self.rows.square * math.exp(CLOSE / self.worth)
        near = fit.residual <= most and self.possible(fit)
        return self.proposal(fit, self.bic(fit)) if near else None


def spectrum(values: Array) -> Array:
    """The power (f,) of both components of values (m, 2), by frequency."""
    spectra = np.fft.rfft(values, axis=0)
    power: Array = np.sum(spectra.real**2 + spectra.imag**2, axis=1)
    return power


def flight_weights(
    flights: Sequence[Samples], vehicles: Sequence[PointMassVehicle], library: Library
) -> tuple[float, ...]:
    """The weight of each flight's rows: the inverse rms residual of the best cells along the axes.

    Of mean square 1 over all rows; one flight has weight 1.
    """
    counts, weights = [len(samples.time) for samples in flights], np.ones(len(flights))
    for _ in range(2 if len(flights) > 1 else 0):
        search = Search.of(flights, vehicles, library, weights.tolist())
        rows = search.rows
        best = fitted(rows, AXIS, search.lobes[:1])
        rest = np.sum((best.rest / rows.weight[:, None]) ** 2, axis=1)
        flight = np.repeat(np.arange(len(flights)), search.counts)
        levels = np.sqrt(np.bincount(flight, rest) / np.bincount(flight))
        levels = np.maximum(levels, 1e-3 * levels.max())
        if not levels.min() > 0:
            break
        weights = 1 / (levels * np.sqrt(np.average(levels**-2, weights=counts)))
    return tuple(weights.tolist())
