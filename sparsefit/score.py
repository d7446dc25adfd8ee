"""Errors of estimates against the true flow."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.errors import InputError, is_real, shown
from sparsefit.estimator.estimate import Estimate, ScaleEstimate
from sparsefit.flight import Flight
from sparsefit.flight.flow import Cells
from sparsefit.flight.waves import Flow, FlowField, check_flow


@dataclass(frozen=True)
class Score:
    """The errors of an estimate, in percent of the truth; NaN where there is no estimate.

    hit: whether the candidate length scale nearest to the true one was chosen.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    hit: bool


def strongest(flow: Flow) -> Cells:
    """The cells of largest mean velocity in ``flow``; raises InputError if it has no cells."""
    if not getattr(flow, "cells", ()):
        words = "score: the true flow must have cells, as CellularFlow has"
        raise InputError(f"{words}; got {shown(flow)}")
    cells: Cells = max(flow.cells, key=lambda part: part.mean_velocity)
    return cells


def score(estimate: Estimate, flow: Flow, scales: ArrayLike) -> Score:
    """Return the errors of an estimate against the true flow, of several against the `strongest`.

    scales: the candidate length scales [m], (g,), of the estimator. Raises as `strongest`.
    """
    truth, candidates = strongest(flow), np.asarray(scales, np.float64)
    nearest = float(candidates[int(np.argmin(np.abs(candidates - truth.length_scale)))])
    return Score(
        _percent(estimate.mean_velocity, truth.mean_velocity),
        _percent(estimate.length_scale, truth.length_scale),
        _percent(estimate.timescale, truth.timescale),
        bool(estimate.grid_length_scale == nearest),
    )


def _percent(estimated: float, true: float) -> float:
    return 100.0 * (estimated - true) / true


@dataclass(frozen=True)
class ScalesScore:
    """The length scales of the true flow that an estimate detected, and its errors there."""

    true: int  # scales of the flow
    detected: int  # those with an estimate within the tolerance
    missed: int  # those without one
    spurious: int  # estimated scales that belong to none of the truth
    max_length_scale_error: float  # largest |error| of L over the detected [%]; NaN without any
    max_mean_velocity_error: float  # likewise of U0

    def within(self, percent: float) -> bool:
        """Whether every scale of the truth was detected, its L within so many percent."""
        return self.missed == 0 and self.max_length_scale_error <= percent


def score_scales(
    estimate: Estimate | tuple[ScaleEstimate, ...], flow: Flow, *, tolerance: float = 0.05
) -> ScalesScore:
    """Match the estimate's scales to the flow's, each to one: the nearest in wavenumber first.

    A pair whose wavenumbers differ by more than the tolerance, |k_est / k_true - 1|, is none. An
    estimate of one length scale counts as the set of that scale.

    Raises:
        InputError: if the tolerance is not above 0, or the flow is no `Flow`.
    """
    if not is_real(tolerance) or not tolerance > 0:
        raise InputError(f"score_scales: tolerance must be above 0, not {shown(tolerance)}")
    if not isinstance(flow, Flow):
        words = "score_scales: the true flow must be a flow of sparsefit"
        raise InputError(f"{words}; got {shown(flow)}")
    scales: Sequence[Any] = estimate.scales if isinstance(estimate, Estimate) else estimate
    if isinstance(estimate, Estimate) and not scales and math.isfinite(estimate.length_scale):
        scales = (estimate,)
    pairs = sorted(
        (abs(part.length_scale / scale.length_scale - 1), i, j)
        for i, part in enumerate(flow.cells)
        for j, scale in enumerate(scales)
    )
    match: dict[int, int] = {}
    for distance, i, j in pairs:
        if distance <= tolerance and i not in match and j not in match.values():
            match[i] = j
    errors = (
        [_percent(getattr(scales[j], name), getattr(flow.cells[i], name)) for i, j in match.items()]
        for name in ("length_scale", "mean_velocity")
    )
    largest = (max(map(abs, own), default=math.nan) for own in errors)
    true, count = len(flow.cells), len(match)
    return ScalesScore(true, count, true - count, len(scales) - count, *largest)


def prediction_error(flow: FlowField | None, flights: Flight | Sequence[Flight]) -> float:
    """Return sqrt(sum |w_hat - w|^2 / sum |w|^2) over all samples of other flights.

    The relative error of the estimated flow w_hat, any object with ``velocity(x, y, t)``, where it
    was not measured; it needs neither thresholds nor names of shapes.

    Args:
        flow: the estimated flow; None, no estimate, counts as still air: 1.
        flights: one or several that know the true flow, in the coordinates and the time of the
            estimated flight, without position noise.

    Raises:
        InputError: if there is no flight, one knows no flow, or the true flow is 0 along all.
    """
    flights = [flights] if isinstance(flights, Flight) else flights
    if not flights or any(flight.flow is None for flight in flights):
        raise InputError("prediction_error needs at least one flight, each with its true flow")
    check_flow(flow)
    missed = there = 0.0
    for flight in flights:
        assert flight.flow is not None
        places = (*flight.position.T, flight.time)
        true = flight.flow.velocity(*places)
        estimated = np.zeros_like(true) if flow is None else flow.velocity(*places)
        missed += float(np.sum((estimated - true) ** 2))
        there += float(np.sum(true**2))
    if not there > 0:
        raise InputError("prediction_error: the true flow is 0 along all flights: fly elsewhere")
    return math.sqrt(missed / there)
