"""One pass over a log: the filter forward, the smoother backward, in blocks of bounded memory.

Only the state at the start of each block is stored; what the way back needs of a block is filtered
once more when it gets there.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.likelihood.model import StateSpace
from sparsefit.likelihood.nodes import Nodes, Smoothed, State

passes: Any
try:
    passes = importlib.import_module("sparsefit.likelihood.passes")
except ImportError:  # no compiler where the package was installed
    passes = importlib.import_module("sparsefit.likelihood.reference")

BLOCK = 2048  # nodes whose passes are stored at once


@dataclass(frozen=True, eq=False)
class Pass:
    """A forward pass, and what a backward one needs.

    Args:
        space: the model.
        nodes: the readings.
        track: s-bar (m, n) [m, m/s], that the motion is linearised along.
        value: the log-likelihood at dtheta = 0.
        score: b (q,) by the columns and the levels.
        information: J (q, q).
        starts: delta, V and P at the first node of each block.
        stored: what the backward pass reads of the only block, where there is one only.
    """

    space: StateSpace
    nodes: Nodes
    track: Array
    value: float
    score: Array
    information: Array
    starts: tuple[tuple[Array, Array, Array], ...]
    stored: Array | None

    @classmethod
    def forward(
        cls,
        space: StateSpace,
        nodes: Nodes,
        track: Array,
        spread: Array,
        last: Smoothed | None = None,
        *,
        keep: bool = True,
    ) -> Pass:
        """Filter a log.

        Args:
            space: the model.
            nodes: the readings.
            track: s-bar (m, n).
            spread: the variance of the first position and velocity (4,), beside the walkers'.
            last: the last smoothed pass, for the columns of the levels.
            keep: whether a backward pass follows.
        """
        (m, n), p = track.shape, len(space.columns)
        state = State.of(n, p if last is None else p + len(space.kicks))
        variance = space.spread.sum(axis=0)
        variance[:4] += spread
        state.covariance[:] = np.diag(variance)
        state.delta[4:] = -track[0, 4:]  # walkers start about 0
        if last is not None:
            state.sensitivity[:, p:] = (space.spread * last.adjoint[0, :n]).T
        value, starts = 0.0, []
        stored = np.empty((m, _width(n, p))) if keep and m <= BLOCK else None
        for first in range(0, m, BLOCK):
            starts.append((state.delta.copy(), state.sensitivity[:, :p].copy(),
                           state.covariance.copy()))  # fmt: skip
            end = min(first + BLOCK, m)
            value += passes.forward(space, nodes, track, first, end, last, state, stored)
        score, information = state.score, state.information
        return cls(space, nodes, track, value, score, information, tuple(starts), stored)

    def backward(self, change: Array) -> Smoothed:
        """Smooth, with the elements of the columns changed by `change` (p,)."""
        space, nodes, (m, n) = self.space, self.nodes, self.track.shape
        p = len(space.columns)
        carried, sums = np.zeros((1 + n, n)), np.zeros((n + 4, 2))
        result = Smoothed(
            self.track.copy(), np.zeros((m + 1, 2 * n)), np.empty((m, 12)),
            np.zeros((len(space.kicks), 2)),
        )  # fmt: skip
        for block in range(len(self.starts) - 1, -1, -1):
            first, stored = block * BLOCK, self.stored
            end = min(first + BLOCK, m)
            if stored is None:  # the states of the block once more, without the levels' columns
                stored = np.empty((end - first, _width(n, p)))
                delta, sensitivity, covariance = (part.copy() for part in self.starts[block])
                state = State(delta, sensitivity, covariance, np.zeros(p), np.zeros((p, p)))
                passes.forward(space, nodes, self.track, first, end, None, state, stored)
            passes.backward(space, nodes, first, end, change, stored, carried, result, sums)
        initial = np.column_stack([result.adjoint[0, :n] ** 2, np.diag(carried[1:])])
        result.squares[:] = space.kicks @ sums[:n] + space.spread @ initial
        result.squares[:] += (space.noise > 0.0) @ sums[n:]
        result.squares[:] *= 0.5
        return result


def _width(n: int, p: int) -> int:
    """The numbers that a node stores for the backward pass."""
    return n * (1 + p + n) + 4 * (2 * n + p + 2) + 4 * n
