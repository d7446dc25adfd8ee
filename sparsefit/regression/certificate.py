"""What the caller verifies about a fit; for convex ones a duality gap with a bound of its rounding.

In the notation of `losses` and `penalties`, with R = Y - Z V, u the derivative of the loss by R
(times m) and, for each target t,

    C = Z'u/m,   r_t = |u_t|^2/m,   q_t = <u_t, Y_t>/m,   y_t = |Y_t|/sqrt(m),   l_t = |V_t|_1,

the dual point s u/m obeys its constraint where s times the dual norm of C is <= alpha, and there
the loss gives P and D; targets that nothing couples have an s each. The gap is P - D over P at
V = 0. A ridge mu/2 |V|^2, mu = alpha rho, is k more rows of Z, sqrt(m mu) I, with targets of zero:
with F = V there, C becomes C - mu F, r becomes r + mu |F|^2 and q stays. Where there is no norm,
F = C/mu is the better dual point, and obeys the constraint C = 0 that is left then. C, r and q come
from the rows, in m k operations, or from the Gram matrix G = Z'Z/m and B = Z'Y/m, in k^2:

    C = B - G V,   q_t = y_t^2 - <V_t, B_t>,   r_t = q_t - <V_t, C_t>.

Rounding. With u = 2^-53 and gamma_N = N u/(1 - N u), a sum of N products in any order (in blocks,
in vectors, fused or not) is off by at most gamma_N times the sum of their moduli; N is the number
of `terms` of the design where rows are summed in blocks. Columns of unit rms turn that, by
Cauchy-Schwarz, into gamma_N for an entry of G, gamma_N y_t of B and gamma_N y_t^2 of y_t^2; sums
over the c columns in use add gamma_c (y_t + l_t). With N more by 2 c n + 20, where 20 covers the
divisions by m and rms, the rounding of rms and of V = W rms and terms of second order (N < 1e8),

    from G:     |err C| <= gamma_N (y + l),   |err q| <= y |err C|,   |err r| <= (y + l) |err C|
    from rows:  |err C| <= gamma_N a + rho,   |err q| <= y |err C|,   |err r| <= (2a + rho) |err C|

where a = sqrt(r) and rho = gamma_{c + 8} (y + l), by how much the rms of R itself is off; both are
larger by the `spread` of a design off which a mean was taken.

What these leave open is reported as ``rounding``: the dual point's limit is taken with |C| raised
by its error, P and D are moved by theirs, and value + rounding is the relative gap that remains, an
upper bound in exact arithmetic. No product underflows: `problem` refuses what is so small.

Where a square-root fit leaves no residual, s R says nothing of the dual optimum of

    y |Y - Z V|_F/sqrt(m) + alpha |V|_1:   max <U, Y>/m,  |Z'U|_max/m <= alpha,  |U|_F <= sqrt(m) y.

But an optimum of weights with signs s on columns A has Z_A'U/m = alpha s there, and of all these U
that of least norm is Z_A u, u = G_AA^-1 s alpha. It is scaled until it obeys both constraints on
all columns (`sharpened`): a feasible point whatever the signs are, and so a bound. Rounding there,
with |u_t|_1 the sum of moduli:

    |err Z'U/m| <= gamma |u_t|_1,   |err |U|^2/m| <= gamma sum |u_t|_1^2,   |err <U, Y>/m| <= gamma
    sum |u_t|_1 y_t,   and the norm of R over sqrt(m) is off by gamma sqrt(r) + gamma (y_t + l_t).

Source: Higham, "Accuracy and Stability of Numerical Algorithms" (2002), sections 3.1 and 3.5.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from sparsefit.arrays import Array
from sparsefit.regression.design import Design, Statistics
from sparsefit.regression.losses import RootSquares
from sparsefit.regression.penalties import Penalty, SquaredNorm

CertificateKind = Literal["duality_gap", "normal_equations", "fixed_point"]


@dataclass(frozen=True)
class Certificate:
    """The bound that the caller verified of a fit.

    ``duality_gap``: (primal - dual) over the primal at zero weights, an upper bound of the relative
    suboptimality; ``rounding``: what rounding can hide at most, so that value + rounding is a
    proven bound; NaN where none is known.
    ``normal_equations``: largest |v'theta'R| / (s_max |Y|) over the retained right singular
    vectors v of theta.
    ``fixed_point``: the larger of two: the share of the coefficients whose membership of the
    support one more iteration would change, and by how much it would move the fit, |Z dV| / |Y|;
    it claims no optimum.
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
    """C (p, k, n), r, q and <u, R>/m (p, n) at p penalties, and bounds (p, n) of their errors."""

    correlation: Array
    square: Array
    product: Array
    overlap: Array
    correlation_error: Array
    square_error: Array
    product_error: Array
    gamma: float


def duality_gaps(
    design: Design, target: Array, weights: Array, alphas: Array, penalty: Penalty
) -> tuple[Certificate, ...]:
    """Certificates from the rows of a design and the target (m, n).

    weights (p, k, n) in original units, at the penalties alphas (p,).
    """
    points, (rows, n) = len(weights), target.shape
    target_square = np.einsum("it,it->t", target, target) / design.samples
    level, certificates = np.sqrt(target_square), []
    step = max(2**22 // (n * max(rows, design.shape[1])), 1)
    for start in range(0, points, step):
        part = slice(start, min(start + step, points))
        scaled = weights[part] * design.rms[:, None]
        count = len(scaled)
        values = np.ascontiguousarray(scaled.transpose(1, 0, 2)).reshape(-1, count * n)
        wide, bound = np.tile(target, (1, count)), np.tile(penalty.loss.bound(level), count)
        rest = wide - design.predict(values)
        pull = rest if np.isinf(bound).all() else np.clip(rest, -bound, bound)
        square, product, overlap = (
            np.einsum("iq,iq->q", pull, other).reshape(count, n) / design.samples
            for other in (pull, wide, rest)
        )
        used = int(np.count_nonzero(values.any(axis=1)))
        gamma = rounding_of(design.terms + 2 * used * n + 20)
        reach, root = level + np.abs(scaled).sum(axis=1), np.sqrt(square)
        rho = design.spread * rounding_of(used + 8) * reach
        error = design.spread * gamma * root + rho
        correlation = design.correlate(pull).reshape(-1, count, n).transpose(1, 0, 2)
        errors = (error, (2.0 * root + rho) * error, level * error)
        residual = _Residual(correlation, square, product, overlap, *errors, gamma)
        null = np.full(n, np.inf)
        if np.isfinite(penalty.loss.clip):
            cut = np.clip(target, -penalty.loss.bound(level), penalty.loss.bound(level))
            null = np.einsum("it,it->t", cut, target - 0.5 * cut) / design.samples
        certificates += _certificates(residual, scaled, alphas[part], penalty, level, null)
    return tuple(certificates)


def gram_gaps(
    statistics: Statistics, weights: Array, alphas: Array, penalty: Penalty
) -> tuple[Certificate, ...]:
    """Certificates from the Gram matrix alone, in k^2 operations a point.

    weights (p, k, n) in original units, at the penalties alphas (p,); for losses without a clip.
    """
    target_square, design = statistics.target_square, statistics.design
    scaled = weights * design.rms[:, None]
    points, columns, targets = scaled.shape
    flat = scaled.transpose(0, 2, 1).reshape(points * targets, columns)
    used = np.flatnonzero(np.any(flat != 0, axis=0))
    few = 2 * len(used) < columns
    fitted = flat[:, used] @ design.gram_rows(used) if few else flat @ design.gram
    correlation = statistics.cross - fitted.reshape(points, targets, columns).transpose(0, 2, 1)
    product = target_square - np.einsum("pkt,kt->pt", scaled, statistics.cross)
    square = np.maximum(product - np.einsum("pkt,pkt->pt", scaled, correlation), 0.0)
    gamma = design.spread**2 * rounding_of(design.terms + 2 * len(used) * targets + 20)
    level = np.sqrt(target_square)
    reach = level + np.abs(scaled).sum(axis=1)
    errors = (gamma * reach, gamma * reach**2, gamma * reach * level)
    residual = _Residual(correlation, square, product, square, *errors, gamma)
    null = np.full(targets, np.inf)
    return tuple(_certificates(residual, scaled, alphas, penalty, level, null))


def _certificates(
    residual: _Residual, scaled: Array, alphas: Array, penalty: Penalty, level: Array, null: Array
) -> list[Certificate]:
    """Primal, dual and gap at weights V = ``scaled`` (p, k, n), and what rounding leaves open.

    null (n,): the loss at zero weights, infinite for the squares'.
    """
    loss, gamma = penalty.loss, residual.gamma
    size = penalty.value(scaled)
    primal = loss.primal(residual.square, residual.overlap, level) + alphas * size
    extended = _with_ridge(residual, scaled, alphas, penalty) if penalty.ridge else residual
    # The gauges (p, n), or (p, 1) where targets are coupled, of C and of what C may be.
    peaks = penalty.constraint(extended.correlation)
    raised = penalty.constraint(extended.correlation, extended.correlation_error)
    if penalty.coupled:
        peaks, raised = (part.max(axis=1, keepdims=True) for part in (peaks, raised))
    dual, _ = _dual(extended, alphas, peaks, extended.square, penalty, level)
    square = extended.square * (1.0 + gamma) + extended.square_error
    square = square if isinstance(loss, RootSquares) else extended.square  # a limit of s there
    certain, doubt = _dual(extended, alphas, raised * (1.0 + gamma), square, penalty, level)
    if isinstance(loss, RootSquares):
        square, loose = residual.square.sum(axis=1), residual.square_error.sum(axis=1)
        moved = np.sqrt(square + loose) - np.sqrt(np.maximum(square - loose, 0.0))
        doubt = doubt + np.sqrt(np.sum(level**2)) * moved + gamma * primal
        whole = float(np.sum(level**2))
    else:
        doubt = doubt + 0.5 * residual.square_error.sum(axis=1) + gamma * primal
        whole = float(np.minimum(null, 0.5 * level**2).sum())
    whole = whole or 1.0
    gaps = np.maximum(primal - dual, 0.0) / whole
    most = np.maximum(primal - (certain - doubt), 0.0) / whole * (1.0 + 2.0 * gamma)
    rounding = np.maximum(most - gaps, 0.0)
    return [
        Certificate("duality_gap", float(g), float(p), float(d), float(r))
        for g, p, d, r in zip(gaps, primal, dual, rounding, strict=True)
    ]


def _with_ridge(residual: _Residual, scaled: Array, alphas: Array, penalty: Penalty) -> _Residual:
    """The residual with the rows of the ridge, whose part of the dual point is F (p, k, n)."""
    mu = (alphas * penalty.ridge)[:, None]
    part, loose = scaled, np.zeros_like(residual.square)
    if isinstance(penalty, SquaredNorm):
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
    residual: _Residual,
    alphas: Array,
    peaks: Array,
    limiting: Array,
    penalty: Penalty,
    level: Array,
) -> tuple[Array, Array]:
    """D (p,) at the best s with s * peaks <= alpha, and by how much rounding may have moved it.

    limiting (p, n): the r that s is chosen by.
    """
    square, product, gamma = residual.square, residual.product, residual.gamma
    off, loose = residual.product_error, residual.square_error
    if penalty.coupled:
        square, product = (part.sum(axis=1, keepdims=True) for part in (square, product))
        off, loose = (part.sum(axis=1, keepdims=True) for part in (off, loose))
        limiting = limiting.sum(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        limit = np.where(peaks > 0, alphas[:, None] / peaks, np.inf)
    s = penalty.loss.factor(limiting, product, limit, level)
    value = penalty.loss.dual(s, square, product)
    error = np.abs(s) * off + 0.5 * s**2 * loose
    rounding = gamma * (4.0 * np.abs(s * product) + 0.5 * s**2 * square)
    size = np.abs(s) * residual.correlation_error
    shape = residual.correlation.shape
    spread = np.broadcast_to(size.max(axis=1)[:, None, None], shape)
    none = np.zeros(len(alphas))
    beyond = penalty.excess(s[:, None, :] * residual.correlation, alphas)
    loose_excess = penalty.excess(spread, none) + penalty.excess(-spread, none)
    total = (error + rounding).sum(axis=1) + loose_excess + gamma * beyond
    return value.sum(axis=1) - beyond, total


def sharpened(
    statistics: Statistics, weights: Array, alpha: float, plain: Certificate, floor: float
) -> Certificate:
    """The certificate ``plain`` of weights (k, n), or that of their signs where it proves more.

    plain: of a square-root fit, from the rows; alpha: the penalty, in the unit of Z'Y/m; floor: a
    share of the largest weight, below which a weight has no sign, such as an interior point's.
    """
    columns, targets = weights.shape
    design = statistics.design
    scaled = weights * design.rms[:, None]
    large = np.abs(scaled) > floor * np.abs(scaled).max()
    used = np.flatnonzero(large.any(axis=1))
    if not len(used):
        return plain
    rows, signs = design.gram_rows(used), np.where(large, np.sign(scaled), 0.0)[used]
    multipliers = np.zeros(signs.shape)
    for target, column in enumerate(signs.T):
        on = np.flatnonzero(column)
        square = rows[np.ix_(on, used[on])]
        multipliers[on, target] = np.linalg.lstsq(square, column[on], rcond=None)[0]
    pulls = rows.T @ multipliers
    norm = float(np.sum(multipliers * pulls[used]))
    product = float(np.sum(multipliers * statistics.cross[used]))
    if not (product > 0.0 and norm > 0.0):
        return plain
    gamma = rounding_of(design.terms + 2 * columns * targets + 20)
    size, level = np.abs(multipliers).sum(axis=0), np.sqrt(statistics.target_square)
    peak, total = float(np.abs(pulls).max()), float(np.sqrt(np.sum(level**2)))
    dual = min(alpha / peak, total / np.sqrt(norm)) * product
    wider = peak * (1.0 + gamma) + gamma * float(size.max())
    longer = norm * (1.0 + gamma) + gamma * float(np.sum(size**2))
    sure = min(alpha / wider, total / np.sqrt(longer)) * (product - gamma * float(size @ level))
    reach = float(np.sum(level + np.abs(scaled).sum(axis=0)))
    doubt = total * gamma * (total + reach) + 4.0 * gamma * (plain.primal + abs(dual))
    value = max(plain.primal - dual, 0.0) / total**2
    most = max(plain.primal - sure + doubt, 0.0) / total**2
    if max(value, most) >= plain.bound:
        return plain
    return replace(plain, value=value, dual=dual, rounding=max(most - value, 0.0))


def rounding_of(count: int) -> float:
    """gamma_N = N u / (1 - N u), by how much a sum of N products can be off, relative."""
    unit = 2.0**-53  # the relative rounding of one operation
    return count * unit / (1.0 - count * unit)
