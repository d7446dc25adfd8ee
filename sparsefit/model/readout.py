"""Parameters from regression weights: the length scale (Eq. 21), the mean velocity (Eqs. 22-24).

With ``refine = "none"`` these are the estimate, otherwise the start of the search.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_type_hints

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, number_setting, one_of
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow
from sparsefit.model.grid import Bounds, candidate_columns, extent_of, middle, wave_columns
from sparsefit.model.ladder import Start, Window
from sparsefit.model.library import Library
from sparsefit.model.search import Search
from sparsefit.model.shapes import WaveCells, read_cells
from sparsefit.regression.fit import Fit
from sparsefit.rows import Samples

UNNAMED = "variable-projection"  # the refinement of files that name none
MOST_WAVES = 12  # peaks of a library of waves


@dataclass(frozen=True)
class Readout:
    """The rules that determine parameters from weights.

    length_scale: the scale with the largest sum of weights (``signed-sum``, Eq. 21 to the
    letter), of their absolute values (``absolute-sum``) or the largest Euclidean norm of its
    block (``group-norm``).
    mean_velocity, after a refit on the 8 columns of that scale: ``paper`` (Eqs. 22-24; Eq. 24 by
    ``eq24`` as the mean of element-wise ratios, ``mean-ratio``, which has poles, or as the
    least-squares coefficient, ``pseudo-inverse``) or ``rms`` over the cell in closed form.
    refine: ``variable-projection`` moves the chosen scale off the grid, to the steady square cells
    along the axes that fit best between the grid's bounds; ``ladder``, the default, also fits
    cells at any heading, of any sides, steady or drifting, and chooses among them by likelihood.
    ``none`` reports the candidate itself. Files without ``refine`` mean ``variable-projection``.
    scales: ``one`` length scale; or ``several``, all that the back-end proposes and the rows
    support, each with its ``rms``, at the peaks of the Euclidean norm.
    precision: the largest relative half-width of the 95 % intervals of U0, L and tau_w for the
    status ``ok``; at 0.03 a value is off by 5 % once in a thousand flights.
    """

    length_scale: Literal["signed-sum", "absolute-sum", "group-norm"] = "group-norm"
    mean_velocity: Literal["paper", "rms"] = "rms"
    eq24: Literal["mean-ratio", "pseudo-inverse"] = "pseudo-inverse"
    refine: Literal["none", "variable-projection", "ladder"] = "ladder"
    scales: Literal["one", "several"] = "one"
    precision: float = 0.03

    def __post_init__(self) -> None:
        for key, kind in get_type_hints(type(self)).items():
            if get_args(kind):
                one_of(f"readout {key}", getattr(self, key), get_args(kind))
        number_setting("readout", "precision", self.precision, low=0.0)
        if self.scales == "several" and self.mean_velocity == "paper":
            words = "mean_velocity 'paper' (Eq. 22) scales one field to its range"
            raise InputError(f"readout: {words}: it cannot part several; use 'rms'")

    def by_scale(self, fit: Fit, library: Library) -> dict[float, float]:
        """The weight of each length scale [m]; of waves the norm of their strengths [m/s]."""
        rows, rule, group_scales = fit.weights, self.length_scale, fit.problem.group_scales
        assert group_scales is not None
        if library.family == "waves":
            sizes = np.linalg.norm(_waves_of(fit)[0], axis=1)
            rows, rule = np.repeat(sizes, 2)[:, None] * rows, "group-norm"
        terms = {"signed-sum": rows, "absolute-sum": np.abs(rows), "group-norm": rows**2}[rule]
        scales, place = np.unique(group_scales, return_inverse=True)
        total = np.bincount(place[fit.problem.groups], terms.sum(axis=1), len(scales))
        total = np.sqrt(total) if rule == "group-norm" else total
        return dict(zip(scales.tolist(), total.tolist(), strict=True))

    def start(self, search: Search, fit: Fit, library: Library) -> Start:
        """The start of the search proposed by the weights of a fit."""
        if library.family == "waves":
            peaks = wave_peaks(*_waves_of(fit), search.extent, MOST_WAVES)[1].tolist()
            return Start(self.refine, waves=tuple((x, y) for x, y in peaks))
        if self.scales == "several":
            lobe = 2 * math.pi / search.extent
            return Start(self.refine, windows=windows(fit, lobe, search.bounds))
        if not len(search.lobes):
            return Start(self.refine)
        by_scale = self.by_scale(fit, library)
        candidate = math.pi / max(by_scale, key=lambda scale: by_scale[scale])
        nearest = search.lobes[np.abs(search.lobes - candidate).argmin()]
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
    top = strength > 0.02 * strength.max()  # weaker groups are ignored
    below[1:], above[:-1] = np.minimum(below[1:], k[:-1]), np.maximum(above[:-1], k[1:])
    around = np.concatenate([[0.0], strength, [0.0]])
    top &= (strength >= around[:-2]) & (strength >= around[2:])
    chosen: list[Window] = []
    for i in np.argsort(-strength, kind="stable"):
        apart = all(abs(k[i] - other) > lobe for other, _, _ in chosen)
        if apart and top[i] and len(chosen) < 6:
            low, high = max(float(below[i]), bounds[0]), min(float(above[i]), bounds[1])
            chosen.append((float(k[i]), low, high))
    return tuple(chosen)


def wave_peaks(
    wavevectors: Array, weights: Array, extent: float, most: int
) -> tuple[IntArray, Array]:
    """The peaks of weights a, b (w, 2) over the plane, strongest first, one in a neighbourhood.

    Returns the index of the strongest wave of each neighbourhood (p,) and the mean wavevector there
    (p, 2) [rad/m], weighted by |k|^2 (a^2 + b^2). extent: of the flight [m].
    """
    strength = np.linalg.norm(wavevectors, axis=1) * np.linalg.norm(weights, axis=1)
    near = 1.5 * math.pi / extent  # the diagonal of a grid of one step
    free = strength > 0
    tops: list[int] = []
    peaks: list[Array] = []
    while free.any() and len(tops) < most:
        top = int(np.argmax(np.where(free, strength, -1.0)))
        if strength[top] < 0.1 * strength.max():
            break
        sides = np.where(wavevectors @ wavevectors[top] < 0, -1.0, 1.0)[:, None] * wavevectors
        around = free & (np.linalg.norm(sides - wavevectors[top], axis=1) <= near)
        shares = strength[around] ** 2
        tops.append(top)
        peaks.append(shares @ sides[around] / shares.sum())
        free &= ~around
    return np.array(tops, dtype=np.intp), np.array(peaks).reshape(-1, 2)


def rms_mean_velocity(weights: Array) -> Array:
    """U0 = sqrt(2 <|w|^2>) [m/s] over the cell, in closed form, from weights (..., 8, 2) [m/s].

    A single has mean square 1/2 and a product 1/4; the cellular flow of Eq. 1 has
    <|w|^2> = U0^2 / 2.
    """
    mean_square = np.repeat([0.5, 0.25], 4)[:, None]
    speed: Array = np.sqrt(2 * np.sum(mean_square * weights**2, axis=(-2, -1)))
    return speed


@dataclass(frozen=True, eq=False)
class CandidateFlow:
    """A weighted sum of candidates; its divergence need not vanish.

    w(x) = sum_j C(k_j, x - x0) W_j, C the 8 candidates of a wavenumber (Eq. 17).
    """

    wavenumbers: Array  # k = pi/L (s,) [1/m]
    weights: Array  # W (s, 8, 2) [m/s]
    origin: Array  # x0 (2,) [m], where the phases of the candidates are 0

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m]; it is steady."""
        places = np.broadcast_arrays(*(np.asarray(given, dtype=np.float64) for given in (x, y, t)))
        position = np.column_stack([places[0].ravel(), places[1].ravel()]) - self.origin
        theta = candidate_columns(position, math.pi / self.wavenumbers)
        return (theta @ self.weights.reshape(-1, 2)).reshape(*places[0].shape, 2)


def read_grid(
    fit: Fit,
    flights: Sequence[Samples],
    vehicles: Sequence[PointMassVehicle],
    library: Library,
    readout: Readout,
    weights: Sequence[float] = (1.0,),
    once: Callable[[object, Callable[[], Any]], Any] = lambda _, work: work(),
) -> tuple[tuple[WaveCells, ...], CandidateFlow | WaveFlow | None]:
    """The cells chosen on the grid by a fit's weights, fastest first, and the flow of the weights.

    The cells are fitted jointly to the rows of the regression, each flight's times its weight. The
    flow is None if the target is not the flow velocity. Fits of the same flights share what `once`,
    called with a key and the work, has computed before.

    Raises:
        InputError: if the flight does not move.
    """
    position = np.concatenate([samples.position for samples in flights])
    sources = [samples.averages or samples for samples in flights]

    def refitted(theta: Callable[[Array], Array]) -> Array:
        """Least-squares weights of columns of all flights; of waves rows are x before y."""
        parts = []
        for source, vehicle, weight in zip(sources, vehicles, weights, strict=True):
            columns = source.averaged(theta(source.position))
            phi = source.flow_velocity(vehicle).reshape(len(columns), -1)
            parts.append((weight * columns, weight * phi))
        columns, target = map(np.concatenate, zip(*parts, strict=True))
        own: Array = np.linalg.lstsq(columns, target, rcond=None)[0]
        return own

    if library.family == "waves":
        k, own = _waves_of(fit)
        k_top = k[wave_peaks(k, own, extent_of(position), MOST_WAVES)[0]]
        top = refitted(lambda place: wave_columns(place, k_top))
        used = own.any(axis=1)
        return (read_cells(k_top, top.reshape(-1, 2)),), WaveFlow(k[used], *own[used].T)
    origin = middle(np.concatenate([source.position for source in sources]))

    def cells_at(k: Array) -> Array:
        """Weights (s, 8, 2) [m/s] of cells of wavenumbers k (s,), phases from the origin."""
        own = refitted(lambda place: candidate_columns(place - origin, np.pi / k))
        return own.reshape(len(k), 8, 2)

    several, scales = readout.scales == "several", fit.problem.group_scales
    assert scales is not None
    if several:
        if not (extent := extent_of(position)) > 0:
            raise InputError("the flight does not move: no length scale can be told; fly farther")
        k = np.array([place[0] for place in windows(fit, 2 * math.pi / extent, (0.0, math.inf))])
        speeds = rms_mean_velocity(cells_at(k))
        k = k[speeds >= 0.05 * speeds.max()]  # systematic errors of a derivative reach 2 %
    else:
        by_scale = readout.by_scale(fit, library)
        k = np.array([math.pi / max(by_scale, key=lambda scale: by_scale[scale])])

    def speeds_of_cells() -> tuple[Array, Array]:
        """Mean velocities (s,) [m/s] of the cells at the wavenumbers, and weights by their rms."""
        if readout.mean_velocity == "rms":
            own = cells_at(k)
            return rms_mean_velocity(own), own
        pairs = list(zip(flights, vehicles, strict=True))
        phi = np.concatenate([samples.flow_velocity(vehicle) for samples, vehicle in pairs])
        target = np.concatenate([library.response(*pair)[:, -2:] for pair in pairs])
        columns = candidate_columns(position, np.pi / k)
        field = columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        return np.array([paper_mean_velocity(field, phi, readout.eq24)]), np.zeros(0)

    speeds, own = once((readout, *k.tolist()), speeds_of_cells)
    order = np.argsort(-speeds)
    cells = tuple(WaveCells(float(speeds[i]), math.pi / float(k[i])) for i in order)
    if several:
        return cells, CandidateFlow(k, own, origin)
    if library.target != "flow-velocity":
        return cells, None
    weighed = fit.weights.reshape(len(scales), 8, -1)
    used = weighed.any(axis=(1, 2))
    return cells, CandidateFlow(math.pi / scales[used], weighed[used], np.zeros(2))


def paper_mean_velocity(field: Array, flow_velocity: Array, eq24: str) -> float:
    """Eqs. 22-24: normalise the fitted field (m, 2) to a range of sqrt(2), then scale it to Phi.

    Eq. 22 gives each component an amplitude of sqrt(2)/2, but that of Eq. 1 is 1, so U0 is up to
    sqrt(2) too large if the flight covers a cell.
    """
    high, low = field.max(axis=0), field.min(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = math.sqrt(2.0) * (field - 0.5 * (high + low)) / (high - low)
        if eq24 == "mean-ratio":
            return float(np.mean(flow_velocity / normal))
        return float(np.sum(flow_velocity * normal) / np.sum(normal * normal))


def _waves_of(fit: Fit) -> tuple[Array, Array]:
    """The wavevectors (w, 2) [rad/m] of a fit of waves, and their weights (w, 2)."""
    assert fit.problem.parameters is not None
    return fit.problem.parameters, fit.weights.reshape(-1, 2)
