"""The samples that a window holds, the rows that a local derivative makes of them, and their sums.

Row i of a rule that takes s neighbours (its span) is made of the samples i to i + s - 1, so that
the rows of a window are the same numbers whether its samples came one by one or all at once.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array
from sparsefit.derivative import Samples, Smoothing
from sparsefit.errors import InputError
from sparsefit.flight import Flight
from sparsefit.flight.record import MINIMUM_SAMPLES
from sparsefit.library.builder import STREAM_BYTES
from sparsefit.online.ring import Ring
from sparsefit.online.settings import Settings
from sparsefit.online.sums import BLOCK, Sums
from sparsefit.regression.statistics import Statistics

FIRST_CAPACITY = 512  # rows; doubled as the window turns out to hold more
SPARE = 4 * BLOCK  # rows beside those of the window: what left may still be in work
EDGE = 1e-9  # of the window: a sample this much older is as old as the window is long


@dataclass(frozen=True, eq=False)
class Contents:
    """The rows of a window at one moment: views of memory that the next samples write to.

    Args:
        samples: states and their derivatives.
        theta: (m, k), times the row's weight where older samples weigh less.
        target: (m, n), the same.
        statistics: of theta and target, as the sums have them.
        fading: weights of the rows (m,), their squares of mean 1; None where all are alike.
    """

    samples: Samples
    theta: Array
    target: Array
    statistics: Statistics
    fading: Array | None = None


class Window:
    """A stretch of the newest samples, without a gap.

    Args:
        settings: of the estimator, its vehicle, and the length of the window.
    """

    def __init__(self, settings: Settings) -> None:
        self.settings = settings
        self.columns = settings.columns
        self.targets = settings.targets
        k, n = self.columns.size, self.targets
        self._raw = Ring(FIRST_CAPACITY, 7)  # t, position, velocity, thrust: x and y of each
        self._state = Ring(FIRST_CAPACITY, 11)  # the same of a row, and the rates of the first two
        self._theta = Ring(FIRST_CAPACITY, k)
        self._target = Ring(FIRST_CAPACITY, n)
        self._sums = Sums(k, n)
        self.count = self.first = self._done = 0  # samples; the first one in the window; rows
        self.pushed = False  # whether the samples come with a measured thrust
        self._reference = -math.inf  # the time that weights in the sums refer to
        self._smoothing: Smoothing | None = None
        self._work: Iterator[None] = iter(())

    @property
    def nbytes(self) -> int:
        """Bytes of memory."""
        rings = self._raw, self._state, self._theta, self._target
        return sum(ring.nbytes for ring in rings) + self._sums.nbytes

    @property
    def samples(self) -> int:
        """The number of samples in the window."""
        return self.count - self.first

    @property
    def rows(self) -> int:
        """The number of rows that they make."""
        return max(self.samples - self.settings.span + 1, 0)

    @property
    def begin(self) -> float:
        """The time of the first sample in the window [s]."""
        return float(self._raw.rows(self.first, self.first + 1)[0, 0])

    def flight(self) -> Flight:
        """The samples in the window, as one flight. Raises InputError where they are too few."""
        return self._flight(self._raw.rows(self.first, self.count))

    def _flight(self, raw: Array) -> Flight:
        thrust = raw[:, 5:] if self.pushed else None
        vehicle = self.settings.vehicle
        return Flight(raw[:, 0], raw[:, 1:3], raw[:, 3:5], vehicle, thrust=thrust)

    def push(self, sample: tuple[float, ...]) -> None:
        """Take one sample (t, x, y, vx, vy), with the thrust behind it where that is measured.

        It is later than the others.
        """
        if not self.count:
            self.pushed = len(sample) > 5
        held = min(self.first, self._sums.low * BLOCK)
        if self.count - held + SPARE > self._raw.capacity:
            self._grow()
        self._raw.put(self.count, np.array([sample if self.pushed else (*sample, 0.0, 0.0)]))
        self.count += 1
        oldest = sample[0] - (1.0 + EDGE) * self.settings.reach
        while self._raw.rows(self.first, self.first + 1)[0, 0] < oldest:
            self.first += 1
        if self._done + BLOCK + self.settings.span - 1 <= self.count:
            self._finish()
            self._work = self._absorbing(self._done, self._done + BLOCK)
            self._done += BLOCK
        next(self._work, None)

    def _finish(self) -> None:
        """Bring the last block into the sums, as far as it is not yet."""
        for _ in self._work:
            pass

    def _grow(self) -> None:
        """Twice the capacity; the rows from the first that is in the sums are kept."""
        capacity = 2 * self._raw.capacity
        if 2 * capacity * self.columns.size * 8 > STREAM_BYTES:
            raise InputError(
                f"a window of {self.settings.reach:g} s holds more than {self.samples} samples: "
                f"with {self.columns.size} columns too many to hold; make it shorter, or the "
                "grid coarser"
            )
        self._raw = self._raw.grown(capacity, self.first, self.count)
        low = min(self._sums.low * BLOCK, self._done)
        for name in ("_state", "_theta", "_target"):
            setattr(self, name, getattr(self, name).grown(capacity, low, self._done))

    def _absorbing(self, start: int, stop: int) -> Iterator[None]:
        """Make the samples of a block rows, and bring these into the sums, in small steps."""
        self._differentiate(start, stop)
        yield
        self._evaluate(start, stop)
        yield
        now = float(self._state.rows(stop - 1, stop)[0, 0])
        outgoing = self._sums.outgoing(self.first // BLOCK)
        leaving = [self._weighted(b * BLOCK, (b + 1) * BLOCK, now) for b in outgoing]
        decay = float(self.settings.weight(now - self._reference)) if self._sums.high else 1.0
        self._sums.enter(self._weighted(start, stop, now), leaving, decay)
        self._reference = now
        yield
        while self._sums.advance():
            yield

    def _differentiate(self, start: int, stop: int) -> None:
        """Work out states, rates and targets of the rows from ``start`` up to ``stop``."""
        span = self.settings.span
        early = min(start, max(0, MINIMUM_SAMPLES - (stop - start + span - 1)))
        flight = self._flight(self._raw.rows(start - early, stop + span - 1))
        samples = self.settings.derivative(flight)
        self._smoothing = samples.smoothing
        thrust = np.zeros_like(samples.position) if samples.thrust is None else samples.thrust
        pairs = samples.position, samples.velocity, samples.position_rate, samples.acceleration
        self._state.put(start, np.column_stack([samples.time, *pairs, thrust])[early:])
        target = self.settings.library.response(samples, self.settings.vehicle)
        self._target.put(start, target[early:])

    def _evaluate(self, start: int, stop: int) -> None:
        """The columns of the rows from ``start`` up to ``stop``."""
        position = self._state.rows(start, stop)[:, 1:3]
        self._theta.put(start, self.columns.at(position))

    def _weighted(self, start: int, stop: int, now: float) -> tuple[Array, Array]:
        """Rows of theta and target, times the roots of their weights at a time [s]."""
        theta, target = self._theta.rows(start, stop), self._target.rows(start, stop)
        if not self.settings.fades:
            return theta, target
        root = np.sqrt(self.weights(start, stop, now))[:, None]
        return root * theta, root * target

    def weights(self, start: int, stop: int, now: float) -> Array:
        """The weights of rows at a time [s]."""
        return self.settings.weight(now - self._state.rows(start, stop)[:, 0])

    def complete(self) -> Samples:
        """A copy of the samples that whole blocks have made."""
        return self._samples(self._state.rows(min(self.first, self._done), self._done).copy())

    def contents(self) -> Contents:
        """The rows that the window holds now; there must be one at least."""
        self._finish()
        start, stop = self.first, self.count - self.settings.span + 1
        if stop > self._done:
            self._differentiate(self._done, stop)
            self._evaluate(self._done, stop)
        state = self._state.rows(start, stop)
        now = float(state[-1, 0])
        low, high = self._sums.low * BLOCK, self._done
        less = self._weighted(low, max(low, min(start, high)), now)
        more = self._weighted(min(max(start, high), stop), stop, now)
        decay = float(self.settings.weight(now - self._reference)) if high > low else 1.0
        gram, cross, square = self._sums.total(more, less, decay)
        theta, target = self._theta.rows(start, stop), self._target.rows(start, stop)
        smoothing, fading = self._smoothing, None
        if self.settings.fades:
            weights = self.weights(start, stop, now)
            mass = float(weights.sum()) / len(weights)
            gram, cross, square = gram / mass, cross / mass, square / mass
            fading, smoothing = np.sqrt(weights / mass), None
            theta, target = fading[:, None] * theta, fading[:, None] * target
        statistics = Statistics.summed(gram, cross, square, count=len(theta))
        samples = replace(self._samples(state), smoothing=smoothing)
        return Contents(samples, theta, target, statistics, fading)

    def _samples(self, state: Array) -> Samples:
        """The samples of states (m, 11)."""
        position, velocity, position_rate, acceleration, thrust = np.split(state[:, 1:], 5, axis=1)
        return Samples(
            state[:, 0],
            position,
            velocity,
            position_rate,
            acceleration,
            thrust=thrust if self.pushed else None,
        )
