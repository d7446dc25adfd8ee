"""Certificates of fits: for convex penalties a duality gap with a bound of its rounding error.

In the notation of `losses` and `penalties`, with R = Y - Z V, u the derivative of the loss by R
(times m) and, for each target t,

    C = Z'u/m,   r_t = |u_t|^2/m,   q_t = <u_t, Y_t>/m,   y_t = |Y_t|/sqrt(m),   l_t = |V_t|_1,

the loss gives P and, at the dual point s u/m, D, less the penalty's conjugate at s C: that of a
norm is 0 where s times the dual norm of C is <= alpha, and infinite elsewhere. For bounded weights
it is finite, and s = 1 is the best at the optimum; s is tried from 1 down, as wide bounds make any
excess of C over alpha by rounding expensive. Targets that no block couples have an s each. The gap
is P - D over P at V = 0. A ridge mu/2 |V|^2, mu = alpha rho, is k more rows of Z, sqrt(m mu) I,
with targets of zero: with F = V there, C becomes C - mu F, r becomes r + mu |F|^2 and q stays.
Without a norm, F = C/mu is the better dual point, and obeys the remaining constraint C = 0.

Where a square-root fit has no residual, s R is no approximation of the dual optimum. But at an
optimum of weights with signs s on columns A, Z_A'u/m = alpha s, and of all these u that of least
norm is Z_A w, w = G_AA^-1 s alpha. It is a dual point for any signs; the better of both counts.

Rounding. With u = 2^-53 and gamma_N = N u/(1 - N u), a sum of N products in any order (in blocks,
in vectors, fused or not) is off by at most gamma_N times the sum of their moduli; N is the number
of `terms` of the design where rows are summed in blocks. Columns of unit rms turn that, by
Cauchy-Schwarz, into gamma_N a for an entry of C, a = sqrt(r). With N more by 2 c n + 20 for the c
columns in use, where 20 covers the divisions by m and rms, the rounding of rms and of V = W rms and
terms of second order (N < 1e8),

    |err C| <= gamma_N a + rho,   |err q| <= y |err C|,   |err r| <= (2a + rho) |err C|

where rho = gamma_{c + 8} (y + l) is by how much the rms of R itself is off, and 0 of Z_A w; both
are larger by the `spread` of a design off which a mean was taken. With Huber's loss u_i is exact in
a row beyond the knot by more than its rounding: rho is that of the other rows, and an outlier of
any size moves P by its own rounding times |u_i| alone.

Where Z'Z, or its rows of the columns in use, were formed, squares are certified without the rows
of Z: with G = Z'Z/m, B = Z'Y/m and c = y^2,

    C = B - G V,   q = c - <V, B>,   r = q - <V, C>;

G is off by gamma_N times spread^2, B by gamma_N y spread, sums over the c weights by gamma_{c + 2}
of l and y + l, which bound |B| + |G V|. With the N above and e = spread^2 gamma_N (y + l),

    |err C| <= e,   |err q| <= y e,   |err r| <= (y + l) e.

The field ``rounding`` is the sum of these errors: the limit of s is taken with |C| raised by its
error, P and D are moved by theirs, and value + rounding is an upper bound of the relative gap in
exact arithmetic. No product underflows, as `problem` refuses norms that are so small.

Source: Higham, "Accuracy and Stability of Numerical Algorithms" (2002), sections 3.1 and 3.5.
"""

import math
from dataclasses import dataclass, replace
from functools import reduce
from typing import Literal

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.regression.design import Design, in_blocks
from sparsefit.regression.losses import SQUARES, RootSquares, Squares
from sparsefit.regression.penalties import Penalty, SquaredNorm

CertificateKind = Literal["duality_gap", "normal_equations", "fixed_point"]
SMALL = 1e-10  # the gap from which a square-root fit is not judged by its signs, too
FLOORS = (0.0, 1e-8)  # of the largest weight, below which one has no sign: an interior point's
SHARES = (1.0, *(1.0 - np.geomspace(1e-14, 0.1, 14)), *np.geomspace(0.8, 1e-8, 20))
"""The s that are tried where weights have bounds."""
Sums = tuple[Array, IntArray, Array]
"""B (k, n), columns J (j,) and Z_J'Z/m (j, k)."""


@dataclass(frozen=True)
class Certificate:
    """A bound of the error of a fit, computed from the data and the weights.

    kind ``duality_gap``: value = (primal - dual) over the primal at zero weights, an upper bound of
    the relative suboptimality; rounding: a bound of its rounding error, so that value + rounding is
    proven; NaN where unknown. ``normal_equations``: the largest |v'theta'R| / (s_max |Y|) over the
    retained right singular vectors v of theta. ``fixed_point``: the larger of the share of
    coefficients that enter or leave the support in one more iteration and of the change of fitted
    values, |Z dV| / |Y|; no optimum is claimed.
    """

    kind: CertificateKind
    value: float
    primal: float = float("nan")
    dual: float = float("nan")
    rounding: float = float("nan")

    @property
    def bound(self) -> float:
        """value + rounding; the value alone where the rounding error is unknown."""
        return self.value + (0.0 if math.isnan(self.rounding) else self.rounding)


@dataclass(frozen=True, eq=False)
class DualPoint:
    """C (p, k, n), r and q (p, n) of u at p penalties, and bounds (p, n) of their errors."""

    correlation: Array
    square: Array
    product: Array
    correlation_error: Array
    square_error: Array
    product_error: Array
    gamma: float

    @classmethod
    def of(
        cls, design: Design, target: Array, pull: Array, gamma: float, rho: Array | float = 0.0
    ) -> "DualPoint":
        """The point of ``pull`` u (m, p n), whose rms has an error of up to rho (p, n)."""
        n, k = target.shape[1], design.shape[1]
        wide = np.tile(target, (1, pull.shape[1] // n))
        square, product, whole = (
            design.overlaps(*pair).reshape(-1, n)
            for pair in ((pull, pull), (pull, wide), (target, target))
        )
        correlation = design.correlate(pull).reshape(k, -1, n).transpose(1, 0, 2)
        root = np.sqrt(square)
        error = design.spread * gamma * root + rho
        errors = error, (2.0 * root + rho) * error, np.sqrt(whole) * error
        return cls(correlation, square, product, *errors, gamma)

    @classmethod
    def of_products(
        cls, design: Design, sums: Sums, level: Array, scaled: Array, gamma: float
    ) -> "DualPoint":
        """The point u = R of V (p, k, n) by its sums and y (n,)."""
        (cross, used, rows), across = sums, scaled.transpose(0, 2, 1)
        product = level**2 - (across * cross.T).sum(axis=2)
        fitted = across.reshape(-1, len(cross)).take(used, 1) @ rows
        correlation = (cross.T - fitted.reshape(across.shape)).transpose(0, 2, 1)
        square = np.maximum(product - (scaled * correlation).sum(axis=1), 0.0)
        reach = level + np.abs(scaled).sum(axis=1)
        error = design.spread**2 * gamma * reach
        return cls(correlation, square, product, error, reach * error, level * error, gamma)

    def with_ridge(self, scaled: Array, alphas: Array, penalty: Penalty) -> "DualPoint":
        """The point extended by the rows of the ridge, with entries F (p, k, n)."""
        mu = (alphas * penalty.ridge)[:, None]
        part, loose = scaled, np.zeros_like(self.square)
        if isinstance(penalty, SquaredNorm):
            part, loose = self.correlation / mu[:, None], self.correlation_error / mu
        pull = mu[:, None] * part  # first: the square of F alone may overflow
        size, total = np.abs(part), np.sum(pull * part, axis=1)
        reach = (2.0 * size.sum(axis=1) + part.shape[1] * loose) * (mu * loose)
        return replace(
            self,
            correlation=self.correlation - pull,
            square=self.square + total,
            correlation_error=self.correlation_error + self.gamma * mu * size.max(axis=1),
            square_error=self.square_error + reach + self.gamma * total,
        )

    def bounds(self, alphas: Array, penalty: Penalty, level: Array) -> tuple[Array, Array]:
        """D (p,) as computed, and a lower bound of it."""
        square, product, wider = self.square, self.product, self.correlation_error
        loose, off = self.square_error, self.product_error
        peaks = penalty.constraint(self.correlation)
        raised = penalty.raised(self.correlation, peaks, wider)
        if penalty.coupled:
            parts = (part.sum(axis=1, keepdims=True) for part in (square, product, loose, off))
            square, product, loose, off = parts
            peaks, raised = (part.max(axis=1, keepdims=True) for part in (peaks, raised))
        # As computed, and certain: less its error.
        peaks = np.array([peaks, raised * (1.0 + self.gamma)])
        certain, limiting = np.array([[[0.0]], [[1.0]]]), square
        if isinstance(penalty.loss, RootSquares):  # a limit of s there
            limiting = square + certain * (self.gamma * square + loose)
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = [np.where(peaks > 0, alphas[:, None] / peaks, np.inf)]
        if penalty.is_bounded:
            limits += [np.minimum(limits[0], share) for share in SHARES]
        values = []
        for limit in limits:
            s = penalty.loss.factor(limiting, product, limit, level)
            size = np.abs(s)
            lost = size * off + 0.5 * s**2 * loose
            lost += self.gamma * (4.0 * size * np.abs(product) + 0.5 * s**2 * square)
            value = penalty.loss.dual(s, square, product) - certain * lost
            if penalty.is_bounded:
                point, error = s[:, :, None] * self.correlation, certain * (size * wider)
                beyond = penalty.beyond(point, alphas[:, None, None], error[:, :, None])
                beyond = beyond.sum(axis=-1, keepdims=True) if penalty.coupled else beyond
                value -= beyond * (1.0 + certain * self.gamma)
            values.append(value)
        dual, least = reduce(np.maximum, values).sum(axis=-1)
        return dual, least


def duality_gaps(
    design: Design,
    target: Array,
    weights: Array,
    alphas: Array,
    penalty: Penalty,
    cross: Array | None = None,
    enough: float = 0.0,
) -> tuple[Certificate, ...]:
    """Certificates of p weights (k, n), in original units, at the penalties alphas (p,).

    cross: Z'Y/m (k, n). With it, and what the design has formed of Z'Z, squares are certified to
    ``enough``; what has no such bound is certified by the rows.
    """
    # Columns are the last axis in memory: numpy is slow where that has few entries.
    scaled = np.multiply(np.swapaxes(weights, 1, 2), design.rms, order="C")
    scaled, size = scaled.transpose(0, 2, 1), target.shape[1] * max(design.shape)
    entries = 2**19 if design.kind == "sparse" else 2**22  # whose sums are no matrix products
    step, rest, gaps = max(entries // size, 1), np.arange(len(weights)), np.empty((4, len(weights)))
    used = np.flatnonzero(scaled.any(axis=(0, 2)))
    rows = design.formed(used) if penalty.loss == SQUARES else None
    if cross is not None and rows is not None:
        gaps[:] = _gaps(design, (target, (cross, used, rows)), scaled, alphas, penalty)
        rest = np.flatnonzero(~(gaps[0] + gaps[3] <= enough))
    for part in (rest[start : start + step] for start in range(0, len(rest), step)):
        gaps[:, part] = _gaps(design, (target, None), scaled[part], alphas[part], penalty)
    return tuple(Certificate("duality_gap", *row) for row in gaps.T.tolist())


@np.errstate(all="ignore")  # what overflows proves nothing
def _gaps(
    design: Design, data: tuple[Array, Sums | None], scaled: Array, alphas: Array, penalty: Penalty
) -> tuple[Array, Array, Array, Array]:
    """The gap, P, D and the rounding error (p,) of the gap of V = ``scaled`` (p, k, n).

    data: Y (m, n) and the sums by which they are computed, V_J not 0; without these, by the rows.
    """
    (count, k, n), loss, sums = scaled.shape, penalty.loss, data[1]
    target = loss.centred(data[0])
    level = np.sqrt(design.overlaps(target, target))
    used = len(sums[1]) if sums else int(np.count_nonzero(scaled.any(axis=(0, 2))))
    gamma = rounding_of(design.terms + 2 * used * n + 20)
    linear = np.zeros(count)
    if sums:
        point = DualPoint.of_products(design, sums, level, scaled, gamma)
    else:
        flat = scaled.transpose(1, 0, 2).reshape(k, -1)
        pull = rest = np.tile(target, (1, count)) - design.predict(flat)
        size, unit = np.abs(scaled).sum(axis=1), design.spread * rounding_of(used + 8)
        rho = unit * (level + size)
        if np.isfinite(loss.clip):
            rest, pull, rho, linear = _clipped(design, data[0], loss, rest, size, unit)
        point = DualPoint.of(design, target, pull, gamma, rho)
    loose, total = point.square_error.sum(axis=1), float(np.sum(level**2))
    overlap, doubt, whole = point.square, 0.5 * loose + linear, 0.5 * total
    if np.isfinite(loss.clip):  # else u = R
        overlap = design.overlaps(pull, rest).reshape(count, n)
        start, cut = loss.clipped(target, loss.bound(data[0]))
        null = design.overlaps(cut, start - 0.5 * cut)
        whole = float(np.minimum(null, 0.5 * level**2).sum())
    if isinstance(loss, RootSquares):
        square = point.square.sum(axis=1)
        moved = np.sqrt(square + loose) - np.sqrt(np.maximum(square - loose, 0.0))
        doubt, whole = np.sqrt(total) * moved, total
    primal = loss.primal(point.square, overlap, level) + alphas * penalty.value(scaled)
    doubt += gamma * (primal + alphas * penalty.rough(scaled))
    whole = whole or 1.0
    full = point.with_ridge(scaled, alphas, penalty) if penalty.ridge else point
    dual, least = full.bounds(alphas, penalty, level)
    if isinstance(loss, RootSquares):
        for i in np.flatnonzero(primal - least > SMALL * whole).tolist():
            for other in of_signs(design, target, scaled[i], gamma):
                ((value, bound),) = zip(*other.bounds(alphas[[i]], penalty, level), strict=True)
                if bound > least[i]:
                    dual[i], least[i] = value, bound
    gap = np.abs(primal - dual) / whole  # D above P: the penalty's parts are at odds
    most = (primal - least + doubt) / whole * (1.0 + 2.0 * gamma)
    rounding = np.maximum(most - gap, 0.0)  # of infinite P, and of what overflowed, not a number
    return gap, primal, dual, np.where(np.isnan(rounding), np.inf, rounding)


def _clipped(
    design: Design, target: Array, loss: Squares, rest: Array, size: Array, unit: float
) -> tuple[Array, Array, Array, Array]:
    """R - b e and u (m, p n) of Huber's loss, and the errors of the rms of u (p, n) and of P (p,).

    rest: R, with the target centred; size: l (p, n); unit: gamma_{c + 8} times the spread.
    """
    (count, n), m = size.shape, design.samples
    centred, reach = loss.centred(target), np.tile(loss.bound(target), (1, count))
    residual, pull = loss.clipped(rest, reach)
    each = np.abs(rest - residual) + np.tile(np.abs(centred), (1, count))
    each *= unit
    if loss.direction is not None and np.ptp(loss.direction) > 0.0:  # else it is off along e alone
        each += 2.0**-53 * np.tile(np.abs(target - centred), (1, count))
    # |z_ij| <= spread sqrt(m) in columns of unit rms, and their means are no larger.
    near = np.abs(residual) < reach + each + 2.0 * np.sqrt(m) * unit * size.ravel()
    rho = np.sqrt(np.square(each * near).sum(axis=0) / m).reshape(count, n) + unit * size
    root = np.sqrt(np.square(pull).sum(axis=0) / m).reshape(count, n)
    linear = np.einsum("iq,iq->q", np.abs(pull), each).reshape(count, n) / m + root * unit * size
    if loss.direction is not None:  # u - e e'u is the dual point, once its entries are c at most
        along = np.abs(in_blocks(np.matmul, loss.direction, pull))
        along += rounding_of(design.terms + 20) * np.sqrt(m) * root.ravel()
        product = np.einsum("iq,iq->q", np.abs(pull), np.tile(np.abs(centred), (1, count))) / m
        lost = product * loss.direction.max() / reach.max(axis=0)  # one ratio in all rows
        lost += np.tile(np.linalg.norm(centred, axis=0) / m, count)
        linear += (along * lost).reshape(count, n)
    return residual, pull, rho, linear.sum(axis=1)


def of_signs(design: Design, target: Array, scaled: Array, gamma: float) -> list[DualPoint]:
    """The points Z_A w of the signs of V = ``scaled`` (k, n) above each of the floors."""
    points = []
    for floor in FLOORS:
        large = np.abs(scaled) > floor * np.abs(scaled).max()
        used = np.flatnonzero(large.any(axis=1))
        square, multipliers = design.products(used), np.zeros(scaled.shape)
        for t in range(scaled.shape[1]):
            on = np.flatnonzero(large[used, t])
            signs = np.sign(scaled[used[on], t])
            multipliers[used[on], t] = np.linalg.lstsq(square[np.ix_(on, on)], signs, rcond=None)[0]
        points.append(DualPoint.of(design, target, design.predict(multipliers), gamma))
    return points


def rounding_of(count: int) -> float:
    """gamma_N = N u / (1 - N u), the relative error bound of a sum of N products."""
    unit = 2.0**-53  # the relative rounding of one operation
    return count * unit / (1.0 - count * unit)
