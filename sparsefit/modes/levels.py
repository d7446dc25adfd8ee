"""The weight of every flight of a stack: one over the level of its noise, where the flow acts.

The level is that of what one mode, fitted to all flights, leaves of a flight: the mean of its
periodogram below `BAND` times the mean frequency of the flow along the path, in units where white
errors have their variance. The mode that explains most is found with equal weights, then with those
that it leads to. Where the flow that the flights met is nearly known, it takes the place of that
mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sparsefit.arrays import Array
from sparsefit.library.scan import Bounds
from sparsefit.modes.projection import left_beside
from sparsefit.modes.space import SearchSpace
from sparsefit.modes.stack import Part

BAND = 8.0  # times the mean frequency of the flow
FEWEST = 8  # frequencies
ROUNDS = 2
APART = 1e3  # levels of two flights at most: beyond it the better one says all there is to say


def weighed(parts: Sequence[Part], bounds: Bounds) -> list[Part]:
    """The flights with their weights, of mean square 1 over all rows; one flight has weight 1.

    bounds: of the wavenumber [1/m]. Raises InputError where nothing can be searched.
    """
    known = list(parts)
    for _ in range(ROUNDS if len(known) > 1 else 0):
        levels = _levels(known, bounds)
        levels = np.maximum(levels, levels.max() / APART)
        if not levels.min() > 0:
            break
        counts = [len(part.samples.time) for part in known]
        weights = 1 / (levels * np.sqrt(np.average(levels**-2, weights=counts)))
        known = [
            replace(part, weight=weight)
            for part, weight in zip(known, weights.tolist(), strict=True)
        ]
    return known


def _levels(parts: Sequence[Part], bounds: Bounds) -> Array:
    flows = [part.flow for part in parts if part.flow is not None]
    if len(flows) == len(parts):
        pairs = zip(parts, flows, strict=True)
        return np.array([_level(_beside(part, flow), flow) for part, flow in pairs])
    space = SearchSpace.of_flights(parts, bounds)
    lowest = int(np.argmin(space.residuals(space.empty)))
    fit = space.at(space.scan.wavenumbers[[lowest]])
    sampled = space.sampled
    scale = np.ones(len(sampled.target)) if sampled.scale is None else sampled.scale
    loose = np.einsum("tmj,j->mt", sampled.nuisance, fit.coefficients)
    flow = space.flow(fit) / scale[:, None]
    rest = (sampled.target - loose) / scale[:, None] - flow
    ends = np.cumsum([0, *(len(part.samples.time) for part in parts)]).tolist()
    return np.array([_level(rest[first:last], flow[first:last]) for first, last in pairwise(ends)])


def _beside(part: Part, flow: Array) -> Array:
    """Phi of a flight less the flow that it met (m, 2), and less what is unknown of the flight."""
    samples = part.samples
    columns = part.nuisance.columns(part.relative(samples), samples.thrust)
    return left_beside(columns, samples.flow_velocity(part.nuisance.believed) - flow)[0]


def _level(rest: Array, flow: Array) -> float:
    """The level [m/s] of errors (m, 2) where a flow (m, 2) has its power."""
    own, left = (np.sum(np.abs(np.fft.rfft(one, axis=0)) ** 2, axis=1) for one in (flow, rest))
    places = np.arange(len(own))
    mean = float(places @ own / own.sum()) if own.any() else float(len(own))
    last = max(FEWEST, round(BAND * mean)) + 1
    return float(np.sqrt(left[1:last].mean() / (2 * len(rest))))
