"""One mode of waves moved to the least residual in reach: Gauss-Newton in the plane of wavevectors.

As for cells (`sparsefit.modes.space`) weights are projected out; a move is cut to where no wave
goes farther than a share of a lobe, and no phase by more than a radian.
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array, box
from sparsefit.library.equal_waves import EqualWaves
from sparsefit.library.pieced_waves import PiecedWaves
from sparsefit.library.waves import Waves
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.projection import ROUNDING, Projection, project, secant

PlaneFamily: TypeAlias = Waves | EqualWaves | PiecedWaves

ITERATIONS, HALVINGS = 25, 6  # of a descent, and of one of its moves
SEEN = 3  # of the last falls of the residual, by which a descent is judged
LONGEST = 0.5  # of a move, in pi over the extent and over the duration
ROUGH, END = 1e-3, 1e-9  # of moves, in the same units: where a descent may stop, and where it ends
SHARES = 0.5, 2.0  # of a move, that the last two may say leads to where moves end
SLIGHT = 1e-6  # of RSS: where a rough descent may stop


def descended(
    family: PlaneFamily,
    rows: Rows,
    parameters: Array,
    *,
    rough: bool = False,
    goal: float = math.inf,
) -> Projection:
    """The modes moved from parameters (s, p) to the least RSS in reach.

    A rough descent ends early. Any ends where it would not come below ``goal``, RSS, even if all
    its moves gained as much as the last ones.
    """
    here = project(family, rows, parameters)
    reach = reach_of(rows, family.pieces if isinstance(family, PiecedWaves) else 1)
    tolerance, size = ROUGH if rough else END, math.sqrt(float(np.sum(rows.target**2)))
    falls, share = [math.inf] * SEEN, 1.0  # of a rough descent 1: where it leads stays as it is
    for left in range(ITERATIONS, 0, -1):
        if here.residual - left * max(falls[-SEEN:]) > goal:
            return here
        longest = _length(family, here, reach)
        if longest <= tolerance:
            return here
        moves = here.moves * min(share, LONGEST / longest)
        for halving in range(HALVINGS):
            there = project(family, rows, here.parameters + moves * 0.3**halving)
            if there.residual < here.residual:
                break
            if there.residual <= here.residual + ROUNDING * size * math.sqrt(here.residual):
                return here  # rounding hides the fall
        else:
            return here
        falls.append(here.residual - there.residual)
        slight = rough and falls[-1] <= SLIGHT * here.residual
        if not rough:
            share = min(max(secant(here, there), SHARES[0]), SHARES[1])
        here = there
        if slight:
            return here
    return here


def reach_of(rows: Rows, pieces: int = 1) -> Array:
    """Pi over the extents of the rows, or of pieces, in k_x, k_y [1/m] and omega [1/s], (3,)."""
    corners = [box(piece) for piece in np.array_split(rows.position, pieces)]
    spans = np.max([high - low for low, high in corners], axis=0)
    widest = float(spans[:2].max())
    duration = float(spans[2]) if len(spans) > 2 else 1.0
    return math.pi / np.array([widest, widest, duration])


def _length(family: PlaneFamily, fit: Projection, reach: Array) -> float:
    """How far the moves of a fit lead, in units of reach, or in radians of phase."""
    count = family.pattern.parameters
    own, phases = fit.moves[:, :count], fit.moves[:, count:]
    waves = np.einsum("sp,spjd->sjd", own, family.pattern.slopes(fit.parameters[:, :count]))
    along = float(np.abs(waves / reach).max(initial=0.0))
    return max(along, LONGEST * float(np.abs(phases).max(initial=0.0)))


def residuals(family: PlaneFamily, rows: Rows, parameters: Array) -> Array:
    """RSS (s,) of every one of s modes alone, at parameters (s, p), nuisance columns left out."""
    values = family.values(rows.position, parameters)
    values = rows.averaged(values.reshape(-1, values.shape[-1])).reshape(values.shape)
    target = rows.stacked(family)[0][:, 0]
    gram, load = values @ values.swapaxes(1, 2), values @ target
    gram += SLIGHT * len(target) * np.mean(values**2, axis=2)[:, :, None] * np.eye(family.size)
    explained = np.sum(load * np.linalg.solve(gram, load[..., None])[..., 0], axis=1)
    rest: Array = float(target @ target) - explained
    return rest
