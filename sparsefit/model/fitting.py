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

import numpy as np

from sparsefit.arrays import Array, box
from sparsefit.cached import cached_property
from sparsefit.model.grid import sines_and_cosines
from sparsefit.model.shapes import Shape

RANK = 1e-12  # eigenvalues of a scaled Gram matrix below this, relative, are dropped
END = 1e-3  # of moves, in pi over the extent and over the duration: where a descent ends


@dataclass(frozen=True, eq=False)
class FlowRows:
    """Rows of the flow velocity.

    Args:
        place: (x, y, t) of the rows from their middle (m, 3) [m], [s].
        target: Phi of the vehicle as it is believed to be, (m, 2) [m/s], times the weight.
        unknowns: N (m, 2, j), times the weight.
        weight: of every row (m,).
    """

    place: Array
    target: Array
    unknowns: Array
    weight: Array

    def cut(self, pieces: int) -> tuple[Array, Array, Array]:
        """The target (s, 2 n), x, y and -t (3, s, n), and weights (s, 1, 1, n) of s pieces.

        A piece has n rows, x before y; those that fill the last one have weight 0. Of pieces the
        target is `rest`.
        """
        if pieces not in self._cuts:
            count = -(-len(self.target) // pieces)
            filled = (0, pieces * count - len(self.target))
            target = np.pad(self.target if pieces == 1 else self.rest, (filled, (0, 0)))
            place = np.pad(self.place.T, ((0, 0), filled)).reshape(3, pieces, count)
            self._cuts[pieces] = (
                target.reshape(pieces, count, 2).swapaxes(1, 2).reshape(pieces, -1),
                place * np.array([1.0, 1.0, -1.0])[:, None, None],
                np.pad(self.weight, filled).reshape(pieces, 1, 1, count),
            )
        return self._cuts[pieces]

    @cached_property
    def _cuts(self) -> dict[int, tuple[Array, Array, Array]]:
        return {}

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
    """Weights (..., k, k) of orthonormal columns from Gram matrices, zero along null spaces.

    sizes (k,): squares beside which a diagonal entry may be rounding; None: the diagonal itself.
    """
    if not gram.size:
        return gram
    own = np.diagonal(gram, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(own > (0.0 if sizes is None else RANK * sizes), own, np.inf))
    roots, vectors = np.linalg.eigh(gram / (scale[..., :, None] * scale[..., None, :]))
    least = RANK * np.maximum(roots[..., -1:], RANK)
    inverse = np.where(roots > least, 1.0 / np.sqrt(np.maximum(roots, least)), 0.0)
    basis: Array = vectors * inverse[..., None, :] / scale[..., :, None]
    return basis


def fitted(rows: FlowRows, shape: Shape, q: Array, pieces: int = 1) -> ShapeFit:
    """Fit the rows by a shape at parameters q (p,); of pieces what is unknown is left out.

    A column is a vector, (k_y, -k_x), times one of g = (-sin theta, cos theta). Where psi = a cos
    theta + b sin theta, the flow is that vector times h = a g_1 + b g_2, and h has the derivative
    b g_1 - a g_2 by theta.
    """
    phases, by_q = shape.phases(q)
    target, axes, weight = rows.cut(pieces)
    count, size = 2 * len(phases), axes.shape[2]
    g = np.stack(sines_and_cosines(np.tensordot(phases, axes, axes=1)), axis=1)
    np.negative(g[:, 0], out=g[:, 0])
    g = np.moveaxis(g, 2, 0) * weight  # (s, J, 2, n)
    across, turned = (part[..., [1, 0]] * (1.0, -1.0) for part in (phases, by_q))
    columns = (g[..., None, :] * across[:, None, :, None]).reshape(pieces, count, 2 * size)
    if pieces == 1 and rows.unknowns.size:
        others = rows.unknowns.transpose(2, 1, 0).reshape(1, -1, 2 * size)
        columns = np.concatenate([columns, others], axis=1)
    basis = orthonormal(columns @ columns.mT)
    weights = (basis @ (basis.mT @ (columns @ target[..., None])))[..., 0]
    rest = target - (weights[:, None] @ columns)[:, 0]
    move = np.zeros(len(q))
    if len(q):
        amplitudes = weights[:, :count].reshape(pieces, -1, 2, 1)
        heights = np.sum(amplitudes * g, axis=2)  # (s, J, n)
        slopes = np.sum(amplitudes[:, :, ::-1] * np.array([[1.0], [-1.0]]) * g, axis=2)
        moved = np.tensordot(by_q, axes, axes=1).transpose(2, 0, 1, 3) * slopes[:, None]
        bent = turned.transpose(0, 2, 1) @ heights[:, None] + across.T @ moved  # (s, p, 2, n)
        bent = bent.reshape(pieces, len(q), -1)
        curvature = np.sum(bent @ bent.mT, axis=0)
        inside = bent @ columns.mT @ basis
        steps = orthonormal(curvature - np.sum(inside @ inside.mT, axis=0), np.diagonal(curvature))
        move = steps @ (steps.T @ np.sum(bent @ rest[..., None], axis=0)[:, 0])
    whole = rest.reshape(pieces, 2, size).swapaxes(1, 2).reshape(-1, 2)[: len(rows.target)]
    residual = float(np.sum(whole**2))
    return ShapeFit(shape, q, weights[0, :count], weights[0, count:], whole, residual, move)


def descended(
    rows: FlowRows, shape: Shape, q: Array, *, pieces: int = 1, goal: float = math.inf
) -> ShapeFit:
    """The shape moved from q (p,) to the least RSS in reach.

    It ends where it would not come below ``goal``, RSS, even if all its moves gained as much as
    the last three, where RSS falls by less than 1e-5, and after 25 moves. In pieces the whole goes
    on from a twentieth of a lobe.
    """
    here, reach = fitted(rows, shape, q, pieces), rows.reach(pieces)
    falls = [math.inf] * 3
    for remaining in range(25, 0, -1):
        if here.residual - remaining * max(falls[-3:]) > goal:
            return here
        moved = np.tensordot(here.move, shape.phases(here.q)[1], axes=1)
        longest = float(np.abs(moved / reach).max(initial=0.0))
        if longest <= (END if pieces == 1 else 0.05):
            return here
        move = here.move * min(1.0, 0.5 / longest)
        for _ in range(5):
            there = fitted(rows, shape, here.q + move, pieces)
            if there.residual < here.residual:
                break
            move = 0.3 * move
        else:
            return here
        falls.append(here.residual - there.residual)
        here = there
        if falls[-1] <= 1e-5 * here.residual:
            return here
    return here


def joined(rows: FlowRows, shape: Shape, q: Array, pieces: int) -> Array:
    """Parameters (p,) caught in pieces of a track, as sharp as the whole can take them."""
    while pieces > 1:
        q = descended(rows, shape, q, pieces=pieces).q
        pieces = (pieces + 1) // 2
    return q
