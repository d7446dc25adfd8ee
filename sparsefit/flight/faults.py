"""Faults of a log: positions that wander or jump, velocities far off, samples missing.

Wander is the first-order autoregression e_{i+1} = rho e_i + sqrt(1 - rho^2) sigma n_i with
rho = exp(-dt/T), as of a satellite receiver.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, integer, non_negative, number_setting, positive, store
from sparsefit.flight.record import Flight, streams


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
        lost_samples: the share of samples that are lost, each by itself, in [0, 1].

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
    lost_samples: float = 0.0

    def __post_init__(self) -> None:
        """Check every fault."""
        store(self, non_negative, "m", "wander", "jump_size")
        store(self, non_negative, "m/s", "outlier_size")
        store(self, positive, "s", "wander_time")
        store(self, non_negative, "s", "gap_duration")
        store(self, integer, 0, "jumps", "gaps")
        for name in ("outliers", "lost_samples"):
            number_setting("faults", name, getattr(self, name), low=0.0, high=1.0)

    def spoil(self, flight: Flight, seed: np.random.SeedSequence) -> Flight:
        """Return the log of a flight with these faults; each fault has a stream of its own.

        Raises:
            InputError: if fewer than three samples are left, or there are more gaps or jumps than
                samples.
        """
        for name, count in (("jumps", self.jumps), ("gaps", self.gaps)):
            if count > flight.samples:
                raise InputError(f"{name}: {count} in {flight.samples} samples; give fewer")
        wander, outlier, jump, gap, loss = streams(seed, 5)
        samples, time = flight.samples, flight.time[:, None]
        error = wander.standard_normal((samples, 2))
        memory = np.exp(-np.diff(flight.time) / self.wander_time)
        for row, share in enumerate(memory.tolist(), start=1):
            error[row] = share * error[row - 1] + math.sqrt(1.0 - share * share) * error[row]
        steps = np.zeros((samples, 2))
        rows = jump.integers(1, samples, self.jumps)
        np.add.at(steps, rows, self.jump_size * _directions(self.jumps, jump))
        hit = outlier.random(samples) < self.outliers
        off = self.outlier_size * hit[:, None] * _directions(samples, outlier)
        lengths = np.minimum(self.gap_duration * gap.random(self.gaps), flight.duration)
        begins = flight.time[0] + (flight.duration - lengths) * gap.random(self.gaps)
        missing = ((begins < time) & (time < begins + lengths)).any(axis=1)
        missing |= loss.random(samples) < self.lost_samples
        missing[[0, -1]] = False
        position = flight.position + self.wander * error + np.cumsum(steps, axis=0)
        return replace(flight, position=position, velocity=flight.velocity + off).rows(~missing)


def _directions(count: int, stream: np.random.Generator) -> Array:
    """Random directions, (count, 2), of length 1."""
    turn = stream.uniform(0.0, 2.0 * math.pi, count)
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)
