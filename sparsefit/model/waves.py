"""The columns of waves of a stream function, steady or drifting.

An incompressible flow in the plane has a stream function psi, u = d psi/dy and v = -d psi/dx. Of

    psi = sum_j a_j cos theta_j + b_j sin theta_j,    theta_j = k_j . x - omega_j t,

each wave j gives two columns, which both velocity components share: rows are x before y of each
sample. With g = d/d theta of cos and of sin, they are (k_y, -k_x) g(theta): every derivative turns
one of the two into the other, with a sign. k is in rad/m, omega in rad/s, a and b in m^2/s.
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.model.cells import BUILD_ROWS, check_size, sines_and_cosines

PROPOSED = 0.1  # of the strongest peak: what is weaker proposes nothing
APART = 1.5  # in pi/extent: nearer waves are one peak, the diagonal of a grid of one step


def wave_columns(place: Array, phases: Array) -> Array:
    """Columns (2 J, m, 2) [rad/m] of waves (J, 3), (k_x, k_y, omega), at (x, y, t) (m, 3).

    The columns of a wave stand together, psi = cos before psi = sin; the last axis is (u, v).
    """
    sine, cosine = sines_and_cosines(phases * (1.0, 1.0, -1.0) @ place.T)
    columns = np.empty((len(phases), 2, len(place), 2))
    across = phases[:, [1, 0]] * (1.0, -1.0)
    np.multiply(-sine[..., None], across[:, None], out=columns[:, 0])
    np.multiply(cosine[..., None], across[:, None], out=columns[:, 1])
    return columns.reshape(2 * len(phases), len(place), 2)


def wave_theta(position: Array, wavevectors: Array) -> Array:
    """Theta (2 m, 2 w) of steady waves k (w, 2) [rad/m] at positions (m, 2) [m], x before y.

    Raises InputError where it would not fit in memory.
    """
    words = f"{len(position)} samples x {len(wavevectors)} waves"
    check_size(2 * len(position), 2 * len(wavevectors), words)
    theta, (k_x, k_y) = np.empty((len(position), 2, len(wavevectors), 2)), wavevectors.T
    for start in range(0, len(position), BUILD_ROWS):
        block = theta[start : start + BUILD_ROWS]
        sine, cosine = sines_and_cosines(position[start : start + BUILD_ROWS] @ wavevectors.T)
        np.multiply(-k_y, sine, out=block[:, 0, :, 0])
        np.multiply(k_y, cosine, out=block[:, 0, :, 1])
        np.multiply(k_x, sine, out=block[:, 1, :, 0])
        np.multiply(-k_x, cosine, out=block[:, 1, :, 1])
    return theta.reshape(2 * len(position), -1)


def polar_jet(position: Array, places: Array) -> tuple[Array, Array, Array]:
    """The columns (s, 2, 2 m) of waves at (|k|, heading) (s, 2), and their derivatives by these.

    The first derivatives are (s, 2, 2, 2 m), the second (s, 2, 2, 2, 2 m). With r = |k|, xi = x
    along k, eta = x across it, theta = r xi, e = (sin, -cos) of the heading and f = e', the columns
    are r e g(theta), and d xi = eta, d eta = -xi, d f = -e by the heading.
    """
    r, heading = places.T[:, :, None]
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = position.T
    xi, eta = cos * x + sin * y, cos * y - sin * x
    sine, cosine = sines_and_cosines(r * xi)
    waves = np.stack([-sine, cosine], axis=1)[..., None]  # g (s, 2, m, 1)
    late = np.stack([-cosine, -sine], axis=1)[..., None]  # dg/d theta
    e, f = (np.stack(pair, axis=2)[:, None] for pair in ((sin, -cos), (cos, sin)))
    r, xi, eta = r[..., None, None], xi[:, None, :, None], eta[:, None, :, None]
    value = r * e * waves
    by_r = e * waves + r * e * xi * late
    by_heading = r * f * waves + r * r * e * eta * late
    by_r_r = 2 * e * xi * late - r * e * xi * xi * waves
    by_both = f * waves + (2 * r * e * eta + r * f * xi) * late - r * r * e * xi * eta * waves
    by_h_h = r * r * (2 * f * eta - e * xi) * late - (r * e + r**3 * e * eta * eta) * waves
    shape = (len(places), 2, 2 * len(position))
    flat = [part.reshape(shape) for part in (by_r, by_heading, by_r_r, by_both, by_h_h)]
    slope = np.stack(flat[:2], axis=1)
    bend = np.stack([np.stack(flat[2:4], axis=1), np.stack(flat[3:5], axis=1)], axis=1)
    return value.reshape(shape), slope, bend


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
        if strength[top] < PROPOSED * strength.max():
            break
        sides = np.where(wavevectors @ wavevectors[top] < 0, -1.0, 1.0)[:, None] * wavevectors
        around = free & (np.linalg.norm(sides - wavevectors[top], axis=1) <= near)
        shares = strength[around] ** 2
        tops.append(top)
        peaks.append(shares @ sides[around] / shares.sum())
        free &= ~around
    return np.array(tops, dtype=np.intp), np.array(peaks).reshape(-1, 2)
