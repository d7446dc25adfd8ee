"""What comes of a flight: the parameters, how sure they are, and how they came about."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sparsefit.arrays import Brief
from sparsefit.codec import finite_or_none
from sparsefit.estimator.doubt import Doubt
from sparsefit.estimator.intervals import (
    FlowUncertainty,
    ShapeUncertainty,
    Uncertainty,
    VehicleUncertainty,
)
from sparsefit.flight.flow import FlowField
from sparsefit.regression.certificate import Certificate
from sparsefit.rows import Repairs

if TYPE_CHECKING:  # who reads an estimator need not wait for it
    from sparsefit.likelihood.goodness import Constancy, Goodness

FINEST = 1e-6  # of a standard error: below it, more digits say nothing
PARAMETERS = (
    ("U0", "mean_velocity", "m/s"),
    ("L_w", "length_scale", "m"),
    ("tau_w", "timescale", "s"),
)


def decimals(spread: float) -> int:
    """Decimals that show two digits of a standard error; four where it is tiny or not known."""
    return max(0, 1 - math.floor(math.log10(spread))) if FINEST <= spread < math.inf else 4


@dataclass(frozen=True)
class Agreement:
    """How far the logged position wanders from the integral of the velocity.

    Args:
        wander: rms of a correlated error of the position [m], 0 where there is none.
        wander_time: its correlation time [s].
        broken: whether the velocity is not that of the position at all.
    """

    wander: float = 0.0
    wander_time: float = math.nan
    broken: bool = False

    @property
    def wanders(self) -> bool:
        """Whether the position errs with a memory."""
        return self.wander > 0.0


@dataclass(frozen=True)
class ScaleEstimate:
    """One cellular flow of several.

    Args:
        mean_velocity: U0 [m/s].
        length_scale: L [m].
        timescale: L/U0 [s], NaN where U0 is 0.
        grid_length_scale: the candidate behind it [m].
        uncertainty: of a refined scale with the ``rms`` mean velocity, all scales fitted together.
        heading: by which the cells are turned counter-clockwise [rad]; NaN where it is not told.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    grid_length_scale: float
    uncertainty: Uncertainty | None = None
    heading: float = math.nan


@dataclass(frozen=True)
class RungEstimate:
    """One shape of flow that was tried.

    Args:
        shape: its name.
        drifting: whether it moves.
        bic: n ln RSS + p ln n, less that of the best.
        residual: what it leaves of the flow velocity, as a share of its squares.
    """

    shape: str
    drifting: bool
    bic: float
    residual: float


@dataclass(frozen=True)
class FlightEstimate:
    """What is of one flight of several through one flow.

    Args:
        samples: that were fitted.
        noise: the level of its noise where the flow acts, over that of all flights together: its
            rows count for one over the square of it.
        response_time: [s], drag [1/m], thrust_scale, thrust_acceleration [m/s^2] and wind [m/s]:
            estimated where the library says they are unknown.
        vehicle_uncertainty: how sure these are.
        goodness: how well the one flow explains this flight, where that was assessed.
        repairs: what was mended in it before.
        agreement: of its logged position and velocity.
    """

    samples: int
    noise: float
    response_time: float = math.nan
    drag: float = math.nan
    thrust_scale: float = math.nan
    thrust_acceleration: tuple[float, float] | None = None
    wind: tuple[float, float] | None = None
    vehicle_uncertainty: VehicleUncertainty | None = None
    goodness: Goodness | None = None
    repairs: Repairs = Repairs()
    agreement: Agreement | None = None


@dataclass(frozen=True, repr=False)
class Estimate(Brief):
    """Estimated parameters, in m/s, m and s, NaN where there is none, and how they came about.

    status ``ok``, ``misfit`` (there is a flow, but not the one assumed), ``inaccurate``,
    ``unidentifiable`` or ``error``, with its reason;
    grid_length_scale: the chosen candidate [m]; weights_by_scale: its weight for each candidate
    length scale [m]; seconds: preparation, fit and readout together; rival_length_scale: where the
    refinement found the best other lobe of the residual [m]; response_time [s], drag [1/m],
    thrust_scale, thrust_acceleration [m/s^2] and wind [m/s]: estimated where the library says they
    are unknown;
    scales: all cellular flows found, fastest first, where the readout asks for several, or the
    ladder finds two: the parameters are those of the first. uncertainty: of a refined scale with
    the ``rms`` mean velocity, `unidentifiable` or not: it holds within the lobe that was chosen,
    and says nothing of its rival; None with other readouts and below 21 samples; of several scales
    each has its own, and this is the first's. vehicle_uncertainty: of what was unknown beside the
    flow. doubt: what kind of doubt the reason of a `misfit` or an `unidentifiable` flow puts in
    words. heading [rad]: by which the cells are turned counter-clockwise. flow: what was found, to
    be evaluated anywhere, in the coordinates and the time of the flight; flow_uncertainty: of a
    flow of waves, the standard error of its velocity anywhere (`FlowUncertainty.standard_error`).
    goodness: how well refined modes fit.
    repairs: what was mended in the flight before. agreement: of logged position and velocity; the
    intervals hold what a position wanders.
    shape: with the ladder of shapes, the one that the flight bears out: ``axis``, ``square``,
    ``rectangle``, ``pair`` or ``several``; length_scales: (L_x, L_y) [m] in the cells' own axes;
    drift: at which they move [m/s], (x, y); shape_uncertainty: how sure these are; rungs: every
    shape that was tried. flights: of several flights through one flow what is of each; what is
    estimated of a vehicle, repairs and agreement stand there alone. constancy: how fast U0 changes
    while it is flown through, with its interval and p-value. freed: the names of what was freed
    beside the flow, where the settings say so.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    status: str
    reason: str
    backend: str
    settings: dict[str, Any]
    certificate: Certificate | None = None
    grid_length_scale: float = math.nan
    weights_by_scale: dict[float, float] = field(default_factory=dict, repr=False)
    seconds: float = math.nan
    samples: int = 0
    columns: int = 0
    rival_length_scale: float = math.nan
    uncertainty: Uncertainty | None = None
    response_time: float = math.nan
    thrust_acceleration: tuple[float, float] | None = None
    wind: tuple[float, float] | None = None
    scales: tuple[ScaleEstimate, ...] = ()
    vehicle_uncertainty: VehicleUncertainty | None = None
    doubt: Doubt | None = None
    heading: float = math.nan
    flow: FlowField | None = field(default=None, repr=False)
    repairs: Repairs = Repairs()
    agreement: Agreement | None = None
    goodness: Goodness | None = None
    shape: str = ""
    length_scales: tuple[float, float] | None = None
    drift: tuple[float, float] | None = None
    shape_uncertainty: ShapeUncertainty | None = None
    rungs: tuple[RungEstimate, ...] = field(default=(), repr=False)
    flow_uncertainty: FlowUncertainty | None = field(default=None, repr=False)
    flights: tuple[FlightEstimate, ...] = ()
    constancy: Constancy | None = None
    drag: float = math.nan
    thrust_scale: float = math.nan
    freed: tuple[str, ...] = ()

    def __str__(self) -> str:
        """The status and its reason, or the parameters with their standard errors: one line."""
        if self.status != "ok":
            return f"{self.status}: {self.reason}"
        told = []
        for symbol, name, unit in PARAMETERS:
            spread = getattr(self.uncertainty, name, math.nan)
            error = f" ± {spread:.2g}" if math.isfinite(spread) else ""
            told.append(f"{symbol} = {getattr(self, name):.{decimals(spread)}f}{error} {unit}")
        return f"ok: {', '.join(told)}"

    def to_dict(self) -> dict[str, Any]:
        """The estimate as JSON-ready values; NaN becomes None. `flow_uncertainty` is left out."""
        values = asdict(replace(self, flow_uncertainty=None))
        del values["flow_uncertainty"]
        values["weights_by_scale"] = [[s, w] for s, w in self.weights_by_scale.items()]
        ready: dict[str, Any] = finite_or_none(values)
        return ready
