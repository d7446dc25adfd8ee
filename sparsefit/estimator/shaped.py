"""What the ladder of shapes says of a flight, as the fields of an estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.estimator.estimate import RungEstimate
from sparsefit.flight.flow import SuperposedFlow
from sparsefit.flight.waves import WaveFlow
from sparsefit.library.nuisance import Nuisance
from sparsefit.modes.fitted_rows import middle
from sparsefit.modes.ladder import Ladder
from sparsefit.modes.rung import Rung
from sparsefit.modes.wave_peaks import at_origin
from sparsefit.uncertainty import Assessment, Shape


@dataclass(frozen=True)
class Shaped:
    """The rung that won.

    Args:
        name: of its shape.
        cells: that its two waves make; None of another number of waves.
        drifting: whether it moves.
        rungs: all that were tried, by rising BIC.
        flow: its waves, and a wind that was unknown, in the flight's own coordinates.
    """

    name: str
    cells: Shape | None
    drifting: bool
    rungs: tuple[RungEstimate, ...]
    flow: WaveFlow | SuperposedFlow

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of an `Estimate`."""
        fields: dict[str, Any] = {"shape": self.name, "rungs": self.rungs}
        if self.cells is None:
            return fields
        return fields | {
            "heading": self.cells.heading,
            "length_scales": self.cells.length_scales,
            "drift": self.cells.drift if self.drifting else (0.0, 0.0),
            "shape_uncertainty": self.cells.uncertainty,
        }


def shaped_of(ladder: Ladder, known: Assessment, origin: Array, nuisance: Nuisance) -> Shaped:
    """What a ladder says, with its assessment.

    origin (3,): the place [m] and time [s] that its rows are counted from.
    """
    best, square = ladder.best, float(np.sum(ladder.rows.target**2)) or 1.0
    least = ladder.rungs[0].bic
    rungs = tuple(
        RungEstimate(rung.shape, rung.drifting, rung.bic - least, _share(rung, ladder, square))
        for rung in ladder.rungs
    )
    waves = flow_of(best, origin, nuisance.ratio(best.fit.coefficients))
    wind = known.vehicle.wind if known.vehicle else (0.0, 0.0)
    flow = SuperposedFlow((waves,), wind) if any(wind) else waves
    return Shaped(best.shape, known.shape, best.drifting, rungs, flow)


def _share(rung: Rung, ladder: Ladder, square: float) -> float:
    """What a rung, fitted to thinned rows, leaves of the squares of all rows."""
    share: float = rung.fit.residual / len(rung.fit.rest) * len(ladder.rows.target) / square
    return share


def middle_of(position: Array, time: Array) -> Array:
    """(x, y, t) of the middle of positions (m, 2) [m] and times [s], from which rows count."""
    return np.array([*middle(position), 0.5 * (time[0] + time[-1])])


def flow_of(rung: Rung, origin: Array, ratio: float) -> WaveFlow:
    """The flow of a rung; ratio: of fitted weights to those of the vehicle that fits best."""
    phases = rung.phases
    place = origin * np.array([1.0, 1.0, -1.0])
    cosine, sine = at_origin(phases, rung.weights / ratio, place).T
    return WaveFlow(phases[:, :2], cosine, sine, phases[:, 2])


def outside(ladder: Ladder, bounds: tuple[float, float]) -> float:
    """The length scale [m] of a wave beyond bounds of k = pi/L [1/m]; NaN where none is."""
    lengths = np.hypot(*ladder.best.phases[:, :2].T) / math.sqrt(2)
    beyond = lengths[(lengths < bounds[0]) | (lengths > bounds[1])]
    return math.pi / float(beyond[0]) if len(beyond) else math.nan
