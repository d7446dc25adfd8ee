"""The iterated smoother: it maximises the likelihood over trajectory, parameters and levels.

A pass linearises the motion along the last track, filters forward and smooths backward, which is
one Gauss-Newton step on trajectory and parameters together (Bell 1994, SIAM J. Optim. 4, 626).

Levels move in the same passes. With the derivative of log L by the logarithm of a variance written
as a - n, a = sum r^2/2 of what was smoothed and n its expectation, a variance moves far from the
optimum by a secant on log(a/n), near it by scoring with the average information (Gilmour, Thompson
and Cullis 1995, Biometrics 51, 1440), linear in the variances, so that a level that falls to
nothing takes the others with it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.likelihood.pattern import StreamPattern
from sparsefit.likelihood.reference import ELEMENTS, Smoothed
from sparsefit.likelihood.trellis import Leg, Pass

SHARED = ("gain", "growth")  # by the logs of one flow, beside its pattern
INSTRUMENTS = (1, 2)  # the places of the levels of position and velocity; 0 is process noise
PASSES = 30  # at most, on few rows and on all
GAIN = 0.005  # of the log-likelihood in a pass, below which the search has converged
NEGLIGIBLE = 0.01  # degrees of freedom of a level that counts as zero
GATE = 4.5  # deviations beyond which a reading is left out
OUTLIERS = 0.2  # the largest share of readings that may be left out
HOPE = 5  # times the gain of a pass: what a search may still gain
SORTING = 8  # passes after which the choice of readings is fixed
DEPENDENT = 1e-11  # the least eigenvalue of the scaled information of an observable model


@dataclass(frozen=True, eq=False)
class Step:
    """One pass of all logs, and the Gauss-Newton step from there."""

    passes: tuple[Pass, ...]  # the forward passes
    names: tuple[str, ...]  # of the free parameters (p,); "tau@2" is that of the second log
    places: list[list[int]]  # per log, the places of its parameters among all
    score: Array  # b (p,)
    information: Array  # J (p, p)
    covariance: Array  # its inverse, where it has one
    blind: tuple[str, ...]  # the names of parameters that are not separately observable, if any

    @classmethod
    def of(cls, legs: Sequence[Leg], names: Sequence[str] = (), *, keep: bool = True) -> Step:
        """Filter all logs; names: of parameters beside those that are free."""
        own = tuple(dict.fromkeys((*legs[0].model.names, *names)))
        every, places, p = list(own), [], len(own)
        for number in range(1, len(legs) + 1):
            suffix = f"@{number}" if number > 1 else ""
            local = [f"{n}{suffix}" if n in ELEMENTS and n not in SHARED else n for n in own]
            every += [name for name in local if name not in every]
            places.append([every.index(name) for name in local])
        passes = tuple(leg.forward(own, keep=keep) for leg in legs)
        score, information = np.zeros(len(every)), np.zeros((len(every), len(every)))
        for leg, each, place in zip(legs, passes, places, strict=True):
            score[place] += each.score[:p]
            information[np.ix_(place, place)] += each.information[:p, :p]
            for number, slope, bend in leg.corrections(own, each):
                score[place[number]] += slope
                information[place[number], place[number]] += bend
        covariance, blind = inverted(information)
        unseen = tuple(every[j] for j in blind)
        return cls(passes, tuple(every), places, score, information, covariance, unseen)

    @property
    def change(self) -> Array:
        """The step of the parameters (p,)."""
        change: Array = self.covariance @ self.score
        return change

    @property
    def gain(self) -> float:
        """The predicted gain of the log-likelihood by the step."""
        return 0.5 * float(self.score @ self.change)

    @property
    def reached(self) -> float:
        """The log-likelihood after the step, to second order; -inf where it is no number."""
        value = float(sum(each.value for each in self.passes)) + self.gain
        return value if math.isfinite(value) else -math.inf

    @property
    def levels(self) -> list[Array]:
        """Per log, the average information of the logarithms of the variances (l, l)."""
        levels = []
        for each, place in zip(self.passes, self.places, strict=True):
            cross, p = each.information[len(place) :, : len(place)], len(place)
            along = cross @ self.covariance[np.ix_(place, place)] @ cross.T
            levels.append(0.5 * (each.information[p:, p:] - along))
        return levels

    def smoothed(self) -> tuple[Smoothed, ...]:
        """The backward passes."""
        pairs = zip(self.passes, self.places, strict=True)
        return tuple(each.backward(self.change[place]) for each, place in pairs)

    def moved(
        self,
        smoothed: tuple[Smoothed, ...],
        share: float = 1.0,
        levels: Sequence[Array] | None = None,
    ) -> tuple[Leg, ...]:
        """The logs after a share of the step of tracks, parameters and logarithms of variances."""
        moved = []
        for i, (leg, each) in enumerate(zip((p.leg for p in self.passes), smoothed, strict=True)):
            steps = zip(leg.model.names, share * self.change[self.places[i]], strict=True)
            values = {name: leg.model.values[name] + step for name, step in steps}
            if levels is not None:
                pairs = zip(leg.model.levels.items(), levels[i].tolist(), strict=True)
                values |= {name: level * math.exp(0.5 * share * e) for (name, level), e in pairs}
            track = leg.track + share * (each.track - leg.track)
            moved.append(replace(leg, model=leg.model.at(values), track=track, last=each))
        return tuple(moved)


def climbed(
    legs: tuple[Leg, ...],
    floors: Sequence[Array],
    hold: int,
    most: int = PASSES,
    least: float = -math.inf,
    inside: Callable[[StreamPattern], bool] | None = None,
) -> tuple[tuple[Leg, ...], Step, str]:
    """Iterate passes until the likelihood has converged.

    Args:
        legs: where the search starts.
        floors: per log, standard deviations (l,) that no level goes below.
        hold: the passes before the levels of the instruments move.
        most: passes.
        least: the log-likelihood asked: a search is given up that does not come there by `HOPE`
            times what is predicted of a pass or, far from there, its last two rises.
        inside: whether waves are those sought: a search is given up that leaves them.

    Returns:
        The logs at the optimum with their smoothed passes, the last step, and the reason why the
        search did not converge; empty if it did.
    """
    reason, share, halvings, fresh = "", 1.0, 0, True
    scouts = [LevelSteps(floor, hold) for floor in floors]
    history: list[float] = []
    best: tuple[Step, tuple[Smoothed, ...], list[Array]] | None = None
    for left in range(most - 1, -1, -1):
        step = Step.of(legs)
        # A promise was false of which half came true while less than half of it is left.
        lost = max(1.0, 0.5 * best[0].gain - step.gain) if best else 0.0
        fallen = best is not None and not fresh and step.reached < best[0].reached - lost
        if fallen or not math.isfinite(step.reached):
            if best is None or halvings == 4:
                reason = "the likelihood cannot be raised from where the search started"
                break
            halvings += 1
        else:
            halvings, smoothed = 0, step.smoothed()
            sorted_out = zip(legs, smoothed, strict=True) if len(history) < SORTING else ()
            fresh = sum(_gated(*pair) for pair in sorted_out) > 0
            history.append(step.reached)
            if not fresh and [rise < 0.0 for rise in np.diff(history[-4:])] == [True, False, True]:
                share *= 0.5  # it goes to and fro across the maximum
            moves = [
                scout.change(list(leg.model.levels.values()), each.squares, levels)
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
            late = history[-3:]
            ahead = max([0.0, *np.diff(late)]) if math.isinf(gains) else step.gain + gains
            if len(history) > 2 and max(late) + min(left, HOPE) * ahead < least:
                reason = "another model is likelier"
                break
        if best is not None:
            legs = best[0].moved(best[1], share * 0.5**halvings, best[2])
            if "latency" in legs[0].model.names:  # nodes move with it
                legs = tuple(leg.again(leg.stride) for leg in legs)
            if inside and not inside(legs[0].model.pattern):
                reason = "the search leads to another flow"
                break
    else:
        reason = f"not at the maximum after {most} passes"
    if best is None:
        return legs, step, reason
    step, smoothed, _ = best
    if step.blind and not reason:
        *others, final = step.blind
        words = f"cannot tell {', '.join(others)} from" if others else "does not see"
        reason = f"the log {words} {final}"
    return step.moved(smoothed), step, reason


def _gated(leg: Leg, smoothed: Smoothed) -> bool:
    """Set the weights of outliers to 0 and of other readings to 1; True if a weight changed."""
    far = np.abs(smoothed.scores[:, 4:8])
    if not far.max() > GATE and ((leg.weights > 0.0) == leg.seen).all():
        return False
    if np.median(far[leg.weights > 0.0]) > 0.85:  # a normal one's is .67: there is no model yet
        return False
    noise = np.repeat([leg.model.values[name] for name in ("position_noise", "velocity_noise")], 2)
    away = np.abs(leg.measured - smoothed.track[:, :4]) / noise
    out = (leg.weights == 0.0) & (away > GATE)
    out = leg.seen & (out | (far > max(GATE, 0.3 * float(far.max()))))
    if out.sum() > OUTLIERS * leg.seen.sum():
        return False
    weights = np.where(leg.seen & ~out, 1.0, 0.0)
    changed = bool((weights != leg.weights).any())
    leg.weights[:] = weights
    return changed


class LevelSteps:
    """Successive steps of the logarithms of the variances of one log."""

    def __init__(self, floors: Array, hold: int) -> None:
        """Begin far from the optimum; the arguments are those of `climbed`."""
        self.floors, self.hold, self.count, self.gain = floors, hold, 0, math.inf
        self.before: tuple[Array, Array] | None = None

    def change(
        self, levels: list[float], squares: Array, information: Array
    ) -> tuple[Array, float]:
        """Return the step (l,) of the logarithms and its predicted gain.

        Args:
            levels: standard deviations (l,).
            squares: a and n (l, 2).
            information: of the logarithms (l, l), or of no rows.
        """
        self.count += 1
        (a, n), places = squares.T, np.arange(len(levels))
        place = 2.0 * np.log(np.maximum(levels, 1e-150))
        lowest = np.minimum(2.0 * np.log(self.floors) - place, 0.0)
        instruments = np.isin(places, INSTRUMENTS)
        few = np.where(instruments, 5.0, 1e-300)
        ratio = np.log((a + few) / (n + few))  # few readings' worth says little of their noise
        moving = (np.maximum(a, n) > NEGLIGIBLE) & ((lowest < -1e-3) | (ratio > 0.0))
        active = places[moving & ~(instruments & (self.count <= self.hold))]
        step, share, gain = np.zeros(len(levels)), np.zeros(len(active)), math.inf
        before, self.before = self.before, (place, ratio)
        if self.gain < 10.0 and len(information) and len(active):
            least = np.where((instruments & (n > 1.0))[active], -0.7, -0.99)
            share = _bounded(information[np.ix_(active, active)], (a - n)[active], least)
            gain = float((a - n)[active] @ share)
        if not len(active) or 0.0 <= gain < 10.0:
            step[active] = np.log1p(share)
            self.gain = gain if len(active) else 0.0
            return np.maximum(step, lowest), self.gain
        slope = np.where(instruments, 1.0, 0.4)
        if before is not None:
            away = place - before[0]
            secant = np.clip((before[1] - ratio) / np.where(away, away, 1.0), 0.2, 1.0)
            slope = np.where(np.abs(away) > 0.05, secant, slope)
        step[active] = np.clip(ratio / slope, -math.log(100.0), math.log(10.0))[active]
        counted = moving if self.count >= self.hold else active
        self.gain = float(np.abs((a - n) * np.clip(ratio, -1.0, 1.0))[counted].sum())
        return np.maximum(step, lowest), math.inf


def _bounded(information: Array, score: Array, least: Array) -> Array:
    """The Newton step (l,), as shares of the variances, with bounds `least` and 2."""
    share, free = np.zeros(len(score)), np.ones(len(score), dtype=bool)
    for _ in score:
        block = information[np.ix_(free, free)]
        rest = score[free] - information[np.ix_(free, ~free)] @ share[~free]
        share[free] = np.linalg.solve(block + 1e-9 * np.diag(np.diag(block)), rest)
        excess = np.where(free, np.maximum(share - 2.0, least - share), 0.0)
        furthest = int(np.argmax(excess))
        if excess[furthest] <= 0.0:
            break
        share[furthest] = min(max(share[furthest], least[furthest]), 2.0)
        free[furthest] = False
    return share


def inverted(information: Array) -> tuple[Array, IntArray]:
    """The inverse of an information matrix (p, p), and the indices of unobservable parameters."""
    if not len(information) or not np.isfinite(information).all():
        return np.full_like(information, np.nan), np.zeros(0, dtype=np.intp)
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    scale = np.where(size > 0.0, size, 1.0)
    values, vectors = np.linalg.eigh(information / scale / scale[:, None])
    blind = values < DEPENDENT
    unseen = np.flatnonzero((np.abs(vectors[:, blind]) > 0.2).any(axis=1))
    half = vectors[:, ~blind] / np.sqrt(values[~blind]) / scale[:, None]
    return half @ half.T, unseen
