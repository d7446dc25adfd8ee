"""The one descent: waves fitted to rows of the flow velocity, their parameters moved downhill.

At parameters q of a shape the rows, x before y of each sample, are

    Phi = sum_j C_j(q) (a_j, b_j) + N b + E,

N the columns of the unknowns. RSS(q) = min over the weights of |E|^2 is a function of q alone
(variable projection; Golub and Pereyra, 1973). With A the derivatives of the flow by q and P the
projection off all columns, the Gauss-Newton move solves A'P A dq = A'E. A track may be cut into
pieces with amplitudes of their own, in which parameters are caught from farther away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from sparsefit.arrays import Array, box
from sparsefit.cached import cached_property
from sparsefit.model.columns import across, sines_and_cosines
from sparsefit.model.shapes import Shape

RANK = 1e-12  # eigenvalues of a scaled Gram matrix below this, relative, are dropped
ITERATIONS, HALVINGS = 25, 5  # of a descent, and of one of its moves
LONGEST = 0.5  # of a move, in pi over the extent and over the duration
END, SLIGHT = 1e-3, 1e-5  # of moves, in these units, and of RSS: where a descent ends
SEEN = 3  # of the last falls of RSS, by which a descent is judged


@dataclass(frozen=True, eq=False)
class FlowRows:
    """Rows of the flow velocity.

    Args:
        place: (x, y, t) of the rows from their middle (m, 3) [m], [s].
        target: Phi of the vehicle as it is believed to be, (m, 2) [m/s].
        unknowns: N (m, 2, j).
        weight: of every row (m,), already in target and unknowns; None: all are 1.
    """

    place: Array
    target: Array
    unknowns: Array
    weight: Array | None = None

    @cached_property
    def square(self) -> float:
        """|Phi|^2 [m^2/s^2], or 1 where it is 0."""
        return float(np.sum(self.target**2)) or 1.0

    @cached_property
    def rest(self) -> Array:
        """Phi less what its unknowns explain, (m, 2) [m/s]."""
        if not self.unknowns.shape[2]:
            return self.target
        columns, target = self.unknowns.reshape(-1, self.unknowns.shape[2]), self.target.ravel()
        basis = orthonormal(columns.T @ columns)
        rest = target - columns @ (basis @ (basis.T @ (columns.T @ target)))
        return rest.reshape(-1, 2)

    def reach(self, pieces: int = 1) -> Array:
        """Pi over the extent of the rows, or of pieces: k_x, k_y [rad/m] and omega [rad/s]."""
        corners = (box(piece) for piece in np.array_split(self.place, pieces))
        x, y, t = np.max([high - low for low, high in corners], axis=0).tolist()
        widest = max(x, y) or 1.0
        return math.pi / np.array([widest, widest, t or 1.0])


@dataclass(frozen=True, eq=False)
class ShapeFit:
    """The fit of a shape at fixed parameters.

    Args:
        shape: of the waves.
        q: the parameters (p,).
        weights: a_1, b_1, a_2, ... [m^2/s], (2 J,), phases from the middle of the rows.
        coefficients: b (j,) of the unknowns.
        rest: E (m, 2) [m/s], what is left of the rows.
        residual: RSS [m^2/s^2].
        move: the Gauss-Newton move (p,); 0 where RSS is flat to rounding.
    """

    shape: Shape
    q: Array
    weights: Array
    coefficients: Array
    rest: Array
    residual: float
    move: Array

    @cached_property
    def phases(self) -> Array:
        """(k_x, k_y, omega) of every wave (J, 3)."""
        return self.shape.phases(self.q)[0]

    @cached_property
    def strengths(self) -> Array:
        """|k| sqrt(a^2 + b^2) of every wave (J,) [m/s]."""
        sizes: Array = np.hypot(*self.weights.reshape(-1, 2).T) * np.hypot(*self.phases[:, :2].T)
        return sizes


def orthonormal(gram: Array, sizes: Array | None = None) -> Array:
    """Weights (k, rank) of orthonormal columns, from the Gram matrix (k, k) less its null space.

    sizes (k,): squares beside which a diagonal entry may be rounding; None: the diagonal itself.
    """
    if not len(gram):
        return np.zeros((0, 0))
    own = gram.diagonal()
    scale = np.sqrt(np.where(own > (0.0 if sizes is None else RANK * sizes), own, np.inf))
    roots, vectors = np.linalg.eigh(gram / (scale[:, None] * scale))
    rank = roots > RANK * max(roots[-1], RANK)
    basis: Array = vectors[:, rank] / np.sqrt(roots[rank]) / scale[:, None]
    return basis


def fitted(rows: FlowRows, shape: Shape, q: Array, pieces: int = 1) -> ShapeFit:
    """Fit the rows by a shape at parameters q (p,); of pieces what is unknown is left out."""
    phases, by_q = shape.phases(q)
    clock = np.array([1.0, 1.0, -1.0])  # theta = k.x - omega t
    curvature = np.zeros((len(q), len(q)))
    slope, sizes, rests = np.zeros(len(q)), np.zeros(len(q)), []
    target = rows.target if pieces == 1 else rows.rest
    ends = np.cumsum([0, *map(len, np.array_split(target, pieces))])
    for first, last in pairwise(ends.tolist()):
        place, part = rows.place[first:last], target[first:last].ravel()
        own = 1.0 if rows.weight is None else rows.weight[first:last, None]
        sine, cosine = sines_and_cosines(phases * clock @ place.T)
        waves = across(phases, np.stack([-sine, cosine], axis=1)) * own
        columns = waves.reshape(2 * len(phases), 2 * len(place))
        if pieces == 1 and rows.unknowns.shape[2]:
            unknowns = rows.unknowns.reshape(-1, rows.unknowns.shape[2])
            columns = np.vstack([columns, unknowns.T])
        basis = orthonormal(columns @ columns.T)
        weights = basis @ (basis.T @ (columns @ part))
        rest = part - weights @ columns
        if len(q):
            a, b = weights[: 2 * len(phases)].reshape(-1, 2).T[:, :, None]
            flow, late = b * cosine - a * sine, -a * cosine - b * sine  # of psi by theta
            moved = late * (by_q * clock @ place.T)
            bent = np.stack([across(by, flow).sum(axis=0) for by in by_q])
            bent += np.stack([across(phases, part).sum(axis=0) for part in moved])
            bent = (bent * own).reshape(len(q), -1)
            inside = bent @ columns.T @ basis
            curvature += bent @ bent.T - inside @ inside.T
            slope += bent @ rest
            sizes += np.sum(bent**2, axis=1)
        rests.append(rest)
    whole = np.concatenate(rests)
    move = np.zeros(0)
    if len(q):
        basis = orthonormal(curvature, sizes)
        move = basis @ (basis.T @ slope)
    amplitudes, coefficients = np.split(weights, [2 * len(phases)])
    residual = float(whole @ whole)
    return ShapeFit(shape, q, amplitudes, coefficients, whole.reshape(-1, 2), residual, move)


def descended(
    rows: FlowRows, shape: Shape, q: Array, *, pieces: int = 1, goal: float = math.inf
) -> ShapeFit:
    """The shape moved from q (p,) to the least RSS in reach.

    It ends where it would not come below ``goal``, RSS, even if all its moves gained as much as
    the last ones.
    """
    here, reach = fitted(rows, shape, q, pieces), rows.reach(pieces)
    falls = [math.inf] * SEEN
    for remaining in range(ITERATIONS, 0, -1):
        if here.residual - remaining * max(falls[-SEEN:]) > goal:
            return here
        moved = np.tensordot(here.move, shape.phases(here.q)[1], axes=1)
        longest = float(np.abs(moved / reach).max(initial=0.0))
        if longest <= END:
            return here
        move = here.move * min(1.0, LONGEST / longest)
        for _ in range(HALVINGS):
            there = fitted(rows, shape, here.q + move, pieces)
            if there.residual < here.residual:
                break
            move = 0.3 * move
        else:
            return here
        falls.append(here.residual - there.residual)
        here = there
        if falls[-1] <= SLIGHT * here.residual:
            return here
    return here


def joined(rows: FlowRows, shape: Shape, q: Array, pieces: int) -> Array:
    """Parameters (p,) caught in pieces of a track, as sharp as the whole can take them."""
    while pieces > 1:
        q = descended(rows, shape, q, pieces=pieces).q
        pieces = (pieces + 1) // 2
    return q
