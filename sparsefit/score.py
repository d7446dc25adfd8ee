"""Errors against the truth: the only room, with the bound, that knows it."""

import math
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.estimator.estimate import Estimate, ScaleEstimate
from sparsefit.flight.flow import CellularFlow, Flow

TOLERANCE = 0.05  # relative, of the wavenumber: nearer than this, a scale counts as detected


@dataclass(frozen=True)
class ParameterError:
    """Estimated minus true, in the parameter's unit and in percent of the truth."""

    signed: float
    signed_percent: float

    @property
    def absolute(self) -> float:
        """|estimated - true|."""
        return abs(self.signed)

    @property
    def absolute_percent(self) -> float:
        """|estimated - true| in percent of the truth."""
        return abs(self.signed_percent)


@dataclass(frozen=True)
class Score:
    """Errors of the three parameters; ``hit``: the candidate nearest the truth was chosen."""

    mean_velocity: ParameterError
    length_scale: ParameterError
    timescale: ParameterError
    hit: bool


def strongest(flow: Flow) -> CellularFlow:
    """The fastest cellular flow of a superposition, the first of equals."""
    return max(flow.components, key=lambda part: part.mean_velocity)


def score(estimate: Estimate, flow: Flow, scales: Array) -> Score:
    """Score an estimate against the true flow; scales (g,) [m] are the candidates it had.

    Of several flows superposed, against the strongest.
    """
    flow = strongest(flow)
    nearest = float(scales[int(np.argmin(np.abs(scales - flow.length_scale)))])
    return Score(
        _error(estimate.mean_velocity, flow.mean_velocity),
        _error(estimate.length_scale, flow.length_scale),
        _error(estimate.timescale, flow.timescale),
        bool(estimate.grid_length_scale == nearest),
    )


def _error(estimated: float, true: float) -> ParameterError:
    return ParameterError(estimated - true, 100.0 * (estimated - true) / true)


@dataclass(frozen=True)
class ScalesScore:
    """Scales of the truth that were found, and errors in percent of those.

    true, found: how many there are; length_scale_errors and mean_velocity_errors: signed, one per
    detected scale, in the order of the flow's components.
    """

    true: int
    found: int
    length_scale_errors: tuple[float, ...]
    mean_velocity_errors: tuple[float, ...]

    @property
    def detected(self) -> int:
        """Scales of the truth with an estimate within the tolerance."""
        return len(self.length_scale_errors)

    @property
    def missed(self) -> int:
        """Scales of the truth without one."""
        return self.true - self.detected

    @property
    def spurious(self) -> int:
        """Estimates that belong to no scale of the truth."""
        return self.found - self.detected

    @property
    def max_length_scale_error(self) -> float:
        """Largest |error| of L over the detected scales [%]; NaN where there is none."""
        return max(map(abs, self.length_scale_errors), default=math.nan)

    @property
    def max_mean_velocity_error(self) -> float:
        """Largest |error| of U0 over the detected scales [%]; NaN where there is none."""
        return max(map(abs, self.mean_velocity_errors), default=math.nan)

    def within(self, percent: float) -> bool:
        """Whether every scale of the truth was detected, its L within so many percent."""
        return self.missed == 0 and self.max_length_scale_error <= percent


def score_scales(
    estimate: Estimate | tuple[ScaleEstimate, ...], flow: Flow, *, tolerance: float = TOLERANCE
) -> ScalesScore:
    """Match the estimate's scales to the flow's, each to one: the nearest in wavenumber first.

    A pair farther apart than the tolerance, |k_est / k_true - 1|, is none. InputError: a tolerance
    not above 0.
    """
    if not tolerance > 0:
        raise InputError(f"score_scales: tolerance must be above 0, not {tolerance!r}")
    found = estimate.scales if isinstance(estimate, Estimate) else estimate
    pairs = sorted(
        (abs(part.length_scale / one.length_scale - 1), i, j)
        for i, part in enumerate(flow.components)
        for j, one in enumerate(found)
    )
    match: dict[int, int] = {}
    for distance, i, j in pairs:
        if distance <= tolerance and i not in match and j not in match.values():
            match[i] = j
    both = [(flow.components[i], found[j]) for i, j in sorted(match.items())]
    return ScalesScore(
        len(flow.components),
        len(found),
        tuple(_error(one.length_scale, p.length_scale).signed_percent for p, one in both),
        tuple(_error(one.mean_velocity, p.mean_velocity).signed_percent for p, one in both),
    )
