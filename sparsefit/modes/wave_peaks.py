"""Where the weights of a wave library propose to look for waves off its grid.

A wave with amplitudes a, b of psi flows at |k| sqrt(a^2 + b^2): its strength [m/s]. A wave between
those of the grid shares its strength among its neighbours, so a peak is the strongest wave of a
neighbourhood, and its place the mean wavevector there, by squared strength.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray

PROPOSED = 0.1  # of the strongest peak: what is weaker proposes nothing
APART = 1.5  # in pi/extent: nearer waves are one peak, the diagonal of a grid of one step


def strengths(wavevectors: Array, weights: Array) -> Array:
    """The strength (w,) [m/s] of waves k (w, 2) [1/m] with weights a, b (w, 2) [m^2/s]."""
    size: Array = np.linalg.norm(wavevectors, axis=1) * np.linalg.norm(weights, axis=1)
    return size


@dataclass(frozen=True, eq=False)
class WavePeaks:
    """Peaks over the plane, strongest first: the strongest waves and where the peaks are.

    Args:
        top: the strongest wave of each (p,), its place among all waves.
        wavevectors: of the peaks (p, 2) [1/m], between the waves that make them.
    """

    top: IntArray
    wavevectors: Array


def wave_peaks(wavevectors: Array, weights: Array, extent: float, most: int) -> WavePeaks:
    """The peaks of the weights over the plane, strongest first, one in a neighbourhood.

    Args:
        wavevectors: k (w, 2) of the waves [1/m]; k and -k are the same wave.
        weights: a and b (w, 2) [m^2/s].
        extent: of the flight [m].
        most: peaks at most.
    """
    strength, near = strengths(wavevectors, weights), APART * math.pi / extent
    left = strength > 0
    tops: list[int] = []
    peaks: list[Array] = []
    while left.any() and len(tops) < most:
        top = int(np.argmax(np.where(left, strength, -1.0)))
        if strength[top] < PROPOSED * strength.max():
            break
        sides = np.where(wavevectors @ wavevectors[top] < 0, -1.0, 1.0)[:, None] * wavevectors
        around = left & (np.linalg.norm(sides - wavevectors[top], axis=1) <= near)
        shares = strength[around] ** 2
        tops.append(top)
        peaks.append(shares @ sides[around] / shares.sum())
        left &= ~around
    return WavePeaks(np.array(tops, dtype=np.intp), np.array(peaks).reshape(-1, 2))


def at_origin(wavevectors: Array, weights: Array, origin: Array) -> Array:
    """Weights (w, 2) of waves with phases k.x, from those with phases k.(x - origin)."""
    shift = wavevectors @ origin
    cos, sin = np.cos(shift), np.sin(shift)
    a, b = weights.T
    return np.stack([a * cos - b * sin, a * sin + b * cos], axis=1)
