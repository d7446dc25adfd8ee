"""What the columns of a case are read from: its estimate, its fit, the truth, and yardsticks."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sparsefit.estimator.estimate import Estimate, ScaleEstimate
from sparsefit.flight import Flight
from sparsefit.flight.flow import Cells, CellularFlow, Flow
from sparsefit.model.grid import extent_of
from sparsefit.model.regression_bound import Bound, cramer_rao
from sparsefit.regression import Fit, RegressionProblem
from sparsefit.score import ScalesScore, prediction_error, score, score_scales
from sparsefit.study.draw import Draw

LISTED_DIGITS = 7  # significant, of the numbers in a listed set of scales
INTERVAL_BITS = 17  # binary digits, of the width of an interval


@dataclass(frozen=True)
class Yardstick:
    """The extent [m] of the flights of a case, and the Cramér-Rao bound of U0, L and tau_w.

    others: flights through the same flow, along which it is predicted.
    """

    extent: float
    bound: Bound | None = None
    others: tuple[Flight, ...] = ()


@dataclass(frozen=True)
class ScaleSets:
    """Two sets of scales held against each other, each listed as JSON, [[L [m], U0 [m/s]], ...]."""

    score: ScalesScore
    true: str
    estimated: str


@dataclass(frozen=True)
class Reading:
    """A case that was read; `flow` is the true one, None in still air."""

    estimate: Estimate
    fit: Fit
    problem: RegressionProblem
    flow: Flow | None
    yardstick: Yardstick

    @property
    def hit(self) -> bool:
        """Whether the candidate scale nearest the truth was chosen."""
        scales, flow = self.problem.group_scales, self.flow
        return scales is not None and flow is not None and score(self.estimate, flow, scales).hit

    @cached_property
    def scale_sets(self) -> ScaleSets | None:
        """The set of scales held against the true one; None where one flow was read as one.

        A readout of one scale on superposed flows counts as the set of that scale.
        """
        estimate, flow = self.estimate, self.flow
        if flow is None or (len(flow.cells) == 1 and not estimate.scales):
            return None
        scales = estimate.scales
        if not scales and math.isfinite(estimate.length_scale + estimate.mean_velocity):
            numbers = (estimate.mean_velocity, estimate.length_scale, estimate.timescale)
            scales = (ScaleEstimate(*numbers, estimate.grid_length_scale),)
        return ScaleSets(score_scales(scales, flow), _listed(flow.cells), _listed(scales))

    def bound(self, parameter: str) -> float | None:
        """The Cramér-Rao bound of one of `PARAMETERS`, in its unit, where there is one."""
        bound = self.yardstick.bound
        return None if bound is None else float(getattr(bound, parameter))

    @property
    def prediction_error(self) -> float | None:
        """The relative error of the flow along other flights; None without a flow or a flight."""
        flow, others = self.estimate.flow, self.yardstick.others
        return prediction_error(flow, others) if flow is not None and others else None

    def standard_error(self, parameter: str) -> float | None:
        """The standard error of one of `PARAMETERS`, in its unit, where there is one."""
        uncertainty = self.estimate.uncertainty
        return None if uncertainty is None else float(getattr(uncertainty, parameter))

    def interval(self, parameter: str) -> tuple[float, float] | tuple[None, None]:
        """The 95 % interval of one of `PARAMETERS`, in its unit, where there is one."""
        uncertainty = self.estimate.uncertainty
        if uncertainty is None:
            return None, None
        return outward(*map(float, getattr(uncertainty, f"{parameter}_interval")))


def outward(low: float, high: float) -> tuple[float, float]:
    """The interval, 1/32768 of its width longer at most: shorter numbers to store."""
    width = high - low
    if not (math.isfinite(width) and width > 0):
        return low, high
    step = math.ldexp(1.0, math.frexp(width)[1] - INTERVAL_BITS)
    return math.floor(low / step) * step, math.ceil(high / step) * step


def _listed(scales: Sequence[Cells | ScaleEstimate]) -> str:
    pairs = [(scale.length_scale, scale.mean_velocity) for scale in scales]
    rounded = [[float(f"{value:.{LISTED_DIGITS}g}") for value in pair] for pair in pairs]
    return json.dumps(rounded, separators=(",", ":"))


def yardstick(draw: Draw, fleet: tuple[Flight, ...], others: tuple[Flight, ...]) -> Yardstick:
    """The extent of flights together, and their semiparametric Cramér-Rao bound under Eq. 7.

    The bound is that of noise on v' alone at known positions: there is none without process
    noise, with noise of position or velocity, or without a single cellular flow.
    """
    position = np.concatenate([flown.position for flown in fleet])
    extent, noise = extent_of(position), draw.values.get("process_noise", 0.0)
    measured = any(draw.values.get(name, 0.0) > 0 for name in ("position_noise", "velocity_noise"))
    if noise <= 0 or measured or not isinstance(draw.flow, CellularFlow):
        return Yardstick(extent, others=others)
    velocity = np.concatenate([flown.velocity for flown in fleet])
    bound = cramer_rao(
        position,
        draw.flow,
        draw.vehicle,
        process_noise=noise,
        model="semiparametric",
        velocity=velocity,
    )
    return Yardstick(extent, bound, others)
