"""The columns of cellular flows: 8 candidates a wavenumber, with their derivatives (Eq. 17).

At a wavenumber k = pi/L the candidates are the single sines and cosines of the phases k x and k y,
and their four products. Derivatives need no further sine: along a phase each candidate becomes
another one, with a sign, and d/dk = x d/d(kx) + y d/d(ky).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.errors import InputError

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
MEAN_SQUARE = np.array([0.5] * 4 + [0.25] * 4)
"""The mean square of each candidate over a cell."""
BUILD_ROWS = 64  # of theta at once: they stay in cache
MAX_THETA_BYTES = 8 * 2**30
CELL_POINTS = 64  # per axis, to bracket the peak of |w| before it is refined
_ALONG = (  # each candidate's derivative by the phases k x and k y: which candidate, what sign
    ([2, 0, 0, 0, 6, 7, 4, 5], (1.0, 0.0, -1.0, 0.0, 1.0, 1.0, -1.0, -1.0)),
    ([0, 3, 0, 1, 5, 4, 7, 6], (0.0, 1.0, 0.0, -1.0, 1.0, -1.0, 1.0, -1.0)),
)


def sines_and_cosines(phase: Array) -> tuple[Array, Array]:
    """sin and cos of phases [rad] of any shape, to 3 units of rounding of 1.

    Both are rational in the tangent of half the phase: with t = tan(phase / 2)

        sin = 2 t / (1 + t^2),   cos = 2 / (1 + t^2) - 1,

    one transcendental function instead of two, and the one that numpy evaluates side by side.
    """
    half = np.tan(0.5 * phase)
    share = 2.0 / (1.0 + half * half)
    return half * share, share - 1.0


def candidates(x: Array, y: Array, out: Array) -> Array:
    """The 8 candidates at phases k x and k y of one shape, written to ``out`` (8, ...)."""
    (out[0], out[2]), (out[1], out[3]) = sines_and_cosines(x), sines_and_cosines(y)
    for place, (first, second) in enumerate(((0, 1), (0, 3), (2, 1), (2, 3)), 4):
        np.multiply(out[first], out[second], out=out[place])
    return out


def check_size(rows: int, columns: int, words: str) -> None:
    """InputError where a dense library of so many rows and columns would not fit in memory."""
    size = 8 * rows * columns
    if size > MAX_THETA_BYTES:
        raise InputError(
            f"a library of {words} needs {size / 2**30:.1f} GiB; use fewer waves, scales or samples"
        )


def candidate_columns(position: Array, scales: Array) -> Array:
    """Theta (m, 8 g) of Eq. 19, group-major: one sine and cosine per scale and axis, then products.

    Args:
        position: (m, 2) [m].
        scales: length scales (g,) [m].

    Raises:
        InputError: if theta would not fit in memory.
    """
    words = f"{len(position)} samples x {len(scales)} scales x 8"
    check_size(len(position), len(scales) * len(CANDIDATES), words)
    theta = np.empty((len(position), len(scales), len(CANDIDATES)))
    wavenumbers, buffer = np.pi / scales, np.empty((len(CANDIDATES), BUILD_ROWS, len(scales)))
    # Rows in blocks, so that sines, cosines and their products stay in cache; each block in one
    # piece a candidate, as strided products take twice the time.
    for start in range(0, len(theta), BUILD_ROWS):
        block = position[start : start + BUILD_ROWS]
        columns = buffer[:, : len(block)]
        candidates(block[:, :1] * wavenumbers, block[:, 1:] * wavenumbers, columns)
        theta[start : start + BUILD_ROWS] = columns.transpose(1, 2, 0)
    return theta.reshape(len(position), -1)


def candidate_jet(position: Array, wavenumbers: Array) -> tuple[Array, Array, Array]:
    """The candidates (s, 8, m) at wavenumbers (s,) [1/m], and d/dk [m] and d2/dk2 [m^2] of them."""
    x, y = position.T
    values = np.empty((8, len(wavenumbers), len(position)))
    candidates(wavenumbers[:, None] * x, wavenumbers[:, None] * y, values)

    def slope(columns: Array) -> Array:
        by_x, by_y = (np.array(signs)[:, None, None] * columns[places] for places, signs in _ALONG)
        slopes: Array = x * by_x + y * by_y
        return slopes

    first = slope(values)
    value, rate, bend = (jet.swapaxes(0, 1) for jet in (values, first, slope(first)))
    return value, rate, bend


def rms_mean_velocity(weights: Array) -> float:
    """U0 = sqrt(2 <|w|^2>) [m/s] over the cell, in closed form, from weights (8, 2) [m/s].

    A single has mean square 1/2 and a product 1/4; the cellular flow of Eq. 1 has
    <|w|^2> = U0^2 / 2.
    """
    return float(np.sqrt(2 * np.sum(MEAN_SQUARE[:, None] * weights**2)))


def peak_mean_velocity(weights: Array) -> float:
    """The largest |w| over the cell [m/s], for weights (8, 2) [m/s]: U0 for the flow of Eq. 1."""
    from scipy.optimize import minimize

    def speed_square(phases: Array) -> Array:
        x, y = phases.T
        columns = candidates(x, y, np.empty((8, len(phases))))
        square: Array = np.sum((columns.T @ weights) ** 2, axis=1)
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


@dataclass(frozen=True, eq=False)
class CandidateFlow:
    """A sum of weighted candidates and a wind; its weights are free, so it may have a divergence.

    w(x) = sum_j C(k_j, x - x0) W_j + wind, C the 8 candidates of a wavenumber (Eq. 17).

    Args:
        wavenumbers: k = pi/L (s,) [1/m].
        weights: W (s, 8, 2) [m/s].
        origin: x0 (2,) [m], where the phases of the candidates are 0.
        wind: [m/s], (x, y).
    """

    wavenumbers: Array
    weights: Array
    origin: Array
    wind: tuple[float, float] = (0.0, 0.0)

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m]; t [s] changes nothing."""
        east, north, _ = np.broadcast_arrays(
            np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64), t
        )
        place = np.column_stack([east.ravel(), north.ravel()]) - self.origin
        theta = candidate_columns(place, math.pi / self.wavenumbers)
        total: Array = theta @ self.weights.reshape(-1, 2) + np.array(self.wind)
        return total.reshape(*east.shape, 2)
