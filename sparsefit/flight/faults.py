"""Simulated faults of a log: wandering or jumping positions, outliers of velocity, lost samples.

Wander is a first-order Gauss-Markov process, e_{i+1} = rho e_i + sqrt(1 - rho^2) sigma n_i with
rho = exp(-dt/T), a model of the position error of a satellite receiver.
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
    """The faults added to a log; by default none.

    Args:
        wander: rms of the Gauss-Markov error of each position coordinate [m].
        wander_time: its correlation time [s], > 0.
        outliers: the share of samples whose velocity is an outlier, in [0, 1].
        outlier_size: its error [m/s], in a random direction.
        jumps: the number of permanent steps of the position.
        jump_size: their length [m], in a random direction.
        gaps: the number of gaps; two may overlap.
        gap_duration: their largest duration [s]; each is drawn uniformly from 0 to it.
        lost_samples: the share of samples lost independently of each other, in [0, 1].

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

    def spoil(self, flight: Flight, seed: int | np.random.SeedSequence) -> Flight:
        """Return the flight with these faults in its log; each fault has its own random stream.

        Raises:
            InputError: if fewer than three samples remain, or gaps or jumps exceed the samples.
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
    """Random unit vectors, (count, 2)."""
    turn = stream.uniform(0.0, 2.0 * math.pi, count)
    return np.stack([np.cos(turn), np.sin(turn)], axis=1)
