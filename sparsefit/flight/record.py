"""The record of one flight, and the checks of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, BoolArray, Brief, frozen
from sparsefit.errors import InputError, non_negative, one_of, store
from sparsefit.flight.flow import Flow, as_flow
from sparsefit.flight.vehicle import MOST_SAMPLES, PointMassVehicle

__all__ = ["FRAMES", "LARGEST", "MINIMUM_SAMPLES", "MOST_SAMPLES", "SMALLEST_STEP", "Flight"]
MINIMUM_SAMPLES = 3  # the least a second-order derivative can be taken from
SMALLEST_STEP = 1e-9  # [s] between samples, in the mean
FRAMES = {
    "": "x and y as in the file",
    "ENU": "x east, y north; headings counter-clockwise from east",
    "NED": "x north, y east; headings clockwise from north",
}
LARGEST = 1e12  # [s], [m] or [m/s]: squares are within the range of four bytes


@dataclass(frozen=True, eq=False, repr=False)
class Flight(Brief):
    """The log of a vehicle: time, position and velocity on the same samples.

    The arrays are stored as read-only float64 copies. Rows count from 0 in every message.

    Args:
        time: t [s], shape (m,), strictly increasing, m >= 3.
        position: (x, y) [m], shape (m, 2).
        velocity: (vx, vy) [m/s], shape (m, 2).
        vehicle: the vehicle that flew.
        flow: the true flow where it is known, also any object with ``velocity(x, y, t)``; no
            estimate ever reads it.
        velocity_measured: whether the velocity was logged, or is only that of the position.
        thrust: measured thrust acceleration m [m/s^2], shape (m, 2), in the axes of the position;
            None where it is the vehicle's constant alone.
        frame: the axes: ``ENU`` (east, north), ``NED`` (north, east) or empty where the log does
            not say. Nothing is turned: results are in the same axes.

    Raises:
        InputError: naming the field and row, if the shapes differ, a value is not finite or
            absurdly large, the time does not increase, or there are fewer than three samples.
    """

    time: Array
    position: Array
    velocity: Array
    vehicle: PointMassVehicle
    flow: Flow | None = None
    velocity_measured: bool = True
    thrust: Array | None = None
    frame: str = ""

    @classmethod
    def from_positions(
        cls,
        time: object,
        position: object,
        vehicle: PointMassVehicle,
        flow: Flow | None = None,
        thrust: Array | None = None,
        frame: str = "",
    ) -> Flight:
        """Return a flight whose log has positions only.

        The arguments are those of the class. The velocity is the difference quotient of the
        position; no estimate reads it where `velocity_measured` is false.

        Raises:
            InputError: as `Flight` does.
        """
        t, x = frozen("time", time, ("m",)), frozen("position", position, ("m", 2))
        _check_rows(t, x, x, None)
        return cls(t, x, np.gradient(x, t, axis=0), vehicle, flow, False, thrust, frame)

    def __post_init__(self) -> None:
        """Check every field and freeze the arrays."""
        store(self, frozen, ("m",), "time")
        store(self, frozen, ("m", 2), "position", "velocity")
        if self.thrust is not None:
            store(self, frozen, ("m", 2), "thrust")
        _check_rows(self.time, self.position, self.velocity, self.thrust)
        if not isinstance(self.vehicle, PointMassVehicle):
            raise InputError(f"vehicle must be a PointMassVehicle; got {self.vehicle!r}")
        tau, *others = self.vehicle.parameters
        slow = LARGEST < tau < math.inf
        if slow or tau < 1.0 / LARGEST or max(map(abs, others)) > LARGEST:
            raise InputError(f"{self.vehicle!r} is no vehicle that flies; change the units")
        one_of("frame", self.frame, FRAMES)
        object.__setattr__(self, "flow", as_flow(self.flow))

    def rows(self, chosen: BoolArray) -> Flight:
        """Return the samples (m,) that are chosen, as a flight.

        Raises:
            InputError: if they are fewer than three.
        """
        if chosen.all():
            return self
        thrust = None if self.thrust is None else self.thrust[chosen]
        own = (self.time[chosen], self.position[chosen])
        if not self.velocity_measured:
            return Flight.from_positions(*own, self.vehicle, self.flow, thrust, self.frame)
        return replace(
            self, time=own[0], position=own[1], velocity=self.velocity[chosen], thrust=thrust
        )

    @property
    def samples(self) -> int:
        """The number of samples m."""
        return len(self.time)

    @property
    def duration(self) -> float:
        """The time from the first sample to the last [s]."""
        return float(self.time[-1] - self.time[0])

    @property
    def extent(self) -> float:
        """The larger side of the flight's bounding box [m]."""
        return float(np.ptp(self.position, axis=0).max())


def level_of(name: str, value: object, unit: str) -> float:
    """Return a level of noise, or raise `InputError` unless it is one that a flight may have."""
    level = non_negative(name, value, unit)
    if level > LARGEST:
        raise InputError(f"{name} is {level:g} {unit}: no flight has as much; lower it")
    return level


def streams(seed: np.random.SeedSequence, count: int) -> Iterator[np.random.Generator]:
    """Yield the independent streams of ``seed.spawn(count)``, and leave the seed as it was."""
    for child in range(count):
        key = (*seed.spawn_key, child)
        yield np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))


def _check_rows(time: Array, position: Array, velocity: Array, thrust: Array | None) -> None:
    """Refuse rows not one per sample, too few, absurdly large, or at times that do not increase."""
    named = {"time": time, "position": position, "velocity": velocity}
    for name, values in {**named, **({} if thrust is None else {"thrust": thrust})}.items():
        large = np.argwhere(np.abs(values) > LARGEST)
        if len(large):
            value = f"{values[tuple(large[0])]:g} in row {large[0][0]}"
            raise InputError(f"{name} is {value}: no flight; change the unit")
    if thrust is not None and len(thrust) != len(time):
        words = f"thrust has {len(thrust)} rows for {len(time)} samples"
        raise InputError(f"{words}; give one each (`ThrustSeries.at` interpolates)")
    counts = (len(time), len(position), len(velocity))
    if len(set(counts)) != 1:
        raise InputError(
            "time, position and velocity must have one row per sample each; "
            "got {} times, {} positions and {} velocities".format(*counts)
        )
    if len(time) < MINIMUM_SAMPLES:
        raise InputError(f"a flight needs at least {MINIMUM_SAMPLES} samples; got {len(time)}")
    falls = np.flatnonzero(np.diff(time) <= 0)
    if len(falls):
        row = int(falls[0]) + 1
        rows = f"row {row} (t={time[row]}) follows t={time[row - 1]}"
        if time[row] < time[row - 1]:
            remedy = "sort or drop rows, or split the log where another begins"
            raise InputError(f"time runs backwards: {rows}; {remedy}")
        raise InputError(f"time must increase strictly: {rows}; sort or drop repeated samples")
    step = float(time[-1] - time[0]) / (len(time) - 1)
    if step < SMALLEST_STEP:
        raise InputError(f"samples {step:.3g} s apart are no flight; give time in seconds")
