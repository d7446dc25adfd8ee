"""What a row says of several scales at once; empty where one flow is read as one."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

from sparsefit.estimator.estimate import Estimate
from sparsefit.estimator.scales import ScaleEstimate
from sparsefit.flight.flow import CellularFlow, Flow
from sparsefit.score import score_scales

NAN = math.nan
DIGITS = 7
WITHIN = 1.0  # percent


@dataclass(frozen=True, kw_only=True)
class ScaleColumns:
    """Counts of scales, the largest |% error| of the detected ones, and both sets.

    true_scales, est_scales: canonical JSON, [[L in m, U0 in m/s], ...].
    """

    scales_true: float = NAN
    scales_detected: float = NAN
    scales_missed: float = NAN
    scales_spurious: float = NAN
    scales_max_length_scale_error: float = NAN
    scales_max_mean_velocity_error: float = NAN
    scales_within_1_percent: float = NAN
    true_scales: str = ""
    est_scales: str = ""


def scale_columns(estimate: Estimate, flow: Flow | None) -> ScaleColumns:
    """The columns of one case, blank where one flow was read as one.

    A readout of one scale on superposed flows counts as the set of that scale.
    """
    if flow is None or (len(flow.components) == 1 and not estimate.scales):
        return ScaleColumns()
    found = estimate.scales or _alone(estimate)
    scored = score_scales(found, flow)
    return ScaleColumns(
        scales_true=scored.true,
        scales_detected=scored.detected,
        scales_missed=scored.missed,
        scales_spurious=scored.spurious,
        scales_max_length_scale_error=scored.max_length_scale_error,
        scales_max_mean_velocity_error=scored.max_mean_velocity_error,
        scales_within_1_percent=float(scored.within(WITHIN)),
        true_scales=_listed(flow.components),
        est_scales=_listed(found),
    )


def _alone(estimate: Estimate) -> tuple[ScaleEstimate, ...]:
    scale, speed = estimate.length_scale, estimate.mean_velocity
    if not math.isfinite(scale) or not math.isfinite(speed):
        return ()
    return (ScaleEstimate(speed, scale, estimate.timescale, estimate.grid_length_scale),)


def _listed(scales: Sequence[CellularFlow | ScaleEstimate]) -> str:
    pairs = [(one.length_scale, one.mean_velocity) for one in scales]
    rounded = [[float(f"{value:.{DIGITS}g}") for value in pair] for pair in pairs]
    return json.dumps(rounded, separators=(",", ":"))
