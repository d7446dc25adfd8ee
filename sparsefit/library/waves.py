"""The columns of waves of a stream function, steady or drifting, in patterns that share parameters.

An incompressible flow in the plane has a stream function psi, u = d psi/dy and v = -d psi/dx. Of

    psi = sum_j a_j cos theta_j + b_j sin theta_j,    theta_j = k_j . x - omega_j t,

each wave j gives two columns, which both velocity components share (n = 1, rows x before y). With
g = d/d theta of cos and of sin, they are (k_y, -k_x) g(theta): every derivative turns one of the
two into the other, with a sign. Waves whose pattern moves at a drift c have omega_j = k_j . c.

A mode is a *pattern* of waves: cells are two of them, k = (k_x, +-k_y) in the cells' own axes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.library.phase import sines_and_cosines

Coefficients = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Pattern:
    """How a mode's parameters q set its waves' (k_x, k_y) [1/m] and omega [1/s].

    Args:
        name: of the pattern.
        waves: for each wave k_x and k_y, as coefficients of the wavenumbers among q: (J, 2, l).
        turned: whether the whole pattern is turned by a heading [rad], counter-clockwise.
        drifting: whether every wave has an omega of its own.

    q = (l wavenumbers, J omegas if drifting, the heading if turned).
    """

    name: str
    waves: tuple[Coefficients, ...]
    turned: bool = False
    drifting: bool = False

    @property
    def size(self) -> int:
        """The number J of waves."""
        return len(self.waves)

    @property
    def wavenumbers(self) -> int:
        """The number l of wavenumbers among the parameters."""
        return len(self.waves[0][0])

    @property
    def parameters(self) -> int:
        """The number p of parameters."""
        return self.wavenumbers + self.size * self.drifting + self.turned

    @property
    def moving(self) -> Pattern:
        """The same pattern where its waves drift."""
        return replace(self, drifting=True)

    @property
    def steady(self) -> Pattern:
        """The same pattern where its waves stand."""
        return replace(self, drifting=False)

    @cached_property
    def _matrix(self) -> Array:
        """The waves (J, 3) before they are turned, by every parameter: (p, J, 3)."""
        matrix = np.zeros((self.parameters, self.size, 3))
        given = np.array(self.waves, dtype=float)
        matrix[: self.wavenumbers, :, :2] = given.transpose(2, 0, 1)
        if self.drifting:
            own = np.arange(self.size)
            matrix[self.wavenumbers + own, own, 2] = 1.0
        return matrix

    def phases(self, parameters: Array) -> Array:
        """(k_x, k_y, omega) of every wave, (s, J, 3), of parameters (s, p)."""
        flat = parameters @ self._matrix.reshape(self.parameters, -1)
        phases: Array = flat.reshape(len(flat), self.size, 3)
        return phases @ _turns(parameters[:, -1]) if self.turned else phases

    def slopes(self, parameters: Array) -> Array:
        """The derivatives of `phases` by the parameters, (s, p, J, 3)."""
        shape = (len(parameters), *self._matrix.shape)
        if not self.turned:
            return np.broadcast_to(self._matrix, shape)
        slopes: Array = (self._matrix.reshape(-1, 3) @ _turns(parameters[:, -1])).reshape(shape)
        slopes[:, -1] = self.phases(parameters) @ QUARTER
        return slopes

    def bends(self, parameters: Array) -> Array:
        """The second derivatives of `phases`, (s, p, p, J, 3): by the heading alone."""
        count = self.parameters
        bends = np.zeros((len(parameters), count, count, self.size, 3))
        if self.turned:
            crossed = self.slopes(parameters) @ QUARTER
            bends[:, -1], bends[:, :, -1] = crossed, crossed
        return bends


# Of rows (k_x, k_y, omega): turned by a quarter, their omegas 0, the derivative by the heading; and
# the direction of a wave's flow, (k_y, -k_x), which is also its size.
QUARTER = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
ACROSS = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
ALONG = np.array([1.0, 1.0, -1.0])  # theta = k_x x + k_y y - omega t


def _turns(heading: Array) -> Array:
    """What turns rows (k_x, k_y, omega) by headings (s,) [rad], (s, 3, 3)."""
    turns = np.zeros((len(heading), 3, 3))
    turns[:, 0, 0] = turns[:, 1, 1] = np.cos(heading)
    turns[:, 0, 1] = sine = np.sin(heading)
    turns[:, 1, 0], turns[:, 2, 2] = -sine, 1.0
    return turns


WAVE = Pattern("wave", (((1, 0), (0, 1)),))
"""One wave: q = (k_x, k_y)."""
POLAR = Pattern("wave", (((1,), (0,)),), turned=True)
"""One wave: q = (|k|, heading of k)."""
PAIR = Pattern("pair", (((1, 0, 0, 0), (0, 1, 0, 0)), ((0, 0, 1, 0), (0, 0, 0, 1))))
"""Any two waves: q = (k_x, k_y) of the one and of the other."""
AXIS = Pattern("axis", (((1,), (1,)), ((1,), (-1,))))
"""Square cells along the axes: q = k = pi/L; the span of the 4 products of sines and cosines."""
SQUARE = replace(AXIS, name="square", turned=True)
"""Square cells at any heading: q = (k, heading)."""
RECTANGLE = Pattern("rectangle", (((1, 0), (0, 1)), ((1, 0), (0, -1))), turned=True)
"""Rectangular cells at any heading: q = (k_x, k_y, heading), L_x = pi/k_x and L_y = pi/k_y."""


@dataclass(frozen=True)
class Waves:
    """The family of one pattern of waves: two columns [1/m] a wave, of psi = cos and psi = sin.

    Weights (2 J, 1) are a_1, b_1, a_2, ... [m^2/s]. Positions are (m, 2) [m], or (m, 3) with the
    time [s] as third coordinate, which patterns that drift need.
    """

    name: ClassVar[str] = "waves"
    targets: ClassVar[int] = 1
    pattern: Pattern = WAVE

    @property
    def parameters(self) -> int:
        """The number p of parameters of the pattern."""
        return self.pattern.parameters

    @property
    def size(self) -> int:
        """The number of columns of a mode, 2 J."""
        return 2 * self.pattern.size

    def values(self, position: Array, parameters: Array) -> Array:
        """Columns (s, 2 J, 2 m) at positions (m, 2) or (m, 3), for parameters (s, p)."""
        phases = self.pattern.phases(parameters)
        theta, across = along_path(phases, position), (phases @ ACROSS)[..., None]
        values = np.empty((*theta.shape[:2], 2, 2, theta.shape[2]))
        sine, cosine = sines_and_cosines(theta)
        np.multiply(-across, sine[:, :, None], out=values[:, :, 0])  # g of cos
        np.multiply(across, cosine[:, :, None], out=values[:, :, 1])  # g of sin
        return self._joined(values)

    def slopes(self, position: Array, parameters: Array, values: Array) -> Array:
        """Their first derivatives by the parameters, (s, p, 2 J, 2 m)."""
        phases, by_q = self.pattern.phases(parameters), self.pattern.slopes(parameters)
        waves, across = self._waves(phases, values), phases @ ACROSS
        later, moved = _along(waves), along_path(by_q, position)
        slopes = _product(by_q @ ACROSS, waves[:, None])
        slopes += _product(across[:, None], later[:, None] * moved[:, :, :, None])
        return self._joined(slopes)

    def bends(self, position: Array, parameters: Array, values: Array) -> Array:
        """Their second derivatives by the parameters, (s, p, p, 2 J, 2 m)."""
        pattern = self.pattern
        phases, by_q = pattern.phases(parameters), pattern.slopes(parameters)
        twice, moved = pattern.bends(parameters), along_path(by_q, position)
        waves = self._waves(phases, values)
        later, across, turned = _along(waves), phases @ ACROSS, by_q @ ACROSS
        first = moved[:, :, None, :, None] * later[:, None, None]
        second = moved[:, None, :, :, None] * later[:, None, None]
        square = (moved[:, :, None] * moved[:, None])[:, :, :, :, None] * waves[:, None, None]
        bow = along_path(twice, position)[:, :, :, :, None] * later[:, None, None]
        bends = _product(twice @ ACROSS, waves[:, None, None])
        bends += _product(turned[:, None], first) + _product(turned[:, :, None], second)
        bends += _product(across[:, None, None], bow - square)
        return self._joined(bends)

    def bent(self, position: Array, parameters: Array, values: Array, weights: Array) -> Array:
        """The derivatives of each mode's flow by its parameters, (s, p, 2 m, 1).

        weights: (s, 2 J, 1), or (s, 2 J, m) where they change along the rows.
        """
        return self.bent_and_late(position, parameters, weights)[0]

    def bent_and_late(
        self, position: Array, parameters: Array, weights: Array, delays: Array | float = 0.0
    ) -> tuple[Array, Array]:
        """`bent`, and the derivatives of each wave's flow by its own phase, (s, J, 2 m, 1).

        delays (s, J, 1): that waves' phases are less by; weights of (s, 2, 1) are those of all.
        """
        phases, by_q = self.pattern.phases(parameters), self.pattern.slopes(parameters)
        flow, later = _flows(along_path(phases, position) - delays, weights)
        across, rows = phases @ ACROSS, 2 * len(position)
        modes, count, waves, _ = by_q.shape
        turned = (by_q @ ACROSS).swapaxes(2, 3).reshape(modes, 2 * count, waves)
        bent = (turned @ flow).reshape(modes, count, 2, len(position))
        bent += across.swapaxes(1, 2)[:, None] @ (along_path(by_q, position) * later[:, None])
        late = across[..., None] * later[:, :, None]
        return bent.reshape(*bent.shape[:2], rows, 1), late.reshape(*late.shape[:2], rows, 1)

    def bent_gradients(
        self, position: Array, parameters: Array, values: Array, weights: Array
    ) -> Array:
        """The derivatives of `bent` by x and by y, (2, s, p, 2 m, 1)."""
        phases, by_q = self.pattern.phases(parameters), self.pattern.slopes(parameters)
        flow, later = _flows(along_path(phases, position), weights)
        moved, across, turned = along_path(by_q, position), phases @ ACROSS, by_q @ ACROSS
        both = []
        for axis in range(2):
            k, k_by_q = phases[..., axis], by_q[..., axis]
            gradient = np.einsum("spjd,sjm->spdm", turned, k[..., None] * later)
            inner = k_by_q[..., None] * later[:, None]
            inner -= k[:, None, :, None] * moved * flow[:, None]
            gradient += np.einsum("sjd,spjm->spdm", across, inner)
            both.append(gradient.reshape(*gradient.shape[:2], 2 * gradient.shape[-1], 1))
        return np.stack(both)

    def gradients(self, parameters: Array, values: Array) -> Array:
        """The derivatives of the columns by x and by y [1/m], (2, s, 2 J, r)."""
        k = self.pattern.phases(parameters)[..., :2]
        shape = (*k.shape[:2], 2, values.shape[-1])
        later = _along(values.reshape(shape))
        gradients = [(k[:, :, axis, None, None] * later).reshape(values.shape) for axis in (0, 1)]
        return np.stack(gradients)

    def laplacians(self, parameters: Array, values: Array) -> Array:
        """The Laplacian of the columns [1/m^2], (s, 2 J, r)."""
        k = self.pattern.phases(parameters)[..., :2]
        laplacians: Array = -np.repeat(np.sum(k * k, axis=2), 2, axis=1)[:, :, None] * values
        return laplacians

    def _waves(self, phases: Array, values: Array) -> Array:
        """G of cos and of sin, (s, J, 2, m), of columns (s, 2 J, 2 m)."""
        across = phases @ ACROSS
        parts = values.reshape(*phases.shape[:2], 2, 2, values.shape[-1] // 2)
        waves: Array = np.einsum("sjd,sjcdm->sjcm", across, parts)
        square: Array = np.sum(across * across, axis=2)
        waves /= np.where(square > 0, square, 1.0)[:, :, None, None]
        return waves

    def _joined(self, parts: Array) -> Array:
        """Columns (..., 2 J, 2 m) of values by wave, column and component, (..., J, 2, 2, m)."""
        joined: Array = parts.reshape(*parts.shape[:-4], self.size, 2 * parts.shape[-1])
        return joined


def along_path(phases: Array, position: Array) -> Array:
    """Theta (..., m) at positions (m, 2), or (m, 3) with the time, of waves (..., 3)."""
    shape, axes = phases.shape[:-1], position.shape[1]
    flat = (phases * ALONG)[..., :axes].reshape(math.prod(shape), axes)
    theta: Array = flat @ position.T  # one product, not one for every mode
    return theta.reshape(*shape, len(position))


def _flows(theta: Array, weights: Array) -> tuple[Array, Array]:
    """psi's derivative by theta (s, J, m) and its next one, of every wave, (s, J, m) each."""
    (sin, cos), a, b = sines_and_cosines(theta), weights[:, ::2], weights[:, 1::2]
    return b * cos - a * sin, -a * cos - b * sin


def _along(waves: Array) -> Array:
    """The derivative by theta of values (..., 2, r) of cos and sin: each becomes the other."""
    return np.stack([-waves[..., 1, :], waves[..., 0, :]], axis=-2)


def _product(across: Array, waves: Array) -> Array:
    """Directions (..., J, 2) times values (..., J, 2, m), as (..., J, 2 columns, 2, m)."""
    product: Array = across[..., :, None, :, None] * waves[..., :, :, None, :]
    return product
