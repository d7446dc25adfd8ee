"""Trigonometric columns: the candidates of cells (Eq. 17), and the waves of a stream function.

At a wavenumber k = pi/L the candidates of cells are the single sines and cosines of the phases k x
and k y, and their four products. An incompressible flow in the plane has a stream function psi, u =
d psi/dy and v = -d psi/dx. Of

    psi = sum_j a_j cos theta_j + b_j sin theta_j,    theta_j = k_j . x,

each wave j gives two columns, which both velocity components share: rows are x before y of each
sample. With g = d/d theta of cos and of sin, they are (k_y, -k_x) g(theta). k is in rad/m, a and b
in m^2/s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array, IntArray
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
APART = 1.5  # in pi/extent: nearer waves are one peak, the diagonal of a grid of one step


def sines_and_cosines(phase: Array) -> tuple[Array, Array]:
    """sin and cos of phases [rad] of any shape, to 3 units of rounding of 1.

    Both are rational in the tangent of half the phase: with t = tan(phase / 2)

        sin = 2 t / (1 + t^2),   cos = 2 / (1 + t^2) - 1,

    one transcendental function instead of two, and the one that numpy evaluates side by side.
    """
    half = np.tan(0.5 * phase)
    share = 2.0 / (1.0 + half * half)
    return half * share, share - 1.0


def check_size(rows: int, columns: int, words: str) -> None:
    """InputError where a dense library of so many rows and columns would not fit in memory."""
    size = 8 * rows * columns
    if size > 8 * 2**30:
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
    k = np.pi / scales
    for start in range(0, len(theta), BUILD_ROWS):  # sines, cosines and products stay in cache
        block, out = position[start : start + BUILD_ROWS], theta[start : start + BUILD_ROWS]
        (out[..., 0], out[..., 2]), (out[..., 1], out[..., 3]) = (
            sines_and_cosines(block[:, axis : axis + 1] * k) for axis in range(2)
        )
        for place, (first, second) in enumerate(((0, 1), (0, 3), (2, 1), (2, 3)), 4):
            np.multiply(out[..., first], out[..., second], out=out[..., place])
    return theta.reshape(len(position), -1)


def wave_theta(position: Array, wavevectors: Array) -> Array:
    """Theta (2 m, 2 w) of steady waves k (w, 2) [rad/m] at positions (m, 2) [m], x before y.

    Raises InputError where it would not fit in memory.
    """
    words = f"{len(position)} samples x {len(wavevectors)} waves"
    check_size(2 * len(position), 2 * len(wavevectors), words)
    theta = np.empty((len(position), 2, len(wavevectors), 2))
    across = wavevectors.T[::-1, :, None] * np.array([1.0, -1.0])[:, None, None]  # (k_y, -k_x)
    for start in range(0, len(position), BUILD_ROWS):
        block = position[start : start + BUILD_ROWS]
        sine, cosine = sines_and_cosines(block @ wavevectors.T)
        theta[start : start + BUILD_ROWS] = across * np.stack([-sine, cosine], axis=2)[:, None]
    return theta.reshape(2 * len(position), -1)


def strengths(wavevectors: Array, weights: Array) -> Array:
    """The strength |k| sqrt(a^2 + b^2) (w,) [m/s] of waves k (w, 2) with weights a, b (w, 2)."""
    size: Array = np.linalg.norm(wavevectors, axis=1) * np.linalg.norm(weights, axis=1)
    return size


def wave_peaks(
    wavevectors: Array, weights: Array, extent: float, most: int
) -> tuple[IntArray, Array]:
    """The peaks of weights a, b (w, 2) over the plane, strongest first, one in a neighbourhood.

    A wave between those of a grid shares its strength among its neighbours: a peak is the
    strongest wave of a neighbourhood (p,), and its place the mean wavevector (p, 2) [rad/m] there,
    by squared strength. k and -k are the same wave; extent: of the flight [m].
    """
    strength, near = strengths(wavevectors, weights), APART * math.pi / extent
    free = strength > 0
    tops: list[int] = []
    peaks: list[Array] = []
    while free.any() and len(tops) < most:
        top = int(np.argmax(np.where(free, strength, -1.0)))
        if strength[top] < 0.1 * strength.max():
            break
        sides = np.where(wavevectors @ wavevectors[top] < 0, -1.0, 1.0)[:, None] * wavevectors
        around = free & (np.linalg.norm(sides - wavevectors[top], axis=1) <= near)
        shares = strength[around] ** 2
        tops.append(top)
        peaks.append(shares @ sides[around] / shares.sum())
        free &= ~around
    return np.array(tops, dtype=np.intp), np.array(peaks).reshape(-1, 2)


def rms_mean_velocity(weights: Array) -> Array:
    """U0 = sqrt(2 <|w|^2>) [m/s] over the cell, in closed form, from weights (..., 8, 2) [m/s].

    A single has mean square 1/2 and a product 1/4; the cellular flow of Eq. 1 has
    <|w|^2> = U0^2 / 2.
    """
    speed: Array = np.sqrt(2 * np.sum(MEAN_SQUARE[:, None] * weights**2, axis=(-2, -1)))
    return speed


@dataclass(frozen=True, eq=False)
class CandidateFlow:
    """A sum of weighted candidates; with free weights it may have a divergence.

    w(x) = sum_j C(k_j, x - x0) W_j, C the 8 candidates of a wavenumber (Eq. 17).

    Args:
        wavenumbers: k = pi/L (s,) [1/m].
        weights: W (s, 8, 2) [m/s].
        origin: x0 (2,) [m], where the phases of the candidates are 0.
    """

    wavenumbers: Array
    weights: Array
    origin: Array

    def velocity(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the flow velocity [m/s], shape (..., 2), at x, y [m]; t [s] changes nothing."""
        places = np.broadcast_arrays(*(np.asarray(given, dtype=np.float64) for given in (x, y, t)))
        position = np.column_stack([places[0].ravel(), places[1].ravel()]) - self.origin
        theta = candidate_columns(position, math.pi / self.wavenumbers)
        return (theta @ self.weights.reshape(-1, 2)).reshape(*places[0].shape, 2)
