"""The rows of the exported C in Python: from samples to Phi = tau (v' - a) + v at a position."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.export.plan import Plan
from sparsefit.flight import Flight

MICROSECOND = 1e-6


@dataclass(frozen=True)
class Row:
    """One row: the sample that completed it, its place from the origin [m], and Phi [m/s]."""

    sample: int
    place: tuple[float, float]
    phi: tuple[float, float]


def microseconds(time: Array) -> IntArray:
    """Time stamps (m,) [us] of a log in seconds, counted from its first sample."""
    stamps: IntArray = np.rint((time - time[0]) / MICROSECOND).astype(np.intp)
    return stamps


def rows_of(
    plan: Plan, flight: Flight, breaks: IntArray, origin: tuple[float, float]
) -> Iterator[Row]:
    """The rows of a flight, in the order of the samples that complete them.

    breaks: samples that begin a new window, after a gap or an uneven step.
    """
    time, state = microseconds(flight.time), np.hstack([flight.position, flight.velocity])
    tau, thrust = flight.vehicle.response_time, np.array(flight.vehicle.thrust_acceleration)
    starts = set(breaks.tolist())
    held = windows = 0
    for sample in range(len(time)):
        held = 1 if sample in starts else min(held + 1, plan.window)
        if held < plan.window:
            continue
        windows += 1
        if (windows - 1) % plan.estimator.library.every:
            continue
        last = slice(sample + 1 - plan.window, sample + 1)
        here, rate = differentiated(plan, time[last], state[last])
        place, phi = here[:2] - origin, tau * (rate - thrust) + here[2:]
        yield Row(sample, (place[0], place[1]), (phi[0], phi[1]))


def differentiated(plan: Plan, time: IntArray, state: Array) -> tuple[Array, Array]:
    """State (4,) and acceleration (2,) of a window: time (w,) [us], state (w, 4) [m, m/s]."""
    steps, velocity = np.diff(time) * MICROSECOND, state[:, 2:]
    method = plan.derivative.method
    if method == "savgol":
        middle = state[plan.window // 2]
        step = (time[-1] - time[0]) * MICROSECOND / (plan.window - 1)
        value, slope = plan.kernels
        away = state - middle
        return middle + value @ away, slope @ away[:, 2:] / step
    quotients = np.diff(velocity, axis=0) / steps[:, None]
    if method == "central":
        before, after = steps
        return state[1], (after * quotients[0] + before * quotients[1]) / (before + after)
    here = state[0] if method == "forward" else 0.5 * (state[0] + state[1])
    return here, quotients[0]
