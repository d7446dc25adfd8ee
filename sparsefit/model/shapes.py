"""Shapes of flow as data, and their fit to rows by least squares and a descent.

    axis-aligned square cells  <  square at any heading  <  rectangular  <  any two waves,

each steady or drifting as a whole; ``several`` are any waves, or axis-aligned cells of several
length scales. The parameters are q = (wavenumbers [rad/m], heading [rad] if the shape may
be rotated, c_x, c_y [m/s] if it drifts); wave j has the phase k_j . (x - c t).

At parameters q the rows of the flow velocity, x before y of each sample, are

    Phi = sum_j C_j(q) (a_j, b_j) + N b + E,

N the columns of the unknowns. RSS(q) = min over the weights of |E|^2 is a function of q alone
(variable projection; Golub and Pereyra, 1973). With A the derivatives of the flow by q and P the
projection off all columns, the Gauss-Newton move solves A'P A dq = A'E. A track may be cut into
pieces with separate amplitudes, which widens the basin of attraction of the parameters.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, field, replace

import numpy as np

from sparsefit.arrays import Array, box
from sparsefit.cached import cached_property
from sparsefit.model.grid import sines_and_cosines

RANK = 1e-12  # relative eigenvalues of a scaled Gram matrix that count as zero
END = 1e-3  # of pi over the extent or the duration: moves below it end a descent


@dataclass(frozen=True)
class Shape:
    """A kind of flow: its waves k_x + i k_y before rotation, as sums over its wavenumbers."""

    name: str
    waves: tuple[tuple[complex, ...], ...]  # the coefficients of l wavenumbers in J waves
    turned: bool = False  # rotated by a heading, counter-clockwise
    drifting: bool = False  # at a velocity c

    @property
    def parameters(self) -> int:
        """The number p of parameters."""
        return len((*self.waves, ())[0]) + self.turned + 2 * self.drifting

    @property
    def size(self) -> int:
        """The number of parameters and amplitudes."""
        return self.parameters + 2 * len(self.waves)

    @property
    def moving(self) -> Shape:
        """The drifting shape."""
        return replace(self, drifting=True)

    @property
    def steady(self) -> Shape:
        """The steady shape."""
        return replace(self, drifting=False)

    def phases(self, q: Array) -> tuple[Array, Array]:
        """(k_x, k_y, omega) of every wave (J, 3) at q (p,), and its derivatives by q (p, J, 3)."""
        phases, by_q = np.zeros((len(self.waves), 3)), np.zeros((len(q), len(self.waves), 3))
        if not self.waves:
            return phases, by_q
        waves = np.array(self.waves)
        count = waves.shape[1]
        if self.turned:
            waves = waves * cmath.exp(1j * q[count])
        k = waves @ q[:count]
        slopes = np.hstack([waves, 1j * k[:, None]])[:, : count + self.turned].T
        phases[:, 0], phases[:, 1] = k.real, k.imag
        by_q[: len(slopes), :, 0], by_q[: len(slopes), :, 1] = slopes.real, slopes.imag
        if self.drifting:
            phases[:, 2] = phases[:, :2] @ q[-2:]
            by_q[:, :, 2] = by_q[:, :, :2] @ q[-2:]
            by_q[-2:, :, 2] = phases[:, :2].T
        return phases, by_q

    def nearest(self, phases: Array) -> Array:
        """The parameters (p,) nearest to waves (k_x, k_y, omega) (J, 3).

        The heading of cells is that of k_1 + k_2, brought to (-pi/4, pi/4] by quarter turns, which
        exchange the waves.
        """
        k = phases[:, :2]
        moved = np.linalg.lstsq(k, phases[:, 2], rcond=None)[0] if self.drifting else np.zeros(0)
        if self.name not in ("axis", "square", "rectangle"):
            return np.concatenate([k.ravel(), moved])
        first, second = (complex(x, y) for x, y in k)
        if (first.conjugate() * second).imag > 0:  # the first is counter-clockwise
            first, second = second, first
        for _ in range(4):
            heading = cmath.phase(first + second)
            if -math.pi / 4 < heading <= math.pi / 4:
                break
            first, second = second, -first
        k_x, k_y = 0.5 * abs(first + second), 0.5 * abs(first - second)
        sides = [k_x, k_y] if len(self.waves[0]) == 2 else [math.sqrt(k_x * k_y)]
        return np.array([*sides, *([heading] if self.turned else []), *moved])


AXIS = Shape("axis", ((1 + 1j,), (1 - 1j,)))
"""Square cells along the axes: q = k = pi/L; the span of the 4 products of sines and cosines."""
SQUARE = replace(AXIS, name="square", turned=True)
"""Square cells at any heading: q = (k, heading)."""
RECTANGLE = Shape("rectangle", ((1, 1j), (1, -1j)), turned=True)
"""Rectangular cells at any heading: q = (k_x, k_y, heading), L_x = pi/k_x and L_y = pi/k_y."""
STAND = (AXIS, SQUARE, RECTANGLE)  # steady cells, the simplest first


def free_waves(count: int, *, drifting: bool = False) -> Shape:
    """Any waves, q = (k_x, k_y) of each: two are a ``pair``, others ``several``."""
    waves = tuple(map(tuple, np.kron(np.eye(count), [1, 1j]).tolist()))
    return Shape("pair" if count == 2 else "several", waves, drifting=drifting)


def axis_cells(count: int) -> Shape:
    """Square cells along the axes of several length scales, q = k = pi/L of each."""
    waves = tuple(map(tuple, np.kron(np.eye(count), [[1 + 1j], [1 - 1j]]).tolist()))
    return Shape("axis" if count == 1 else "scales", waves)


PAIR = free_waves(2)
"""Any two waves: q = (k_x, k_y) of the one and of the other."""


@dataclass(frozen=True)
class WaveCells:
    """The parameters of waves: U0 of all of them, the others of the two strongest.

        U0^2 = sum_j |k_j|^2 (a_j^2 + b_j^2),    L = sqrt(2) pi / sqrt(mean |k_j|^2)

    Two waves make cells between the lines on which (k_1 + k_2).x/2 and (k_1 - k_2).x/2 step by pi.
    """

    mean_velocity: float  # U0 [m/s]
    length_scale: float  # L [m]
    length_scales: tuple[float, float] = (math.nan, math.nan)  # [m] along the cells' own axes
    heading: float = math.nan  # of these, counter-clockwise [rad], in (-pi/4, pi/4]


def read_cells(wavevectors: Array, amplitudes: Array) -> WaveCells:
    """The fastest flow of waves k (j, 2) [rad/m] with amplitudes a, b (j, 2) [m^2/s]."""
    squares = np.sum(wavevectors**2, axis=1)
    powers = squares * np.sum(amplitudes**2, axis=1)
    part = max(flows_of(wavevectors, amplitudes), key=lambda part: float(powers[part].sum()))
    two = np.array(part)[np.sort(np.argsort(-powers[part], kind="stable")[:2])]
    speed = math.sqrt(float(powers[part].sum()))
    scale = math.pi * math.sqrt(2.0 / float(squares[two].mean()))
    if len(two) < 2:
        return WaveCells(speed, scale)
    first, second = wavevectors[two]
    both = first / np.hypot(*first) + second / np.hypot(*second)
    heading = math.atan2(both[1], both[0])
    quarters = round(heading / (0.5 * math.pi))
    x, y = (2 * math.pi / math.hypot(*side) for side in (first + second, first - second))
    sides = (y, x) if quarters % 2 else (x, y)
    return WaveCells(speed, scale, sides, heading - 0.5 * math.pi * quarters)


def flows_of(wavevectors: Array, amplitudes: Array) -> list[list[int]]:
    """The indices of the waves of each flow: of four waves two pairs of cells, or all.

    Two waves are cells if they are similar in strength and length and at right angles.
    """
    if len(wavevectors) != 4:
        return [list(range(len(wavevectors)))]
    size = np.log(np.maximum(np.hypot(*amplitudes.T), np.finfo(float).tiny))
    length = np.log(np.hypot(*wavevectors.T))
    along = wavevectors / np.exp(length)[:, None]
    pairings = np.array([[[0, 1], [2, 3]], [[0, 2], [1, 3]], [[0, 3], [1, 2]]])
    first, second = pairings[..., 0], pairings[..., 1]
    turned = np.abs(np.sum(along[first] * along[second], axis=2))
    unlike = np.abs(size[first] - size[second]) + np.abs(length[first] - length[second])
    # The angle has a weight of 0.1: of four equal waves, right angles are preferred.
    best = pairings[np.argmin(np.sum(unlike + 0.1 * turned, axis=1))]
    if np.abs(np.diff(size[best], axis=1)).max() > 0.2:  # waves that differ by more are no cells
        return [[0, 1, 2, 3]]
    pairs: list[list[int]] = best.tolist()
    return pairs


@dataclass(frozen=True, eq=False)
class FlowRows:
    """Rows of the flow velocity, with their weights."""

    place: Array  # (x, y, t) from their middle (m, 3) [m], [s]
    target: Array  # Phi of the assumed vehicle, (m, 2) [m/s], times the weight
    unknowns: Array  # N (m, 2, j), times the weight
    weight: Array  # (m,)
    _cuts: dict[int, tuple[Array, Array, Array]] = field(default_factory=dict)

    def cut(self, pieces: int) -> tuple[Array, Array, Array]:
        """The target (s, 2 n), x, y and -t (3, s, n), and -+ weights (s, 1, 2, n) of s pieces.

        A piece has n rows, x before y; the last one is padded by rows of weight 0. With pieces the
        target is `rest`.
        """
        if pieces not in self._cuts:
            target = self.target if pieces == 1 else self.rest
            rows = np.vstack([target.T, self.place.T, self.weight])
            count = -(-len(target) // pieces)
            rows = np.pad(rows, ((0, 0), (0, pieces * count - len(target))))
            x, y, *place, weight = rows.reshape(6, pieces, count)
            signed = weight[:, None, None] * [[-1.0], [1.0]]
            self._cuts[pieces] = np.hstack([x, y]), np.stack([*place[:2], -place[2]]), signed
        return self._cuts[pieces]

    @cached_property
    def square(self) -> float:
        """|Phi|^2 [m^2/s^2], or 1 where it is 0."""
        return float(np.sum(self.target**2)) or 1.0

    @cached_property
    def rest(self) -> Array:
        """Phi with its unknowns projected out, (m, 2) [m/s]."""
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
    """The fit of a shape at fixed parameters."""

    shape: Shape
    q: Array  # the parameters (p,)
    weights: Array  # a_1, b_1, a_2, ... [m^2/s], (2 J,), phases from the middle of the rows
    coefficients: Array  # b (j,) of the unknowns
    rest: Array  # the residual E (m, 2) [m/s]
    residual: float  # RSS [m^2/s^2]
    move: Array  # the Gauss-Newton step (p,); 0 where RSS is flat to rounding
    fall: float  # the predicted reduction of RSS by the move

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

    sizes (k,): the scale of each diagonal entry, to detect rounding; None: the diagonal itself.
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
    """Fit the rows by a shape at parameters q (p,); with pieces the unknowns are left out.

    A column is a vector, (k_y, -k_x), times one of g = (-sin theta, cos theta). Where psi = a cos
    theta + b sin theta, the flow is that vector times h = a g_1 + b g_2, and h has the derivative
    b g_1 - a g_2 by theta.
    """
    phases, by_q = shape.phases(q)
    target, axes, signed = rows.cut(pieces)
    count, size = 2 * len(phases), axes.shape[2]
    g = np.stack(sines_and_cosines(np.tensordot(phases, axes, axes=1)), axis=1)
    g = np.moveaxis(g, 2, 0) * signed  # (s, J, 2, n)
    across, turned = (part[..., [1, 0]] * (1.0, -1.0) for part in (phases, by_q))
    columns = (g[..., None, :] * across[:, None, :, None]).reshape(pieces, count, 2 * size)
    if pieces == 1 and rows.unknowns.size:
        others = rows.unknowns.transpose(2, 1, 0).reshape(1, -1, 2 * size)
        columns = np.concatenate([columns, others], axis=1)
    basis = orthonormal(columns @ columns.mT)
    weights = (basis @ (basis.mT @ (columns @ target[..., None])))[..., 0]
    rest = target - (weights[:, None] @ columns)[:, 0]
    move, fall = np.zeros(len(q)), 0.0
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
        along = steps.T @ np.sum(bent @ rest[..., None], axis=0)[:, 0]
        move, fall = steps @ along, float(along @ along)
    whole = rest.reshape(pieces, 2, size).swapaxes(1, 2).reshape(-1, 2)[: len(rows.target)]
    residual = float(np.sum(whole**2))
    return ShapeFit(shape, q, weights[0, :count], weights[0, count:], whole, residual, move, fall)


def descended(
    rows: FlowRows, shape: Shape, q: Array, *, pieces: int = 1, goal: float = math.inf
) -> ShapeFit:
    """The shape at the local minimum of RSS from q (p,).

    The descent ends if RSS would not fall below ``goal`` even if every remaining move gained as
    much as the next one predicts, if RSS falls by less than 1e-5, and after 25 moves. With pieces
    it ends at moves of a twentieth of a lobe.
    """
    here, reach = fitted(rows, shape, q, pieces), rows.reach(pieces)
    for remaining in range(25, 0, -1):
        if here.residual - remaining * here.fall > goal:
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
        here, fall = there, here.residual - there.residual
        if fall <= 1e-5 * here.residual:
            return here
    return here


def joined(rows: FlowRows, shape: Shape, q: Array, pieces: int) -> Array:
    """Parameters (p,) by descents in fewer and fewer pieces, near those of the whole track."""
    while pieces > 1:
        q = descended(rows, shape, q, pieces=pieces).q
        pieces = (pieces + 1) // 2
    return q
