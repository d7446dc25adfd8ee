"""A log with a model and a track through its nodes, and one pass over it.

A pass filters forward and smooths backward, in blocks: only the filter at the start of each is
stored, and what the way back needs of a block is filtered once more when it gets there.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.likelihood.model import Model, StateSpace
from sparsefit.likelihood.nodes import FlightLog, Nodes, Smoothed, State

passes: Any
try:
    passes = importlib.import_module("sparsefit.likelihood.passes")
except ImportError:  # no compiler where the package was installed
    passes = importlib.import_module("sparsefit.likelihood.reference")

BLOCK = 8192  # nodes whose passes are stored at once


@dataclass(frozen=True, eq=False)
class Leg:
    """One log on the way to the optimum.

    Args:
        log: the readings.
        model: at the values and levels reached; phases count from the origin of the nodes.
        nodes: of every `stride`-th row.
        track: the states (m, n) at the nodes, which the motion is linearised along.
        last: the last smoothed pass, of these nodes; None: none of use.
        stride: of the rows.
    """

    log: FlightLog
    model: Model
    nodes: Nodes
    track: Array
    last: Smoothed | None = None
    stride: int = 1

    @classmethod
    def of(
        cls,
        log: FlightLog,
        model: Model,
        phase: float,
        stride: int = 1,
        path: tuple[Array, Array] | None = None,
    ) -> Leg:
        """Place the nodes of a log, and a track on them.

        Args:
            log: the readings.
            model: of the log.
            phase: the largest step of the motion [rad], twice that where rows are left out.
            stride: of the rows.
            path: times (k,) and states (k, 4 or more) of an earlier track; None: the readings.
        """
        longest = longest_step(log, model, phase) * (1.0 + (stride > 1))
        nodes = Nodes.of(log, model.pattern.origin, longest, model.values["latency"], stride)
        near = nodes.track() if path is None else _between(*path, nodes.time)
        track = np.zeros((len(near), 4 + len(StateSpace.of(model).walkers)))
        width = min(track.shape[1], near.shape[1])
        track[:, :width] = near[:, :width]
        return cls(log, model, nodes, track, None, stride)

    def again(self, phase: float, stride: int) -> Leg:
        """The leg on the nodes of another stride, or of a latency that has moved."""
        leg = Leg.of(self.log, self.model, phase, stride, (self.nodes.time, self.track))
        if not np.array_equal(leg.nodes.rows, self.nodes.rows):
            return leg
        nodes = replace(leg.nodes, weights=self.nodes.weights.copy())
        return replace(leg, nodes=nodes, last=self.last)

    def at(self, levels: dict[str, float]) -> Leg:
        """The leg at other levels, of which no pass was made."""
        disturbance = self.model.disturbance.at(levels)
        return replace(self, model=replace(self.model, disturbance=disturbance), last=None)

    def with_model(self, model: Model) -> Leg:
        """The leg under another model of the same flow, what is new of its state about 0."""
        width = 4 + len(StateSpace.of(model).walkers)
        track = np.zeros((len(self.track), width))
        track[:, : self.track.shape[1]] = self.track[:, :width]
        return replace(self, model=model, track=track, last=None)

    def louder(self, height: float, name: str = "acceleration") -> Leg:
        """The leg with a level times exp(height)."""
        return self.at({name: self.model.disturbance.levels[name] * math.exp(height)})

    def forward(self, names: Sequence[str], *, keep: bool = True) -> Pass:
        """Filter the log; keep: whether a backward pass follows.

        names: the parameters (p,) by which the score and the information are wanted.
        """
        space = StateSpace.of(self.model, names)
        (m, n), p, last = self.track.shape, len(names), self.last
        state = State.of(n, p if last is None else p + len(space.kicks))
        state.covariance[:] = np.diag(space.spread.sum(axis=0))
        state.covariance[range(4), range(4)] += self.log.spread
        state.delta[4:] = -self.track[0, 4:]  # walkers start about 0
        if last is not None:
            state.sensitivity[:, p:] = (space.spread * last.adjoint[0, :n]).T
        value, starts = 0.0, []
        stored = np.empty((m, _width(n, p))) if keep and m <= BLOCK else None
        for first in range(0, m, BLOCK):
            carried = state.delta, state.sensitivity[:, :p], state.covariance
            starts.append(tuple(part.copy() for part in carried))
            end = min(first + BLOCK, m)
            value += passes.forward(space, self.nodes, self.track, first, end, last, state, stored)
        return Pass(self, space, value, state.score, state.information, tuple(starts), stored)


@dataclass(frozen=True, eq=False)
class Pass:
    """A forward pass, and what a backward one needs.

    Args:
        leg: that was filtered.
        space: its model.
        value: the log-likelihood at dtheta = 0.
        score: b (p + l,) by the parameters, and by the levels where a last pass gave them.
        information: J (p + l, p + l).
        starts: delta, V and P at the first node of each block.
        stored: what the backward pass reads of the only block, where there is one only.
    """

    leg: Leg
    space: StateSpace
    value: float
    score: Array
    information: Array
    starts: tuple[tuple[Array, ...], ...]
    stored: Array | None

    def backward(self, change: Array) -> Smoothed:
        """Smooth, with the parameters changed by `change` (p,)."""
        space, nodes, track, (m, n) = (
            self.space,
            self.leg.nodes,
            self.leg.track,
            self.leg.track.shape,
        )
        p, levels = len(change), len(space.kicks)
        carried, sums = np.zeros((1 + n, n)), np.zeros((n + 4, 2))
        result = Smoothed(
            track.copy(), np.zeros((m + 1, 2 * n)), np.empty((m, 12)), np.zeros((levels, 2))
        )
        for block in range(len(self.starts) - 1, -1, -1):
            first, stored = block * BLOCK, self.stored
            end = min(first + BLOCK, m)
            if stored is None:  # the block once more, without the levels' columns
                stored = np.empty((end - first, _width(n, p)))
                delta, sensitivity, covariance = (part.copy() for part in self.starts[block])
                state = State(delta, sensitivity, covariance, np.zeros(p), np.zeros((p, p)))
                passes.forward(space, nodes, track, first, end, None, state, stored)
            passes.backward(space, nodes, first, end, change, stored, carried, result, sums)
        initial = np.column_stack([result.adjoint[0, :n] ** 2, np.diag(carried[1:])])
        squares = space.kicks @ sums[:n] + space.spread @ initial + (space.noise > 0.0) @ sums[n:]
        result.squares[:] = 0.5 * squares
        return result


def longest_step(log: FlightLog, model: Model, phase: float) -> float:
    """The step [s] in which the flow's waves turn by a phase [rad] at the speed of a log."""
    size, tau = float(np.hypot(*model.pattern.waves[:, :2].T).max()), model.values["response_time"]
    slaved = log.interval > tau  # what the vehicle does within its response time is not seen
    return min(phase / (size * log.speed), (1.5 if slaved else 0.5) * tau)


def _between(old: Array, track: Array, new: Array) -> Array:
    """A track (m, n) at other times, by cubics through values and slopes; straight beyond it."""
    slope = np.gradient(track, old, axis=0)
    slope[:, :2] = track[:, 2:4]
    inside = np.clip(new, old[0], old[-1])
    first = np.clip(np.searchsorted(old, inside, side="right") - 1, 0, len(old) - 2)
    step = (old[first + 1] - old[first])[:, None]
    u = (inside - old[first])[:, None] / step
    start, end = track[first], track[first + 1]
    leaving, coming = step * slope[first] - (end - start), (end - start) - step * slope[first + 1]
    between: Array = start + u * (end - start) + u * (1.0 - u) * ((1.0 - u) * leaving + u * coming)
    between[:, :2] += (new - inside)[:, None] * between[:, 2:4]
    return between


def _width(n: int, p: int) -> int:
    """The numbers that a node stores for the backward pass."""
    return n * (1 + p + n) + 4 * (2 * n + p + 2) + 4 * n
