"""A log with a model and a track through its nodes, and one pass over it.

Nodes are the times of readings. Each has up to four (position x, y, velocity x, y); a missing one
has the weight 0. Positions with a latency have nodes of their own. Where readings are further apart
than the longest step of the motion, nodes without readings are inserted.

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

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError
from sparsefit.likelihood.model import Model
from sparsefit.likelihood.readings import FlightLog
from sparsefit.likelihood.reference import SHAPING, Smoothed, StateSpace, width

passes: Any
try:
    passes = importlib.import_module("sparsefit.likelihood.passes")
except ImportError:  # no compiler where the package was installed
    passes = importlib.import_module("sparsefit.likelihood.reference")

MOST_NODES = 64  # per row of the log; a log that needs more is refused
BLOCK = 8192  # nodes whose passes are stored at once
PHASE = 0.25  # of the flow's waves [rad] in the largest step of the motion, twice in a rough one


@dataclass(frozen=True, eq=False)
class Leg:
    """One log with a model and a track at its nodes, during the search for the optimum."""

    log: FlightLog
    model: Model  # at the values and levels reached; phases count from the origin of the nodes
    time: Array  # of the nodes (m,), from the origin [s]
    push: Array  # of the log at the nodes (m, 2) [m/s^2]
    measured: Array  # positions and velocities from the origin (m, 4), 0 where missing
    weights: Array  # of these (m, 4): 1, or 0 where missing or left out
    seen: BoolArray  # whether there is a reading (m, 4)
    track: Array  # the states (m, n) at the nodes, which the motion is linearised along
    last: Smoothed | None = None  # the last backward pass on these nodes, if any
    stride: int = 1  # of the rows
    rough: bool = False  # whether steps are as long as noise hides (`longest_step`)

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
        (*middle, start), rows = model.pattern.origin, slice(None, None, stride)
        place, speed, clock = log.position[rows] - middle, log.velocity[rows], log.time - start
        stamps = clock[rows]
        late = stamps - (model.values["latency"] if np.isfinite(speed).any() else 0.0)
        times = np.union1d(stamps, late)
        count = np.maximum(np.ceil(np.diff(times) / longest - 1e-9), 1.0).astype(np.intp)
        if count.sum() > MOST_NODES * len(stamps) + 1000:
            raise InputError(
                f"gaps of up to {np.diff(times).max():.3g} s are too long for motion that needs "
                f"steps of {longest:.3g} s; split the log there"
            )
        starts = np.concatenate([[0], np.cumsum(count)])
        within = np.arange(starts[-1]) - np.repeat(starts[:-1], count)
        steps = np.repeat(np.diff(times) / count, count)
        time = np.append(np.repeat(times[:-1], count) + within * steps, times[-1])
        measured, weights = np.zeros((2, len(time), 4))
        for channel, values, own in ((0, place, late), (2, speed, stamps)):
            nodes = starts[np.searchsorted(times, own)]
            measured[nodes, channel : channel + 2] = np.nan_to_num(values, nan=0.0)
            weights[nodes, channel : channel + 2] = np.isfinite(values)
        push = np.column_stack([np.interp(time, clock, each) for each in log.push.T])
        seen, track = weights > 0.0, np.zeros((len(time), 4))
        for channel, read in enumerate(seen.T):
            if read.any():
                track[:, channel] = np.interp(time, time[read], measured[read, channel])
            else:
                track[:, channel] = np.gradient(track[:, channel - 2], time)
        if path is not None:
            track = np.column_stack([np.interp(time, path[0], own) for own in path[1].T])
        track = _widened(track, model)
        return cls(log, model, time, push, measured, weights, seen, track, None, stride, rough)

    def again(self, stride: int) -> Leg:
        """The leg on the nodes of another stride or of a changed latency."""
        leg = Leg.of(self.log, self.model, stride, (self.time, self.track), rough=self.rough)
        if not np.array_equal(leg.seen, self.seen):
            return leg
        return replace(leg, weights=self.weights.copy(), last=self.last)

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
            total += passes.forward(space, self, first, end, rows, sums, stored)
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
    """A forward pass, with the data for a backward pass."""

    leg: Leg  # that was filtered
    space: StateSpace  # its model
    value: float  # the log-likelihood at dtheta = 0
    score: Array  # b (p + l,) by the parameters, and by the levels where a last pass gave them
    information: Array  # J (p + l, p + l)
    course: list[Array]  # -b and J (p + l, 1 + p + l) of all nodes up to the end of each block
    starts: list[Array]  # P, delta and V (n, n + 1 + p) at the first node of each block
    stored: Array | None  # what the backward pass reads of the last block
    block: int  # the nodes of one

    def backward(self, change: Array) -> Smoothed:
        """Smooth, with the parameters changed by `change` (p,)."""
        space, leg, track, stored = self.space, self.leg, self.leg.track, self.stored
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
                passes.forward(space, leg, first, end, rows, rest, stored)
            step = np.append(1.0, change)
            passes.backward(space, leg, first, end, step, stored, carried, result, sums[number])
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
    if track.shape[1] >= states:
        return np.ascontiguousarray(track[:, :states])
    return np.pad(track, ((0, 0), (0, states - track.shape[1])))
