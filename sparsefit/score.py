"""Errors against the truth: the only room, with the bound, that knows it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sparsefit.estimator import Estimate
from sparsefit.flow import CellularFlow


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


def score(estimate: Estimate, flow: CellularFlow, scales: NDArray[np.float64]) -> Score:
    """Score an estimate against the true flow; scales (g,) [m] are the candidates it had."""
    nearest = float(scales[int(np.argmin(np.abs(scales - flow.length_scale)))])
    return Score(
        _error(estimate.mean_velocity, flow.mean_velocity),
        _error(estimate.length_scale, flow.length_scale),
        _error(estimate.timescale, flow.timescale),
        bool(estimate.grid_length_scale == nearest),
    )


def _error(estimated: float, true: float) -> ParameterError:
    return ParameterError(estimated - true, 100.0 * (estimated - true) / true)
