"""Shapes of flow as data: how few parameters set the waves of a stream function.

    axis-aligned square cells  <  square at any heading  <  rectangular  <  any two waves,

each steady or drifting as a whole; several are waves of any wavevector, or axis-aligned cells of
several length scales. The parameters are q = (wavenumbers [rad/m], heading [rad] if the shape may
be turned, c_x, c_y [m/s] if it drifts); wave j has the phase k_j . (x - c t).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array


@dataclass(frozen=True)
class Shape:
    """The wavevectors of a shape before it is turned, as coefficients of its wavenumbers.

    Args:
        name: of the shape.
        waves: for each of J waves k_x and k_y by the l wavenumbers, (J, 2, l).
        turned: whether the shape is turned by a heading, counter-clockwise.
        drifting: whether it moves at a velocity c.
    """

    name: str
    waves: tuple[tuple[tuple[float, ...], ...], ...]
    turned: bool = False
    drifting: bool = False

    @property
    def wavenumbers(self) -> int:
        """The number l of wavenumbers among the parameters."""
        return len(self.waves[0][0]) if self.waves else 0

    @property
    def parameters(self) -> int:
        """The number p of parameters."""
        return self.wavenumbers + self.turned + 2 * self.drifting

    @property
    def size(self) -> int:
        """The number of parameters and amplitudes."""
        return self.parameters + 2 * len(self.waves)

    @property
    def cells(self) -> bool:
        """True where its two waves are equally long sides of cells."""
        return self.name in ("axis", "square", "rectangle")

    @property
    def moving(self) -> Shape:
        """The shape where it drifts."""
        return replace(self, drifting=True)

    @property
    def steady(self) -> Shape:
        """The shape where it stands."""
        return replace(self, drifting=False)

    def phases(self, q: Array) -> tuple[Array, Array]:
        """(k_x, k_y, omega) of every wave (J, 3) at q (p,), and its derivatives by q (p, J, 3)."""
        count = self.wavenumbers
        by_q = np.zeros((self.parameters, len(self.waves), 3))
        if not count:
            return np.zeros((0, 3)), by_q
        by_q[:count, :, :2] = np.array(self.waves).transpose(2, 0, 1)
        if self.turned:
            cos, sin = math.cos(q[count]), math.sin(q[count])
            by_q[:count, :, :2] = by_q[:count, :, :2] @ np.array([[cos, sin], [-sin, cos]])
        phases = np.zeros((len(self.waves), 3))
        phases[:, :2] = np.tensordot(q[:count], by_q[:count, :, :2], axes=1)
        if self.turned:
            by_q[count, :, :2] = phases[:, [1, 0]] * (-1.0, 1.0)
        if self.drifting:
            phases[:, 2] = phases[:, :2] @ q[-2:]
            by_q[:, :, 2] = by_q[:, :, :2] @ q[-2:]
            by_q[-2:, :, 2] = phases[:, :2].T
        return phases, by_q

    def nearest(self, phases: Array) -> Array:
        """The parameters (p,) that come nearest to waves (k_x, k_y, omega) (J, 3).

        The heading of cells is that of k_1 + k_2, brought to (-pi/4, pi/4] by a quarter turn,
        which exchanges the waves.
        """
        k = phases[:, :2]
        moved = np.linalg.lstsq(k, phases[:, 2], rcond=None)[0] if self.drifting else np.zeros(0)
        if not self.cells:
            return np.concatenate([k.ravel(), moved])
        first, second = k
        if second[0] * first[1] < second[1] * first[0]:  # the first is counter-clockwise
            first, second = second, first
        for _ in range(4):
            heading = math.atan2(first[1] + second[1], first[0] + second[0])
            if -math.pi / 4 < heading <= math.pi / 4:
                break
            first, second = second, -first
        k_x, k_y = (0.5 * math.hypot(*side) for side in (first + second, first - second))
        sides = [k_x, k_y] if self.wavenumbers == 2 else [math.sqrt(k_x * k_y)]
        return np.array([*sides, *([heading] if self.turned else []), *moved])


AXIS = Shape("axis", (((1,), (1,)), ((1,), (-1,))))
"""Square cells along the axes: q = k = pi/L; the span of the 4 products of sines and cosines."""
SQUARE = replace(AXIS, name="square", turned=True)
"""Square cells at any heading: q = (k, heading)."""
RECTANGLE = Shape("rectangle", (((1, 0), (0, 1)), ((1, 0), (0, -1))), turned=True)
"""Rectangular cells at any heading: q = (k_x, k_y, heading), L_x = pi/k_x and L_y = pi/k_y."""


def free_waves(count: int, *, drifting: bool = False) -> Shape:
    """Any waves, q = (k_x, k_y) of each: two are a ``pair``, others ``several``."""
    unit = np.eye(2 * count).reshape(count, 2, 2 * count).tolist()
    waves = tuple(tuple(map(tuple, wave)) for wave in unit)
    return Shape("pair" if count == 2 else "several", waves, drifting=drifting)


def axis_cells(count: int) -> Shape:
    """Square cells along the axes of several length scales, q = k = pi/L of each."""
    unit = np.eye(count).tolist()
    waves = tuple(
        (tuple(row), tuple(sign * value for value in row)) for row in unit for sign in (1.0, -1.0)
    )
    return Shape("axis" if count == 1 else "several", waves)


PAIR = free_waves(2)
"""Any two waves: q = (k_x, k_y) of the one and of the other."""


@dataclass(frozen=True)
class WaveCells:
    """The parameters that are read from waves: U0 of all of them, the rest of the two strongest.

        U0^2 = sum_j |k_j|^2 (a_j^2 + b_j^2),    L = sqrt(2) pi / sqrt(mean |k_j|^2)

    Two waves make cells between the lines on which (k_1 + k_2).x/2 and (k_1 - k_2).x/2 step by pi.

    Args:
        mean_velocity: U0 [m/s].
        length_scale: L [m].
        length_scales: (L_x, L_y) [m] in the cells' own axes, NaN of one wave.
        heading: by which these are turned counter-clockwise [rad], in (-pi/4, pi/4].
    """

    mean_velocity: float
    length_scale: float
    length_scales: tuple[float, float] = (math.nan, math.nan)
    heading: float = math.nan


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
    """The places of the waves of every flow: of four waves that are two flows of cells, or of all.

    Two waves are cells where they are alike in strength, length and at right angles.
    """
    if len(wavevectors) != 4:
        return [list(range(len(wavevectors)))]
    size = np.log(np.maximum(np.hypot(*amplitudes.T), np.finfo(float).tiny))
    length = np.log(np.hypot(*wavevectors.T))
    along = wavevectors / np.exp(length)[:, None]

    def unlike(pairing: Array) -> float:
        first, second = pairing.T
        apart = np.abs(size[first] - size[second]) + np.abs(length[first] - length[second])
        # The angle counts a tenth: of waves all alike, squares are preferred.
        turned = np.abs(np.sum(along[first] * along[second], axis=1))
        return float(np.sum(apart + 0.1 * turned))

    best = min((np.array(own) for own in ([[0, 1], [2, 3]], [[0, 2], [1, 3]], [[0, 3], [1, 2]])),
               key=unlike)  # fmt: skip
    if np.abs(np.diff(size[best], axis=1)).max() > 0.2:  # waves that differ by more make no cells
        return [[0, 1, 2, 3]]
    return [list(map(int, pair)) for pair in best]
