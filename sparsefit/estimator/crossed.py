"""How many cells of the flow that was found a flight has been in."""

from __future__ import annotations

import math

import numpy as np

from sparsefit.arrays import Array
from sparsefit.estimator.estimate import Estimate


def cells_crossed(estimate: Estimate, time: Array, position: Array) -> int | None:
    """Return the number of different cells of an estimated flow that a track has been in.

    The cells are counted in their own axes, and where they drift with them; to one or two, as where
    their edges are is not asked.

    Args:
        estimate: with a length scale; None is returned where it has none.
        time: [s], (m,).
        position: [m], (m, 2).
    """
    lengths = np.array(estimate.length_scales or (estimate.length_scale,) * 2)
    if not (np.isfinite(lengths).all() and (lengths > 0).all()):
        return None
    heading = estimate.heading if math.isfinite(estimate.heading) else 0.0
    drift = np.array(estimate.drift or (0.0, 0.0))
    axes = np.array(
        [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
    )
    along = (position - time[:, None] * drift) @ axes
    return len(np.unique(np.floor(along / lengths), axis=0))
