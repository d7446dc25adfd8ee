"""What goes wrong in a log: positions that wander or jump, velocities far off, samples missing.

Wander is the first-order autoregression e_{i+1} = rho e_i + sqrt(1 - rho^2) sigma n_i with
rho = exp(-dt/T), as of a satellite receiver.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, is_number, non_negative, positive
from sparsefit.flight.record import MINIMUM_SAMPLES, Flight, level_of


@dataclass(frozen=True)
class LogFaults:
    """Faults that a log is given, by default none.

    Args:
        wander: rms of each coordinate of a position error that wanders [m].
        wander_time: its correlation time [s], > 0.
        outliers: the share of samples with a velocity far off, in [0, 1].
        outlier_size: by how much [m/s], in a random direction.
        jumps: how often the position jumps, for good.
        jump_size: by how much [m], in a random direction.
        gaps: how many gaps there are; two may overlap.
        gap_duration: the longest they may be [s]; each is drawn uniformly from 0 to it.

    Raises:
        InputError: if one of them is not in its range.
    """

    wander: float = 0.0
    wander_time: float = 5.0
    outliers: float = 0.0
    outlier_size: float = 5.0
    jumps: int = 0
    jump_size: float = 1.0
    gaps: int = 0
    gap_duration: float = 1.0

    def __post_init__(self) -> None:
        """Check every fault."""
        level_of("wander", self.wander, "m")
        positive("wander_time", self.wander_time, "s")
        if not is_number(self.outliers, 0.0, 1.0):
            raise InputError(f"outliers is a share of the samples, 0 to 1; got {self.outliers!r}")
        level_of("outlier_size", self.outlier_size, "m/s")
        integer("jumps", self.jumps, 0)
        level_of("jump_size", self.jump_size, "m")
        integer("gaps", self.gaps, 0)
        non_negative("gap_duration", self.gap_duration, "s")

    def spoil(self, flight: Flight, seed: np.random.SeedSequence) -> Flight:
        """Return the flight as a log with these faults tells it; each has a stream of its own.

        Raises:
            InputError: if the gaps leave fewer than three samples, or there are more of them or of
                jumps than samples.
        """
        for name, count in (("jumps", self.jumps), ("gaps", self.gaps)):
            if count > flight.samples:
                raise InputError(f"{name}: {count} in {flight.samples} samples; give fewer")
        key = seed.spawn_key
        wander, outlier, jump, gap = (
            np.random.default_rng(np.random.SeedSequence(seed.entropy, spawn_key=(*key, child)))
            for child in range(4)
        )
        position = flight.position + self._wander(flight.time, wander)
        spoilt = replace(
            flight,
            position=position + self._jumps(len(position), jump),
            velocity=flight.velocity + self._outliers(len(position), outlier),
        )
        return self._without_gaps(spoilt, gap)

    def _wander(self, time: Array, stream: np.random.Generator) -> Array:
        """The error of the position that wanders [m], (m, 2), stationary from the start."""
        kicks = stream.standard_normal((len(time), 2))
        kept = np.exp(-np.diff(time) / self.wander_time)
        for row, share in enumerate(kept.tolist(), start=1):
            kicks[row] = share * kicks[row - 1] + math.sqrt(1.0 - share * share) * kicks[row]
        return self.wander * kicks

    def _outliers(self, samples: int, stream: np.random.Generator) -> Array:
        """The error of the velocities that are far off [m/s], (m, 2)."""
        hit = stream.random(samples) < self.outliers
        return self.outlier_size * hit[:, None] * _directions(samples, stream)

    def _jumps(self, samples: int, stream: np.random.Generator) -> Array:
        """The sum of all jumps so far [m], (m, 2)."""
        steps = np.zeros((samples, 2))
        rows = stream.integers(1, samples, self.jumps)
        np.add.at(steps, rows, self.jump_size * _directions(self.jumps, stream))
        return np.cumsum(steps, axis=0)

    def _without_gaps(self, flight: Flight, stream: np.random.Generator) -> Flight:
        lengths = np.minimum(self.gap_duration * stream.random(self.gaps), flight.duration)
        starts = flight.time[0] + (flight.duration - lengths) * stream.random(self.gaps)
        inside = (starts < flight.time[:, None]) & (flight.time[:, None] < starts + lengths)
        kept = ~inside.any(axis=1)
        if kept.all():
            return flight
        if kept.sum() < MINIMUM_SAMPLES:
            raise InputError(
                f"gaps of up to {self.gap_duration:g} s leave {kept.sum()} samples of a flight of "
                f"{flight.duration:g} s: make them fewer or shorter"
            )
        logged = {name: getattr(flight, name)[kept] for name in ("time", "position", "velocity")}
        thrust = None if flight.thrust is None else flight.thrust[kept]
        return replace(flight, **logged, thrust=thrust)


def _directions(count: int, stream: np.random.Generator) -> Array:
    """Random directions, (count, 2), of length 1."""
    turn = stream.uniform(0.0, 2.0 * math.pi, count)
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)
