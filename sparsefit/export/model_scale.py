"""One length scale in the exported C's model: its least squares, and the way off the grid.

Between two wavenumbers of the grid all sums are the polynomial of degree 5 through their values and
two derivatives at both (Hermite), positions counted from the middle of the flight; the residual's

    dR/dk = sum over x, y of  W' (dG/dk) W - 2 W' dc/dk,   W = G^-1 c,

vanishes at the length scale, which the rule of false position (Illinois) finds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.export.layout import TERMS
from sparsefit.export.model import ALONG_X, ALONG_Y, CROSS, CROSS_SIDE, SIDE, Sums, harmonics
from sparsefit.export.plan import COARSE, END, STEPS, Plan

_PRODUCT = np.zeros((3, 3, SIDE))  # h_i h_j = sum over t of _PRODUCT[i, j, t] h_t
for _i, _j, _t, _weight in (
    *((0, 0, 0, 1.0), (0, 1, 1, 1.0), (0, 2, 2, 1.0), (1, 1, 0, 0.5), (1, 1, 3, 0.5)),
    *((1, 2, 4, 0.5), (2, 2, 0, 0.5), (2, 2, 3, -0.5)),
):
    _PRODUCT[_i, _j, _t] = _PRODUCT[_j, _i, _t] = _weight
_GRAM = np.einsum(
    "abs,abt->abst",
    _PRODUCT[ALONG_X[:, None], ALONG_X],
    _PRODUCT[ALONG_Y[:, None], ALONG_Y],
).reshape(64, CROSS)


@dataclass(frozen=True, eq=False)
class ScaleFit:
    """Least squares on the 8 columns of a scale: weights (8, 2) [m/s], |theta W|^2, least pivot."""

    weights: Array
    explained: float
    pivot: float

    @property
    def mean_velocity(self) -> float:
        """U0 = sqrt(2 <|w|^2>) [m/s]."""
        squares = np.sum(self.weights**2, axis=1)
        return math.sqrt(float(squares[:4].sum() + 0.5 * squares[4:].sum()))


@dataclass(frozen=True, eq=False)
class ScalePlace:
    """Where a descent ended: k [1/m], its fit, what it leaves of |Phi|^2, and a doubt or none.

    error: the standard error of k [1/m], by the curvature of the residual; NaN on the grid.
    """

    k: float
    fit: ScaleFit
    left: float
    doubt: str = ""
    error: float = math.nan


def gram_of(terms: Array) -> Array:
    """theta'theta (..., 8, 8) from the sums (..., 43) of scales."""
    gram: Array = (terms[..., :CROSS] @ _GRAM.T).reshape(*terms.shape[:-1], 8, 8)
    return gram


def cross_of(terms: Array) -> Array:
    """theta'Phi (..., 8, 2) from the sums (..., 43) of scales."""
    parts = terms[..., CROSS:].reshape(*terms.shape[:-1], 2, CROSS_SIDE, CROSS_SIDE)
    cross: Array = np.swapaxes(parts[..., ALONG_X, ALONG_Y], -1, -2)
    return cross


def least_squares(terms: Array, floor: float) -> ScaleFit:
    """The least squares of a scale, by Cholesky of its columns in unit norm.

    A column whose pivot is at or below the floor depends on those before it: it has no weight.
    """
    unit, values, z, pivots = _solved_in_unit(terms, floor)
    weights = values * unit[:, None]
    return ScaleFit(weights, float(np.sum(z**2)), min(1.0, float(pivots.min())))


def explained(terms: Array, floor: float) -> Array:
    """|theta W|^2 (g,) of each of several scales, from their sums (g, 43)."""
    z = _solved_in_unit(terms, floor)[2]
    total: Array = np.sum(z**2, axis=(-1, -2))
    return total


def _solved_in_unit(terms: Array, floor: float) -> tuple[Array, Array, Array, Array]:
    """1/|theta| (..., 8), and what `solved` gives of columns in unit norm."""
    gram, cross = gram_of(terms), cross_of(terms)
    squares = np.diagonal(gram, axis1=-2, axis2=-1)
    unit = np.where(squares > 0, 1.0 / np.sqrt(np.where(squares > 0, squares, 1.0)), 0.0)
    scaled = gram * unit[..., :, None] * unit[..., None, :]
    return unit, *solved(scaled, cross * unit[..., None], floor)


def solved(gram: Array, cross: Array, floor: float) -> tuple[Array, Array, Array]:
    """G^-1 c (..., n, t), Z = F^-1 c (..., n, t) and pivots (..., n), with G = F F'.

    gram: (..., n, n), cross: (..., n, t). Columns with pivots at or below the floor are left out:
    theirs are 0.
    """
    size = gram.shape[-1]
    factor, z, values = np.zeros(gram.shape), np.zeros(cross.shape), np.zeros(cross.shape)
    pivots, kept = np.zeros(gram.shape[:-1]), np.zeros(gram.shape[:-1])
    for a in range(size):
        for b in range(a):
            left = gram[..., a, b] - _products(factor[..., a, :b], factor[..., b, :b])
            factor[..., a, b] = left * kept[..., b]
        row = factor[..., a, :a]
        pivot = gram[..., a, a] - _products(row, row)
        pivots[..., a] = np.where(pivot > floor, pivot, 0.0)
        kept[..., a] = np.where(pivot > floor, 1.0 / np.sqrt(np.maximum(pivot, floor)), 0.0)
        z[..., a, :] = cross[..., a, :] - np.einsum("...e,...et->...t", row, z[..., :a, :])
        z[..., a, :] *= kept[..., a, None]
    for a in reversed(range(size)):
        below = np.einsum("...e,...et->...t", factor[..., a + 1 :, a], values[..., a + 1 :, :])
        values[..., a, :] = (z[..., a, :] - below) * kept[..., a, None]
    return values, z, pivots


def _products(left: Array, right: Array) -> Array:
    total: Array = np.einsum("...e,...e->...", left, right)
    return total


def left_of(plan: Plan, square: float, explained: float) -> float:
    """What a fit leaves of |Phi|^2, at least its rounding."""
    return max(square - explained, plan.rounding * square)


def centred(plan: Plan, sums: Sums, scale: int) -> Array:
    """The sums (orders, 43) of a scale with positions counted from the middle of the flight."""
    terms: Array = sums.scales[scale].copy()
    middle, k = 0.5 * (sums.lowest + sums.highest), plan.wavenumbers[scale : scale + 1]
    parts = np.split(np.arange(TERMS), (CROSS, CROSS + CROSS_SIDE**2))
    for axis in range(2):
        h = harmonics(k, middle[axis : axis + 1], plan.orders)[:, 0, 0]
        for part, side in zip(parts, (SIDE, CROSS_SIDE, CROSS_SIDE), strict=True):
            table = terms[:, part].reshape(-1, side, side)
            along = table if axis == 0 else table.transpose(0, 2, 1)
            turned = _turned(along, h)
            table = turned if axis == 0 else turned.transpose(0, 2, 1)
            terms[:, part] = table.reshape(len(terms), -1)
    return terms


def _turned(table: Array, h: Array) -> Array:
    """Harmonics along the first axis of (orders, s, s), from the origin of h (orders, 5)."""
    turned = table.copy()
    for p in range(1, table.shape[1], 2):
        for d in range(len(table)):
            cos, sin = table[d::-1, p], table[d::-1, p + 1]
            turned[d, p] = h[: d + 1, p] @ cos + h[: d + 1, p + 1] @ sin
            turned[d, p + 1] = h[: d + 1, p] @ sin - h[: d + 1, p + 1] @ cos
    return turned


def slope_of(fit: ScaleFit, rates: Array) -> float:
    """dR/dk, in the unit of the rates (43,) of the sums."""
    w = fit.weights
    bent = np.einsum("ac,ab,bc->", w, gram_of(rates), w)
    return float(bent - 2.0 * np.sum(w * cross_of(rates)))


def between(left: Array, right: Array, width: float, t: float) -> tuple[Array, Array]:
    """Sums (43,) at a share t of an interval in k, and their rates by t, from both ends (3, 43)."""
    up, up_rate = 10 * t**3 - 15 * t**4 + 6 * t**5, 30 * t**2 - 60 * t**3 + 30 * t**4
    basis = np.array(
        [
            [1 - up, t - 6 * t**3 + 8 * t**4 - 3 * t**5, t**2 - 3 * t**3 + 3 * t**4 - t**5],
            [up, 7 * t**4 - 4 * t**3 - 3 * t**5, t**3 - 2 * t**4 + t**5],
        ]
    )
    rate = np.array(
        [
            [
                -up_rate,
                1 - 18 * t**2 + 32 * t**3 - 15 * t**4,
                2 * t - 9 * t**2 + 12 * t**3 - 5 * t**4,
            ],
            [up_rate, 28 * t**3 - 12 * t**2 - 15 * t**4, 3 * t**2 - 8 * t**3 + 5 * t**4],
        ]
    )
    nodes, powers = np.stack([left, right]), width ** np.arange(3)
    values, rates = (np.einsum("nd,ndi->i", part * powers, nodes) for part in (basis, rate))
    return values, rates


def descend(plan: Plan, sums: Sums, scale: int) -> ScalePlace:
    """From a minimum of the residual on the grid to the one off it."""
    square, k = sums.square, plan.wavenumbers
    here = centred(plan, sums, scale)
    fit = least_squares(here[0], plan.floor)
    place = ScalePlace(float(k[scale]), fit, left_of(plan, square, fit.explained), "edge")
    lower = scale if slope_of(fit, here[1]) < 0 else scale + 1
    if not 0 < lower < len(k):
        return place
    width = float(k[lower - 1] - k[lower])
    unresolved = ScalePlace(place.k, place.fit, place.left, "coarse")
    if width * sums.extent > 2 * math.pi * COARSE:
        return unresolved
    ends = centred(plan, sums, lower), centred(plan, sums, lower - 1)

    def at(t: float) -> tuple[ScaleFit, float]:
        values, rates = between(*ends, width, t)
        fit = least_squares(values, plan.floor)
        return fit, slope_of(fit, rates)

    low, high = at(0.0)[1], at(1.0)[1]
    if low > 0 or high < 0:
        return unresolved
    bend = (high - low) / width**2
    t_low, t_high, moved, last = 0.0, 1.0, 0, 1.0
    for _ in range(STEPS[plan.real]):
        rise = high - low
        t = (t_low * high - t_high * low) / rise if rise > 0 else t_high
        fit, slope = at(t)
        if abs(t - last) <= END[plan.real] or not t_low < t < t_high:
            break
        last = t
        if slope < 0:
            high *= 0.5 if moved == 1 else 1.0
            moved, low, t_low = 1, slope, t
        else:
            low *= 0.5 if moved == 2 else 1.0
            moved, high, t_high = 2, slope, t
    off = float(k[lower]) + t * width
    left = left_of(plan, square, fit.explained)
    error = math.sqrt(left * plan.correlation / (sums.weight * bend)) if bend > 0 else math.inf
    return ScalePlace(off, fit, left, "", error)
