"""The dual certificate over a continuum of wavenumbers, as a pure function of the residual.

The group-LASSO over every length scale of an interval, Z(k) (m, 8) the candidates at k = pi/L in
columns of unit rms, V_j (8, n) the weights at k_j:

    P = 1/(2m) |Y - sum_j Z(k_j) V_j|^2 + alpha sum_j |V_j|,    eta(k) = |Z(k)'R| / (m alpha)

R is optimal exactly where eta <= 1 on the whole interval and V_j = |V_j| Z(k_j)'R / (m alpha).
s R / m with s <= 1 / max eta is feasible for the dual, and gives the gap.

The supremum is found and not sampled: entries of Z(k)'R are sums of exp(i k s) with |s| at most the
flight's extent D about its centre, so (Bernstein) a scan of step h misses no peak by more than
(h D)^2 / 8; every grid peak that close to the highest is refined on all rows.
Sources: Bredies and Pikkarainen, "Inverse problems in spaces of measures" (2013); Duval and Peyre,
"Exact support recovery for sparse spikes deconvolution" (2015).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, ComplexArray, IntArray
from sparsefit.modes.refine import fourier_sums, kernel_gain
from sparsefit.regression.certificate import Certificate
from sparsefit.regression.problem import RegressionProblem

Interval = tuple[float, float]

STEP = 0.15  # of the scan, in 1/extent: peaks of |Z'R|^2 are met within 0.6 %
SLACK = 0.02  # grid peaks this close to the highest may hold the supremum: three times that
POINTS = 4_000_000  # of a scan: beyond it, memory
NEWTON = 30


@dataclass(frozen=True)
class Peak:
    """A local maximum of eta: where, k [1/m], and |Z(k)'R|_F / m there."""

    wavenumber: float
    height: float


@dataclass(frozen=True, eq=False)
class Jet:
    """Z(k)' and its first and second derivatives by k (s, 8, m), and the rms (s, 8) of theta.

    A column that is zero in every row stays zero, with rms 1.
    """

    value: Array
    slope: Array
    bend: Array
    rms: Array

    @classmethod
    def at(cls, position: Array, wavenumbers: Array) -> "Jet":
        """The unit-rms candidates at each wavenumber (s,), for position (m, 2)."""
        theta, first, second = _candidates(position, np.atleast_1d(wavenumbers))
        rms = np.sqrt(_mean(theta, theta))
        rms[rms == 0] = 1.0
        # With z = theta / r: r r' = <theta, theta'>, r r'' + r'^2 = |theta'|^2 + <theta, theta''>.
        for part in (theta, first, second):
            part /= rms[..., None]
        rate = _mean(theta, first)
        turn = _mean(first, first) + _mean(theta, second) - rate * rate
        first -= theta * rate[..., None]
        second -= 2 * first * rate[..., None] + theta * turn[..., None]
        return cls(theta, first, second, rms)


def _mean(one: Array, other: Array) -> Array:
    mean: Array = np.einsum("scm,scm->sc", one, other) / one.shape[-1]
    return mean


def _candidates(position: Array, k: Array) -> Array:
    """The 8 candidates in the order of CANDIDATES and two derivatives by k: (3, s, 8, m)."""
    x, y = position[:, 0], position[:, 1]
    sin_x, cos_x, sin_y, cos_y = (f(np.outer(k, s)) for s in (x, y) for f in (np.sin, np.cos))
    out = np.empty((3, len(k), 8, len(x)))
    along_x = (sin_x, x * cos_x, -x * x * sin_x), (cos_x, -x * sin_x, -x * x * cos_x)
    along_y = (sin_y, y * cos_y, -y * y * sin_y), (cos_y, -y * sin_y, -y * y * cos_y)
    for i, (a, b) in enumerate(zip(along_x, along_y, strict=True)):
        out[:, :, 2 * i], out[:, :, 2 * i + 1] = a, b
    for i, a in enumerate(along_x):
        for j, b in enumerate(along_y):
            column = out[:, :, 4 + 2 * i + j]
            column[0], column[1] = a[0] * b[0], a[1] * b[0] + a[0] * b[1]
            column[2] = a[2] * b[0] + 2 * a[1] * b[1] + a[0] * b[2]
    return out


@dataclass(frozen=True, eq=False)
class Scanner:
    """|Z(k)'R| / m at wavenumbers (q,), a uniform grid that resolves every lobe, for any R.

    What does not depend on R is made once: the rms of the columns (q, 8) from Fourier sums, the
    phases of the flight's centre.
    """

    position: Array
    bounds: Interval
    wavenumbers: Array
    scale: Array
    step: float
    sums: "FourierSums"

    @classmethod
    def of(cls, position: Array, bounds: Interval) -> "Scanner":
        """A scanner over the interval bounds of k [1/m] for the rows at position (m, 2) [m]."""
        step, first, last = _grid(position, bounds)
        k = step * np.arange(first, last + 1)
        sums = FourierSums.of(position, step, first, last)
        found = (sums(2 * mode, _NONE)[0] for mode in MODES)
        c_x, c_y, c_plus, c_minus = (s.real / len(position) for s in found)
        pair, cross = c_x + c_y, 0.5 * (c_plus + c_minus)
        squares = [(1 - c_x) / 2, (1 - c_y) / 2, (1 + c_x) / 2, (1 + c_y) / 2]
        squares += [(1 - pair + cross) / 4, (1 - c_x + c_y - cross) / 4]
        squares += [(1 + c_x - c_y - cross) / 4, (1 + pair + cross) / 4]
        # Below the sums' error a column's rms is unknown: the refinement sees the exact one.
        scale = np.sqrt(np.maximum(np.stack(squares, axis=-1), 1e-6))
        return cls(position, bounds, k.astype(float, copy=False), scale, step, sums)

    def heights(self, residual: Array) -> Array:
        """|Z(k)'R|_F / m (q,) for the residual (m, n), to about 1e-6 of its largest value."""
        loads = np.ascontiguousarray(residual.T) / len(residual)
        # Means of R exp(-i k s), s = x, y, x + y, x - y.
        along_x, along_y, plus, minus = (self.sums(mode, loads)[1:] for mode in MODES)
        products = [
            0.5 * (minus.real - plus.real),  # sin sin
            -0.5 * (plus.imag + minus.imag),  # sin x cos y
            -0.5 * (plus.imag - minus.imag),  # cos x sin y
            0.5 * (plus.real + minus.real),  # cos cos
        ]
        singles = [-along_x.imag, -along_y.imag, along_x.real, along_y.real]
        squares = np.sum(np.square(np.stack(singles + products)), axis=1)  # (8, q)
        heights: Array = np.sqrt(np.sum(squares / np.square(self.scale.T), axis=0))
        return heights

    def peaks(
        self, residual: Array, *, slack: float = SLACK, most: int | None = None
    ) -> list[Peak]:
        """Local maxima within ``slack`` of the highest, refined on all rows, highest first.

        most: refine no more than so many of the highest.
        """
        heights = self.heights(residual)
        padded = np.concatenate([[-np.inf], heights, [-np.inf]])
        top = (heights >= padded[:-2]) & (heights >= padded[2:])
        chosen = np.flatnonzero(top & (heights >= (1 - slack) * heights.max()))
        chosen = chosen[np.argsort(-heights[chosen], kind="stable")][:most]
        found = [self._refined(residual, float(k)) for k in self.wavenumbers[chosen]]
        return sorted(found, key=lambda peak: -peak.height)

    def _refined(self, residual: Array, start: float) -> Peak:
        k, square = climb(
            lambda k: _height_square(self.position, residual, k), start, self.step, self.bounds
        )
        return Peak(k, math.sqrt(square))


def climb(
    curve: Callable[[float], tuple[float, float, float]],
    start: float,
    step: float,
    bounds: Interval,
) -> tuple[float, float]:
    """(k, height) of the peak of a curve within one step of start, by Newton's method.

    curve(k) gives height, slope and curvature; k stays in bounds.
    """
    low, high = max(start - step, bounds[0]), min(start + step, bounds[1])
    best = k = min(max(start, low), high)
    height, rate, turn = curve(best)
    last = math.inf
    for _ in range(NEWTON):
        move = -rate / turn if turn < 0 else math.copysign(0.25 * step, rate)
        k = min(max(best + move, low), high)
        if abs(k - best) <= 1e-15 * best or abs(k - best) >= last:
            break
        found = curve(k)
        while found[0] < height * (1 - 1e-13) and abs(k - best) > 1e-12 * best:
            k = 0.5 * (k + best)
            found = curve(k)
        if abs(k - best) < 1e-6 * step:  # heights differ by rounding: moves that grow are noise
            last = abs(k - best)
        best, (height, rate, turn) = k, found
    return best, height


def _height_square(position: Array, residual: Array, k: float) -> tuple[float, float, float]:
    """|Z'R|^2 / m^2 and its first two derivatives by k."""
    jet = Jet.at(position, np.array([k]))
    m = len(position)
    c0, c1, c2 = (z[0] @ residual / m for z in (jet.value, jet.slope, jet.bend))
    turn = 2 * float(np.sum(c1 * c1) + np.sum(c0 * c2))
    return float(np.sum(c0 * c0)), 2 * float(np.sum(c0 * c1)), turn


MODES = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
_NONE = np.empty((0, 0))


def scan_points(position: Array, bounds: Interval) -> int:
    """How many wavenumbers a scan takes: grows with the extent and the interval."""
    extent = float(np.ptp(position, axis=0).max())
    return math.ceil(bounds[1] * extent / STEP) + 1


def _grid(position: Array, bounds: Interval) -> tuple[float, int, int]:
    """(step, first, last): k = j step, the first exactly the lower bound, the last at the upper."""
    extent = float(np.ptp(position, axis=0).max())
    first = max(1, math.ceil(bounds[0] * extent / STEP))
    step = bounds[0] / first
    return step, first, max(first, math.ceil(bounds[1] / step * (1 - 1e-12)))


@dataclass(frozen=True, eq=False)
class FourierSums:
    """Sums of w exp(-i k s) on the grid of k, s = mode . position, by non-uniform Fourier sums."""

    centred: Array
    centre: Array
    step: float
    numbers: IntArray
    gain: Array
    size: int

    @classmethod
    def of(cls, position: Array, step: float, first: int, last: int) -> "FourierSums":
        """The sums at k = j step, j = first..last, over rows at position (m, 2)."""
        centre = 0.5 * (position.max(axis=0) + position.min(axis=0))
        gain, size = kernel_gain(first, last)
        return cls(
            position - centre, centre, step, np.arange(first, last + 1, dtype=np.intp), gain, size
        )

    def __call__(self, mode: Array, loads: Array) -> ComplexArray:
        """(1 + n, q): for w = 1 and for each row of loads (n, m)."""
        sums = fourier_sums(self.centred @ mode, loads, self.step, self.size)
        phase = np.exp(-1j * float(self.centre @ mode) * self.step * self.numbers)
        turned: ComplexArray = sums[:, self.numbers] * (phase / self.gain)
        return turned


def continuous_alpha_max(position: Array, target: Array, bounds: Interval) -> float:
    """max over k of |Z(k)'Y|_F / m: the smallest alpha whose solution is zero."""
    return Scanner.of(position, bounds).peaks(target)[0].height


def continuous_gap(
    problem: RegressionProblem, weights: Array, alpha: float, bounds: Interval
) -> Certificate:
    """The duality gap over every k of the interval bounds [1/m], relative to |Y|^2 / 2m.

    problem: columns of the found scales, with their position; weights (8 s, n) in original units.
    The same formula as `objective.duality_gaps`, the dual norm taken over the interval.
    """
    assert problem.position is not None
    theta, target, m = problem.theta, problem.target, len(problem.theta)
    residual = target - theta @ weights
    scaled = weights * np.sqrt(np.mean(theta * theta, axis=0))[:, None]
    norms = np.sqrt(np.sum(scaled.reshape(-1, 8 * target.shape[1]) ** 2, axis=1))
    top = Scanner.of(problem.position, bounds).peaks(residual)[0].height
    return gap_of(residual, target, float(alpha), float(norms.sum()), top, m)


def gap_of(
    residual: Array, target: Array, alpha: float, norm: float, top: float, m: int
) -> Certificate:
    """Certificate from R, sum |V_j| = norm and sup |Z(k)'R| / m = top."""
    square, product = float(np.sum(residual**2)), float(np.sum(residual * target))
    limit = alpha / top if top > 0 else math.inf
    s = min(max(product / square if square > 0 else 0.0, -limit), limit)
    primal = square / (2 * m) + alpha * norm
    dual = (s * product - 0.5 * s * s * square) / m
    null = float(np.sum(target**2)) / (2 * m)
    return Certificate("duality_gap", max(primal - dual, 0.0) / (null or 1.0), primal, dual)
