"""The dual certificate over a continuum of columns, as a pure function of the residual.

The group-LASSO over every q of a continuum, Z(q) (m, c) the columns at q in unit rms, V_j (c, n)
the weights at q_j:

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

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError, is_number
from sparsefit.regression.backend import Solution
from sparsefit.regression.certificate import Certificate
from sparsefit.regression.continuum import Bounds, Continuum, Jet, Scan
from sparsefit.regression.problem import RegressionProblem

POINTS = 4_000_000  # of a scan: beyond it, memory
NEWTON = 30


@dataclass(frozen=True, eq=False)
class Peak:
    """A local maximum of eta: where, q (p,), and |Z(q)'R|_F / m there."""

    place: Array
    height: float


@dataclass(frozen=True, eq=False)
class Scanner:
    """A continuum between bounds of its wavenumber with its scan, made once for every residual."""

    continuum: Continuum
    bounds: Bounds
    scan: Scan

    @classmethod
    def of(cls, continuum: Continuum, bounds: Bounds) -> "Scanner":
        """The scanner between bounds of the wavenumber."""
        return cls(continuum, bounds, continuum.scan(bounds))

    def peaks(self, residual: Array) -> list[Peak]:
        """Local maxima within the scan's slack of the highest, refined on all rows, highest first.

        residual (m, n).
        """
        peaks = []
        for start, reach in zip(*self.scan.tops(residual, self.scan.slack), strict=True):
            place, square = climb(
                lambda q: _height_square(self.continuum, residual, q), start, reach, self.bounds
            )
            peaks.append(Peak(place, math.sqrt(square)))
        return sorted(peaks, key=lambda peak: -peak.height)


def climb(
    curve: Callable[[Array], tuple[float, Array, Array]],
    start: Array,
    reach: Array,
    bounds: Bounds,
) -> tuple[Array, float]:
    """(q, height) of the peak of a curve within reach (p,) of start (p,), by Newton's method.

    curve(q) gives height, gradient (p,) and Hessian (p, p); the first of q stays in bounds.
    """
    low, high = start - reach, start + reach
    low[0], high[0] = max(low[0], bounds[0]), min(high[0], bounds[1])
    best = np.clip(start, low, high)
    height, rate, turn = curve(best)
    last = math.inf
    for _ in range(NEWTON):
        free = ((best > low) | (rate > 0)) & ((best < high) | (rate < 0))
        q = np.clip(best + _uphill(rate, turn, reach, free), low, high)
        size = float(np.max(np.abs(q - best) / reach))
        if np.all(np.abs(q - best) <= 1e-15 * np.abs(best)) or size >= last:
            break
        found = curve(q)
        while found[0] < height * (1 - 1e-13) and np.any(np.abs(q - best) > 1e-12 * np.abs(best)):
            q, size = 0.5 * (q + best), 0.5 * size
            found = curve(q)
        if size < 1e-6:  # heights differ by rounding: moves that grow are noise
            last = size
        best, (height, rate, turn) = q, found
    return best, height


def _uphill(rate: Array, turn: Array, reach: Array, free: BoolArray) -> Array:
    """Newton's move (p,) of what is free; a quarter of the reach where a curve is not concave."""
    move = np.zeros_like(rate)
    roots, axes = np.linalg.eigh((turn * np.outer(reach, reach))[np.ix_(free, free)])
    slopes = axes.T @ (rate * reach)[free]
    concave = roots < 0
    moves = np.where(concave, -slopes / np.where(concave, roots, 1.0), np.copysign(0.25, slopes))
    move[free] = reach[free] * (axes @ moves)
    return move


def _height_square(continuum: Continuum, residual: Array, q: Array) -> tuple[float, Array, Array]:
    """|Z'R|^2 / m^2 and its gradient and Hessian by q."""
    jet = Jet.of(*continuum.columns(q[None]))
    c0, c1, c2 = (z[0] @ residual / len(residual) for z in (jet.value, jet.slope, jet.bend))
    turn = np.einsum("pcn,qcn->pq", c1, c1) + np.einsum("cn,pqcn->pq", c0, c2)
    return float(np.sum(c0 * c0)), 2 * np.einsum("cn,pcn->p", c0, c1), 2 * turn


def continuous_alpha_max(continuum: Continuum, target: Array, bounds: Bounds) -> float:
    """max over q of |Z(q)'Y|_F / m, the smallest alpha whose solution is zero, of a target (m, n).

    bounds: of the wavenumber [1/m].
    """
    return Scanner.of(continuum, bounds).peaks(target)[0].height


def continuous_gap(
    problem: RegressionProblem, weights: Array, alpha: float, bounds: Bounds
) -> Certificate:
    """The duality gap over every q of the continuum, relative to |Y|^2 / 2m.

    problem: columns of the q that were found, with their continuum; weights (c s, n) in original
    units. The formula is that of a grid's certificate, the dual norm taken over the continuum.
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
    """Certificate from R and Y (m, n), sum |V_j| = norm and sup |Z(q)'R| / m = top."""
    square, product = float(np.sum(residual**2)), float(np.sum(residual * target))
    limit = alpha / top if top > 0 else math.inf
    s = min(max(product / square if square > 0 else 0.0, -limit), limit)
    primal = square / (2 * m) + alpha * norm
    dual = (s * product - 0.5 * s * s * square) / m
    null = float(np.sum(target**2)) / (2 * m)
    return Certificate("duality_gap", max(primal - dual, 0.0) / (null or 1.0), primal, dual)


def places_of(solution: Solution) -> tuple[Array, Array]:
    """The places q (s, p) and weights (c s, n) of a solution with a problem of its own."""
    assert solution.problem is not None
    assert solution.problem.continuum is not None
    assert solution.problem.parameters is not None
    assert solution.weights is not None
    return solution.problem.continuum.places(solution.problem.parameters), solution.weights


def refusal(
    name: str, problem: RegressionProblem, lower: float | None, upper: float | None
) -> Solution | None:
    """Why a back-end that makes its own columns cannot search [lower, upper]; None if it can.

    A problem without a continuum, rows in one place, more scan points than memory holds.
    """
    continuum = problem.continuum
    if continuum is None:
        return Solution(
            None,
            "error",
            f"{name} makes its own columns and needs the position of every row; build the problem "
            "with Library of family 'cells', or of one flight 'waves' in groups by wave, where the "
            "vehicle is known and whose columns fit in memory (a coarser grid or fewer samples "
            "where they do not), not in the weak form; or use group-lasso",
        )
    if not continuum.extent > 0:
        return Solution(None, "unidentifiable", f"{name}: the flight stands still: no extent")
    if continuum.scan_points(continuum.interval(lower, upper)) > POINTS:
        return Solution(
            None,
            "error",
            f"{name}: the extent of the flight holds more than {POINTS} scan points "
            "between the bounds; raise lower, or use fewer cells of the flight",
        )
    return None


def checked_bounds(name: str, lower: float | None, upper: float | None) -> None:
    """Raise InputError unless the bounds [m] are positive and in order; None is open."""
    for key, value in (("lower", lower), ("upper", upper)):
        if value is not None and not is_number(value, 0.0, open_low=True):
            raise InputError(f"{name}: {key} must be a length above 0 m, not {value!r}")
    if lower is not None and upper is not None and lower > upper:
        raise InputError(f"{name}: lower ({lower:g} m) is above upper ({upper:g} m); swap them")
