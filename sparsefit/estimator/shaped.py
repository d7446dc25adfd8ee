"""What waves and the ladder of shapes say of a flight, as the fields of an estimate."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.estimator.estimate import RungEstimate
from sparsefit.flight.flow import SuperposedFlow
from sparsefit.flight.waves import WaveFlow
from sparsefit.library.nuisance import VehicleEstimate
from sparsefit.modes.choice import Ladder
from sparsefit.modes.rung import Rung
from sparsefit.modes.wave_peaks import at_origin
from sparsefit.uncertainty import FlowUncertainty, Shape


@dataclass(frozen=True)
class Shaped:
    """A flow of waves.

    Args:
        name: of its shape; empty of waves on the grid.
        cells: that its two strongest waves make; None of fewer.
        drifting: whether it moves.
        rungs: all that were tried, by rising BIC.
        flow: its waves, in the flight's own coordinates; None where no vehicle could have flown so.
        flow_uncertainty: how sure it is anywhere, where that is told.
    """

    name: str
    cells: Shape | None
    drifting: bool = False
    rungs: tuple[RungEstimate, ...] = ()
    flow: WaveFlow | SuperposedFlow | None = None
    flow_uncertainty: FlowUncertainty | None = None

    @property
    def fields(self) -> dict[str, Any]:
        """The fields of an `Estimate`."""
        fields: dict[str, Any] = {"shape": self.name, "rungs": self.rungs}
        fields["flow_uncertainty"] = self.flow_uncertainty
        if self.cells is None:
            return fields
        fields["heading"] = self.cells.heading
        if not self.name:
            return fields
        return fields | {
            "length_scales": self.cells.length_scales,
            "drift": self.cells.drift if self.drifting else (0.0, 0.0),
            "shape_uncertainty": self.cells.uncertainty,
        }


def rungs_of(ladder: Ladder) -> tuple[RungEstimate, ...]:
    """The rungs of a ladder as an estimate reports them."""
    least, square = ladder.rungs[0].bic, float(np.sum(ladder.rows.target**2)) or 1.0
    return tuple(
        RungEstimate(rung.shape, rung.drifting, rung.bic - least, _share(rung, ladder, square))
        for rung in ladder.rungs
    )


def _share(rung: Rung, ladder: Ladder, square: float) -> float:
    """What a rung, fitted to thinned rows, leaves of the squares of all rows."""
    share: float = rung.fit.residual / len(rung.fit.rest) * len(ladder.rows.target) / square
    return share


def flow_of(rung: Rung, origin: Array, ratio: float) -> WaveFlow:
    """The flow of a rung; ratio: of fitted weights to those of the vehicle that fits best.

    origin (3,): the place [m] and time [s] that its rows are counted from.
    """
    phases, place = rung.phases, origin * np.array([1.0, 1.0, -1.0])
    cosine, sine = at_origin(phases, rung.weights / ratio, place).T
    return WaveFlow(phases[:, :2], cosine, sine, phases[:, 2])


def with_wind(flow: WaveFlow, vehicle: VehicleEstimate) -> WaveFlow | SuperposedFlow | None:
    """A flow and the wind that was found beside it; None of a vehicle that cannot be."""
    if not vehicle.possible:
        return None
    return SuperposedFlow((flow,), vehicle.wind) if any(vehicle.wind) else flow


def outside(ladder: Ladder, bounds: tuple[float, float]) -> float:
    """The length scale [m] of a wave beyond bounds of k = pi/L [1/m]; NaN where none is."""
    lengths = np.hypot(*ladder.best.phases[:, :2].T) / math.sqrt(2)
    beyond = lengths[(lengths < bounds[0]) | (lengths > bounds[1])]
    return math.pi / float(beyond[0]) if len(beyond) else math.nan
