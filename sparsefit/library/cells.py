"""The columns of cellular flows: 8 candidates a wavenumber, with their derivatives (Eq. 17).

At a wavenumber k = pi/L the candidates are the single sines and cosines of the phases k x and k y,
and their four products. Derivatives need no further sine: along a phase each candidate becomes
another one, with a sign, and d/dk = x d/d(kx) + y d/d(ky).

The span of the 8 candidates is that of the cosines and sines of k (p x + q y) in four `WAVES`
(p, q), and does not move with the origin.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.library.phase import sines_and_cosines

CANDIDATES = (
    "sin x",
    "sin y",
    "cos x",
    "cos y",
    "sin x sin y",
    "sin x cos y",
    "cos x sin y",
    "cos x cos y",
)
WAVES = np.array([(1, 0), (0, 1), (1, 1), (1, -1)])
"""The plane waves (p, q), of phase k (p x + q y), that span the candidates of one wavenumber."""
MEAN_SQUARE = np.array([0.5] * 4 + [0.25] * 4)
"""The mean square of each candidate over a cell."""
LAPLACIAN = np.array([1.0] * 4 + [2.0] * 4)
"""-(d2/dx2 + d2/dy2) of each candidate, over k^2 times the candidate."""
BUILD_ROWS = 64  # of theta at once: they stay in cache
MAX_THETA_BYTES = 8 * 2**30
CELL_POINTS = 64  # per axis, to bracket the peak of |w| before it is refined
_ALONG = (  # each candidate's derivative by the phases k x and k y: which candidate, what sign
    ((2, 0, 0, 0, 6, 7, 4, 5), (1.0, 0.0, -1.0, 0.0, 1.0, 1.0, -1.0, -1.0)),
    ((0, 3, 0, 1, 5, 4, 7, 6), (0.0, 1.0, 0.0, -1.0, 1.0, -1.0, 1.0, -1.0)),
)
_PERMUTED = tuple(list(places) for places, _ in _ALONG)
_SIGNED = tuple(np.array(signs)[:, None] for _, signs in _ALONG)
_MATRICES = tuple(np.eye(8)[:, places] * signs for places, signs in _ALONG)  # C M W = (dC) W


def products(x: Array, y: Array, out: list[Array]) -> None:
    """Write the 8 candidates at phases k x and k y into 8 arrays of their shape."""
    (sin_x, cos_x), (sin_y, cos_y) = sines_and_cosines(x), sines_and_cosines(y)
    out[0][...], out[1][...], out[2][...], out[3][...] = sin_x, sin_y, cos_x, cos_y
    np.multiply(sin_x, sin_y, out=out[4])
    np.multiply(sin_x, cos_y, out=out[5])
    np.multiply(cos_x, sin_y, out=out[6])
    np.multiply(cos_x, cos_y, out=out[7])


def along(values: Array, axis: int) -> Array:
    """The derivative by the phase k x (axis 0) or k y (axis 1) of candidates (..., 8, m)."""
    derivative: Array = _SIGNED[axis] * values[..., _PERMUTED[axis], :]
    return derivative


def candidate_columns(position: Array, scales: Array) -> Array:
    """Theta (m, 8 g) of Eq. 19, group-major: one sine and cosine per scale and axis, then products.

    Args:
        position: (m, 2) [m].
        scales: length scales (g,) [m].

    Raises:
        InputError: if theta would not fit in memory.
    """
    size = len(position) * len(scales) * len(CANDIDATES) * 8
    if size > MAX_THETA_BYTES:
        raise InputError(
            f"a library of {len(position)} samples x {len(scales)} scales x 8 needs "
            f"{size / 2**30:.1f} GiB; use fewer scales or samples"
        )
    theta = np.empty((len(position), len(scales), len(CANDIDATES)))
    wavenumbers, buffer = np.pi / scales, np.empty((len(CANDIDATES), BUILD_ROWS, len(scales)))
    # Rows in blocks, so that sines, cosines and their products stay in cache; each block in one
    # piece a candidate, as strided products take twice the time.
    for start in range(0, len(theta), BUILD_ROWS):
        block = position[start : start + BUILD_ROWS]
        x, y = block[:, :1] * wavenumbers, block[:, 1:] * wavenumbers
        columns = buffer[:, : len(block)]
        products(x, y, list(columns))
        theta[start : start + BUILD_ROWS] = columns.transpose(1, 2, 0)
    return theta.reshape(len(position), -1)


@dataclass(frozen=True)
class Cells:
    """The paper's family: one parameter k = pi/L [1/m], 8 candidates for each velocity component.

    Both components have the same columns and weights of their own, W (8, 2) [m/s].
    """

    name: ClassVar[str] = "cells"
    parameters: ClassVar[int] = 1
    size: ClassVar[int] = 8
    targets: ClassVar[int] = 2

    def values(self, position: Array, parameters: Array) -> Array:
        """Columns (s, 8, m) at positions (m, 2) [m], for parameters (s, 1): k [1/m]."""
        x, y = (np.outer(parameters[:, 0], along_axis) for along_axis in position.T)
        values = np.empty((len(parameters), self.size, len(position)))
        products(x, y, [values[:, i] for i in range(self.size)])
        return values

    def slopes(self, position: Array, parameters: Array, values: Array) -> Array:
        """d/dk of the columns [m], as (s, 1, 8, m)."""
        x, y = position.T
        slopes: Array = x * along(values, 0) + y * along(values, 1)
        return slopes[:, None]

    def bends(self, position: Array, parameters: Array, values: Array) -> Array:
        """d2/dk2 of the columns [m^2], as (s, 1, 1, 8, m)."""
        slopes = self.slopes(position, parameters, values)[:, 0]
        return self.slopes(position, parameters, slopes)[:, :, None]

    def bent(self, position: Array, parameters: Array, values: Array, weights: Array) -> Array:
        """d/dk of the flow of each mode, from weights (s, 8, 2), as (s, 1, m, 2).

        The derivative along a phase permutes the columns, and so may permute the weights instead.
        """
        turned = np.concatenate([matrix @ weights for matrix in _MATRICES], axis=2)
        by_phase, (x, y) = turned.swapaxes(1, 2) @ values, position.T
        bent: Array = x * by_phase[:, :2] + y * by_phase[:, 2:]
        return bent.swapaxes(1, 2)[:, None]

    def bent_gradients(
        self, position: Array, parameters: Array, values: Array, weights: Array
    ) -> Array:
        """The derivatives of `bent` by x and by y [1/(m s)], as (2, s, 1, m, 2)."""
        k, (x, y) = parameters[:, 0, None, None], position.T[:, :, None]
        columns, bent = values.transpose(0, 2, 1), []
        for matrix in _MATRICES:
            turned = [matrix @ weights, *(other @ matrix @ weights for other in _MATRICES)]
            parts = columns @ np.concatenate(turned, axis=2)
            bent.append(parts[..., :2] + k * (x * parts[..., 2:4] + y * parts[..., 4:]))
        return np.stack(bent)[:, :, None]

    def gradients(self, parameters: Array, values: Array) -> Array:
        """The derivatives of the columns by x and by y [1/m], as (2, s, 8, m)."""
        k = parameters[:, 0, None, None]
        return np.stack([k * along(values, axis) for axis in range(2)])

    def laplacians(self, parameters: Array, values: Array) -> Array:
        """The Laplacian of the columns [1/m^2], (s, 8, m)."""
        k = parameters[:, 0, None, None]
        laplacians: Array = -(k * k) * LAPLACIAN[:, None] * values
        return laplacians


def rms_mean_velocity(weights: Array) -> float:
    """U0 = sqrt(2 <|w|^2>) [m/s] over the cell, in closed form, from weights (8, 2) [m/s].

    A single has mean square 1/2 and a product 1/4; the cellular flow of Eq. 1 has
    <|w|^2> = U0^2 / 2.
    """
    return float(np.sqrt(2 * np.sum(MEAN_SQUARE[:, None] * weights**2)))


def peak_mean_velocity(weights: Array) -> float:
    """The largest |w| over the cell [m/s], for weights (8, 2) [m/s]: U0 for the flow of Eq. 1."""
    from scipy.optimize import minimize

    unit = np.ones((1, 1))

    def speed_square(phases: Array) -> Array:
        velocity = Cells().values(phases, unit)[0].T @ weights
        square: Array = np.sum(velocity**2, axis=1)
        return square

    axis = np.linspace(0, 2 * np.pi, CELL_POINTS, endpoint=False)
    cell = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    squares = speed_square(cell)
    top = float(squares.max())
    if not top > 0:
        return top

    def loss(phase: Array) -> float:
        return -float(speed_square(phase[None, :])[0]) / top

    best = minimize(loss, cell[int(squares.argmax())], tol=1e-14)
    return float(math.sqrt(-best.fun * top))
