"""What a log says of a model: the optimum, its covariance, and what else could be freed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.likelihood.model import Model
from sparsefit.likelihood.nodes import Nodes
from sparsefit.likelihood.trellis import Smoothed


@dataclass(frozen=True, eq=False)
class Track:
    """A smoothed flight.

    Args:
        time: of the nodes (m,) [s], from the origin of the posterior.
        state: (m, 4 + w): x, y [m], v_x, v_y [m/s], from that origin, and what wanders.
        innovation: (m, 4), standardised; NaN where there is no reading.
        residual: (m, 4), of each reading from all others, standardised; NaN likewise.
        rows: the row of the log (m, 2) of the position and the velocity, -1 for none.
        outliers: the number of readings that were left out.
    """

    time: Array
    state: Array
    innovation: Array
    residual: Array
    rows: IntArray
    outliers: int


@dataclass(frozen=True, eq=False)
class Descent:
    """Where the search stands.

    Args:
        models: one per log.
        nodes: one per log.
        tracks: one per log.
        spreads: per log, the variance of the first position and velocity (4,).
        last: the last smoothed passes, of the nodes and tracks before; None: none of use.
        stride: of the rows that the nodes are of.
    """

    models: tuple[Model, ...]
    nodes: tuple[Nodes, ...]
    tracks: tuple[Array, ...]
    spreads: tuple[Array, ...]
    last: tuple[Smoothed, ...] | None = None
    stride: int = 1


@dataclass(frozen=True, eq=False)
class Posterior:
    """What a log says of a model.

    Args:
        models: the model of each log at the optimum, values and levels; of one log one.
        names: of the free parameters (p,).
        covariance: of these (p, p), levels at their values.
        log_likelihood: at the optimum.
        tracks: one per log.
        estimated: the names of the levels that were estimated.
        level_information: of the logarithms of their variances, of the first log (l, l).
        reason: why the search did not end at the optimum; empty where it did.
        passes: the number of passes over few rows, and over all.
        origin: (x, y, t), that the phases of the pattern and the tracks are counted from.
        state: what further passes start from.
    """

    models: tuple[Model, ...]
    names: tuple[str, ...]
    covariance: Array
    log_likelihood: float
    tracks: tuple[Track, ...]
    estimated: tuple[str, ...]
    level_information: Array
    reason: str
    passes: tuple[int, int]
    origin: tuple[float, float, float]
    state: Descent

    @property
    def converged(self) -> bool:
        """Whether the search ended at the optimum, and the log sees every free parameter."""
        return not self.reason

    @property
    def model(self) -> Model:
        """The model of the first log."""
        return self.models[0]

    @property
    def bic(self) -> float:
        """Return -2 log L + (p + l) log(readings)."""
        readings = sum(int(np.isfinite(track.innovation).sum()) for track in self.tracks)
        free = len(self.names) + len(self.estimated)
        return -2.0 * self.log_likelihood + free * math.log(max(readings, 2))

    def value(self, name: str) -> float:
        """The value of a parameter."""
        return self.model.parameters[name].value

    def error(self, name: str) -> float:
        """The standard error of a parameter, 0 of one that is known."""
        if name not in self.names:
            return 0.0
        place = self.names.index(name)
        return math.sqrt(max(float(self.covariance[place, place]), 0.0))
