"""The iterated smoother: trajectory, parameters and levels climb the likelihood together.

A pass linearises the motion along the last track, filters forward and smooths backward, which is
one Gauss-Newton step on trajectory and parameters together (Bell 1994, SIAM J. Optim. 4, 626).
Levels move in the same passes (`levels`). The process noise comes down from a level at which
every start converges; the first passes see few rows. Where it ends at nothing, a short ladder
looks for a higher maximum above.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.likelihood.levels import LevelSteps
from sparsefit.likelihood.model import ELEMENTS, StateSpace
from sparsefit.likelihood.nodes import Smoothed
from sparsefit.likelihood.trellis import Leg, Pass

SHARED = ("gain", "growth")  # by the logs of one flow, beside its pattern


COARSE = 200  # rows of a log that the first passes see
PHASE = 0.25  # of the flow's waves [rad] in the largest step of the motion
ANNEAL = 1.0  # process noise that the search starts from, in |w|/tau per sqrt(|k| |w|)
PASSES = 30  # at most, on few rows and on all
GAIN = 0.005  # of the log-likelihood, that a last pass may still bring
LIFTS = 2  # times that the search may start again with ten times the process noise
NEGLIGIBLE = 0.01  # degrees of freedom that a level may take and count as zero
GATE = 4.5  # deviations beyond which a reading is left out
OUTLIERS = 0.2  # the largest share of readings that may be left out
SORTING = 8  # passes after which no reading is left out or taken in any more
EXACT = 1e-6  # of the flow's length and velocity: noise below it counts as none
DEPENDENT = 1e-11  # the least eigenvalue of the scaled information of an observable model


@dataclass(frozen=True, eq=False)
class Step:
    """One pass of all logs, forward and, where it was wanted, backward.

    Args:
        passes: the forward passes.
        places: per log, the places of its parameters among all.
        value: the log-likelihood at the start.
        gain: that the step should gain.
        change: of the free parameters (p,).
        information: of the free parameters (p, p).
        covariance: its inverse, where it has one.
        levels: per log, the average information of the logarithms of the variances (l, l).
        blind: the names that the logs cannot tell from each other, if any.
    """

    passes: tuple[Pass, ...]
    places: list[list[int]]
    value: float
    gain: float
    change: Array
    information: Array
    covariance: Array
    levels: list[Array]
    blind: tuple[str, ...]

    @classmethod
    def of(cls, legs: Sequence[Leg], *, keep: bool = True) -> Step:
        """Filter all logs, and solve for the change of the free parameters."""
        local = legs[0].model.names
        names, places = joined(local, len(legs))
        passes, p = tuple(leg.forward(local, keep=keep) for leg in legs), len(local)
        score, information = summed(passes, places)
        covariance, blind = inverted(information)
        change, levels = covariance @ score, []
        for each, place in zip(passes, places, strict=True):
            cross = each.information[p:, :p]
            known = cross @ covariance[np.ix_(place, place)] @ cross.T
            levels.append(0.5 * (each.information[p:, p:] - known))
        value, gain = float(sum(each.value for each in passes)), 0.5 * float(score @ change)
        unseen = tuple(names[j] for j in blind)
        return cls(
            passes, places, value, gain, change, information, covariance, levels, unseen
        )  # fmt: skip

    @property
    def legs(self) -> tuple[Leg, ...]:
        """The logs, where the step was linearised."""
        return tuple(each.leg for each in self.passes)

    @property
    def reached(self) -> float:
        """The log-likelihood after the step, to second order."""
        return self.value + self.gain

    def smoothed(self) -> tuple[Smoothed, ...]:
        """The backward passes."""
        pairs = zip(self.passes, self.places, strict=True)
        return tuple(each.backward(self.change[place]) for each, place in pairs)

    def moved(
        self,
        smoothed: tuple[Smoothed, ...],
        share: float = 1.0,
        levels: list[Array] | None = None,
    ) -> tuple[Leg, ...]:
        """The legs after a share of the step of tracks, parameters and logarithms of variances."""
        moved = []
        for i, (leg, each) in enumerate(zip(self.legs, smoothed, strict=True)):
            steps = zip(leg.model.names, share * self.change[self.places[i]], strict=True)
            model = leg.model.at({name: leg.model.values[name] + step for name, step in steps})
            if levels is not None:
                pairs = zip(model.disturbance.levels.items(), levels[i].tolist(), strict=True)
                new = {name: level * math.exp(0.5 * share * e) for (name, level), e in pairs}
                model = replace(model, disturbance=model.disturbance.at(new))
            track = leg.track + share * (each.track - leg.track)
            moved.append(replace(leg, model=model, track=track, last=each))
        return tuple(moved)


@dataclass(frozen=True)
class Ascent:
    """The way up: all that does not change from pass to pass.

    Args:
        wanted: the places of the levels that are estimated.
        floors: per log, standard deviations (l,) that no level goes below.
    """

    wanted: list[int]
    floors: tuple[Array, ...]

    def climbed(
        self, start: tuple[Leg, ...], hold: int, most: int = PASSES
    ) -> tuple[Step, tuple[Smoothed, ...], int, str]:
        """Pass after pass while the likelihood rises.

        Args:
            start: the legs where the search starts.
            hold: the passes before the levels of the instruments move.
            most: passes.

        Returns:
            The last pass that was accepted, forward and backward, the number of passes, and the
            reason why the search did not converge.
        """
        legs, reason, halvings, lifts, fresh = start, "", 0, 0, True
        scouts = self._scouts(hold)
        history: list[float] = []
        best: tuple[Step, tuple[Smoothed, ...], list[Array]] | None = None
        count = 0
        while count < most:
            count += 1
            step = Step.of(legs)
            fallen = best is not None and not fresh and step.reached < best[0].reached - 1.0
            if fallen or not math.isfinite(step.reached):
                if best is not None and halvings < 4:
                    halvings += 1
                    legs = self._placed(best[0].moved(best[1], 0.5**halvings, best[2]))
                    continue
                if lifts == LIFTS:
                    reason = "the likelihood cannot be raised from where the search started"
                    break
                legs = tuple(
                    noisier(leg, max(10.0 * leg.model.disturbance.acceleration, 0.01))
                    for leg in (legs if best is None else best[0].legs)
                )
                best, lifts, halvings, fresh, scouts = None, lifts + 1, 0, True, self._scouts(hold)
                continue
            halvings, smoothed = 0, step.smoothed()
            fresh = len(history) < SORTING and self._gated(legs, smoothed)
            history.append(step.reached)
            moves = [
                scout.change(list(leg.model.disturbance.levels.values()), each.squares, levels)
                for scout, leg, each, levels in zip(
                    scouts, legs, smoothed, step.levels, strict=True
                )
            ]
            best = step, smoothed, [change for change, _ in moves]
            gains = sum(gain for _, gain in moves)
            enough = GAIN * (30.0 if legs[0].stride > 1 else 1.0)
            level = len(history) > 6 and max(history[-4:]) - history[-7] < 10.0 * enough
            if not fresh and step.gain < enough and (gains < enough or level):
                break
            legs = self._placed(step.moved(smoothed, 1.0, best[2]))
        else:
            reason = f"not at the maximum after {most} passes"
        if best is None:  # the tracks as they were
            nothing = tuple(
                Smoothed(leg.track, np.zeros((len(leg.track) + 1, 2 * leg.track.shape[1])),
                         np.full((len(leg.track), 12), np.nan), np.zeros((len(floor), 2)))
                for leg, floor in zip(step.legs, self.floors, strict=True)
            )  # fmt: skip
            still = replace(step, value=-math.inf, gain=0.0, change=np.zeros_like(step.change))
            return still, nothing, count, reason
        if best[0].blind and not reason:
            *others, final = best[0].blind
            reason = f"the log cannot tell {', '.join(others)} from {final}" if others else (
                f"the log does not see {final}"
            )  # fmt: skip
        return best[0], best[1], count, reason

    def _scouts(self, hold: int) -> list[LevelSteps]:
        """Steps of the levels of each log, far from the optimum."""
        return [LevelSteps(self.wanted, floors, NEGLIGIBLE, hold) for floors in self.floors]

    def _placed(self, legs: tuple[Leg, ...]) -> tuple[Leg, ...]:
        """The legs on nodes of their latency, where that may have moved."""
        if "latency" not in legs[0].model.names:
            return legs
        return tuple(leg.again(PHASE, leg.stride) for leg in legs)

    def _gated(self, legs: tuple[Leg, ...], smoothed: tuple[Smoothed, ...]) -> bool:
        """Leave readings out that all others contradict, take in those that they bear out.

        Returns:
            Whether any weight changed.
        """
        changed = False
        for leg, each in zip(legs, smoothed, strict=True):
            nodes, far = leg.nodes, np.abs(each.scores[:, 4:8])
            if not far.max() > GATE and ((nodes.weights > 0.0) == nodes.seen).all():
                continue
            if np.median(far[nodes.weights > 0.0]) > 0.85:
                continue  # a normal one's is .67: there is no model yet
            noise = np.sqrt(StateSpace.of(leg.model).noise.sum(axis=0))
            away = np.abs(nodes.measured - each.track[:, :4]) / noise
            out = (nodes.weights == 0.0) & (away > GATE)
            out = nodes.seen & (out | (far > max(GATE, 0.3 * float(far.max()))))
            if out.sum() <= OUTLIERS * nodes.seen.sum():
                weights = np.where(nodes.seen & ~out, 1.0, 0.0)
                changed |= bool((weights != nodes.weights).any())
                nodes.weights[:] = weights
        return changed


def noisier(leg: Leg, level: float) -> Leg:
    """The leg with at least this process noise."""
    return leg.at({"acceleration": max(level, leg.model.disturbance.acceleration)})


def joined(names: Sequence[str], count: int) -> tuple[tuple[str, ...], list[list[int]]]:
    """The names of parameters of several logs, and the places of each log's among them."""
    every, places = list(names), []
    for number in range(1, count + 1):
        suffix = f"@{number}" if number > 1 else ""
        local = [f"{n}{suffix}" if n in ELEMENTS and n not in SHARED else n for n in names]
        every += [name for name in local if name not in every]
        places.append([every.index(name) for name in local])
    return tuple(every), places


def summed(passes: Sequence[Pass], places: Sequence[list[int]]) -> tuple[Array, Array]:
    """The score (p,) and information (p, p) of parameters of all logs."""
    size, p = 1 + max((max(place, default=-1) for place in places), default=-1), len(places[0])
    score, information = np.zeros(size), np.zeros((size, size))
    for each, place in zip(passes, places, strict=True):
        score[place] += each.score[:p]
        information[np.ix_(place, place)] += each.information[:p, :p]
    return score, information


def inverted(information: Array) -> tuple[Array, IntArray]:
    """The inverse of an information matrix (p, p), and which parameters it leaves unknown."""
    if not len(information) or not np.isfinite(information).all():
        return np.full_like(information, np.nan), np.zeros(0, dtype=np.intp)
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(information / scale / scale[:, None])
    blind = values < DEPENDENT
    unseen = np.flatnonzero((np.abs(vectors[:, blind]) > 0.2).any(axis=1))
    half = vectors[:, ~blind] / np.sqrt(values[~blind]) / scale[:, None]
    return half @ half.T, unseen
