"""The record of one flight, and the checks of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray, Brief, frozen
from sparsefit.errors import InputError, integer, one_of, shown, store
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import FlowField, check_flow

MINIMUM_SAMPLES = 3  # the least a second-order derivative can be taken from
MOST_SAMPLES = 5_000_000  # of a flight that is read from a file or simulated: some 5 GB to estimate
SMALLEST_STEP = 1e-9  # [s] between samples, in the mean
FRAMES = {
    "": "x and y as in the file",
    "ENU": "x east, y north; headings counter-clockwise from east",
    "NED": "x north, y east; headings clockwise from north",
}
LARGEST = 1e12  # [s], [m] or [m/s]: squares are within the range of four bytes


@dataclass(frozen=True, eq=False, repr=False)
class Flight(Brief):
    """The log of one flight: time, position and velocity at the same samples.

    The arrays are stored as read-only float64 copies. Rows count from 0 in every message.

    Args:
        time: t [s], shape (m,), strictly increasing, m >= 3.
        position: (x, y) [m], shape (m, 2).
        velocity: (vx, vy) [m/s], shape (m, 2).
        vehicle: the vehicle that flew.
        flow: the true flow if it is known, or any object with ``velocity(x, y, t)``; used for
            scoring only, never by an estimate.
        velocity_measured: whether the velocity was logged, or is the derivative of the position.
        thrust: measured thrust acceleration [m/s^2], shape (m, 2), in the axes of the position;
            None if the vehicle's constant thrust is the only one.
        frame: the axes: ``ENU`` (east, north), ``NED`` (north, east) or empty if unknown. Results
            are in the same axes.

    Raises:
        InputError: naming the field and row, if the shapes differ, a value is not finite or
            absurdly large, the time does not increase, or there are fewer than three samples.
    """

    time: Array
    position: Array
    velocity: Array
    vehicle: PointMassVehicle
    flow: FlowField | None = None
    velocity_measured: bool = True
    thrust: Array | None = None
    frame: str = ""

    @classmethod
    def from_positions(
        cls, time: Any, position: Any, vehicle: PointMassVehicle, **others: Any
    ) -> Flight:
        """Return a flight whose log has positions only; the arguments are those of the class.

        Its velocity is the difference quotient of the position, which no estimate uses.
        """
        return cls(time, position, position, vehicle, velocity_measured=False, **others)

    def __post_init__(self) -> None:
        """Check every field and freeze the arrays."""
        names = ("time", "position", "velocity", *(() if self.thrust is None else ("thrust",)))
        if self.velocity is None:
            words = "sf.Flight.from_positions(time, position, vehicle)"
            raise InputError(f"velocity is None: a log of positions only is {words}")
        for name in names:
            store(self, frozen, ("m",) if name == "time" else ("m", 2), name)
            values = getattr(self, name)
            for place in np.argwhere(np.abs(values) > LARGEST)[:1]:
                value = f"{values[tuple(place)]:g} in row {place[0]}"
                raise InputError(f"{name} is {value}: no flight; change the unit")
        counts = [len(getattr(self, name)) for name in names]
        if len(set(counts)) != 1:
            words = ", ".join(f"{n} of {name}" for n, name in zip(counts, names, strict=True))
            raise InputError(f"a flight has one row per sample in every array; got {words}")
        if self.samples < MINIMUM_SAMPLES:
            raise InputError(f"a flight needs at least {MINIMUM_SAMPLES} samples; got {counts[0]}")
        for row in np.flatnonzero(np.diff(self.time) <= 0)[:1] + 1:
            before, after = self.time[row - 1], self.time[row]
            raise InputError(
                f"time {'runs backwards' if after < before else 'stands still'}: row {row} "
                f"(t={after}) follows t={before}; sort or drop rows, or split the log where "
                "another begins"
            )
        step = self.duration / (self.samples - 1)
        if step < SMALLEST_STEP:
            raise InputError(f"samples {step:.3g} s apart are no flight; give time in seconds")
        if not self.velocity_measured:
            rate = np.gradient(self.position, self.time, axis=0)
            object.__setattr__(self, "velocity", frozen("velocity", rate, ("m", 2)))
        if not isinstance(self.vehicle, PointMassVehicle):
            raise InputError(f"vehicle must be a PointMassVehicle; got {shown(self.vehicle)}")
        _, quadratic, *others = self.vehicle.parameters
        laws = (self.vehicle.rate, quadratic)
        if max(laws) < 1.0 / LARGEST or max(map(abs, (*laws, *others))) > LARGEST:
            raise InputError(f"{self.vehicle!r} is no vehicle that flies; change the units")
        one_of("frame", self.frame, FRAMES)
        check_flow(self.flow)

    def rows(self, chosen: BoolArray) -> Flight:
        """Return the flight of the samples where chosen, a mask (m,), is true.

        Raises:
            InputError: if fewer than three remain.
        """
        if (n := int(chosen.sum())) < MINIMUM_SAMPLES:
            span = f"the {self.samples} from t={self.time[0]:.10g} to {self.time[-1]:.10g} s"
            raise InputError(f"a flight needs at least {MINIMUM_SAMPLES} samples: {n} of {span}")
        own = {name: getattr(self, name) for name in ("time", "position", "velocity", "thrust")}
        part = {name: rows[chosen] for name, rows in own.items() if rows is not None}
        return self if chosen.all() else replace(self, **part)

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


def streams(seed: int | np.random.SeedSequence, count: int) -> Iterator[np.random.Generator]:
    """Yield the independent streams of ``seed.spawn(count)``, and leave the seed as it was."""
    if not isinstance(seed, np.random.SeedSequence):
        seed = np.random.SeedSequence(integer("seed", seed, 0))
    for child in range(count):
        key = (*seed.spawn_key, child)
        yield np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=key))
