"""Flights in pieces: where a log has gaps, and what becomes of time steps that are not even.

A step much longer than the others is a gap: nothing is known within it, and no derivative is taken
across it. Within a piece uneven steps are made even: position by the cubic Hermite polynomial of
two neighbours, whose velocity is measured too, and velocity by a polynomial through six.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.derivative.steps import is_even

GAP = 4.0  # median steps: a polynomial through the samples carries over less
STENCIL = 6  # samples a velocity is interpolated from: as exact as the smoother's shortest window


@dataclass(frozen=True, eq=False)
class Pieces:
    """The samples of a flight, m of them, and where it is interrupted.

    Args:
        time: [s], (m,).
        position: [m], (m, 2).
        velocity: [m/s], (m, 2).
        starts: the first rows of all pieces but the first, (pieces - 1,).
        velocity_measured: whether the velocity tells more than the position.
    """

    time: Array
    position: Array
    velocity: Array
    starts: IntArray
    velocity_measured: bool = True

    @property
    def slices(self) -> list[slice]:
        """The rows of each piece."""
        ends = [0, *self.starts.tolist(), len(self.time)]
        return [slice(*pair) for pair in pairwise(ends)]

    def step(self) -> float:
        """The mean time step [s] within the pieces."""
        within = sum(float(self.time[p.stop - 1] - self.time[p.start]) for p in self.slices)
        return within / (len(self.time) - len(self.slices))

    def even(self) -> bool:
        """Whether the steps within the pieces are one and the same."""
        return is_even(self.time, self.step(), self.starts)

    def longer_than(self, samples: int) -> Pieces:
        """The pieces of at least so many samples; all of them where there is no such piece."""
        kept = [piece for piece in self.slices if piece.stop - piece.start >= samples]
        if len(kept) in (0, len(self.starts) + 1):
            return self
        rows = np.concatenate([np.arange(piece.start, piece.stop) for piece in kept])
        counts = [piece.stop - piece.start for piece in kept]
        arrays = self.time[rows], self.position[rows], self.velocity[rows]
        return Pieces(*arrays, _starts(counts), self.velocity_measured)

    def resampled(self) -> Pieces:
        """The same pieces on even steps, the mean one; each begins with its own first sample."""
        step = self.step()
        parts = [self._on_grid(piece, step) for piece in self.slices]
        time, position, velocity = map(np.concatenate, zip(*parts, strict=True))
        starts = _starts([len(part[0]) for part in parts])
        return Pieces(time, position, velocity, starts, self.velocity_measured)

    def _on_grid(self, piece: slice, step: float) -> tuple[Array, Array, Array]:
        time = self.time[piece]
        count = int((time[-1] - time[0]) / step + 1e-6) + 1
        grid = np.minimum(time[0] + step * np.arange(count), time[-1])
        position, velocity = self.position[piece], self.velocity[piece]
        return grid, hermite(time, position, velocity, grid), _interpolated(time, velocity, grid)


def cut(log: Pieces) -> Pieces:
    """The samples cut at their gaps: steps longer than `GAP` times the median one."""
    steps = np.diff(log.time)
    if steps.max() <= GAP * steps.min():
        return log
    return replace(log, starts=np.flatnonzero(steps > GAP * np.median(steps)) + 1)


def _starts(counts: list[int]) -> IntArray:
    """Where the pieces begin that have so many samples, but for the first."""
    starts: IntArray = np.cumsum(np.array(counts[:-1], dtype=np.intp))
    return starts


def straddling(starts: IntArray, width: int, rows: int) -> BoolArray:
    """Which of ``rows`` windows, the j-th of the samples j to j + width - 1, cross a gap."""
    crossing = np.zeros(rows, dtype=bool)
    for start in starts:
        crossing[max(start - width + 1, 0) : start] = True
    return crossing


def hermite(time: Array, position: Array, velocity: Array, at: Array) -> Array:
    """Positions (q, 2) at the times (q,) by the cubic through position and velocity beside them."""
    low = np.clip(np.searchsorted(time, at, side="right") - 1, 0, len(time) - 2)
    width = (time[low + 1] - time[low])[:, None]
    s = (at - time[low])[:, None] / width
    rest = 1.0 - s
    left = (1.0 + 2.0 * s) * position[low] + s * width * velocity[low]
    right = (1.0 + 2.0 * rest) * position[low + 1] - rest * width * velocity[low + 1]
    between: Array = rest**2 * left + s**2 * right
    return between


def _interpolated(time: Array, values: Array, at: Array) -> Array:
    """Values (q, 2) at the times (q,) by Lagrange's polynomial through the nearest samples."""
    width = min(STENCIL, len(time))
    first = np.searchsorted(time, at) - width // 2
    rows = np.clip(first, 0, len(time) - width)[:, None] + np.arange(width)
    nodes = time[rows] - at[:, None]
    weights = np.ones_like(nodes)
    for one in range(width):
        for other in range(width):
            if other != one:
                weights[:, one] *= nodes[:, other] / (nodes[:, other] - nodes[:, one])
    interpolated: Array = np.einsum("qw,qwc->qc", weights, values[rows])
    return interpolated
