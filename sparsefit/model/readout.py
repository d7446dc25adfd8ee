"""Parameters read from weights: the length scale (Eq. 21), the mean velocity (Eqs. 22-24).

On the grid these are the answer; off the grid they say where the search starts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, number_setting, one_of
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow
from sparsefit.model.columns import (
    CandidateFlow,
    candidate_columns,
    rms_mean_velocity,
    strengths,
    wave_peaks,
    wave_theta,
)
from sparsefit.model.grid import Bounds, extent_of, middle
from sparsefit.model.library import Library
from sparsefit.model.search import Search, Start
from sparsefit.model.shapes import read_cells
from sparsefit.model.unknowns import JointUnknowns, Read
from sparsefit.regression.fit import Fit
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Samples

LengthScaleReadout = Literal["signed-sum", "absolute-sum", "group-norm"]
MeanVelocityReadout = Literal["paper", "rms"]
Eq24 = Literal["mean-ratio", "pseudo-inverse"]
Refine = Literal["none", "variable-projection", "ladder"]
Scales = Literal["one", "several"]

UNNAMED: Refine = "variable-projection"  # what a file that names no refinement has always meant
MOST_SCALES, MOST_WAVES = 6, 12  # that are read: of several length scales, and of waves
Window = tuple[float, float, float]  # the wavenumber of a candidate, from where, and to where


@dataclass(frozen=True)
class Readout:
    """The way from weights to parameters.

    length_scale: the scale with the largest sum of weights (``signed-sum``, Eq. 21 to the
    letter), of their absolute values (``absolute-sum``) or the largest Euclidean norm of its
    block (``group-norm``).
    mean_velocity, after a refit on the 8 columns of that scale: ``paper`` (Eqs. 22-24, whose last
    step is read as the mean of element-wise ratios, ``mean-ratio``, which has poles, or as the
    least-squares coefficient, ``pseudo-inverse``) or ``rms`` over the cell in closed form.
    refine: ``variable-projection`` moves the chosen scale off the grid, to the steady square cells
    along the axes that fit best between the grid's bounds; ``ladder``, the default, goes on from
    there to the shapes of an incompressible flow, cells at any heading, of any sides, steady or
    drifting, and lets the flight choose (`sparsefit.model.search`). ``none`` reports the candidate
    itself. Files that name no refinement mean ``variable-projection``.
    scales: ``one`` reads one length scale; ``several`` reads all that the back-end proposes and the
    flight bears out, each with its ``rms``. Its peaks are those of the Euclidean norm always.
    precision: the largest half-width of the 95 % intervals of U0, L and tau_w, as a share of the
    value, that is still called ``ok``; at 0.03 a value is off by 5 % once in a thousand flights.
    """

    length_scale: LengthScaleReadout = "group-norm"
    mean_velocity: MeanVelocityReadout = "rms"
    eq24: Eq24 = "pseudo-inverse"
    refine: Refine = "ladder"
    scales: Scales = "one"
    precision: float = 0.03

    def __post_init__(self) -> None:
        for key, valid in (
            ("length_scale", get_args(LengthScaleReadout)),
            ("mean_velocity", get_args(MeanVelocityReadout)),
            ("eq24", get_args(Eq24)),
            ("refine", get_args(Refine)),
            ("scales", get_args(Scales)),
        ):
            one_of(f"readout {key}", getattr(self, key), valid)
        number_setting("readout", "precision", self.precision, low=0.0)
        if self.scales == "several" and self.mean_velocity == "paper":
            raise InputError(
                "readout: mean_velocity 'paper' (Eq. 22) scales one field to its range and cannot "
                "part several; use 'rms', or scales 'one'"
            )

    def scale_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weight of each group (g,), by the length-scale readout, from weights (k, n)."""
        groups = int(problem.groups.max()) + 1
        rows = {
            "signed-sum": weights.sum(axis=1),
            "absolute-sum": np.abs(weights).sum(axis=1),
            "group-norm": np.square(weights).sum(axis=1),
        }[self.length_scale]
        sums = np.bincount(problem.groups, weights=rows, minlength=groups).astype(float)
        return np.sqrt(sums) if self.length_scale == "group-norm" else sums

    def by_scale(self, fit: Fit, library: Library) -> dict[float, float]:
        """The weight of each length scale [m]: of waves the norm of their strengths [m/s]."""
        if library.family == "waves":
            k, weights = _waves_of(fit)
            scales = math.sqrt(2.0) * math.pi / np.linalg.norm(k, axis=1)
            rings, ring = np.unique(np.round(scales, 9), return_inverse=True)
            squares = np.bincount(ring, strengths(k, weights) ** 2, len(rings))
            return dict(zip(rings.tolist(), np.sqrt(squares).tolist(), strict=True))
        assert fit.problem.group_scales is not None
        own = self.scale_weights(fit.problem, fit.weights).tolist()
        return dict(zip(fit.problem.group_scales.tolist(), own, strict=True))

    def start(self, search: Search, fit: Fit, library: Library) -> Start:
        """The start of a search that the weights of a fit propose."""
        lookout = search.lookout
        if library.family == "waves":
            peaks = wave_peaks(*_waves_of(fit), lookout.extent, MOST_WAVES)[1].tolist()
            return Start(self.refine, waves=tuple((x, y) for x, y in peaks))
        if self.scales == "several":
            lobe = 2 * math.pi / lookout.extent
            return Start(self.refine, windows=windows(fit, lobe, lookout.bounds))
        if not len(lookout.lobes):
            return Start(self.refine)
        by_scale = self.by_scale(fit, library)
        candidate = math.pi / max(by_scale, key=lambda scale: by_scale[scale])
        nearest = lookout.lobes[np.abs(lookout.lobes - candidate).argmin()]
        return Start(self.refine, float(nearest))


def windows(fit: Fit, lobe: float, bounds: Bounds) -> tuple[Window, ...]:
    """The peaks of |W_g| by group, strongest first, one per lobe: (k, low, high) [1/m] of each.

    A window is two lobes [1/m] wide, goes to the neighbouring candidates and stays within bounds.
    """
    scales = fit.problem.group_scales
    assert scales is not None
    squares = np.bincount(fit.problem.groups, np.square(fit.weights).sum(axis=1), len(scales))
    order = np.argsort(-scales, kind="stable")
    k, strength = math.pi / scales[order], np.sqrt(squares[order])
    below, above = k - lobe, k + lobe
    top = strength > 0.02 * strength.max()  # what is smaller proposes nothing
    below[1:], above[:-1] = np.minimum(below[1:], k[:-1]), np.maximum(above[:-1], k[1:])
    around = np.concatenate([[0.0], strength, [0.0]])
    top &= (strength >= around[:-2]) & (strength >= around[2:])
    chosen: list[Window] = []
    for i in np.argsort(-strength, kind="stable"):
        apart = all(abs(k[i] - other) > lobe for other, _, _ in chosen)
        if apart and top[i] and len(chosen) < MOST_SCALES:
            low, high = max(float(below[i]), bounds[0]), min(float(above[i]), bounds[1])
            chosen.append((float(k[i]), low, high))
    return tuple(chosen)


@dataclass(frozen=True)
class GridScale:
    """U0 [m/s] and L [m] of one mode on the grid of a back-end; heading [rad] of waves."""

    mean_velocity: float
    length_scale: float
    heading: float = math.nan


@dataclass(frozen=True, eq=False)
class GridReading:
    """The parameters on the grid.

    Args:
        scales: of each mode, fastest first.
        flow: that the weights say; None where they are not those of a flow velocity, or no vehicle
            could have flown so.
        vehicles: of each flight with its unknowns, None of one that cannot be, and the steady
            velocity [m/s] beside the flow; empty where all is known.
    """

    scales: tuple[GridScale, ...]
    flow: CandidateFlow | WaveFlow | None
    vehicles: tuple[Read, ...] = ()


def read_grid(
    fit: Fit,
    flights: Sequence[Samples],
    vehicles: Sequence[PointMassVehicle],
    library: Library,
    readout: Readout,
    weights: Sequence[float] = (1.0,),
    once: Callable[[object, Callable[[], Any]], Any] = lambda key, work: work(),
) -> GridReading:
    """The parameters of the modes that a fit's weights choose, where they are on the grid.

    weights: of the rows of each flight; once: the result of work under a key, computed once for
    all fits of these flights by this library. Raises InputError where the flight does not move.
    """
    position = np.concatenate([samples.position for samples in flights])
    several, extent = readout.scales == "several", extent_of(position)
    averaged = any(samples.averages for samples in flights)
    if not (several or library.unknown or averaged or library.family == "waves"):
        weights = (1.0,) * len(flights)
    unknowns = JointUnknowns.of(library.unknown, vehicles)
    rows = _Rows(flights, vehicles, unknowns, weights)
    if library.family == "waves":
        return _read_waves(fit, rows, extent)
    if several:
        if not extent > 0:
            raise InputError("the flight does not move: no length scale can be told; fly farther")
        places = windows(fit, 2 * math.pi / extent, (0.0, math.inf))
        k = np.array([place[0] for place in places])
        speeds = np.array([rms_mean_velocity(mode) for mode in rows.cells(k)[0]])
        k = k[speeds >= 0.05 * speeds.max()]  # systematic errors of a derivative reach 2 %
    else:
        by_scale = readout.by_scale(fit, library)
        k = np.array([math.pi / max(by_scale, key=lambda scale: by_scale[scale])])
    own, coefficients = once((*k.tolist(), *weights), lambda: rows.cells(k))
    own, pairs = own / rows.ratio(coefficients), unknowns.read(coefficients)
    possible = all(vehicle is not None for vehicle, _ in pairs)
    if readout.mean_velocity == "paper":
        key, eq24 = (readout.eq24, *k.tolist()), readout.eq24
        speeds = np.array([once(key, lambda: _paper_velocity(rows, library, eq24, k, pairs))])
    elif several or possible:
        speeds = np.array([rms_mean_velocity(mode) for mode in own])
    else:
        speeds = np.array([math.nan])
    scales = tuple(GridScale(float(speeds[i]), math.pi / float(k[i])) for i in np.argsort(-speeds))
    flow: CandidateFlow | None = None
    if several and possible:
        flow = CandidateFlow(k, own, rows.origin, pairs[0][1] if pairs else (0.0, 0.0))
    elif not several and library.target == "flow-velocity" and not library.unknown:
        assert fit.problem.group_scales is not None
        weighed = fit.weights.reshape(len(fit.problem.group_scales), 8, -1)
        used = weighed.any(axis=(1, 2))
        flow = CandidateFlow(math.pi / fit.problem.group_scales[used], weighed[used], np.zeros(2))
    return GridReading(scales, flow, pairs)


def _read_waves(fit: Fit, rows: _Rows, extent: float) -> GridReading:
    """Waves on the grid: U0 and L of their peaks, fitted together, and their sum as the flow."""
    k, own = _waves_of(fit)
    tops, _ = wave_peaks(k, own, extent, MOST_WAVES)
    weights, coefficients = rows.fitted(lambda place: wave_theta(place, k[tops]), shared=True)
    ratio, used = rows.ratio(coefficients), own.any(axis=1)
    cells = read_cells(k[tops], weights.reshape(-1, 2) / ratio)
    flow = WaveFlow(k[used], *(own[used] / ratio).T)
    reading = GridScale(cells.mean_velocity, cells.length_scale, cells.heading)
    return GridReading((reading,), flow, rows.unknowns.read(coefficients))


def _paper_velocity(
    rows: _Rows, library: Library, eq24: Eq24, k: Array, pairs: tuple[Read, ...]
) -> float:
    """U0 by Eqs. 22-24 at k (1,), by the vehicles that fit best where these are unknown."""
    vehicles, background = list(rows.vehicles), np.zeros(2)
    phi, target = [], []
    for number, samples in enumerate(rows.flights):
        if pairs:
            vehicle, steady = pairs[number]
            if vehicle is None:
                return math.nan
            vehicles[number], background = vehicle, np.array(steady)
        phi.append(samples.flow_velocity(vehicles[number]) - background)
        own = phi[-1] if pairs else library.response(samples, vehicles[number])
        target.append(own[:, -2:])
    position = np.concatenate([samples.position for samples in rows.flights])
    columns = candidate_columns(position, np.pi / k)
    field = columns @ _least_squares(columns, np.concatenate(target))
    return paper_mean_velocity(field, np.concatenate(phi), eq24)


def paper_mean_velocity(field: Array, flow_velocity: Array, eq24: str) -> float:
    """Eqs. 22-24: normalise the fitted field (m, 2) to a range of sqrt(2), then scale it to Phi.

    Eq. 22 gives each component an amplitude of sqrt(2)/2; that of Eq. 1 is 1, so U0 comes out up
    to sqrt(2) too large once the flight covers a cell.
    """
    high, low = field.max(axis=0), field.min(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = math.sqrt(2.0) * (field - 0.5 * (high + low)) / (high - low)
        if eq24 == "mean-ratio":
            return float(np.mean(flow_velocity / normal))
        return float(np.sum(flow_velocity * normal) / np.sum(normal * normal))


@dataclass(frozen=True, eq=False)
class _Rows:
    """The rows of the regression of flights, to refit a few modes on.

    Args:
        flights: the samples of each.
        vehicles: of each, as they are believed to be.
        unknowns: of all flights.
        weights: of the rows of each flight.
    """

    flights: Sequence[Samples]
    vehicles: Sequence[PointMassVehicle]
    unknowns: JointUnknowns
    weights: Sequence[float]

    @cached_property
    def origin(self) -> Array:
        """The place (2,) [m] from which the phases of cells count."""
        return middle(np.concatenate([samples.source.position for samples in self.flights]))

    def cells(self, k: Array) -> tuple[Array, Array]:
        """Weights (s, 8, 2) [m/s] of cells of wavenumbers k (s,), phases from the origin."""
        scales, origin = np.pi / k, self.origin
        weights, coefficients = self.fitted(
            lambda position: candidate_columns(position - origin, scales), shared=False
        )
        return weights.reshape(2, len(k), 8).transpose(1, 2, 0), coefficients

    def fitted(self, theta: Callable[[Array], Array], *, shared: bool) -> tuple[Array, Array]:
        """Weights of the columns and coefficients of the unknowns, by least squares.

        shared: whether both velocity components share their weights, theta with rows x before y of
        each sample; else weights of x come before those of y.
        """
        sources = [samples.source for samples in self.flights]
        others, parts, targets = self.unknowns.columns(sources), [], []
        for number, source in enumerate(sources):
            columns = source.averaged(theta(source.position))
            own, target = others[number], source.flow_velocity(self.vehicles[number])
            if not shared:
                own, target = own.swapaxes(0, 1), target.T
            both = columns if shared else np.asarray(np.kron(np.eye(2), columns), dtype=float)
            joint = np.hstack([both, own.reshape(len(both), -1)])
            parts.append(self.weights[number] * joint)
            targets.append(self.weights[number] * target.ravel())
        solution = _least_squares(np.concatenate(parts), np.concatenate(targets))
        count = len(solution) - others[0].shape[2]
        return solution[:count], solution[count:]

    def ratio(self, coefficients: Array) -> float:
        """Phi of the believed vehicle over the true one's, where one flight tells it."""
        ratios = self.unknowns.ratios(coefficients)
        return ratios[0] if len(ratios) == 1 else 1.0


def _waves_of(fit: Fit) -> tuple[Array, Array]:
    """The wavevectors (w, 2) [rad/m] of a fit of waves, and their weights (w, 2)."""
    assert fit.problem.parameters is not None
    return fit.problem.parameters, fit.weights.reshape(-1, 2)


def _least_squares(columns: Array, target: Array) -> Array:
    return np.linalg.lstsq(columns, target, rcond=None)[0].astype(float, copy=False)
