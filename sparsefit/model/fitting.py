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
from sparsefit.model.columns import sines_and_cosines
from sparsefit.model.shapes import Shape

RANK = 1e-12  # eigenvalues of a scaled Gram matrix below this, relative, are dropped
ITERATIONS, HALVINGS = 25, 5  # of a descent, and of one of its moves
LONGEST = 0.5  # of a move, in pi over the extent and over the duration
END, SLIGHT = 1e-3, 1e-5  # of moves, in these units, and of RSS: where a descent ends
CAUGHT = 0.05  # of moves in pieces: the whole goes on from there
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

    def cut(self, pieces: int) -> tuple[Array, Array, Array]:
        """The target (s, n, 2), x, y and t (3, s, n), and weights (s, n) of s pieces of n rows.

        Rows that fill the last piece have weight 0; of pieces the target is `rest`.
        """
        if pieces not in self._cuts:
            count = -(-len(self.target) // pieces)
            filled = (0, pieces * count - len(self.target))
            own = np.ones(len(self.target)) if self.weight is None else self.weight
            target = self.target if pieces == 1 else self.rest
            self._cuts[pieces] = (
                np.pad(target, (filled, (0, 0))).reshape(pieces, count, 2),
                np.pad(self.place.T, ((0, 0), filled)).reshape(3, pieces, count),
                np.pad(own, filled).reshape(pieces, count),
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

    A column is a vector, (k_y, -k_x), times one of g = (-sin theta, cos theta); the derivatives of
    the flow by q are vectors times g and g x, g y, g t. So all inner products are those of these
    functions of a row, times products of vectors; pieces of n rows are a stack of them.
    """
    phases, by_q = shape.phases(q)
    target, axes, weight = rows.cut(pieces)  # (s, n, 2), (3, s, n), (s, n)
    clock, count = np.array([1.0, 1.0, -1.0]), 2 * len(phases)  # theta = k.x - omega t
    angles = np.tensordot(phases * clock, axes, axes=1)
    g = np.stack(sines_and_cosines(angles), axis=1)  # (waves, 2, s, n)
    np.negative(g[:, 0], out=g[:, 0])
    g = np.ascontiguousarray(g.reshape(count, *weight.shape).swapaxes(0, 1))
    if pieces > 1 or rows.weight is not None:
        g *= weight[:, None]
    # the vector of each column (2 J, 2), and its derivatives (p, 2 J, 2)
    across, turned = (
        np.repeat(part[..., [1, 0]] * (1.0, -1.0), 2, axis=-2) for part in (phases, by_q)
    )
    gram = (g @ g.mT) * (across @ across.T)
    load = np.sum((g @ target) * across, axis=2)
    others = rows.unknowns if pieces == 1 else rows.unknowns[:0]
    if others.size:
        mixed = np.einsum("id,idj->ij", across, np.tensordot(g[0], others, axes=1))
        flat = others.reshape(-1, others.shape[2])
        gram = np.block([[gram[0], mixed], [mixed.T, flat.T @ flat]])[None]
        load = np.concatenate([load[0], target.ravel() @ flat])[None]
    basis = orthonormal(gram)
    weights = (basis @ (basis.mT @ load[..., None]))[..., 0]
    amplitudes, coefficients = weights[:, :count], weights[0, count:]
    rest = target - g.mT @ (amplitudes[..., None] * across)
    if others.size:
        rest -= others @ coefficients
    move = np.zeros(len(q))
    if len(q):
        # d psi/d theta = a g_1 + b g_2, its derivative by theta b g_1 - a g_2
        late = amplitudes.reshape(len(g), -1, 2)[..., ::-1] * (1.0, -1.0)
        late = late.reshape(len(g), count, 1) * across
        moved = np.repeat(by_q * clock, 2, axis=1)[..., : 2 + shape.drifting]
        vectors = np.concatenate(
            [(amplitudes[..., None] * turned[:, None]).swapaxes(0, 1)]
            + [(late * by[..., None][:, None]).swapaxes(0, 1) for by in np.moveaxis(moved, 2, 0)],
            axis=2,
        )  # (s, p, functions, 2)
        parts = [g, *(g * axis[:, None] for axis in axes[: moved.shape[2]])]
        functions = np.concatenate(parts, axis=1)
        products = functions @ functions.mT
        bent = vectors.transpose(0, 3, 1, 2) @ products[:, None]  # (s, 2, p, functions)
        curvature = np.sum(bent @ vectors.transpose(0, 3, 2, 1), axis=(0, 1))
        sizes = np.diagonal(curvature).copy()
        inside = np.einsum("sdpi,id->spi", bent[..., :count], across)
        if others.size:
            mixed = np.tensordot(vectors[0], np.tensordot(functions[0], others, axes=1), axes=2)
            inside = np.concatenate([inside, mixed[None]], axis=2)
        inside = inside @ basis
        curvature -= np.sum(inside @ inside.mT, axis=0)
        slope = np.tensordot(vectors, functions @ rest, axes=([0, 2, 3], [0, 1, 2]))
        steps = orthonormal(curvature, sizes)
        move = steps @ (steps.T @ slope)
    whole = rest.reshape(-1, 2)[: len(rows.target)]
    residual = float(np.sum(whole**2))
    return ShapeFit(shape, q, amplitudes[0], coefficients, whole, residual, move)


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
        if longest <= (END if pieces == 1 else CAUGHT):
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
