"""Weights of samples in a polynomial's value, slope and bend at the middle of their window.

The window of n samples runs over -1 <= s <= 1, so that d/dt = (1/reach) d/ds, reach half a window.
Savitzky and Golay (1964, Anal. Chem. 36, 1627) for one channel; position and velocity together are
the same least squares with rows of derivative data.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from sparsefit.arrays import Array

KEPT = 128  # kernels: those of one flight are asked for several times


@lru_cache(maxsize=KEPT)
def coupled_kernels(
    window: int, order: int, step: float, ratio: float
) -> tuple[Array, Array, Array]:
    """Weights (2n,) of n positions and n velocities in p, p' and p'' at the middle.

    ratio: sigma_v / sigma_x [1/s]; step [s]; order: degree of p'.
    """
    reach = window // 2 * step
    powers = np.vander(np.linspace(-1.0, 1.0, window), order + 2, increasing=True)
    slopes = np.zeros_like(powers)
    slopes[:, 1:] = powers[:, :-1] * np.arange(1, order + 2) / reach
    basis, triangle = np.linalg.qr(np.vstack([ratio * powers, slopes]))
    solved = np.linalg.solve(triangle.T, np.eye(order + 2)[:, :3]).T @ basis.T
    solved[:, :window] *= ratio
    return _kept(solved[0]), _kept(solved[1] / reach), _kept(2.0 * solved[2] / reach**2)


@lru_cache(maxsize=KEPT)
def polynomial_kernels(window: int, order: int, step: float) -> tuple[Array, Array, Array]:
    """Weights (n,) of one channel in p, p' and p'' at the middle (Savitzky and Golay).

    step [s]; order: degree of the polynomial, below n.
    """
    reach = window // 2 * step
    powers = np.vander(np.linspace(-1.0, 1.0, window), order + 1, increasing=True)
    solved = np.linalg.pinv(powers)
    return _kept(solved[0]), _kept(solved[1] / reach), _kept(2.0 * solved[2] / reach**2)


def _kept(weights: Array) -> Array:
    """Weights that are shared by all who ask for them: nobody writes into them."""
    weights.flags.writeable = False
    return weights
