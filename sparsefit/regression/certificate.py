"""What the caller verifies about a fit; for convex ones a duality gap with a bound of its rounding.

In the notation of `objective`, with R = Y - Z V and, for each target t,

    C = Z'R/m,   r_t = |R_t|^2/m,   q_t = <R_t, Y_t>/m,   y_t = |Y_t|/sqrt(m),   l_t = |V_t|_1,

the dual point s R/m obeys its constraint where s max_g |C_g|/omega_g <= alpha, and there

    P = sum_t r_t/2 + alpha Omega(V),   D = sum_t (s q_t - s^2 r_t/2),   s = q/r, cut to the limit;

targets that the penalty does not couple have an s each. The gap is (P - D) / (|Y|^2/2m). A ridge
mu/2 |V|^2, mu = alpha rho, is k more rows of Z, sqrt(m mu) I, with targets of zero: with F = V
there, C becomes C - mu F, r becomes r + mu |F|^2 and q stays. Where there is no norm, F = C/mu is
the better dual point, and obeys the constraint C = 0 that is left then. max_g |C_g|/omega_g stands
for the dual norm of `objective`. With the root of the mean square as the loss, r = sum_t r_t and
q = sum_t q_t,

    P = y sqrt(r) + alpha Omega(V),   D = s q,   s = y/sqrt(r), cut to the limit,

since the dual point's own constraint is |s R|_F/sqrt(m) <= y (Belloni, Chernozhukov and Wang 2011);
that gap is (P - D) / y^2, y^2 being P at V = 0. C, r and q come from the rows, in m k operations,
or from the Gram matrix G = Z'Z/m and B = Z'Y/m, in k^2:

    C = B - G V,   q_t = y_t^2 - <V_t, B_t>,   r_t = q_t - <V_t, C_t>.

Rounding. With u = 2^-53 and gamma_N = N u/(1 - N u), a sum of N products in any order (in blocks,
in vectors, fused or not) is off by at most gamma_N times the sum of their moduli. Columns of unit
rms turn that, by Cauchy-Schwarz, into gamma_m for an entry of G, gamma_m y_t of B and gamma_m y_t^2
of y_t^2; sums over columns add gamma_k (y_t + l_t). With N = m + 2 k n + 20, where 20 covers the
divisions by m and rms, the rounding of rms and of V = W rms and terms of second order (N < 1e8),

    from G:     |err C| <= gamma_N (y + l),   |err q| <= y |err C|,   |err r| <= (y + l) |err C|
    from rows:  |err C| <= gamma_N a + rho,   |err q| <= y |err C|,   |err r| <= (2a + rho) |err C|

where a = sqrt(r) and rho = gamma_{k + 8} (y + l), by how much the rms of R itself is off.

What these leave open is reported as ``rounding``: the dual point's limit is taken with |C_g| raised
by its error, P and D are moved by theirs, and value + rounding is the relative gap that remains, an
upper bound in exact arithmetic. m is the number of rows held; where these are the triangle of a QR
of more samples, they are the data. No product underflows: `problem` refuses what is so small.

Source: Higham, "Accuracy and Stability of Numerical Algorithms" (2002), sections 3.1 and 3.5.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.objective import Penalty
from sparsefit.regression.statistics import Statistics, row_blocks

CertificateKind = Literal["duality_gap", "normal_equations", "fixed_point"]
UNIT = 2.0**-53  # the relative rounding of one operation


@dataclass(frozen=True)
class Certificate:
    """What the caller verified about a fit.

    ``duality_gap``: (primal - dual) / (|Y|^2 / 2m), an upper bound of the relative suboptimality;
    ``rounding``: what rounding can hide at most, so that value + rounding is a proven bound; NaN
    where none is known.
    ``normal_equations``: largest |v'theta'R| / (s_max |Y|) over the retained right singular
    vectors v of theta.
    ``fixed_point``: share of the coefficients whose membership of the support one more iteration
    would change; it claims no optimum.
    """

    kind: CertificateKind
    value: float
    primal: float = float("nan")
    dual: float = float("nan")
    rounding: float = float("nan")

    @property
    def bound(self) -> float:
        """The value with all that rounding can hide of it; the value where that is not known."""
        return self.value + (0.0 if math.isnan(self.rounding) else self.rounding)

    def proves(self, tolerance: float) -> bool:
        """Whether the value is below the tolerance whatever the rounding was, which is small."""
        return self.rounding <= 0.1 * tolerance and self.bound <= tolerance


@dataclass(frozen=True, eq=False)
class _Residual:
    """C (p, k, n), r and q (p, n) of weights at p penalties, and bounds (p, n) of their errors."""

    correlation: Array
    square: Array
    product: Array
    correlation_error: Array
    square_error: Array
    product_error: Array
    gamma: float


def duality_gaps(
    theta: Array,
    target: Array,
    rms: Array,
    weights: Array,
    alphas: Array,
    penalty: Penalty,
    *,
    samples: int | None = None,
) -> tuple[Certificate, ...]:
    """Certificates from the rows theta (m, k) and target (m, n), with column scales rms (k,).

    weights (p, k, n) in original units, at the penalties alphas (p,). ``samples``: the number m
    that sums are divided by, where the rows are the compressed ones of more samples.
    """
    points, columns, targets = weights.shape
    m = samples or len(theta)
    correlation, square, product = _row_sums(theta, target, weights)
    scaled = weights * rms[:, None]
    target_square = np.einsum("it,it->t", target, target) / m
    gamma = rounding_of(len(theta) + 2 * columns * targets + 20)
    rho, root = rounding_of(columns + 8) * _reach(target_square, scaled), np.sqrt(square / m)
    error = gamma * root + rho
    residual = _Residual(
        (correlation / (rms[:, None] * m)).reshape(columns, points, targets).transpose(1, 0, 2),
        square / m,
        product / m,
        error,
        (2.0 * root + rho) * error,
        np.sqrt(target_square) * error,
        gamma,
    )
    return _certificates(residual, scaled, alphas, penalty, target_square)


def gram_gaps(
    statistics: Statistics, weights: Array, alphas: Array, penalty: Penalty
) -> tuple[Certificate, ...]:
    """The same certificates from the Gram matrix alone, in k^2 operations a point.

    weights (p, k, n) in original units, at the penalties alphas (p,).
    """
    target_square = statistics.target_square
    scaled = weights * statistics.rms[:, None]
    points, columns, targets = scaled.shape
    flat = scaled.transpose(0, 2, 1).reshape(points * targets, columns)
    used = np.flatnonzero(np.any(flat != 0, axis=0))
    few = 2 * len(used) < columns
    fitted = flat[:, used] @ statistics.gram_rows(used) if few else flat @ statistics.gram
    correlation = statistics.cross - fitted.reshape(points, targets, columns).transpose(0, 2, 1)
    product = target_square - np.einsum("pkt,kt->pt", scaled, statistics.cross)
    square = product - np.einsum("pkt,pkt->pt", scaled, correlation)
    gamma = rounding_of(statistics.rows + 2 * columns * targets + 20)
    reach = _reach(target_square, scaled)
    residual = _Residual(
        correlation,
        np.maximum(square, 0.0),
        product,
        gamma * reach,
        gamma * reach**2,
        gamma * reach * np.sqrt(target_square),
        gamma,
    )
    return _certificates(residual, scaled, alphas, penalty, target_square)


def _row_sums(theta: Array, target: Array, weights: Array) -> tuple[Array, Array, Array]:
    """theta'R (k, p n), |R_t|^2 and <R_t, Y_t> (p, n) of R = Y - theta W for weights (p, k, n)."""
    points, columns, targets = weights.shape
    flat = np.ascontiguousarray(weights.transpose(1, 0, 2)).reshape(columns, points * targets)
    used = np.flatnonzero(np.any(flat != 0, axis=1))
    sparse = 2 * len(used) < columns  # gathering columns costs a copy: worth it when few are used
    correlation = np.zeros((columns, points * targets))
    square = np.zeros((points, targets))
    product = np.zeros((points, targets))
    for rows, values in row_blocks(theta, target):
        fitted = rows[:, used] @ flat[used] if sparse else rows @ flat
        residual = values[:, None, :] - fitted.reshape(len(rows), points, targets)
        square += np.einsum("ipt,ipt->pt", residual, residual)
        product += np.einsum("ipt,it->pt", residual, values)
        correlation += rows.T @ residual.reshape(len(rows), points * targets)
    return correlation, square, product


def _certificates(
    residual: _Residual, scaled: Array, alphas: Array, penalty: Penalty, target_square: Array
) -> tuple[Certificate, ...]:
    """Primal, dual and gap at weights V = ``scaled`` (p, k, n), and what rounding leaves open."""
    if penalty.root:
        return _root_certificates(residual, scaled, alphas, penalty, target_square)
    primal = 0.5 * residual.square.sum(axis=1) + alphas * penalty.value(scaled)
    extended = _with_ridge(residual, scaled, alphas, penalty) if penalty.ridge else residual
    peaks, error = _constraint(extended, penalty)
    dual, _ = _dual(extended, alphas, peaks, penalty)
    certain, doubt = _dual(extended, alphas, peaks * (1.0 + residual.gamma) + error, penalty)
    doubt = doubt + 0.5 * residual.square_error.sum(axis=1) + residual.gamma * primal
    return _told(residual, primal, dual, certain - doubt, 0.5 * float(target_square.sum()))


def _root_certificates(
    residual: _Residual, scaled: Array, alphas: Array, penalty: Penalty, target_square: Array
) -> tuple[Certificate, ...]:
    """The same for the root of the mean square, at whose targets one factor s acts."""
    level, gamma = float(np.sqrt(target_square.sum())), residual.gamma
    square, product = residual.square.sum(axis=1), residual.product.sum(axis=1)
    loose, off = residual.square_error.sum(axis=1), residual.product_error.sum(axis=1)
    primal = level * np.sqrt(square) + alphas * penalty.value(scaled)
    peaks, error = (part.max(axis=1) for part in _constraint(residual, penalty))

    def factor(peak: Array, spread: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = np.where(peak > 0, alphas / peak, np.inf), level / np.sqrt(spread)
        least: Array = np.minimum(*limits)
        return np.where(np.isfinite(least), least, 0.0)

    dual = factor(peaks, square) * product
    safe = factor(peaks * (1.0 + gamma) + error, square * (1.0 + gamma) + loose)
    moved = level * (np.sqrt(square + loose) - np.sqrt(np.maximum(square - loose, 0.0)))
    doubt = moved + safe * off + 4.0 * gamma * (primal + safe * np.abs(product))
    return _told(residual, primal, dual, safe * product - doubt, level**2)


def _told(
    residual: _Residual, primal: Array, dual: Array, least: Array, null: float
) -> tuple[Certificate, ...]:
    """Gaps relative to ``null``, the objective at zero; ``least``: D less all that rounding did."""
    null = null or 1.0
    gaps = np.maximum(primal - dual, 0.0) / null
    most = np.maximum(primal - least, 0.0) / null * (1.0 + 2.0 * residual.gamma)
    rounding = np.maximum(most - gaps, 0.0)
    return tuple(
        Certificate("duality_gap", float(g), float(p), float(d), float(r))
        for g, p, d, r in zip(gaps, primal, dual, rounding, strict=True)
    )


def _constraint(residual: _Residual, penalty: Penalty) -> tuple[Array, Array]:
    """The dual norms (p, n), or (p, 1) when joint, of C and bounds of their errors."""
    if penalty.smooth:  # C = 0, by the choice of F
        return (np.zeros((len(residual.square), 1)),) * 2
    peaks = penalty.dual_norms(residual.correlation)
    unit = penalty.dual_norms(np.ones(residual.correlation.shape[1:]))
    error = unit * residual.correlation_error
    return peaks, error.max(axis=1, keepdims=True) if penalty.joint else error


def _with_ridge(residual: _Residual, scaled: Array, alphas: Array, penalty: Penalty) -> _Residual:
    """The residual with the rows of the ridge, whose part of the dual point is F (p, k, n)."""
    mu = (alphas * penalty.ridge)[:, None]
    part, loose = scaled, np.zeros_like(residual.square)
    if penalty.smooth:
        part, loose = residual.correlation / mu[:, None], residual.correlation_error / mu
    pull = mu[:, None] * part  # first: the square of F alone may overflow
    size, total = np.abs(part), np.sum(pull * part, axis=1)
    reach = (2.0 * size.sum(axis=1) + part.shape[1] * loose) * (mu * loose)
    return replace(
        residual,
        correlation=residual.correlation - pull,
        square=residual.square + total,
        correlation_error=residual.correlation_error + residual.gamma * mu * size.max(axis=1),
        square_error=residual.square_error + reach + residual.gamma * total,
    )


def _dual(
    residual: _Residual, alphas: Array, peaks: Array, penalty: Penalty
) -> tuple[Array, Array]:
    """D (p,) at the best s with s * peaks <= alpha, and by how much rounding may have moved it."""
    square, product = residual.square, residual.product
    if penalty.joint:
        square, product = (part.sum(axis=1, keepdims=True) for part in (square, product))
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(peaks > 0, alphas[:, None] / peaks, np.inf)
        best = np.where(square > 0, product / square, 0.0)
    s = np.clip(best, -limit, limit)
    linear, quadratic = s * product, 0.5 * s**2 * square
    error = np.abs(s) * residual.product_error + 0.5 * s**2 * residual.square_error
    rounding = residual.gamma * (np.abs(linear) + quadratic)
    return (linear - quadratic).sum(axis=1), error.sum(axis=1) + rounding.sum(axis=1)


def rounding_of(count: int) -> float:
    """gamma_N = N u / (1 - N u), by how much a sum of N products can be off, relative."""
    return count * UNIT / (1.0 - count * UNIT)


def _reach(target_square: Array, scaled: Array) -> Array:
    """y + l (p, n): the most that a target and its weights can sum up to."""
    reach: Array = np.sqrt(target_square) + np.abs(scaled).sum(axis=1)
    return reach
