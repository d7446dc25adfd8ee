"""Several flights in rounds: all of them again, near the flow that was found so far.

Weights of flights come from what one mode of steady cells along the axes leaves of each. Where the
flow is another, that is not noise, and what the flow that was found leaves takes its place.

Where drag is unknown, each flight is read alone first.

The response time of a flight scales its flow velocity, and is not linear beside a flow that all
flights share (`sparsefit.modes.stack`). What each flight tells alone is where the first round
starts; a round is a Gauss-Newton step, and two are enough: what is left is of fourth order.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from time import perf_counter

from sparsefit.estimator.doubt import Doubt
from sparsefit.estimator.estimate import Estimate, FlightEstimate
from sparsefit.flight import Flight
from sparsefit.flight.flow import FlowField

ROUNDS = 2
PLAIN = ("", "axis")  # shapes that the weights are made for


def in_rounds(
    fleet: Sequence[Flight],
    alone: Callable[[Flight], Estimate],
    along: Callable[[Sequence[Flight], FlowField], Estimate],
) -> Estimate:
    """The estimate from several flights whose vehicles are sought.

    Args:
        fleet: the flights.
        alone: estimates from one of them.
        along: estimates from all, through what is nearly a given flow.
    """
    start = perf_counter()
    first = [alone(flight) for flight in fleet]
    told = [estimate for estimate in first if estimate.status == "ok" and estimate.flow is not None]
    if not told:
        words = "no flight alone tells the flow and its vehicle"
        reason = f"{words} (flight 1: {first[0].reason}); give the drag of one"
        return replace(first[0], status="unidentifiable", reason=reason, doubt=Doubt.VEHICLE)
    best = min(told, key=_spread)
    flow: FlowField | None = best.flow
    found: Sequence[Estimate | FlightEstimate] = [
        estimate if estimate.status == "ok" else FlightEstimate(0, math.nan) for estimate in first
    ]
    for _ in range(ROUNDS):
        assert flow is not None
        fleet = [_as_found(*pair) for pair in zip(fleet, found, strict=True)]
        estimate = along(fleet, flow)
        flow, found = estimate.flow, estimate.flights
        if flow is None or any(one.vehicle_uncertainty is None for one in found):
            break
    return replace(estimate, seconds=perf_counter() - start)


def weighed_anew(
    fleet: Sequence[Flight],
    first: Estimate,
    along: Callable[[Sequence[Flight], FlowField], Estimate],
) -> Estimate:
    """The estimate with weights by what its flow leaves, where weights took it for another.

    Args:
        fleet: the flights.
        first: the estimate from them with weights by steady cells along the axes.
        along: estimates from all, through what is nearly a given flow.
    """
    if first.flow is None or (first.shape in PLAIN and not any(first.drift or ())):
        return first
    second = along(fleet, first.flow)
    return replace(second, seconds=first.seconds + second.seconds)


def _spread(estimate: Estimate) -> float:
    known = estimate.uncertainty
    return known.mean_velocity / estimate.mean_velocity if known else math.inf


def _as_found(flight: Flight, found: Estimate | FlightEstimate) -> Flight:
    """The flight, its vehicle with the drag that was found."""
    own = {name: getattr(found, name) for name in ("response_time", "drag")}
    told = {name: value for name, value in own.items() if math.isfinite(value)}
    return replace(flight, vehicle=replace(flight.vehicle, **told))
