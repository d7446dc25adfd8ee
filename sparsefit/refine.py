"""The length scale off the grid: variable projection of the 8-column fit over k = pi/L.

At a wavenumber k the flow velocity is Phi = C(k) W + E, C (m, 8) the candidates of one length
scale and W (8, 2) free; RSS(k) = min_W |Phi - C(k) W|^2 is minimised over k (Golub and Pereyra,
1973). Its minima are lobes of width ~ 2 pi / extent, so the whole interval is scanned at a step
that resolves them before any is refined: a search near the start alone returns L/2 or 2L.

The span of C(k) = span {cos k s, sin k s: s = x, y, x + y, x - y} does not move with the origin:
positions are centred throughout, which decouples the phases from k.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sparsefit.errors import InputError

Array = NDArray[np.float64]

DIRECTIONS = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])  # s = p x + q y of the four plane waves
DX = np.array([2, 0, 0, 0, 6, 7, 4, 5]), np.array([1.0, 0, -1, 0, 1, 1, -1, -1])
DY = (
    np.array([0, 3, 0, 1, 5, 4, 7, 6]),
    np.array([0, 1.0, 0, -1, 1, -1, 1, -1]),
)  # dC_j/dy: C_i, sign
STEP = 0.15  # of the scan, in 1/extent; 0.6 steps over lobes
LOBES = 5  # refined on all rows; the rest are too shallow to be best or rival
RIDGE = 1e-6  # of the scan: above the error of its sums, and 2e-6 of |Phi|^2 at most at the truth
RANK = 1e-12  # eigenvalues of the scaled 8 x 8 Gram below this, relative, are dropped
CHUNK = 4096  # wavenumbers solved at once: bounds the memory
SPREAD = 8  # cells of the spreading kernel: sums to 1e-7
BETA = 2.3 * SPREAD
ITERATIONS = 40
ROUGH = 1e-3  # in scan steps, 1e-9 of a lobe's depth: where a rival's descent may stop
SIGNIFICANCE = 0.05
CORRELATION = 10  # samples: errors of smoothed derivatives and of positions are not white


@dataclass(frozen=True)
class Refinement:
    """The best length scale of an interval and its rival, the best other lobe.

    length_scale L [m] and wavenumber k = pi/L [1/m] of the least residual RSS(k); null_residual
    |Phi|^2 [m^2/s^2]; the rival's, NaN and inf without one; at_bound: the least residual is on the
    edge of the interval; samples m, of 2 components; lobes: separate minima in the interval.
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

    @property
    def evidence(self) -> float:
        """2 ln(likelihood ratio) of best to rival, white residuals: 2m ln(RSS_rival / RSS)."""
        floor = 1e-15 * self.null_residual  # rounding
        best, rival = max(self.residual, floor), max(self.rival_residual, floor)
        return 2 * self.samples * math.log(rival / best) if best > 0 else 0.0

    @property
    def identifiable(self) -> bool:
        """Whether the data exclude the rival, and L is inside the interval.

        A false lobe leads by a likelihood ratio c with probability <= 1/c; over all lobes the
        risk is 5 % at evidence = 2 ln(lobes / 0.05), times the length CORRELATION of the errors.
        """
        needed = 2 * CORRELATION * math.log(self.lobes / SIGNIFICANCE)
        return not self.at_bound and self.evidence > needed


def columns(position: Array, wavenumber: float) -> tuple[Array, Array]:
    """C (m, 8) in the order of CANDIDATES, and its derivative dC/dk (m, 8) [m]."""
    (sin_x, sin_y), (cos_x, cos_y) = (
        np.sin(wavenumber * position.T),
        np.cos(wavenumber * position.T),
    )
    singles, (x, y) = [sin_x, sin_y, cos_x, cos_y], position.T
    value = np.stack([*singles, sin_x * sin_y, sin_x * cos_y, cos_x * sin_y, cos_x * cos_y])
    slope = x * (DX[1][:, None] * value[DX[0]]) + y * (DY[1][:, None] * value[DY[0]])
    return value.T, slope.T


@dataclass(frozen=True, eq=False)
class Projection:
    """The 8-column fit at one k: RSS, W (8, 2), gradient of RSS/2 and its curvature."""

    wavenumber: float
    residual: float
    weights: Array
    gradient: float
    curvature: float


def project(position: Array, flow_velocity: Array, wavenumber: float) -> Projection:
    """Fit Phi (m, 2) at k, by the Gram matrix with its null directions dropped.

    position (m, 2) should be centred. The gradient of RSS/2 is -(R, dC/dk W), as R is normal to
    C; P projects off C (Kaufman's Gauss-Newton curvature).
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
    residual, gradient = float(np.sum(rest * rest)), -float(np.sum(rest * bend))
    return Projection(wavenumber, residual, weights, gradient, max(curvature, 0.0))


def residual_curve(position: Array, flow_velocity: Array, wavenumbers: Array) -> Array:
    """RSS(k) (q,) of the joint 8-column fit at each wavenumber (q,) [1/m], on all rows.

    0.5 ms each for 3000 rows; `scan` is 50 times faster on a uniform grid, to 1e-6 |Phi|^2.
    """
    centred = _centred(position)
    found = [project(centred, flow_velocity, float(k)).residual for k in np.ravel(wavenumbers)]
    return np.array(found)


def scan(position: Array, flow_velocity: Array, step: float, first: int, last: int) -> Array:
    """RSS(k) at k = j step, j = first..last, from Fourier sums: all rows, few operations.

    The Gram entries are sums of cos and sin of k (p x + q y), |p|, |q| <= 2: 12 non-uniform
    Fourier transforms and their conjugates; C'Phi is 8 more. A ridge of RIDGE m is added.
    """
    centred, count = _centred(position), last - first + 1
    gain, size = _kernel_gain(first, last)
    sums, cross = np.empty((25, count), complex), np.empty((4, 2, count), complex)
    sums[12] = len(centred)
    for i in range(12):  # (p, q) = divmod(i, 5) - 2: symmetric about i = 12, (0, 0)
        mode = np.array(divmod(i, 5)) - 2
        wave = np.flatnonzero((-mode == DIRECTIONS).all(axis=1))
        loads = flow_velocity.T if len(wave) else flow_velocity.T[:0]
        found = _fourier_sums(centred @ mode, loads, step, size)[:, first : last + 1] / gain
        sums[i], sums[24 - i] = found[0].conj(), found[0]
        if len(wave):
            cross[wave[0]] = found[1:]
    one, other = DIRECTIONS[:, None], DIRECTIONS
    minus, plus = (sums[(pair + 2) @ (5, 1)] for pair in (one - other, one + other))
    null = float(np.sum(flow_velocity**2))
    curve = np.empty(count)
    for begin in range(0, count, CHUNK):
        part = slice(begin, begin + CHUNK)
        gram = _real_gram(minus[..., part], plus[..., part])
        load = np.concatenate([cross[..., part].real, cross[..., part].imag]).transpose(2, 0, 1)
        gram[:, range(8), range(8)] += RIDGE * len(centred)
        curve[part] = null - np.sum(load * np.linalg.solve(gram, load), axis=(1, 2))
    return curve


def _real_gram(minus: NDArray[np.complex128], plus: NDArray[np.complex128]) -> Array:
    """Gram (q, 8, 8) of cos, sin of the plane waves, from sums (4, 4, q) at a - b and a + b."""
    cos_cos, sin_sin = (plus + minus).real, (minus - plus).real
    sin_cos, cos_sin = (plus + minus).imag, (plus - minus).imag
    rows = np.concatenate([cos_cos, cos_sin], 1), np.concatenate([sin_cos, sin_sin], 1)
    return np.ascontiguousarray(0.5 * np.concatenate(rows, 0).transpose(2, 0, 1))


def _fourier_sums(points: Array, loads: Array, step: float, size: int) -> NDArray[np.complex128]:
    """Sum_i w_i exp(-1j j step points[i]), j = 0..size/2, times the kernel's gain: NUFFT, type 1.

    For w = 1 and each row of loads. Kernel exp(beta sqrt(1 - z^2)) over SPREAD cells, twofold
    oversampling (Barnett, Magland and af Klinteberg, 2019).
    """
    place = points * (step * size / (2 * math.pi))
    low = np.ceil(place - SPREAD / 2)
    offset = (low - place) * (2 / SPREAD) + np.arange(SPREAD)[:, None] * (2 / SPREAD)
    kernel = np.exp(BETA * np.sqrt(np.maximum(1 - offset * offset, 0.0)) - BETA)
    cells = ((low.astype(np.intp) + np.arange(SPREAD)[:, None]) % size).ravel()
    weighted = [kernel, *(kernel * row for row in loads)]
    return np.fft.rfft([np.bincount(cells, values.ravel(), size) for values in weighted])


def _kernel_gain(first: int, last: int) -> tuple[Array, int]:
    """The kernel's Fourier transform at j = first..last, and the grid's size."""
    size = 1 << math.ceil(math.log2(4 * (last + 1) + 4 * SPREAD))
    nodes, mass = np.polynomial.legendre.leggauss(4 * SPREAD)
    mass = 0.5 * SPREAD * mass * np.exp(BETA * (np.sqrt(1 - nodes * nodes) - 1))
    gain: Array = (
        np.cos(np.outer(np.arange(first, last + 1), math.pi * SPREAD / size * nodes)) @ mass
    )
    return gain, size


def refine(
    position: Array,
    flow_velocity: Array,
    start_length_scale: float | None = None,
    *,
    lower: float,
    upper: float,
) -> Refinement:
    """Find L in [lower, upper] [m] with the least residual, and its rival.

    position (m, 2) [m]; flow_velocity Phi (m, 2) [m/s]; start_length_scale: a back-end's answer
    [m], whose lobe is refined whatever its depth. Raises InputError if the interval is empty or
    the flight stands still.
    """
    extent = float(np.ptp(position, axis=0).max())
    if not (0 < lower < upper < math.inf and extent > 0):
        raise InputError(
            f"refine needs 0 < lower < upper and a flight that moves; got {lower:g} to {upper:g} m "
            f"and an extent of {extent:g} m"
        )
    low, high = math.pi / upper, math.pi / lower
    step = min(STEP / extent, (high - low) / 8)
    limits, first, last = (low, high, step), math.floor(low / step), math.ceil(high / step)
    minima = _minima(scan(position, flow_velocity, step, first, last))
    chosen = minima[:LOBES].tolist()
    if start_length_scale is not None:
        chosen.append(minima[np.abs(minima + first - math.pi / start_length_scale / step).argmin()])
    centred, phi, rough = _centred(position), flow_velocity, ROUGH * step
    found = [_descend(centred, phi, step * (first + j), limits, rough) for j in set(chosen)]
    found.sort(key=lambda fit: fit.residual)
    best = _descend(centred, phi, found[0].wavenumber, limits, 0.0)
    others = [fit for fit in found if abs(fit.wavenumber - best.wavenumber) > 2 * step]
    rival = others[0] if others else None
    return Refinement(
        length_scale=math.pi / best.wavenumber,
        wavenumber=best.wavenumber,
        residual=best.residual,
        null_residual=float(np.sum(phi**2)),
        rival_length_scale=math.pi / rival.wavenumber if rival else math.nan,
        rival_residual=rival.residual if rival else math.inf,
        at_bound=best.wavenumber in (low, high),
        samples=len(position),
        lobes=len(minima),
    )


def _centred(position: Array) -> Array:
    centre: Array = 0.5 * (position.max(axis=0) + position.min(axis=0))
    return position - centre


def _minima(curve: Array) -> NDArray[np.intp]:
    """Indices of the local minima, edges included, deepest first by the parabola through three."""
    padded = np.concatenate([[np.inf], curve, [np.inf]])
    found = np.flatnonzero((curve <= padded[:-2]) & (curve <= padded[2:]))
    inner = np.clip(found, 1, len(curve) - 2)
    before, here, after = curve[inner - 1], curve[inner], curve[inner + 1]
    bend = before - 2 * here + after
    drop = (after - before) ** 2 / np.where(bend > 0, 8 * bend, np.inf)
    depth = np.where(found == inner, here - drop, curve[found])
    return found[np.argsort(depth, kind="stable")]


def _descend(
    position: Array, phi: Array, start: float, limits: tuple[float, float, float], tolerance: float
) -> Projection:
    """Gauss-Newton from k = start: moves within one scan step, shortened until RSS falls.

    limits: the least and the largest k, and the scan step; tolerance on a move [1/m].
    """
    lowest, highest, step = limits
    here = project(position, phi, min(max(start, lowest), highest))
    move = _newton(here)
    for _ in range(ITERATIONS):
        k = min(max(here.wavenumber + min(max(move, -step), step), lowest), highest)
        if abs(k - here.wavenumber) <= max(tolerance, 1e-15 * k):
            break
        there = project(position, phi, k)
        if there.residual < here.residual:
            here, move = there, _newton(there)
        else:
            move /= 4 if abs(move) > 1e-9 * k else 1e9  # below it, rounding decides
    return here


def _newton(fit: Projection) -> float:
    return -fit.gradient / fit.curvature if fit.curvature > 0 else 0.0
