"""The readings of a log, with what they alone say of their noise and of their motion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property

if TYPE_CHECKING:
    from sparsefit.flight import Flight

DIFFUSE = 30.0  # prior deviation of the first state over the noise of its readings


@dataclass(frozen=True, eq=False)
class FlightLog:
    """Readings of one flight."""

    time: Array  # t (m,) [s], increasing
    position: Array  # (m, 2) [m], NaN where there is no reading
    velocity: Array  # (m, 2) [m/s], NaN likewise
    push: Array  # the thrust acceleration [m/s^2], (2,) or one per row (m, 2)
    thrust_noise: float = 0.0  # white, of each row of the thrust [m/s^2]

    def __post_init__(self) -> None:
        """Give each array its full shape."""
        shape = np.shape(self.position)
        for name in ("time", "position", "velocity", "push"):
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


def noise_of(values: Array) -> float:
    """The level of white noise of a series (m, 2), from the median size of fourth differences."""
    sizes = np.abs(np.diff(values, n=4, axis=0))
    size = float(np.nanmedian(sizes)) if np.isfinite(sizes).any() else 0.0
    return max(size / 0.6745 / math.sqrt(70.0), 1e-9)
