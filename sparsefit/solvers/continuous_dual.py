"""The dual certificate over a continuum of columns, as a pure function of the residual.

The group-LASSO over every place q of a continuum, Z(q) (m, c) the columns at q in unit rms, V_j
(c, n) the weights at q_j:

    P = 1/(2m) |Y - sum_j Z(q_j) V_j|^2 + alpha sum_j |V_j|,    eta(q) = |Z(q)'R| / (m alpha)

R is optimal exactly where eta <= 1 on the whole continuum and V_j = |V_j| Z(q_j)'R / (m alpha).
s R / m with s <= 1 / max eta is feasible for the dual, and gives the gap.

The supremum is found and not sampled: entries of Z'R are sums of exp(i k.x) with |x| at most the
rows' extent D about their centre, so (Bernstein) a scan no k of which is farther than d from its
grid misses no peak by more than (d D)^2 / 2, d = h/2 along a line of step h; every grid peak that
close to the highest is refined on all rows.

Sources: Bredies and Pikkarainen, "Inverse problems in spaces of measures" (2013); Duval and Peyre,
"Exact support recovery for sparse spikes deconvolution" (2015).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.certificate import Certificate
from sparsefit.regression.continuous_columns import Bounds, Continuum, Scan
from sparsefit.regression.problem import RegressionProblem

FLAT = 1e-9  # curvatures below this, relative, are raised to it: the gradient vanishes there too
Curve = tuple[float, Array, Array]  # a value, its gradient (N,) and its Hessian (N, N)


@dataclass(frozen=True, eq=False)
class Jet:
    """Z(q)' (s, c, m), its first and second derivatives by q, and the rms (s, c) of its columns.

    The derivatives are (s, p, c, m) and (s, p, p, c, m). Columns are of unit rms. One that is zero
    in every row stays zero, with rms 1.
    """

    value: Array
    slope: Array
    bend: Array
    rms: Array

    @classmethod
    def of(cls, value: Array, slope: Array, bend: Array) -> Jet:
        """From columns theta (s, c, m) in original units and their derivatives."""

        def mean(first: Array, second: Array) -> Array:
            own: Array = np.vecdot(first, second) / first.shape[-1]
            return own

        rms = np.sqrt(mean(value, value))
        rms[rms == 0] = 1.0
        value, slope = value / rms[..., None], slope / rms[:, None, :, None]
        bend = bend / rms[:, None, None, :, None]
        # With z = theta / r: r r_p = <theta, theta_p>, and
        # r r_pq + r_p r_q = <theta_p, theta_q> + <theta, theta_pq>.
        first, second = slope[:, :, None], slope[:, None]
        rates = mean(value[:, None], slope)
        rate, other = rates[:, :, None, :, None], rates[:, None, :, :, None]
        turn = mean(first, second) + mean(value[:, None, None], bend)
        turn -= rates[:, :, None] * rates[:, None]
        slope -= value[:, None] * rates[..., None]
        bend -= slope[:, :, None] * other
        bend -= slope[:, None] * rate
        bend -= value[:, None, None] * turn[..., None]
        return cls(value, slope, bend, rms)


def newton(
    curve: Callable[[Array], Curve],
    start: Array,
    box: tuple[Array, Array],
    longest: Array,
    scale: float,
) -> Array:
    """The minimum of a curve that Newton's method reaches from start (N,) in a box, never going up.

    longest (N,): of one move of each variable. Where a predicted fall is below 1e-10 of ``scale``,
    rounding hides it: there full steps are trusted as long as they halve the gradient.
    """
    x = np.clip(start, *box)
    value, slope, bend = curve(x)
    last = math.inf
    for _ in range(60):
        free = np.flatnonzero(((x > box[0]) | (slope < 0)) & ((x < box[1]) | (slope > 0)))
        step = np.zeros_like(x)
        step[free] = _step(slope[free], bend[np.ix_(free, free)])
        step *= min(1.0, 1.0 / max(float(np.abs(step / longest).max()), 1.0))
        predicted, steepness = -float(slope @ step), float(np.linalg.norm(slope[free]))
        settled = predicted <= 1e-10 * scale
        if settled and (steepness >= 0.5 * last or steepness <= 1e-15 * scale):
            break
        last = steepness if settled else math.inf
        for halving in range(25):
            there = np.clip(x + 0.5**halving * step, *box)
            point = curve(there)
            if settled or point[0] <= value - 1e-4 * 0.5**halving * predicted:
                break
        else:
            break
        x, (value, slope, bend) = there, point
    return x


def _step(gradient: Array, hessian: Array) -> Array:
    """Newton's step, with the curvatures' absolute values where they are not all positive."""
    if not len(gradient):
        return gradient
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diagonal(hessian)), 1e-300))
    scaled = hessian * scale[:, None] * scale
    try:
        if np.linalg.cholesky(scaled).diagonal().min() ** 2 > FLAT:
            newton_step: Array = -scale * np.linalg.solve(scaled, scale * gradient)
            return newton_step
    except np.linalg.LinAlgError:
        pass
    roots, vectors = np.linalg.eigh(scaled)
    size = np.maximum(np.abs(roots), FLAT * np.abs(roots).max())
    step: Array = -scale * (vectors @ ((vectors.T @ (scale * gradient)) / size))
    return step


@dataclass(frozen=True, eq=False)
class Scanner:
    """A continuum between bounds of its wavenumber with its scan, made once for every residual."""

    continuum: Continuum
    bounds: Bounds
    scan: Scan

    @classmethod
    def of(cls, continuum: Continuum, bounds: Bounds) -> Scanner:
        """The scanner between bounds of the wavenumber."""
        return cls(continuum, bounds, continuum.scan(bounds))

    def peaks(
        self, residual: Array, pattern: Array | None = None, most: int | None = None
    ) -> list[tuple[Array, float]]:
        """Places q (p,) and heights |Z(q)'R|_F / m of peaks, refined on all rows, highest first.

        residual R (m, n). Peaks are the local maxima within the scan's slack of the highest; of a
        pattern (c, n) the ``most`` highest of |<f, R>| / |f| sqrt(m), f = theta(q) pattern.
        """
        slack = self.scan.slack if pattern is None else 1.0
        starts = zip(*self.scan.tops(residual, slack, pattern), strict=True)
        peaks = [self._climbed(residual, *start, pattern) for start in list(starts)[:most]]
        return sorted(peaks, key=lambda peak: -peak[1])

    def _climbed(
        self, residual: Array, start: Array, reach: Array, pattern: Array | None
    ) -> tuple[Array, float]:
        flat = residual if pattern is None else residual.reshape(-1, 1)

        def curve(q: Array) -> Curve:
            columns = self.continuum.columns(q[None])
            jet = Jet.of(*(columns if pattern is None else known_column(columns, pattern)))
            c0, c1, c2 = (z[0] @ flat / len(flat) for z in (jet.value, jet.slope, jet.bend))
            turn = np.einsum("pcn,qcn->pq", c1, c1) + np.einsum("cn,pqcn->pq", c0, c2)
            return -float(np.sum(c0 * c0)), -2 * np.einsum("cn,pcn->p", c0, c1), -2 * turn

        low, high = start - reach, start + reach
        low[0], high[0] = max(low[0], self.bounds[0]), min(high[0], self.bounds[1])
        place = newton(curve, start, (low, high), reach, -curve(np.clip(start, low, high))[0])
        return place, math.sqrt(-curve(place)[0])


def known_column(columns: tuple[Array, ...], pattern: Array) -> tuple[Array, Array, Array]:
    """The column f = theta(q) S (m n,) for weights S (c, n), in place of theta, with its jet."""
    value, slope, bend = (
        np.einsum("...cm,cn->...mn", part, pattern).reshape(*part.shape[:-2], 1, -1)
        for part in columns
    )
    return value, slope, bend


def continuous_alpha_max(continuum: Continuum, target: Array, bounds: Bounds) -> float:
    """max over q of |Z(q)'Y|_F / m, the smallest alpha whose solution is zero, of a target (m, n).

    bounds: of the wavenumber [1/m].
    """
    return Scanner.of(continuum, bounds).peaks(target)[0][1]


def continuous_gap(
    problem: RegressionProblem, weights: Array, alpha: float, bounds: Bounds
) -> Certificate:
    """The duality gap over every q of the continuum, relative to |Y|^2 / 2m.

    problem: columns of the q that were found, with their continuum; weights (c s, n) in original
    units. The formula is that of a grid's certificate, the dual norm taken over the continuum.
    """
    assert problem.continuum is not None
    residual = problem.target - problem.theta @ weights
    scaled = weights * np.sqrt(np.mean(problem.theta**2, axis=0))[:, None]
    norm = float(block_norms(scaled.reshape(-1, problem.continuum.size, problem.targets)).sum())
    top = Scanner.of(problem.continuum, bounds).peaks(residual)[0][1]
    return gap_of(residual, problem.target, float(alpha), norm, top)


def gap_of(residual: Array, target: Array, alpha: float, norm: float, top: float) -> Certificate:
    """Certificate from R and Y (m, n), sum |V_j| = norm and sup |Z(q)'R| / m = top."""
    m = len(target)
    square, product = float(np.sum(residual**2)), float(np.sum(residual * target))
    limit = alpha / top if top > 0 else math.inf
    s = min(max(product / square if square > 0 else 0.0, -limit), limit)
    primal = square / (2 * m) + alpha * norm
    dual = (s * product - 0.5 * s * s * square) / m
    null = float(np.sum(target**2)) / (2 * m)
    return Certificate("duality_gap", max(primal - dual, 0.0) / (null or 1.0), primal, dual)


def block_norms(weights: Array) -> Array:
    """|V_j| (s,) of weights V (s, c, n)."""
    norms: Array = np.sqrt(np.sum(weights**2, axis=(1, 2)))
    return norms
