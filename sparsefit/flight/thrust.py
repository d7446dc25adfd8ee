"""Thrust that changes in time: a series of accelerations, or of attitudes that make them."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, finite, positive
from sparsefit.flight.record import MOST_SAMPLES

GRAVITY = 9.80665  # m/s^2
SLACK = 1e-6  # of the mean step: how far rounding may lead beyond the ends


@dataclass(frozen=True, eq=False)
class ThrustSeries:
    """A thrust acceleration that changes in time, a straight line from sample to sample.

    Its clock and its axes are those of the flight: x and y as in the position.

    Args:
        time: t [s], (k,), strictly increasing, k >= 2.
        acceleration: a = T/m [m/s^2], (k, 2).

    Raises:
        InputError: if the shapes differ, a value is not finite or the time does not increase.
    """

    time: Array
    acceleration: Array

    def __post_init__(self) -> None:
        """Check both and freeze them."""
        time = _series("time of the thrust", self.time)
        given = np.array(self.acceleration, dtype=np.float64)
        if len(time) < 2 or not (np.diff(time) > 0).all():
            raise InputError("the thrust needs two times or more, increasing strictly")
        if given.shape != (len(time), 2) or not np.isfinite(given).all():
            raise InputError(
                f"the thrust must be finite accelerations ({len(time)}, 2) [m/s^2], a row for each "
                f"time; got shape {given.shape}"
            )
        for array in (time, given):
            array.flags.writeable = False
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "acceleration", given)

    @classmethod
    def from_attitude(
        cls, time: object, *, heading: object, tilt: object = None, magnitude: object = None
    ) -> ThrustSeries:
        """The series of a vehicle that thrusts where it points.

        The frame: heading is counter-clockwise from the x axis of the position (with x east and
        y north, a compass course psi clockwise from north is pi/2 - psi). A multirotor thrusts
        along its own upward axis, tilted from the vertical towards its heading: the horizontal part
        is ``magnitude * sin(tilt)``. Without a magnitude it holds its height: ``g tan(tilt)``.
        Without a tilt the thrust lies in the plane, as of a boat or of an aircraft in level flight.

        Args:
            time: t [s], (k,).
            heading: [rad], (k,) or one number.
            tilt: from the vertical [rad], in [0, pi/2), (k,) or one number.
            magnitude: thrust over mass [m/s^2], (k,) or one number.

        Raises:
            InputError: if both tilt and magnitude are missing, or a value is out of its range.
        """
        clock = _series("time of the thrust", time)
        course = _along("heading", heading, clock)
        if tilt is None and magnitude is None:
            raise InputError("an attitude needs tilt, magnitude, or both; neither is given")
        push = None if magnitude is None else _along("magnitude", magnitude, clock)
        if tilt is not None:
            lean = _along("tilt", tilt, clock)
            if not ((lean >= 0) & (lean < np.pi / 2)).all():
                raise InputError("tilt must be in [0, pi/2) rad, from the vertical; got others")
            push = GRAVITY * np.tan(lean) if push is None else push * np.sin(lean)
        assert push is not None
        return cls(clock, (push * np.array([np.cos(course), np.sin(course)])).T)

    def at(self, time: object) -> Array:
        """The acceleration [m/s^2] at times (m,) [s], (m, 2).

        Raises:
            InputError: for a time that the series does not cover.
        """
        sought = _series("time", time)
        first, last = float(self.time[0]), float(self.time[-1])
        slack = SLACK * (last - first) / (len(self.time) - 1)
        if sought.min() < first - slack or sought.max() > last + slack:
            raise InputError(
                f"the thrust is known from {first:g} to {last:g} s, the flight is from "
                f"{sought.min():g} to {sought.max():g} s: log it for all of the flight"
            )
        return np.stack([np.interp(sought, self.time, one) for one in self.acceleration.T], axis=1)

    def pointwise(self) -> Callable[[float], tuple[float, float]]:
        """The same at one time, on plain floats; the ends hold beyond them."""
        times, rows = self.time.tolist(), self.acceleration.tolist()

        def at(t: float) -> tuple[float, float]:
            after = min(max(bisect_right(times, t), 1), len(times) - 1)
            start, (x, y), (far_x, far_y) = times[after - 1], rows[after - 1], rows[after]
            share = min(max((t - start) / (times[after] - start), 0.0), 1.0)
            return x + share * (far_x - x), y + share * (far_y - y)

        return at


def turning(
    duration: float,
    sample_rate: float,
    *,
    constant: tuple[float, float],
    size: float,
    period: float,
    phase: float,
) -> ThrustSeries:
    """A constant thrust (x, y) and one beside it that turns counter-clockwise, both [m/s^2].

    Sampled at ``sample_rate`` [Hz] over ``duration`` [s], and one sample more; it points to
    ``phase`` [rad] at the start, and again after every ``period`` [s].
    """
    positive("period of the thrust", period, "s")
    if not 0 < duration * sample_rate <= MOST_SAMPLES:
        words = f"{duration:g} s at {sample_rate:g} Hz"
        raise InputError(f"{words} is no flight; keep it below {MOST_SAMPLES} samples")
    time = np.arange(round(duration * sample_rate) + 2) / sample_rate
    turned = 2.0 * np.pi * time / period + phase
    circle = np.stack([np.cos(turned), np.sin(turned)], axis=1)
    return ThrustSeries(time, np.array(constant) + finite("thrust", size, "m/s^2") * circle)


def _series(name: str, given: object) -> Array:
    try:
        values: Array = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be an array of numbers, (k,)") from None
    if values.ndim != 1 or not len(values) or not np.isfinite(values).all():
        raise InputError(f"{name} must be finite numbers, (k,); got shape {values.shape}")
    return values


def _along(name: str, given: object, time: Array) -> Array:
    """A value for each time (k,): the ones given, or one for all."""
    values = _series(name, np.atleast_1d(np.asarray(given)))
    if len(values) not in (1, len(time)):
        raise InputError(f"{name} has {len(values)} values for {len(time)} times; give one each")
    return np.broadcast_to(values, time.shape).copy()
