"""Where a back-end's weights propose to look for modes off the grid.

Proposals are the peaks of the weights |W_g| by group, and around each group in use a window of
wavenumbers: to the neighbouring candidates and at least a lobe, 2 pi / extent, wide. A window
gives one mode at most, and no mode comes from outside the windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.library.scan import Bounds
from sparsefit.regression.fit import Fit

PROPOSED = 0.02  # of the largest |W_g|: what is smaller proposes nothing


@dataclass(frozen=True)
class Window:
    """Wavenumbers low to high [1/m] that a candidate at k proposes to look in."""

    wavenumber: float
    low: float
    high: float


def proposals(
    fit: Fit, lobe: float, limits: Bounds, *, on_grid: bool
) -> tuple[tuple[Window, ...], tuple[Window, ...]]:
    """(peaks of |W_g| by group, strongest first, one per lobe; windows of all groups in use).

    Args:
        fit: a back-end's, with a length scale for each group of columns.
        lobe: the width of a lobe of the residual [1/m].
        limits: of the wavenumber [1/m].
        on_grid: whether the groups are the candidates of a grid, between which a mode may lie, or
            scales that the back-end placed itself.
    """
    scales = fit.problem.group_scales
    assert scales is not None
    squares = np.bincount(fit.problem.groups, np.square(fit.weights).sum(axis=1), len(scales))
    order = np.argsort(-scales, kind="stable")
    k, strength = math.pi / scales[order], np.sqrt(squares[order])
    used = strength > PROPOSED * strength.max()
    below, above = k - lobe, k + lobe
    top = used
    if on_grid:
        below[1:], above[:-1] = np.minimum(below[1:], k[:-1]), np.maximum(above[:-1], k[1:])
        around = np.concatenate([[0.0], strength, [0.0]])
        top = used & (strength >= around[:-2]) & (strength >= around[2:])
    windows = [
        Window(float(k[i]), max(float(below[i]), limits[0]), min(float(above[i]), limits[1]))
        for i in range(len(k))
    ]
    peaks: list[Window] = []
    for i in np.argsort(-strength, kind="stable"):
        if top[i] and all(abs(k[i] - peak.wavenumber) > lobe for peak in peaks):
            peaks.append(windows[i])
    return tuple(peaks), tuple(windows[i] for i in np.flatnonzero(used))
