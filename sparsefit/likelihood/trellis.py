"""A log with a model and a track through its nodes, and one pass over it.

A pass filters forward and smooths backward, in blocks: the filter at the start of each is stored,
and every block but the last is filtered once more in the backward pass.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.likelihood.model import Model
from sparsefit.likelihood.nodes import FlightLog, Nodes, Smoothed
from sparsefit.likelihood.reference import SHAPING, StateSpace, width

passes: Any
try:
    passes = importlib.import_module("sparsefit.likelihood.passes")
except ImportError:  # no compiler where the package was installed
    passes = importlib.import_module("sparsefit.likelihood.reference")

BLOCK = 8192  # nodes whose passes are stored at once
PHASE = 0.25  # of the flow's waves [rad] in the largest step of the motion, twice in a rough one


@dataclass(frozen=True, eq=False)
class Leg:
    """One log during the search for the optimum.

    Args:
        log: the readings.
        model: at the values and levels reached; phases count from the origin of the nodes.
        nodes: of every `stride`-th row.
        track: the states (m, n) at the nodes, which the motion is linearised along.
        last: the last backward pass on these nodes, if any.
        stride: of the rows.
        rough: whether steps are as long as noise hides (`longest_step`).
    """

    log: FlightLog
    model: Model
    nodes: Nodes
    track: Array
    last: Smoothed | None = None
    stride: int = 1
    rough: bool = False

    @classmethod
    def of(
        cls,
        log: FlightLog,
        model: Model,
        stride: int = 1,
        path: tuple[Array, Array] | None = None,
        *,
        rough: bool = False,
    ) -> Leg:
        """Place the nodes of a log, further apart if rows are left out, and a track on them.

        path: times (k,) and states (k, 4 or more) of an earlier track; None: the readings.
        """
        longest = 2.0 * longest_step(log, model) if stride > 1 else longest_step(log, model, rough)
        nodes = Nodes.of(log, model.pattern.origin, longest, model.values["latency"], stride)
        near = nodes.track()
        if path is not None:
            near = np.column_stack([np.interp(nodes.time, path[0], own) for own in path[1].T])
        return cls(log, model, nodes, _widened(near, model), None, stride, rough)

    def again(self, stride: int) -> Leg:
        """The leg on the nodes of another stride or of a changed latency."""
        path = self.nodes.time, self.track
        leg = Leg.of(self.log, self.model, stride, path, rough=self.rough)
        if not np.array_equal(leg.nodes.seen, self.nodes.seen):
            return leg
        nodes = replace(leg.nodes, weights=self.nodes.weights.copy())
        return replace(leg, nodes=nodes, last=self.last)

    def with_model(self, model: Model) -> Leg:
        """The leg under another model of the same flow; new states are 0."""
        return replace(self, model=model, track=_widened(self.track, model), last=None)

    def forward(self, names: Sequence[str], *, keep: bool = True, block: int = 0) -> Pass:
        """Filter the log; keep: whether a backward pass follows.

        names: the parameters (p,) by which the score and the information are wanted; block: of the
        nodes that are stored at once, 0: `BLOCK`.
        """
        (m, n), last, block = self.track.shape, self.last, block or BLOCK
        space = self.model.space(names, self.track)
        own = n + 1 + len(names)  # columns of P, delta and V
        rows = np.zeros((n, own + (len(space.kicks) if last else 0)))
        rows[:, :n] = np.diag(space.spread.sum(axis=0))
        rows[range(4), range(4)] += self.log.spread
        rows[4:, n] = -self.track[0, 4:]  # walkers start about 0
        if last is not None:
            rows[:, own:] = (space.spread * last.adjoint[0, :n]).T
        sums, total, stored = np.zeros((len(rows.T) - n,) * 2), 0.0, None
        starts, course = list[Array](), list[Array]()
        for first in range(0, m, block):
            starts.append(rows[:, :own].copy())
            end = min(first + block, m)
            if keep and end == m:
                stored = np.empty((end - first, width(n, len(names))))
            total += passes.forward(
                space, self.nodes, self.track, first, end, last, rows, sums, stored
            )
            course.append(sums[1:].copy())
        value = -0.5 * (float(sums[0, 0]) + total)
        score, information = -sums[1:, 0], sums[1:, 1:]
        return Pass(self, space, value, score, information, course, starts, stored, block)

    def corrections(self, names: Sequence[str], own: Pass) -> Iterator[tuple[int, float, float]]:
        """Corrections of b and J by the elements that shape the innovations' variance S.

        b = sum G'e/S is the derivative of log L at a constant S. What wanders reaches the log
        through vehicle and instruments, so that S depends on their elements, too: the values of
        two passes beside the own one give the derivatives of log L itself.

        Yields:
            The place of an element among names, the correction of b and that of J, 0 or more.
        """
        shaping = SHAPING if self.model.processes else ()
        for place in (place for place, name in enumerate(names) if name in shaping):
            name, curvature = names[place], float(own.information[place, place])
            step = 1.0 / math.sqrt(curvature) if curvature > 0.0 else math.nan
            beside = (self.model.values[name] + step, self.model.values[name] - step)
            models = (self.model.at({name: value}) for value in beside)
            up, down = (self.with_model(each).forward((), keep=False).value for each in models)
            slope, bend = 0.5 * (up - down) / step, (2.0 * own.value - up - down) / step**2
            if math.isfinite(slope) and math.isfinite(bend):
                yield place, slope - float(own.score[place]), max(bend - curvature, 0.0)


@dataclass(frozen=True, eq=False)
class Pass:
    """A forward pass, with the data for a backward pass.

    Args:
        leg: that was filtered.
        space: its model.
        value: the log-likelihood at dtheta = 0.
        score: b (p + l,) by the parameters, and by the levels where a last pass gave them.
        information: J (p + l, p + l).
        course: -b and J (p + l, 1 + p + l) of all nodes up to the end of each block.
        starts: P, delta and V (n, n + 1 + p) at the first node of each block.
        stored: what the backward pass reads of the last block.
        block: the nodes of one.
    """

    leg: Leg
    space: StateSpace
    value: float
    score: Array
    information: Array
    course: list[Array]
    starts: list[Array]
    stored: Array | None
    block: int

    def backward(self, change: Array) -> Smoothed:
        """Smooth, with the parameters changed by `change` (p,)."""
        space, nodes, track, stored = self.space, self.leg.nodes, self.leg.track, self.stored
        (m, n), p, levels = track.shape, len(change), len(space.kicks)
        carried, sums = np.zeros((1 + n, n)), np.zeros((len(self.starts), n + 4, 2))
        adjoint, scores = np.zeros((m + 1, 2 * n)), np.empty((m, 12))
        squares, parts = np.zeros((levels, 2)), sums[:, :n]
        result = Smoothed(track.copy(), adjoint, scores, squares, parts)
        for number in range(len(self.starts) - 1, -1, -1):
            first = number * self.block
            end = min(first + self.block, m)
            if stored is None:  # the block once more, without the levels' columns
                rows, rest = self.starts[number].copy(), np.zeros((1 + p, 1 + p))
                stored = np.empty((end - first, width(n, p)))
                passes.forward(space, nodes, track, first, end, None, rows, rest, stored)
            step = np.append(1.0, change)
            passes.backward(space, nodes, first, end, step, stored, carried, result, sums[number])
            stored = None
        initial = np.column_stack([result.adjoint[0, :n] ** 2, np.diag(carried[1:])])
        parts *= 0.5 * space.kicks.sum(axis=0)[:, None]
        noise = (space.noise > 0.0) @ sums[:, n:].sum(axis=0)
        kicked = (space.kicks > 0.0) @ parts.sum(axis=0)
        squares += kicked + 0.5 * (space.spread @ initial + noise)
        return result


def longest_step(log: FlightLog, model: Model, rough: bool = False) -> float:
    """The step [s] in which waves turn by `PHASE`, if by less than half a turn between rows.

    rough: whether it may be up to twice that, its error (of fourth order) as the log's noise.
    """
    size, tau = float(np.hypot(*model.pattern.waves[:, :2].T).max()), model.values["response_time"]
    slaved = log.interval > tau  # what the vehicle does within its response time is not seen
    hidden = min(max(2.0 * (log.noise[1] / log.speed) ** 0.25, PHASE), 2.0 * PHASE)
    turn = (hidden if rough else PHASE) * max(1.0 / (size * log.speed), log.interval / math.pi)
    return min(turn, (1.5 if slaved else 0.5) * tau)


def _widened(track: Array, model: Model) -> Array:
    """A track (m, n) with the states of a model, new ones 0."""
    states = 4 + sum(len(process.elements) for process in model.processes)
    return np.pad(track[:, :states], ((0, 0), (0, max(states - track.shape[1], 0))))
