"""The linear filter behind Phi: what smoothing and differencing do to a flow, and to noise.

Every derivative of `sparsefit.derivative` reads state and acceleration from n raw samples,

    x_s = kx . (x, v),    v_s = kv . (x, v),    a_s = ka . (x, v),

with weights (2n,), n positions and then n velocities. Along an exact path velocity is the integral
of V' and position that of V, so a_s = P V' with weights p of sum 1: a forward difference is the
mean over its step. Hence Phi is (P - 1) V' tau + (S - 1) V away from the flow velocity.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples
from sparsefit.derivative.kernels import polynomial_kernels
from sparsefit.derivative.pieces import GAP
from sparsefit.derivative.smoothing import Channels, Smoothing
from sparsefit.derivative.steps import nearly_even

KEPT = 32  # filters
DIGITS = 12  # of a time step: beyond them is the rounding of the clock
DEGREE = 10  # of the polynomials that the weights on samples keep exact: the smoother's own
PLAIN = {  # state and difference on neighbouring samples, and where the first one is, in steps
    "forward": ((1.0, 0.0), (-1.0, 1.0), 0.0),
    "midpoint": ((0.5, 0.5), (-1.0, 1.0), -0.5),
    "central": ((0.0, 1.0, 0.0), (-0.5, 0.0, 0.5), -1.0),
}


@dataclass(frozen=True, eq=False)
class Filters:
    """Weights on raw samples, for noise, and on the samples they give, for what they distort.

    raw (3, 2, n): of position [1, s], velocity [1/s, 1] and acceleration [1/s^2, 1/s], on n raw
    positions and n raw velocities. kicks (n - 1,): of the mean acceleration in each step, in the
    filtered acceleration. path (2, 2, n'), mean (n',): position, velocity and P on the n' samples
    around one, n' odd; None where steps are uneven. sigma_position [m], sigma_velocity [m/s]: of
    the raw noise, NaN where it was not sought.
    """

    raw: Array
    kicks: Array
    path: Array | None
    mean: Array | None
    sigma_position: float = math.nan
    sigma_velocity: float = math.nan

    @classmethod
    def of(cls, samples: Samples) -> Filters | None:
        """The filters that made ``samples``; None where no rule of this package did."""
        if samples.smoothing is None or len(samples.time) < 2:
            return None
        steps = np.diff(samples.time)
        step = float(f"{_step(samples.smoothing, steps):.{DIGITS}g}")
        return _filters(samples.smoothing, step, nearly_even(steps, step))


@lru_cache(maxsize=KEPT)
def _filters(smoothing: Smoothing, step: float, even: bool) -> Filters | None:
    """The filters of a rule at a time step [s]; those of a stream are asked for again and again."""
    kernels = _kernels(smoothing, step)
    if kernels is None:
        return None
    raw, first = kernels
    kicks, path, mean = kicks_through(raw[2], step), None, None
    if even:
        path, mean = _on_samples(raw, kicks, first, step)
    return Filters(raw, kicks, path, mean, smoothing.sigma_position, smoothing.sigma_velocity)


def _step(smoothing: Smoothing, steps: Array) -> float:
    """The time step [s] behind the weights; between gaps, of the steps that are none."""
    gaps = smoothing.method == "auto" and steps.max() > GAP * steps.min()
    return float(np.median(steps) if gaps else np.mean(steps))


def _kernels(smoothing: Smoothing, step: float) -> tuple[Array, float] | None:
    """raw (3, 2, n), and the place of the first raw sample in steps from the filtered one."""
    if smoothing.method == "auto":
        nothing = np.empty((0, 2))
        channels = Channels(
            nothing,
            nothing,
            step,
            smoothing.sigma_position,
            smoothing.sigma_velocity,
            positions_only=smoothing.positions_only,
        )
        state = channels.kernels(smoothing.window, smoothing.coupled)
        rate = channels.kernels(smoothing.rate_window, smoothing.coupled)[3].reshape(2, -1)
        trim = (smoothing.window - smoothing.rate_window) // 2
        wide = np.pad(rate, ((0, 0), (trim, trim)))
        return np.stack([*state[[0, 2]].reshape(2, 2, -1), wide]), -(smoothing.window // 2)
    if smoothing.method == "savgol":
        value, slope, _ = polynomial_kernels(smoothing.window, smoothing.order, step)
        first = -(smoothing.window // 2) * 1.0
    elif smoothing.method in PLAIN:
        state_weights, difference, first = PLAIN[smoothing.method]
        value, slope = np.array(state_weights), np.array(difference) / step
    else:
        return None
    none = np.zeros(len(value))
    return np.array([[value, none], [none, value], [none, slope]]), first


def kicks_through(acceleration: Array, step: float) -> Array:
    """Weights (n - 1,) of the mean of V' in each step, in what the filter gives for V'.

    acceleration (2, n) [1/s^2, 1/s]: the filter's weights on n positions and n velocities, ``step``
    [s] apart.

    A kick u in step j adds h u to every later velocity, and h^2 (i - j - 1/2) u to position i.
    """
    by_position, by_velocity = acceleration
    index = np.arange(len(by_velocity))
    later = [np.cumsum(row[::-1])[::-1][1:] for row in (by_velocity, by_position)]
    moment = np.cumsum((index * by_position)[::-1])[::-1][1:]
    weights: Array = step * later[0] + step**2 * (moment - (index[:-1] + 0.5) * later[1])
    return weights


def _on_samples(raw: Array, kicks: Array, first: float, step: float) -> tuple[Array, Array]:
    """path (2, 2, n') and mean (n',), exact for polynomials of `DEGREE`.

    Long windows keep their own weights, P by the trapezoidal rule, and take the least change that
    makes it exact; short ones are the least weights on DEGREE + 1 samples that are.
    """
    size = raw.shape[2]
    if size > DEGREE:
        mean: Array = np.zeros(size)
        mean[1:] += 0.5 * kicks
        mean[:-1] += 0.5 * kicks
        used = np.flatnonzero(np.any(raw[2] != 0, axis=0))  # the derivative's shorter window
        held = slice(used[0], used[-1] + 1)
        powers: Array = _powers(_places(size))[:, held]
        mean[held] += _least(powers, _moments(raw[2], first, step) - powers @ mean[held])
        return raw[:2], mean
    nodes = _powers(_places(DEGREE + 1))
    reach = DEGREE / 2
    places: Array = (first + np.arange(size, dtype=np.float64)) / reach
    on_nodes = _least(nodes, _powers(places) @ raw[0, 0])
    none = np.zeros(len(on_nodes))
    whole = _least(nodes, _moments(raw[2], first, step, reach))
    return np.array([[on_nodes, none], [none, on_nodes]]), whole


def _least(powers: Array, moments: Array) -> Array:
    """The least weights with these moments."""
    weights: Array = np.linalg.lstsq(powers, moments, rcond=None)[0].astype(float, copy=False)
    return weights


def _places(size: int) -> Array:
    return np.linspace(-1.0, 1.0, size)


def _powers(places: Array) -> Array:
    return np.vander(places, DEGREE + 1, increasing=True).T


def _moments(acceleration: Array, first: float, step: float, reach: float = 0.0) -> Array:
    """What the acceleration's weights (2, n) give where V' = t^j, t in units of the reach."""
    reach = reach or (acceleration.shape[1] - 1) / 2
    t: Array = (first + np.arange(acceleration.shape[1], dtype=np.float64)) / reach
    scale = reach * step
    j, powers = np.arange(DEGREE + 1), _powers(t)
    by_velocity = powers @ (t * acceleration[1]) / (j + 1)
    by_position = powers @ (t * t * acceleration[0]) / ((j + 1) * (j + 2))
    moments: Array = scale * by_velocity + scale**2 * by_position
    return moments
