"""The length scale off the grid: variable projection of the 8-column fit over k = pi/L.

At a wavenumber k the flow velocity is Phi = C(k) W + E, C (m, 8) the candidates of one length
scale and W (8, 2) free; RSS(k) = min_W |Phi - C(k) W|^2 is minimised over k (Golub and Pereyra,
1973). Its minima are lobes of width ~ 2 pi / extent, so the whole interval is scanned at a step
that resolves them before any is refined: a search near the start alone returns L/2 or 2L.

The span of C(k) = span {cos k s, sin k s: s = x, y, x + y, x - y} does not move with the origin:
positions are centred throughout, which decouples the phases from k.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array, ComplexArray, IntArray
from sparsefit.errors import InputError, positive

if TYPE_CHECKING:
    from sparsefit.modes.rows import Rows


DIRECTIONS = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])  # s = p x + q y of the four plane waves
DX, DX_SIGN = [2, 0, 0, 0, 6, 7, 4, 5], np.array([[1.0, 0, -1, 0, 1, 1, -1, -1]]).T  # dC/dx
DY, DY_SIGN = [0, 3, 0, 1, 5, 4, 7, 6], np.array([[0, 1.0, 0, -1, 1, -1, 1, -1]]).T  # over k
STEP = 0.15  # of the scan, in 1/extent; 0.6 steps over lobes
LOBES = 5  # refined on all rows; the rest are too shallow to be best or rival
RIDGE = 1e-6  # of the scan: above the error of its sums, and 2e-6 of |Phi|^2 at most at the truth
RANK = 1e-12  # eigenvalues of the scaled 8 x 8 Gram below this, relative, are dropped
CHUNK = 4096  # wavenumbers solved at once: bounds the memory
SPREAD, BETA = 8, 18.4  # cells of the spreading kernel, and its steepness: sums to 1e-7
ITERATIONS, MAX_STEPS = 40, 500_000  # of a descent; of a scan, 0.4 GB
ROUGH = 1e-2  # in scan steps, 1e-7 of a lobe's depth: where a rival's descent may stop
SIGNIFICANCE = 0.01  # of a lobe being mistaken for another
FALSE_ALARM, EXTRA = 1e-3, 15  # of a detection; 16 weights and k, less a uniform wind's 2
CORRELATION = 5  # samples: errors of smoothed derivatives and of positions are not white
BINS = 16  # of the residuals' spectrum, averaged: its level is then known to 18 %


@dataclass(frozen=True)
class Refinement:
    """The best length scale of an interval and its rival, the best other lobe.

    length_scale L [m] and wavenumber k = pi/L [1/m] of the least residual RSS(k); null_residual
    that of a uniform wind [m^2/s^2]; the rival's, NaN and inf without one; at_bound: the least
    residual is on the edge of the interval; samples m, of 2 components; lobes: separate minima
    in the interval; correlation: samples over which errors correlate; floor: of residuals, by
    rounding.
    """

    length_scale: float
    wavenumber: float
    residual: float
    null_residual: float
    rival_length_scale: float
    rival_residual: float
    at_bound: bool
    samples: int
    lobes: int
    correlation: float = CORRELATION
    floor: float = 0.0

    @property
    def evidence(self) -> float:
        """2m ln(RSS_rival / RSS) / correlation: 2 ln(likelihood ratio) to the rival."""
        return self._evidence(self.rival_residual)

    @property
    def detected(self) -> bool:
        """Whether the best scale explains more than chance, with a false alarm in 1000 flights.

        A uniform wind has 15 parameters less: where there is no flow, 2 ln(likelihood ratio) is
        chi-squared with 15 degrees of freedom in each lobe.
        """
        return self._evidence(self.null_residual) > _chi_squared(FALSE_ALARM / self.lobes)

    def _evidence(self, other: float) -> float:
        floor = self.floor or 1.0
        ratio = max(other, floor) / max(self.residual, floor)
        return 2 * self.samples * math.log(ratio) / self.correlation

    @property
    def identifiable(self) -> bool:
        """Whether there is a flow, the data exclude the rival, and L is inside the interval.

        A false lobe leads by a likelihood ratio c with probability <= 1/c; over all lobes the
        risk is 1 % at evidence = 2 ln(lobes / 0.01).
        """
        needed = 2 * math.log(self.lobes / SIGNIFICANCE)
        return self.detected and not self.at_bound and self.evidence > needed


def _chi_squared(probability: float) -> float:
    """Upper quantile of chi-squared with EXTRA degrees of freedom (Wilson and Hilferty, 1931)."""
    normal, spread = NormalDist().inv_cdf(1 - probability), 2 / (9 * EXTRA)
    return EXTRA * (1 - spread + normal * math.sqrt(spread)) ** 3


def columns(position: Array, wavenumber: float) -> tuple[Array, Array]:
    """C (m, 8) in the order of CANDIDATES, and its derivative dC/dk (m, 8) [m]."""
    (sin_x, sin_y), (cos_x, cos_y) = (
        np.sin(wavenumber * position.T),
        np.cos(wavenumber * position.T),
    )
    singles, (x, y) = [sin_x, sin_y, cos_x, cos_y], position.T
    value = np.stack([*singles, sin_x * sin_y, sin_x * cos_y, cos_x * sin_y, cos_x * cos_y])
    slope = x * (DX_SIGN * value[DX]) + y * (DY_SIGN * value[DY])
    return value.T, slope.T


@dataclass(frozen=True, eq=False)
class Projection:
    """The 8-column fit at one k: RSS, W (8, 2), and the Gauss-Newton move in k [1/m]."""

    wavenumber: float
    residual: float
    weights: Array
    move: float


def project(position: Array, flow_velocity: Array, wavenumber: float) -> Projection:
    """Fit centred positions and Phi, (m, 2), at k by the Gram matrix, less its null directions.

    The gradient of RSS/2 is -(R, dC/dk W); the curvature |P dC/dk W|^2, P projecting off C.
    """
    value, slope = columns(position, wavenumber)
    scale = np.sqrt(np.einsum("ij,ij->j", value, value))
    scale[scale == 0] = 1.0
    roots, vectors = np.linalg.eigh(value.T @ value / np.outer(scale, scale))
    kept = roots > RANK * roots[-1]
    basis = vectors[:, kept] / np.sqrt(roots[kept]) / scale[:, None]  # C basis is orthonormal
    weights = basis @ (basis.T @ (value.T @ flow_velocity))
    rest, bend = flow_velocity - value @ weights, slope @ weights
    shared = basis.T @ (value.T @ bend)
    curvature = float(np.sum(bend * bend) - np.sum(shared * shared))
    move = float(np.sum(rest * bend)) / curvature if curvature > 0 else 0.0
    return Projection(wavenumber, float(np.sum(rest * rest)), weights, move)


def scan(
    position: Array,
    flow_velocity: Array,
    step: float,
    first: int,
    last: int,
    rows: Rows | None = None,
) -> Array:
    """RSS(k) at k = j step, j = first..last, from Fourier sums: all rows, few operations.

    The Gram entries are sums of cos and sin of k (p x + q y), |p|, |q| <= 2: 12 non-uniform
    Fourier transforms and their conjugates; C'Phi is 8 more. A ridge of RIDGE m is added.
    Unknown parameters of the vehicle in ``rows`` add the sums of their series.
    """
    points, count = centred(position), last - first + 1
    gain, size = kernel_gain(first, last)
    series = flow_velocity.T if rows is None else np.vstack([flow_velocity.T, rows.scanned])
    sums, cross = np.empty((25, count), complex), np.empty((4, len(series), count), complex)
    sums[12] = len(points)
    for i in range(12):  # (p, q) = divmod(i, 5) - 2: symmetric about i = 12, (0, 0)
        mode = np.array(divmod(i, 5)) - 2
        wave = np.flatnonzero((-mode == DIRECTIONS).all(axis=1))
        loads = series[: len(series) * len(wave)]
        found = fourier_sums(points @ mode, loads, step, size)[:, first : last + 1] / gain
        sums[i], sums[24 - i] = found[0].conj(), found[0]
        if len(wave):
            cross[wave[0]] = found[1:]
    pairs = (DIRECTIONS[:, None] + sign * DIRECTIONS for sign in (-1, 1))
    minus, plus = (sums[(pair + 2) @ (5, 1)] for pair in pairs)
    curve = np.full(count, np.sum(flow_velocity**2))
    for part in (slice(begin, begin + CHUNK) for begin in range(0, count, CHUNK)):
        gram = _real_gram(minus[..., part], plus[..., part])
        gram[:, range(8), range(8)] += RIDGE * len(points)
        load = np.concatenate([cross[..., part].real, cross[..., part].imag]).transpose(2, 0, 1)
        if len(series) > 2 and rows is not None:
            freed = load.transpose(0, 2, 1) @ np.linalg.solve(gram, load)
            curve[part] = rows.reduced(series @ series.T - freed)
            continue
        curve[part] -= np.sum(load * np.linalg.solve(gram, load), axis=(1, 2))
    return curve


def _real_gram(minus: ComplexArray, plus: ComplexArray) -> Array:
    """Gram (q, 8, 8) of cos, sin of the plane waves, from sums (4, 4, q) at a - b and a + b."""
    cos_cos, sin_sin = (plus + minus).real, (minus - plus).real
    sin_cos, cos_sin = (plus + minus).imag, (plus - minus).imag
    rows = np.concatenate([cos_cos, cos_sin], 1), np.concatenate([sin_cos, sin_sin], 1)
    return np.ascontiguousarray(0.5 * np.concatenate(rows, 0).transpose(2, 0, 1))


def fourier_sums(points: Array, loads: Array, step: float, size: int) -> ComplexArray:
    """Sum_i w_i exp(-1j j step points[i]), j = 0..size/2, times the gain; w = 1 and each of loads.

    NUFFT of type 1 with the kernel exp(beta sqrt(1 - z^2)) (Barnett et al., 2019).
    """
    place = points * (step * size / (2 * math.pi))
    low = np.ceil(place - SPREAD / 2)
    offset = (low - place) * (2 / SPREAD) + np.arange(SPREAD)[:, None] * (2 / SPREAD)
    kernel = np.exp(BETA * np.sqrt(np.maximum(1 - offset * offset, 0.0)) - BETA)
    cells = ((low.astype(np.intp) + np.arange(SPREAD)[:, None]) % size).ravel()
    weighted = [kernel, *(kernel * row for row in loads)]
    return np.fft.rfft([np.bincount(cells, values.ravel(), size) for values in weighted])


def kernel_gain(first: int, last: int) -> tuple[Array, int]:
    """The kernel's Fourier transform at j = first..last; the size that oversamples twice."""
    size = 1 << math.ceil(math.log2(4 * (last + 1) + 4 * SPREAD))
    nodes, mass = np.polynomial.legendre.leggauss(4 * SPREAD)
    nodes, mass = nodes[2 * SPREAD :], 2 * mass[2 * SPREAD :]  # the kernel is even
    mass = 0.5 * SPREAD * mass * np.exp(BETA * np.sqrt(1 - nodes * nodes) - BETA)
    waves = np.outer(np.arange(first, last + 1), math.pi * SPREAD / size * nodes)
    return np.cos(waves) @ mass, size


def refine(
    position: Array,
    flow_velocity: Array,
    start_length_scale: float | None = None,
    *,
    lower: float,
    upper: float,
    correlation: float = CORRELATION,
    rows: Rows | None = None,
) -> Refinement:
    """Find L in [lower, upper] [m] with the least residual, and its rival.

    position (m, 2) [m]; flow_velocity Phi (m, 2) [m/s]; start_length_scale: a back-end's answer
    [m], whose lobe is refined whatever its depth; correlation: samples over which the errors of
    Phi correlate, at least; more where the residuals show it; rows: what is fitted in place of Phi
    at the positions, which then only tell where the lobes are. InputError: empty interval, flight
    at rest.
    """
    extent = float(np.ptp(position, axis=0).max())
    if not 0 < lower < upper < math.inf:
        raise InputError(f"refine needs 0 < lower < upper; got {lower:g} to {upper:g} m")
    if not extent > 0:
        raise InputError("the flight does not move: no length scale can be told; fly farther")
    low, high = math.pi / upper, math.pi / lower
    step = min(STEP / extent, (high - low) / 8)
    if high > MAX_STEPS * step:
        raise InputError(f"refine: lower {lower:g} m is too small for {extent:g} m; raise it")
    limits, first, last = (low, high, step), math.floor(low / step), math.ceil(high / step)
    curve = scan(position, flow_velocity, step, first, last, rows)
    minima = _minima(curve)
    chosen = minima[:LOBES].tolist()
    if start_length_scale is not None:
        start = math.pi / positive("start_length_scale", start_length_scale, "m") / step - first
        chosen.append(int(minima[np.abs(minima - start).argmin()]))
    at: Callable[[float], Projection] = partial(project, centred(position), flow_velocity)
    at, phi = (at, flow_velocity) if rows is None else (rows.project, rows.target)
    rough = ROUGH * step
    vertices = {j: step * (first + j + _vertex(curve, j)) for j in chosen}
    found = [_descend(at, k, limits, rough) for k in vertices.values()]
    found.sort(key=lambda fit: fit.residual)
    best = _descend(at, found[0].wavenumber, limits, 0.0)
    others = [fit for fit in found if abs(fit.wavenumber - best.wavenumber) > 2 * step]
    rival = (math.pi / others[0].wavenumber, others[0].residual) if others else (math.nan, math.inf)
    k, edge = best.wavenumber, best.wavenumber in (low, high)
    if rows is None:  # other rows know how far their errors correlate
        errors = phi - columns(centred(position), k)[0] @ best.weights
        correlation = max(correlation, concentration(errors))
    null, floor = float(np.sum((phi - phi.mean(axis=0)) ** 2)), 1e-15 * float(np.sum(phi**2))
    null = null if rows is None else rows.null_residual
    return Refinement(
        math.pi / k,
        k,
        best.residual,
        null,
        *rival,
        edge,
        len(phi),
        len(minima),
        correlation,
        floor,
    )


def centred(position: Array) -> Array:
    """Positions (m, 2) from the middle of their bounding box."""
    centre: Array = 0.5 * (position.max(axis=0) + position.min(axis=0))
    return position - centre


def concentration(errors: Array) -> float:
    """The highest power of the spectrum of errors (m, 2) over its mean: 1 for white noise.

    A column takes from the residual what noise has at its own frequencies: m samples of such
    errors are worth m / concentration white ones to whoever fits where the power is highest.
    """
    power = np.sum(np.abs(np.fft.rfft(errors, axis=0)) ** 2, axis=1)
    total, bins = np.cumsum(np.concatenate([[0.0], power])), min(BINS, len(power))
    highest = float((total[bins:] - total[:-bins]).max()) / bins
    return highest / float(power.mean()) if highest > 0 else 1.0


def _vertex(curve: Array, j: int) -> float:
    """Where the parabola through three points of the curve is lowest, in steps from j."""
    if not 0 < j < len(curve) - 1:
        return 0.0
    before, here, after = curve[j - 1 : j + 2].tolist()
    bow = before - 2 * here + after
    return 0.5 * (before - after) / bow if bow > 0 else 0.0


def _minima(curve: Array) -> IntArray:
    """Indices of the local minima, edges included, deepest first."""
    padded = np.concatenate([[np.inf], curve, [np.inf]])
    found = np.flatnonzero((curve <= padded[:-2]) & (curve <= padded[2:]))
    return found[np.argsort(curve[found], kind="stable")]


def _descend(
    fitted: Callable[[float], Projection],
    start: float,
    limits: tuple[float, float, float],
    tolerance: float,
) -> Projection:
    """Gauss-Newton from k = start: moves within one scan step, shortened until RSS falls.

    fitted: `project` at a k; limits: the least and the largest k, and the scan step; tolerance on
    a move [1/m].
    """
    lowest, highest, step = limits
    here = fitted(min(max(start, lowest), highest))
    move = here.move
    for _ in range(ITERATIONS):
        k = min(max(here.wavenumber + min(max(move, -step), step), lowest), highest)
        if abs(k - here.wavenumber) <= max(tolerance, 1e-15 * k):
            break
        there = fitted(k)
        if there.residual < here.residual:
            here, move = there, there.move
        else:
            move /= 4 if abs(move) > 1e-9 * k else 1e9  # below it, rounding decides
    return here
