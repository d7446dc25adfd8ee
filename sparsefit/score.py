"""Errors against the truth: the only room, with the bound, that knows it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, is_real
from sparsefit.estimator.estimate import Estimate, ScaleEstimate
from sparsefit.flight import Flight
from sparsefit.flight.flow import Cells
from sparsefit.flight.waves import Flow, FlowField


@dataclass(frozen=True)
class Score:
    """The errors of an estimate, in percent of the truth; NaN where there is no estimate.

    hit: whether, of the candidate scales, the one nearest the truth was chosen.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    hit: bool


def strongest(flow: Flow) -> Cells:
    """The cells of largest mean velocity in ``flow``, the first of equals.

    A flow without cells has none: ValueError.
    """
    cells: Cells = max(flow.cells, key=lambda part: part.mean_velocity)
    return cells


def score(estimate: Estimate, flow: Flow, scales: Array) -> Score:
    """Return the errors of an estimate against the true flow, of several against the `strongest`.

    scales: the candidate length scales [m], (g,), that the estimator had.
    """
    truth = strongest(flow)
    nearest = float(scales[int(np.argmin(np.abs(scales - truth.length_scale)))])
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
    """Which scales of the true flow an estimate detected, and how far off it is there."""

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

    A pair whose wavenumbers differ by more than the tolerance, |k_est / k_true - 1|, is none.

    Raises:
        InputError: if the tolerance is not above 0.
    """
    if not is_real(tolerance) or not tolerance > 0:
        raise InputError(f"score_scales: tolerance must be above 0, not {tolerance!r}")
    scales = estimate.scales if isinstance(estimate, Estimate) else estimate
    pairs = sorted(
        (abs(part.length_scale / scale.length_scale - 1), i, j)
        for i, part in enumerate(flow.cells)
        for j, scale in enumerate(scales)
    )
    match: dict[int, int] = {}
    for distance, i, j in pairs:
        if distance <= tolerance and i not in match and j not in match.values():
            match[i] = j
    matched = [(scales[j], flow.cells[i]) for i, j in match.items()]
    off = [_percent(own.length_scale, truth.length_scale) for own, truth in matched]
    fast = [_percent(own.mean_velocity, truth.mean_velocity) for own, truth in matched]
    largest = (max(map(abs, errors), default=math.nan) for errors in (off, fast))
    count = len(match)
    true, missed, spurious = len(flow.cells), len(flow.cells) - count, len(scales) - count
    return ScalesScore(true, count, missed, spurious, *largest)


def prediction_error(flow: FlowField | None, flights: Sequence[Flight]) -> float:
    """Return sqrt(sum |w_hat - w|^2 / sum |w|^2) over all samples of other flights.

    Free of thresholds and of names for shapes: how well the estimated flow w_hat, any object with
    ``velocity(x, y, t)``, tells the true flow w where it was not measured.

    Args:
        flow: the estimated flow; None, no estimate, counts as the still air that it leaves a pilot
            with: 1.
        flights: through the true flow, which each of them knows, in the coordinates and the time
            of the flight that was estimated from; without noise of position, or it is judged at
            the wrong places.

    Raises:
        InputError: if there is no flight, one knows no flow, or the true flow is 0 along all.
    """
    if not flights or any(flight.flow is None for flight in flights):
        raise InputError("prediction_error needs at least one flight, each with its true flow")
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
