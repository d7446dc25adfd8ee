"""Sines and cosines of the same phases, which every family of columns is made of."""

from __future__ import annotations

import numpy as np

from sparsefit.arrays import Array


def sines_and_cosines(phase: Array) -> tuple[Array, Array]:
    """sin and cos of phases [rad] of any shape, to 3 units of rounding of 1.

    Both are rational in the tangent of half the phase: with t = tan(phase / 2)

        sin = 2 t / (1 + t^2),   cos = 2 / (1 + t^2) - 1,

    one transcendental function instead of two, and the one that numpy evaluates side by side.
    """
    half = np.tan(0.5 * phase)
    share = 2.0 / (1.0 + half * half)
    return half * share, share - 1.0
