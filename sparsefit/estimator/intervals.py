"""Standard errors and 95 % intervals of a flow, of its cells, of a vehicle, and of a velocity.

Waves (k_x, k_y, omega, a, b) (j, 5) are those of psi = sum a cos(phi) + b sin(phi), phi = k.x -
omega t; `sparsefit.model.shapes` reads cells of them, and the drift c solves k_j.c = omega_j of the
two strongest. Variances are those of the waves through central differences of what is read.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.arrays import Array
from sparsefit.model.shapes import read_cells

NORMAL_95 = 1.959963984540054
STEP = 1e-6  # of a central difference, as a share of a parameter's size
NAMES = {
    "mean_velocity": "the mean velocity",
    "length_scale": "the length scale",
    "timescale": "the timescale",
}
Interval = tuple[float, float]


def interval(value: float, error: float, freedom: float = math.inf) -> Interval:
    """The 95 % interval of a value with a standard error of so many degrees of freedom."""
    half = reach(freedom) * error
    return value - half, value + half


def reach(freedom: float) -> float:
    """Standard errors in half a 95 % interval (Student's t); 1.96 of infinite freedom."""
    if math.isinf(freedom):
        return NORMAL_95
    from scipy.special import stdtrit

    return float(stdtrit(freedom, 0.975))


@dataclass(frozen=True)
class Uncertainty:
    """Standard errors [m/s], [m], [s], and intervals that hold the truth in 95 % of flights.

    Where a flight does not tell a quantity its standard error is inf, and its interval infinite.
    freedom: the degrees of freedom of the standard errors, infinite where these are certain.
    """

    mean_velocity: float
    length_scale: float
    timescale: float
    mean_velocity_interval: Interval
    length_scale_interval: Interval
    timescale_interval: Interval
    freedom: tuple[float, float, float] = (math.inf, math.inf, math.inf)

    def widest(self, values: tuple[float, float, float]) -> tuple[str, float]:
        """The name of the worst known of (U0, L, tau_w), and its interval's half-width over it."""
        pairs = zip(values, NAMES, self.freedom, strict=True)
        shares = [reach(free) * getattr(self, name) / abs(value) for value, name, free in pairs]
        worst = max(range(3), key=lambda i: shares[i])
        return tuple(NAMES)[worst], shares[worst]

    def wide(self, values: tuple[float, float, float], precision: float) -> str:
        """A sentence on the value whose interval reaches beyond `precision` of it; else empty."""
        name, share = self.widest(values)
        if share <= precision:
            return ""
        if not math.isfinite(share):
            return f"the flight does not tell {NAMES[name]} at all; fly across more cells"
        accuracy = f"{NAMES[name]} is known only to +-{100 * share:.0f} %"
        return f"{accuracy}; fly longer, across more cells, or ask for less (readout precision)"

    @classmethod
    def around(
        cls, values: Sequence[float], errors: Sequence[float], freedom: float = math.inf
    ) -> Uncertainty:
        """Intervals around (U0, L, tau_w) from standard errors with degrees of freedom."""
        sure = [error if math.isfinite(error) else math.inf for error in errors]
        ends = [interval(*pair, freedom) for pair in zip(values, sure, strict=True)]
        return cls(sure[0], sure[1], sure[2], ends[0], ends[1], ends[2], (freedom,) * 3)


@dataclass(frozen=True)
class ShapeUncertainty:
    """Standard errors and 95 % intervals of (L_x, L_y) [m], the heading [rad] and the drift [m/s].

    None of a drift that the shape does not have; pairs are (x, y).
    """

    length_scales: tuple[float, float]
    length_scale_intervals: tuple[Interval, Interval]
    heading: float
    heading_interval: Interval
    drift: tuple[float, float] | None = None
    drift_intervals: tuple[Interval, Interval] | None = None


@dataclass(frozen=True)
class VehicleUncertainty:
    """Standard errors and 95 % intervals of tau [s], a [m/s^2], wind [m/s], c [1/m] and s.

    NaN and None where a quantity was not estimated; pairs are (x, y).
    """

    response_time: float = math.nan
    response_time_interval: Interval | None = None
    thrust_acceleration: tuple[float, float] | None = None
    thrust_acceleration_intervals: tuple[Interval, Interval] | None = None
    wind: tuple[float, float] | None = None
    wind_intervals: tuple[Interval, Interval] | None = None
    drag: float = math.nan
    drag_interval: Interval | None = None
    thrust_scale: float = math.nan
    thrust_scale_interval: Interval | None = None


@dataclass(frozen=True, eq=False)
class FlowUncertainty:
    """How sure the velocity of `Estimate.flow` is at any place and time.

    Args:
        waves: (k_x, k_y, omega, a, b) of each (j, 5), in the coordinates and time of the flight.
        covariance: of these, row by row, and of the wind (x, y): (5 j + 2, 5 j + 2).
    """

    waves: Array
    covariance: Array

    def standard_error(self, x: ArrayLike, y: ArrayLike, t: ArrayLike = 0.0) -> Array:
        """Return the standard error of the velocity [m/s], shape (..., 2), at x, y [m] and t [s].

        It holds where the shape of the flow does: far from the flight it grows with the distance,
        to first order, and says nothing of a flow that changes there.
        """
        given = np.broadcast_arrays(*(np.asarray(value, np.float64) for value in (x, y, t)))
        east, north, time = (value.ravel() for value in given)
        slopes: list[Array] = []
        for kx, ky, omega, a, b in self.waves:
            phase = kx * east + ky * north - omega * time
            cos, sin = np.cos(phase), np.sin(phase)
            height, bend = b * cos - a * sin, -(a * cos + b * sin)  # psi', psi'' by the phase
            along, none = np.array([ky, -kx])[:, None], np.zeros_like(height)
            slopes += [
                along * (bend * east) + np.stack([none, -height]),
                along * (bend * north) + np.stack([height, none]),
                along * (-bend * time),
                along * -sin,
                along * cos,
            ]
        unit = np.ones_like(east)
        slopes += [np.stack([unit, 0 * unit]), np.stack([0 * unit, unit])]
        every = np.array(slopes)
        variance = np.einsum("idm,ij,jdm->md", every, self.covariance, every)
        errors: Array = np.sqrt(np.maximum(variance, 0.0)).reshape(*given[0].shape, 2)
        return errors


def read_waves(waves: Array) -> Array:
    """U0 [m/s], L [m] and tau_w [s] of waves (j, 5); of two or more also L_x, L_y, heading, drift.

    (3,) of a single wave, else (8,), the drift (x, y) last.
    """
    cells = read_cells(waves[:, :2], waves[:, 3:])
    speed, scale = cells.mean_velocity, cells.length_scale
    values = [speed, scale, scale / speed if speed else math.inf]
    if len(waves) < 2:
        return np.array(values)
    strength = np.sum(waves[:, :2] ** 2, axis=1) * np.sum(waves[:, 3:] ** 2, axis=1)
    two = np.argsort(-strength, kind="stable")[:2]
    drift = np.linalg.lstsq(waves[two, :2], waves[two, 2], rcond=1e-9)[0]
    return np.array([*values, *cells.length_scales, cells.heading, *drift])


def read_with_errors(waves: Array, covariance: Array) -> tuple[Array, Array]:
    """`read_waves` and the standard errors of its values, by the covariance (5 j, 5 j) of waves."""
    size = np.abs(waves).max(axis=0)
    steps = STEP * np.where(size > 0, size, 1.0)
    steps[2] = STEP * max(size[2], 1.0)
    gradients = []
    for place in np.ndindex(*waves.shape):
        moved = [waves.copy(), waves.copy()]
        for sign, own in zip((1, -1), moved, strict=True):
            own[place] += sign * steps[place[1]]
        gradients.append((read_waves(moved[0]) - read_waves(moved[1])) / (2 * steps[place[1]]))
    slopes = np.array(gradients)
    variances = np.einsum("if,ij,jf->f", slopes, covariance, slopes)
    return read_waves(waves), np.sqrt(np.maximum(variances, 0.0))
