"""Waves off the grid, where a back-end's weights propose them and the flight bears them out.

Peaks join one by one, strongest first; after each all waves move together to the least residual in
reach, and the peak stays where BIC = n ln RSS + p ln n falls, n the rows of both components worth
counting and p = 4 a wave. No wave comes from anywhere but a peak.
"""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.scan import extent_of
from sparsefit.library.waves import WAVE, Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.plane import descended
from sparsefit.modes.projection import Projection, project
from sparsefit.modes.wave_peaks import strengths

CLOSE = 0.5  # in pi/extent: waves nearer than that are one, with amplitudes of opposite sign
UNKNOWNS = 4  # of a wave: its wavevector, and the amplitudes of its cosine and its sine
LARGEST = 4.0  # of the rms of Phi: a wave that strong is one of two that cancel
EXACT = 1e-12  # of |Phi|^2: a residual below it is rounding, and no wave lowers it


def refined(rows: Rows, thin: Rows, peaks: Array, worth: float) -> Projection:
    """The fit of the waves that peaks (p, 2) [1/m] lead to; of none where none is borne out.

    Args:
        rows: that are fitted in the end.
        thin: fewer of them, to search with.
        peaks: wavevectors, strongest first.
        worth: how many rows, of both components, count where errors correlate.
    """
    family, reach = Waves(WAVE), math.pi / extent_of(thin.position)
    kept = np.zeros((0, 2))
    most = LARGEST * float(np.sqrt(np.mean(np.sum(thin.target**2, axis=1))))
    best = project(family, thin, kept).residual
    floor = EXACT * best
    for peak in peaks:
        tried = descended(family, thin, np.vstack([kept, peak]), rough=True)
        strongest = strengths(tried.parameters, tried.weights[:, :, 0]).max()
        if best <= floor or strongest > most or _closest(tried.parameters) < CLOSE * reach:
            continue
        ratio = max(tried.residual, floor) / best
        if worth * math.log(ratio) + UNKNOWNS * math.log(worth) < 0:
            kept, best = tried.parameters, tried.residual
    return descended(family, rows, kept)


def _closest(wavevectors: Array) -> float:
    """The least distance of two waves (s, 2) [1/m], k and -k being one; infinite for one."""
    first, second = np.triu_indices(len(wavevectors), 1)
    apart = [wavevectors[first] + sign * wavevectors[second] for sign in (-1.0, 1.0)]
    return float(np.linalg.norm(apart, axis=2).min(initial=math.inf))
