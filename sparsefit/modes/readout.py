"""Parameters read from weights: the length scale (Eq. 21), the mean velocity (Eqs. 22-24)."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, number_setting, one_of
from sparsefit.library.cells import candidate_columns, peak_mean_velocity, rms_mean_velocity
from sparsefit.regression.problem import RegressionProblem

LengthScaleReadout = Literal["signed-sum", "absolute-sum", "group-norm"]
MeanVelocityReadout = Literal["paper", "rms", "peak"]
Eq24 = Literal["mean-ratio", "pseudo-inverse"]
Refine = Literal["none", "variable-projection", "ladder"]
Scales = Literal["one", "several"]
Correction = Literal["none", "first-order"]

UNNAMED: Refine = "variable-projection"  # what a file that names no refinement has always meant


@dataclass(frozen=True)
class Readout:
    """How weights become parameters.

    length_scale: the scale with the largest sum of weights (``signed-sum``, Eq. 21 to the
    letter), of their absolute values (``absolute-sum``) or the largest Euclidean norm of its
    block (``group-norm``).
    mean_velocity, after a refit on the 8 columns of that scale: ``paper`` (Eqs. 22-24, whose last
    step is read as the mean of element-wise ratios, ``mean-ratio``, which has poles, or as the
    least-squares coefficient, ``pseudo-inverse``), ``rms`` over the cell in closed form, or the
    ``peak`` of |w| over the cell.
    refine: ``variable-projection`` moves the chosen scale off the grid, to the least residual of
    the 8-column fit between the grid's bounds; ``ladder``, the default, goes on from there to the
    shapes of an incompressible flow, cells at any heading, of any sides, steady or drifting, and
    lets the flight choose (`sparsefit.modes.ladder`); with several scales, ``peak``, ``paper`` or
    fewer than 10 samples that count it is ``variable-projection``. ``none`` reports the candidate
    itself. Files that name no refinement mean ``variable-projection``.
    scales: ``one`` reads one length scale; ``several`` reads all that the back-end proposes and the
    flight bears out, each with a velocity, ``rms`` or ``peak``, from one fit of them all
    (`sparsefit.modes.search`). Its peaks are those of the Euclidean norm always.
    correction: ``first-order`` takes from a refined ``rms`` readout what smoothing, differencing
    and noisy columns are known to do to it, and in turbulence moves the values by a step of
    generalised least squares, for samples and a known vehicle; ``none`` leaves it.
    precision: the largest half-width of the 95 % intervals of U0, L and tau_w, as a share of the
    value, that is still called ``ok``; at 0.03 a value is off by 5 % once in a thousand flights.
    """

    length_scale: LengthScaleReadout = "group-norm"
    mean_velocity: MeanVelocityReadout = "rms"
    eq24: Eq24 = "pseudo-inverse"
    refine: Refine = "ladder"
    scales: Scales = "one"
    correction: Correction = "first-order"
    precision: float = 0.03

    def __post_init__(self) -> None:
        for key, valid in (
            ("length_scale", get_args(LengthScaleReadout)),
            ("mean_velocity", get_args(MeanVelocityReadout)),
            ("eq24", get_args(Eq24)),
            ("refine", get_args(Refine)),
            ("scales", get_args(Scales)),
            ("correction", get_args(Correction)),
        ):
            one_of(f"readout {key}", getattr(self, key), valid)
        number_setting("readout", "precision", self.precision, low=0.0)
        if self.scales == "several" and self.mean_velocity == "paper":
            raise InputError(
                "readout: mean_velocity 'paper' (Eq. 22) scales one field to its range and cannot "
                "part several; use 'rms' or 'peak', or scales 'one'"
            )

    def scale_weights(self, problem: RegressionProblem, weights: Array) -> Array:
        """The weight of each group (g,), by the length-scale readout, from weights (k, n)."""
        groups = int(problem.groups.max()) + 1
        rows = {
            "signed-sum": weights.sum(axis=1),
            "absolute-sum": np.abs(weights).sum(axis=1),
            "group-norm": np.square(weights).sum(axis=1),
        }[self.length_scale]
        sums = np.bincount(problem.groups, weights=rows, minlength=groups).astype(float)
        return np.sqrt(sums) if self.length_scale == "group-norm" else sums

    def velocity(
        self, position: Array, flow_velocity: Array, target: Array, length_scale: float
    ) -> float:
        """U0 [m/s] at a length scale [m], refitted; NaN where the readout has no finite answer.

        Args:
            position: (m, 2) [m].
            flow_velocity: Phi (m, 2) [m/s].
            target: what the library was regressed on (m, n), its last two columns the velocity
                components: Eq. 22 normalises its refit.
            length_scale: L [m].
        """
        columns = candidate_columns(position, np.array([length_scale]))
        if self.mean_velocity == "paper":
            field = columns @ _refit(columns, target[:, -2:])
            return paper_mean_velocity(field, flow_velocity, self.eq24)
        return mean_velocity_of(_refit(columns, flow_velocity), self.mean_velocity)


def _refit(columns: Array, target: Array) -> Array:
    return np.linalg.lstsq(columns, target, rcond=None)[0].astype(float, copy=False)


def paper_mean_velocity(field: Array, flow_velocity: Array, eq24: str) -> float:
    """Eqs. 22-24: normalise the fitted field (m, 2) to a range of sqrt(2), then scale it to Phi.

    Eq. 22 gives each component an amplitude of sqrt(2)/2; that of Eq. 1 is 1, so U0 comes out up
    to sqrt(2) too large once the flight covers a cell.
    """
    high, low = field.max(axis=0), field.min(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        normal = math.sqrt(2.0) * (field - 0.5 * (high + low)) / (high - low)
        if eq24 == "mean-ratio":
            return float(np.mean(flow_velocity / normal))
        return float(np.sum(flow_velocity * normal) / np.sum(normal * normal))


def mean_velocity_of(weights: Array, readout: MeanVelocityReadout) -> float:
    """U0 [m/s] by its readout, ``rms`` or ``peak``, from the weights (8, 2) [m/s] of one mode."""
    return rms_mean_velocity(weights) if readout == "rms" else peak_mean_velocity(weights)
