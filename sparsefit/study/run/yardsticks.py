"""What a case is held against: the intervals that it gives, and the bound of its flight."""

from __future__ import annotations

import math
from dataclasses import dataclass

from sparsefit.flight import Flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.study.spec.flights import Draw
from sparsefit.uncertainty import Uncertainty
from sparsefit.uncertainty.bound import cramer_rao

NAN = math.nan
DIGITS = 17  # binary, of the width of an interval
PARAMETERS = ("mean_velocity", "length_scale", "timescale")


@dataclass(frozen=True)
class Yardstick:
    """Of one flight: its extent [m], and the bounds of U0 [m/s], L [m], tau_w [s]; NaN: none."""

    extent: float
    bound_mean_velocity: float = NAN
    bound_length_scale: float = NAN
    bound_timescale: float = NAN


def yardstick(draw: Draw, flown: Flight) -> Yardstick:
    """The extent of a flight, and its semiparametric Cramer-Rao bound under Eq. 7.

    The bound is that of noise on v' alone at known positions: there is none without process
    noise, with noise of position or velocity, or without a single cellular flow.
    """
    measured = draw.position_noise > 0 or draw.velocity_noise > 0
    if draw.process_noise <= 0 or measured or not isinstance(draw.flow, CellularFlow):
        return Yardstick(flown.extent)
    noise = draw.process_noise
    bound = cramer_rao(
        flown.position, draw.flow, draw.vehicle, process_noise=noise, model="semiparametric"
    )
    return Yardstick(flown.extent, bound.mean_velocity, bound.length_scale, bound.timescale)


def intervals(found: Uncertainty | None) -> dict[str, float]:
    """`se_*`, `low_*` and `high_*` of the three parameters by name; nothing without any."""
    if found is None:
        return {}
    values: dict[str, float] = {}
    for name in PARAMETERS:
        low, high = _outward(*map(float, getattr(found, f"{name}_interval")))
        error = float(getattr(found, name))
        values |= {f"se_{name}": error, f"low_{name}": low, f"high_{name}": high}
    return values


def _outward(low: float, high: float) -> tuple[float, float]:
    """The interval, 1/32768 of its width longer at most: shorter numbers to store."""
    width = high - low
    if not (math.isfinite(width) and width > 0):
        return low, high
    step = math.ldexp(1.0, math.frexp(width)[1] - DIGITS)
    return math.floor(low / step) * step, math.ceil(high / step) * step
