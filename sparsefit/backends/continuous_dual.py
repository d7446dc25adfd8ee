"""The dual certificate over a continuum of wavenumbers, as a pure function of the residual.

The group-LASSO over every k of an interval, Z(k) (m, c) the columns at k in unit rms, V_j (c, n)
the weights at k_j:

    P = 1/(2m) |Y - sum_j Z(k_j) V_j|^2 + alpha sum_j |V_j|,    eta(k) = |Z(k)'R| / (m alpha)

R is optimal exactly where eta <= 1 on the whole interval and V_j = |V_j| Z(k_j)'R / (m alpha).
s R / m with s <= 1 / max eta is feasible for the dual, and gives the gap.

The supremum is found and not sampled: entries of Z(k)'R are sums of exp(i k s) with |s| at most the
rows' extent D about their centre, so (Bernstein) a scan of step h misses no peak by more than
(h D)^2 / 8; every grid peak that close to the highest is refined on all rows.
Sources: Bredies and Pikkarainen, "Inverse problems in spaces of measures" (2013); Duval and Peyre,
"Exact support recovery for sparse spikes deconvolution" (2015).
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, local_maxima
from sparsefit.regression.certificate import Certificate
from sparsefit.regression.continuum import Bounds, Continuum, Jet, Scan
from sparsefit.regression.problem import RegressionProblem

SLACK = 0.02  # grid peaks this close to the highest may hold the supremum: three times that
POINTS = 4_000_000  # of a scan: beyond it, memory
NEWTON = 30


@dataclass(frozen=True)
class Peak:
    """A local maximum of eta: where, k, and |Z(k)'R|_F / m there."""

    wavenumber: float
    height: float


@dataclass(frozen=True, eq=False)
class Scanner:
    """An interval of a continuum with its scan, made once for every residual."""

    continuum: Continuum
    bounds: Bounds
    scan: Scan

    @classmethod
    def of(cls, continuum: Continuum, bounds: Bounds) -> "Scanner":
        """The scanner of an interval of k."""
        return cls(continuum, bounds, continuum.scan(bounds))

    def peaks(
        self, residual: Array, *, slack: float = SLACK, most: int | None = None
    ) -> list[Peak]:
        """Local maxima within ``slack`` of the highest, refined on all rows, highest first.

        residual (m, n); most: refine no more than so many of the highest.
        """
        heights = self.scan.heights(residual)
        highest = heights.max()
        tops = [i for i in local_maxima(heights) if heights[i] >= (1 - slack) * highest][:most]
        peaks = []
        for start in self.scan.wavenumbers[tops].tolist():
            k, square = climb(
                lambda k: _height_square(self.continuum, residual, k),
                start,
                self.scan.step,
                self.bounds,
            )
            peaks.append(Peak(k, math.sqrt(square)))
        return sorted(peaks, key=lambda peak: -peak.height)


def climb(
    curve: Callable[[float], tuple[float, float, float]],
    start: float,
    step: float,
    bounds: Bounds,
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


def _height_square(continuum: Continuum, residual: Array, k: float) -> tuple[float, float, float]:
    """|Z'R|^2 / m^2 and its first two derivatives by k."""
    jet = Jet.of(*continuum.columns(np.array([k])))
    c0, c1, c2 = (z[0] @ residual / len(residual) for z in (jet.value, jet.slope, jet.bend))
    turn = 2 * float(np.sum(c1 * c1) + np.sum(c0 * c2))
    return float(np.sum(c0 * c0)), 2 * float(np.sum(c0 * c1)), turn


def continuous_alpha_max(continuum: Continuum, target: Array, bounds: Bounds) -> float:
    """max over k of |Z(k)'Y|_F / m: the smallest alpha whose solution is zero."""
    return Scanner.of(continuum, bounds).peaks(target)[0].height


def continuous_gap(
    problem: RegressionProblem, weights: Array, alpha: float, bounds: Bounds
) -> Certificate:
    """The duality gap over every k of the interval, relative to |Y|^2 / 2m.

    problem: columns of the k that were found, with their continuum; weights (c s, n) in original
    units. The formula is that of a grid's certificate, the dual norm taken over the interval.
    """
    assert problem.continuum is not None
    theta, target, m = problem.theta, problem.target, len(problem.theta)
    residual = target - theta @ weights
    scaled = weights * np.sqrt(np.mean(theta * theta, axis=0))[:, None]
    blocks = scaled.reshape(-1, problem.continuum.size * target.shape[1])
    norms = np.sqrt(np.sum(blocks**2, axis=1))
    top = Scanner.of(problem.continuum, bounds).peaks(residual)[0].height
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
