"""The result of an estimate: parameters, standard errors, status and diagnostics."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, fields
from enum import StrEnum
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Brief
from sparsefit.codec import finite_or_none
from sparsefit.flight.waves import FlowField
from sparsefit.likelihood.causes import FREEDOMS
from sparsefit.likelihood.goodness import Constancy, Goodness, Uncertainty
from sparsefit.regression.certificate import Certificate
from sparsefit.rows import Repairs

if TYPE_CHECKING:
    from sparsefit.flight.vehicle import PointMassVehicle
    from sparsefit.likelihood.posterior import Posterior

Pair = tuple[float, float]
FINEST = 1e-6  # the least standard error that sets the number of decimals
PARAMETERS = (
    ("U0", "mean_velocity", "m/s"),
    ("L_w", "length_scale", "m"),
    ("tau_w", "timescale", "s"),
)


def decimals(spread: float) -> int:
    """The decimals that show two digits of a standard error; 4 if it is tiny or unknown."""
    return max(0, 1 - math.floor(math.log10(spread))) if FINEST <= spread < math.inf else 4


class Doubt(StrEnum):
    """The kind of reason for which an estimate is not ``ok``."""

    NO_WEIGHTS = "no-weights"  # all weights of the back-end are zero
    STILL_AIR = "still-air"  # the flow velocity is constant, to rounding
    DISAGREEMENT = "disagreement"  # logged velocity and logged position contradict each other
    FEW_SAMPLES = "few-samples"  # too few samples to estimate their noise
    UNDERSAMPLED = "undersampled"  # the flow changes too much from sample to sample
    NO_FLOW = "no-flow"  # no length scale explains more than a uniform velocity does
    EDGE = "edge"  # the best length scale is a bound of the search
    RIVAL = "rival"  # another length scale fits too nearly as well
    IMPRECISE = "imprecise"  # an interval is wider than the readout's precision
    VEHICLE = "vehicle"  # the estimated response time is not positive
    NO_CELLS = "no-cells"  # the estimated waves are not the cells of one flow or two
    MEAN_VELOCITY = "mean-velocity"  # the readout gives no mean velocity above zero
    SHORT_TRACK = "short-track"  # the flight covers less than one period of the flow
    MISFIT = "misfit"  # the model of flow, vehicle or log is wrong


@dataclass(frozen=True)
class Verdict:
    """A status with its reason, in words and as a kind."""

    status: str
    reason: str = ""
    doubt: Doubt | None = None


@dataclass(frozen=True)
class ScaleEstimate:
    """The parameters of one cellular flow."""

    mean_velocity: float  #: U0 [m/s]
    length_scale: float  #: L [m]
    timescale: float  #: L/U0 [s], NaN where U0 is 0
    grid_length_scale: float = math.nan  #: the candidate behind it [m]
    #: of these three, from the joint likelihood of all flows; None on the grid
    uncertainty: Uncertainty | None = None
    heading: float = math.nan  #: of the cells, counter-clockwise [rad]; NaN if unknown


@dataclass(frozen=True)
class RungEstimate:
    """One shape of flow that the search proposed."""

    shape: str  #: its name
    drifting: bool  #: whether it moves
    bic: float  #: n ln RSS + p ln n of the rows, less the least of all shapes
    residual: float  #: RSS over the sum of squares of the flow velocity


@dataclass(frozen=True, kw_only=True)
class ShapeEstimate:
    """The shape of the flow, in the coordinates and the time of the flight."""

    shape: str = ""  #: ``axis``, ``square``, ``rectangle``, ``pair``, ``several``; "" on the grid
    length_scales: Pair | None = None  #: (L_x, L_y) [m] in the cells' own axes
    drift: Pair | None = None  #: the velocity of the pattern [m/s], (x, y)
    shape_uncertainty: Uncertainty | None = None  #: of length_scales, heading and drift
    rungs: tuple[RungEstimate, ...] = field(
        default=(), repr=False
    )  #: shapes proposed by the search
    scales: tuple[ScaleEstimate, ...] = ()  #: all flows, fastest first, where several are sought
    flow: FlowField | None = field(default=None, repr=False)  #: to be evaluated anywhere
    rival_length_scale: float = math.nan  #: of a flow that fits nearly as well [m]


@dataclass(frozen=True, kw_only=True)
class FlightEstimate:
    """The quantities that belong to one flight; NaN or None if they were not estimated."""

    response_time: float = math.nan  #: tau [s]
    drag: float = math.nan  #: the coefficient of quadratic drag [1/m]
    thrust_scale: float = math.nan  #: of the measured acceleration
    thrust_acceleration: Pair | None = None  #: [m/s^2], (x, y)
    wind: Pair | None = None  #: [m/s], (x, y)
    causes: dict[str, float | Pair] = field(default_factory=dict)  #: others that were freed, in SI
    vehicle_uncertainty: Uncertainty | None = None  #: of those that were estimated
    samples: int = 0  #: that were fitted
    goodness: Goodness | None = None  #: of the fit
    repairs: Repairs = Repairs()  #: of the log, before the fit
    position_wander: float = math.nan  #: rms of a correlated error of the logged position [m]
    #: of several flights: the standard deviation of its noise over the rms of all of them
    noise: float = math.nan


def flight_fields(posterior: Posterior, place: int, believed: PointMassVehicle) -> dict[str, Any]:
    """The fields of `FlightEstimate` by which a posterior describes the vehicle of a flight."""
    leg, suffix = posterior.legs[place], f"@{place + 1}" if place else ""
    steady = not np.ptp(leg.push, axis=0).any()  # a logged acceleration is in no element
    base = {"thrust_acceleration": believed.thrust_acceleration} if steady else {}
    shares = {"drag": 1.0 / leg.model.values["response_time"]}
    values, errors, absent = dict[str, Any](), dict[str, Any](), dict[str, None]()
    known = {item.name for item in fields(FlightEstimate)}
    for name, cause in FREEDOMS.items():
        own, share = cause.elements, shares.get(name, 1.0)
        if name in known:
            absent |= {name: None, f"{name}_interval{'s' * (len(own) > 1)}": None}
        if own[0] in leg.model.names and not cause.wanders:
            pairs = zip(base.get(name, (0.0, 0.0)), own, strict=False)
            value = tuple(b + share * leg.model.values[element] for b, element in pairs)
            ending = suffix * (not cause.of_flow)  # which all flights share
            error = tuple(share * posterior.error(element + ending) for element in own)
            values[name], errors[name] = (value, error) if len(own) > 1 else (value[0], error[0])
    sure = Uncertainty(absent | Uncertainty.of(values, errors)) if values else None
    causes = {name: values.pop(name) for name in [*values] if name not in known}
    wander = leg.model.levels.get("wander", math.nan)
    return values | {"causes": causes, "position_wander": wander, "vehicle_uncertainty": sure}


@dataclass(frozen=True, kw_only=True, repr=False)
class Estimate(Brief, ScaleEstimate, ShapeEstimate, FlightEstimate):
    """Estimated parameters in m/s, m and s, NaN where there are none, and their diagnostics.

    Of several flows the parameters are those of the fastest; of several flights, the quantities
    of each are in `flights`.
    """

    #: ``ok``, ``misfit`` (the model of flow, vehicle or log is wrong), ``inaccurate``,
    #: ``unidentifiable`` or ``error``
    status: str
    reason: str = ""  #: of the status, in words; empty if it is ``ok``
    backend: str = ""  #: its name
    settings: dict[str, Any] = field(default_factory=dict)  #: of the back-end
    certificate: Certificate | None = None  #: of its fit
    #: of each candidate length scale [m]
    weights_by_scale: dict[float, float] = field(default_factory=dict, repr=False)
    seconds: float = math.nan  #: of preparation, fit and readout together
    columns: int = 0  #: of the regression problem
    doubt: Doubt | None = None  #: the kind of the reason
    flights: tuple[FlightEstimate, ...] = ()  #: of several flights through one flow, each
    constancy: Constancy | None = None  #: the rate of change of U0 during the flight
    freed: tuple[str, ...] = ()  #: the names of the freedoms estimated beside the flow

    def __str__(self) -> str:
        """The status and its reason, or the parameters with their standard errors: one line."""
        if self.status != "ok":
            return f"{self.status}: {self.reason}"
        parameters = []
        for symbol, name, unit in PARAMETERS:
            spread = getattr(self.uncertainty, name, math.nan)
            error = f" ± {spread:.2g}" if math.isfinite(spread) else ""
            parameters.append(
                f"{symbol} = {getattr(self, name):.{decimals(spread)}f}{error} {unit}"
            )
        return f"ok: {', '.join(parameters)}"

    def to_dict(self) -> dict[str, Any]:
        """The estimate as JSON-ready values; NaN becomes None."""
        values = asdict(self)
        values["weights_by_scale"] = [[s, w] for s, w in self.weights_by_scale.items()]
        first = ("mean_velocity", "length_scale", "timescale", "status", "reason", "uncertainty")
        ready: dict[str, Any] = finite_or_none({name: values.pop(name) for name in first} | values)
        return ready
