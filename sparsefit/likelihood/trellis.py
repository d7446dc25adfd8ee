"""One pass over a log: the filter forward, the smoother backward, in blocks of bounded memory."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.likelihood.model import StateSpace
from sparsefit.likelihood.nodes import Nodes

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
        starts: the state at the first node of each block.
        stored: what the backward pass reads of the only block, where there is one only.
    """

    space: StateSpace
    nodes: Nodes
    track: Array
    value: float
    score: Array
    information: Array
    starts: tuple[Array, ...]
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
        n, p = track.shape[1], len(space.columns)
        levels = 0 if last is None else len(space.kicks)
        q = p + levels
        state = np.zeros((2 + q + n + q, max(n, q)))
        variance = space.spread.sum(axis=0)
        variance[:4] += spread
        state[1 + q : 1 + q + n, :n] = np.diag(variance)
        state[0, 4:n] = -track[0, 4:]  # walkers start about 0
        if last is not None:
            state[1 + p : 1 + q, :n] = space.spread * last.adjoint[0, :n]
        value, starts, stored = 0.0, [], None
        for first in range(0, len(nodes.time), BLOCK):
            starts.append(state.copy())
            whole = keep and len(nodes.time) <= BLOCK
            stored = np.empty((len(nodes.time), _width(n, p))) if whole else None
            value += _forward(space, nodes, track, first, state, stored, last)
        return cls(
            space, nodes, track, value, state[1 + q + n, :q].copy(),
            state[2 + q + n : 2 + q + n + q, :q].copy(), tuple(starts), stored,
        )  # fmt: skip

    def backward(self, change: Array) -> Smoothed:
        """Smooth, with the elements of the columns changed by `change` (p,)."""
        space, nodes, track = self.space, self.nodes, self.track
        (m, n), p = track.shape, len(space.columns)
        q = len(self.score)
        carried, noise = np.zeros((1 + n, n)), space.noise.sum(axis=0)
        smoothed, adjoint, scores = np.empty((m, n)), np.zeros((m + 1, 2 * n)), np.empty((m, 12))
        sums = np.zeros((n + 4, 2))
        for block in range(len(self.starts) - 1, -1, -1):
            first, stored = block * BLOCK, self.stored
            end = min(first + BLOCK, m)
            if stored is None:  # the states of the block once more, without the levels' columns
                stored = np.empty((end - first, _width(n, p)))
                state = np.zeros((2 + p + n + p, max(n, p)))
                start = self.starts[block]
                state[: 1 + p, :n] = start[: 1 + p, :n]
                state[1 + p : 1 + p + n, :n] = start[1 + q : 1 + q + n, :n]
                _forward(space, nodes, track, first, state, stored, None)
            passes.backward(
                space.rates, p, nodes.time[first : end + 1], nodes.weights[first:end], change,
                noise, stored, carried, smoothed[first:end], adjoint[first:end],
                scores[first:end], sums,
            )  # fmt: skip
        initial = np.column_stack([adjoint[0, :n] ** 2, np.diag(carried[1:])])
        squares = space.kicks @ sums[:n] + space.spread @ initial
        squares += (space.noise > 0.0) @ sums[n:]
        return Smoothed(track + smoothed, adjoint, scores, 0.5 * squares)


def _width(n: int, p: int) -> int:
    """The numbers that a node stores for the backward pass."""
    return n * (1 + p + n) + 4 * (2 * n + p + 2) + 4 * n


def _forward(
    space: StateSpace, nodes: Nodes, track: Array, first: int, state: Array,
    stored: Array | None, last: Smoothed | None,
) -> float:  # fmt: skip
    """Filter the block that begins at a node; the state goes on to the node after it."""
    end, n = min(first + BLOCK, len(nodes.time)), track.shape[1]
    adjoint = np.zeros((0, 2 * n)) if last is None else last.adjoint[first : end + 1]
    scores = np.zeros((0, 12)) if last is None else last.scores[first:end]
    value = passes.forward(
        space.elements, space.walkers, space.rates, space.columns, space.kicks, space.noise,
        nodes.time[first : end + 1], nodes.thrust[first : end + 1], nodes.measured[first:end],
        nodes.weights[first:end], track[first : end + 1], adjoint, scores, state, stored,
    )  # fmt: skip
    return float(value)


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A backward pass.

    Args:
        track: the states (m, n) given all readings.
        adjoint: r at each node and after it (m + 1, 2 n).
        scores: of the readings (m, 12): u, the residuals u/sqrt(D) of readings that are left out,
            the standardised innovations.
        squares: half the sum of r^2 and of its variance (l, 2), times the variance of each level:
            their difference is the derivative of the log-likelihood by its logarithm.
    """

    track: Array
    adjoint: Array
    scores: Array
    squares: Array

    @classmethod
    def empty(cls, space: StateSpace, track: Array) -> Smoothed:
        """Return the pass of a log that could not be filtered: the track as it was."""
        m, n = track.shape
        unseen = np.full((m, 12), np.nan)
        return cls(track, np.zeros((m + 1, 2 * n)), unseen, np.zeros((len(space.kicks), 2)))
