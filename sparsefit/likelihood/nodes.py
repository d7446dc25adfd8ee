"""The readings of a log, the nodes (times) at which they are taken, and smoothed states.

A node has up to four readings (position x, y, velocity x, y); a missing reading has the weight 0.
Positions with a latency have nodes of their own. Where readings are further apart than the longest
step of the motion, nodes without readings are inserted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError

if TYPE_CHECKING:
    from sparsefit.flight import Flight

MOST_NODES = 64  # per row of the log; a log that needs more is refused
DIFFUSE = 30.0  # prior deviation of the first state over the noise of its readings


@dataclass(frozen=True, eq=False)
class FlightLog:
    """Readings of one flight.

    Args:
        time: t (m,) [s], increasing.
        position: (m, 2) [m], NaN where there is no reading.
        velocity: (m, 2) [m/s], NaN likewise.
        thrust: the thrust acceleration [m/s^2], (2,) or one per row (m, 2).
        thrust_noise: white, of each row of the thrust [m/s^2].
    """

    time: Array
    position: Array
    velocity: Array
    thrust: Array
    thrust_noise: float = 0.0

    def __post_init__(self) -> None:
        """Give each array its full shape."""
        shape = np.shape(self.position)
        for name in ("time", "position", "velocity", "thrust"):
            array = np.asarray(getattr(self, name), dtype=np.float64)
            full = np.broadcast_to(array, shape[:1] if name == "time" else shape)
            object.__setattr__(self, name, full)

    @classmethod
    def of_flight(cls, flight: Flight, sound: Array | None = None) -> FlightLog:
        """Return the readings of a flight; its velocity only where it was measured.

        sound: positions (m, 2) [m] with outliers, which are no readings, replaced.
        """
        thrust = flight.vehicle.thrust_acceleration if flight.thrust is None else flight.thrust
        velocity = flight.velocity if flight.velocity_measured else np.nan * flight.velocity
        noise = 0.0 if flight.thrust is None else noise_of(flight.thrust)
        scaled = noise * abs(flight.vehicle.thrust_scale)
        place = flight.position if sound is None else sound
        position = np.where(place == flight.position, place, np.nan)
        return cls(flight.time, position, velocity, np.asarray(thrust), scaled)

    @property
    def origin(self) -> tuple[float, float, float]:
        """The middle (x, y, t) of the box around the positions, and of the time."""
        x, y = 0.5 * (np.nanmin(self.position, axis=0) + np.nanmax(self.position, axis=0))
        return float(x), float(y), 0.5 * float(self.time[0] + self.time[-1])

    @cached_property
    def speed(self) -> float:
        """The 95th percentile of the speed [m/s]."""
        speeds = np.hypot(*self.velocity.T)
        if not np.isfinite(speeds).any():
            seen = np.isfinite(self.position).all(axis=1)
            speeds = np.hypot(*np.diff(self.position[seen], axis=0).T) / np.diff(self.time[seen])
        return float(np.nanquantile(speeds, 0.95)) + 1e-9

    @cached_property
    def interval(self) -> float:
        """The median time [s] between rows."""
        return float(np.median(np.diff(self.time)))

    @cached_property
    def noise(self) -> tuple[float, float]:
        """The levels of white noise of position [m] and velocity [m/s], from the log alone."""
        return noise_of(self.position), noise_of(self.velocity)

    @property
    def kicks(self) -> float:
        """The smallest process noise [m/s^2/sqrt(Hz)]: that of the measured thrust."""
        return self.thrust_noise * math.sqrt(self.interval)

    @property
    def spread(self) -> Array:
        """The prior variance (4,) of the first position and velocity, from the log alone."""
        place, rate = (DIFFUSE * noise for noise in self.noise)
        measured = np.isfinite(self.velocity).any()
        return np.repeat(np.square([place, rate if measured else 10.0 * self.speed]), 2)


@dataclass(frozen=True, eq=False)
class Nodes:
    """The readings of a log in order of time, relative to an origin.

    Args:
        time: from the origin (m,) [s].
        push: the thrust acceleration (m, 2) [m/s^2].
        measured: (m, 4), 0 where missing.
        weights: 1, or 0 where missing or left out (m, 4).
        seen: whether there is a reading (m, 4).
    """

    time: Array
    push: Array
    measured: Array
    weights: Array
    seen: BoolArray

    @classmethod
    def of(
        cls,
        log: FlightLog,
        origin: tuple[float, float, float],
        longest: float,
        latency: float = 0.0,
        stride: int = 1,
    ) -> Nodes:
        """Return the nodes of every `stride`-th row.

        origin: x, y, t [m, m, s] that positions and times are counted from; longest: the longest
        step of the motion [s]; latency: by which positions are older than velocities [s].
        """
        rows = np.arange(0, len(log.time), stride)
        clock = log.time[rows] - origin[2]
        place, speed = log.position[rows] - origin[:2], log.velocity[rows]
        shift = latency if np.isfinite(speed).any() else 0.0
        times = np.union1d(clock, clock - shift) if shift else clock
        count = np.maximum(np.ceil(np.diff(times) / longest - 1e-9), 1.0).astype(np.intp)
        if count.sum() > MOST_NODES * len(rows) + 1000:
            raise InputError(
                f"gaps of up to {np.diff(times).max():.3g} s are too long for motion that needs "
                f"steps of {longest:.3g} s; split the log there"
            )
        starts = np.concatenate([[0], np.cumsum(count)])
        within = np.arange(starts[-1]) - np.repeat(starts[:-1], count)
        steps = np.repeat(np.diff(times) / count, count)
        time = np.append(np.repeat(times[:-1], count) + within * steps, times[-1])
        measured, weights = np.zeros((2, len(time), 4))
        for channel, values, stamps in ((0, place, clock - shift), (2, speed, clock)):
            nodes = starts[np.searchsorted(times, stamps)]
            measured[nodes, channel : channel + 2] = np.nan_to_num(values, nan=0.0)
            weights[nodes, channel : channel + 2] = np.isfinite(values)
        push = [np.interp(time, log.time - origin[2], each) for each in log.thrust.T]
        return cls(time, np.column_stack(push), measured, weights, weights > 0.0)

    def track(self) -> Array:
        """Return an initial track (m, 4), interpolated between the readings."""
        track = np.zeros((len(self.time), 4))
        for channel, seen in enumerate(self.seen.T):
            if seen.any():
                values = self.measured[seen, channel]
                track[:, channel] = np.interp(self.time, self.time[seen], values)
            else:
                track[:, channel] = np.gradient(track[:, channel - 2], self.time)
        return track


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The result of a backward pass.

    Args:
        track: the states (m, n) given all readings.
        adjoint: r at each node and after it (m + 1, 2 n).
        scores: of the readings (m, 12): u, the standardised leave-one-out residual u/sqrt(D), the
            standardised innovation e/sqrt(S).
        squares: half the sum of r^2 and of its variance (l, 2), times the variance of each level:
            their difference is the derivative of the log-likelihood by its logarithm.
        parts: the share of each state's kicks in each block of the pass (b, n, 2).
    """

    track: Array
    adjoint: Array
    scores: Array
    squares: Array
    parts: Array


def noise_of(values: Array) -> float:
    """The level of white noise of a series (m, 2), from the median size of fourth differences."""
    sizes = np.abs(np.diff(values, n=4, axis=0))
    size = float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 0.0
    return max(size / 0.6745 / math.sqrt(70.0), 1e-9)
