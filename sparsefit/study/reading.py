"""What the columns of a case are read from: its estimate, its fit, the truth, and yardsticks."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from sparsefit.errors import InputError
from sparsefit.estimator.estimate import Estimate, ScaleEstimate
from sparsefit.flight import Flight
from sparsefit.flight.flow import Cells, CellularFlow, Flow
from sparsefit.likelihood import Disturbance, FlightLog, StreamPattern, bound
from sparsefit.likelihood.vehicle_estimate import model_of
from sparsefit.regression import Fit, RegressionProblem
from sparsefit.score import ScalesScore, prediction_error, score, score_scales
from sparsefit.study.columns import PARAMETERS
from sparsefit.study.draw import Draw
from sparsefit.study.logged import Logged

WITHIN = 1.0  # percent: the error within which all length scales count as right
LISTED_DIGITS = 7  # significant, of the numbers in a listed set of scales
INTERVAL_BITS = 17  # binary digits, of the width of an interval
EXACT = 1e-6  # noise of a known position and velocity, in L and U0


@dataclass(frozen=True)
class Flown:
    """The flights of a unit in a condition, without their flow, and how they are judged.

    The truth enters at the score and nowhere before. extent [m]: of the flights together; bounds:
    the least standard deviations of U0 [m/s], L [m] and tau_w [s]; none where none is known.
    others: flights through the same flow, along which it is predicted.
    """

    unit: int
    draw: Draw | Logged
    fleet: tuple[Flight, ...]
    extent: float
    bounds: Mapping[str, float] = field(default_factory=dict)
    others: tuple[Flight, ...] = ()


@dataclass(frozen=True)
class ScaleSets:
    """Two sets of scales held against each other, each listed as JSON, [[L [m], U0 [m/s]], ...]."""

    score: ScalesScore
    true: str
    estimated: str

    @property
    def within_1_percent(self) -> bool:
        """Whether all length scales are found and right to a percent."""
        return self.score.within(WITHIN)


@dataclass(frozen=True)
class Reading:
    """A case that was read."""

    estimate: Estimate
    fit: Fit
    problem: RegressionProblem
    flown: Flown

    @property
    def flow(self) -> Flow | None:
        """The true flow, None in still air."""
        return self.flown.draw.flow

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

    @property
    def prediction_error(self) -> float | None:
        """The relative error of the flow along other flights; None without a flow or a flight."""
        flow, others = self.estimate.flow, self.flown.others
        return prediction_error(flow, others) if flow is not None and others else None

    @cached_property
    def intervals(self) -> Mapping[str, tuple[float, float]]:
        """The 95 % intervals by parameter, in their units, where there are any."""
        uncertainty = self.estimate.uncertainty
        if uncertainty is None:
            return {}
        ends = {name: getattr(uncertainty, f"{name}_interval") for name in PARAMETERS}
        return {name: outward(*map(float, pair)) for name, pair in ends.items()}


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


def bounds_of(draw: Draw, fleet: tuple[Flight, ...]) -> dict[str, float]:
    """The Cramér-Rao bounds of U0 [m/s], L [m] and tau_w [s] of flights together under Eq. 7.

    Bounds are those of trajectories that are known, with noise on v' alone: there are none
    without process noise, with noise of position or velocity, without a single cellular flow, or
    where the flights do not see all of it.
    """
    noise, flow = draw.values.get("process_noise", 0.0), draw.flow
    measured = any(draw.values.get(name, 0.0) > 0 for name in ("position_noise", "velocity_noise"))
    if noise <= 0 or measured or not isinstance(flow, CellularFlow):
        return {}
    # psi = U0/(2k) [cos k(x - y) - cos k(x + y)]
    speed, scale = flow.mean_velocity, flow.length_scale
    k, height = flow.wavenumber, 0.5 * speed / flow.wavenumber
    waves, cosine = k * np.array([[1.0, 1.0], [1.0, -1.0]]), height * np.array([-1.0, 1.0])
    pattern, models = StreamPattern.of_waves("axis", waves, cosine, np.zeros(2)), []
    for flown in fleet:
        density = noise * math.sqrt(flown.duration / (flown.samples - 1))  # [m/s^2/sqrt(Hz)]
        noises = Disturbance(density, EXACT * scale, EXACT * speed)
        model = model_of(pattern, flown, draw.vehicle, (0.0, 0.0))
        models.append(replace(model, disturbance=noises))
    states = [np.hstack([flown.position, flown.velocity]) for flown in fleet]
    try:
        covariance = bound([FlightLog.of_flight(flown) for flown in fleet], models, states)
    except InputError:
        return {}
    slopes = np.zeros((3, len(covariance)))  # of U0, L and tau_w by the parameters of the pattern
    slopes[0, 0] = slopes[1, 1] = 1.0
    slopes[2, :2] = -scale / speed**2, 1.0 / speed
    errors = np.sqrt(np.einsum("ij,jk,ik->i", slopes, covariance, slopes)).tolist()
    return dict(zip(("mean_velocity", "length_scale", "timescale"), errors, strict=True))
