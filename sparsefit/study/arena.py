"""Solvers of one objective on one problem: each is judged once, all are timed by turns.

The parent's side: which process is asked what, in which order, and what its answers count for. An
answer is weights in a file of known shape; every timed repeat has one, and one that is not that of
the first is judged itself. A process that is lost costs the case that it was at.
"""

from __future__ import annotations

import math
import os
from collections.abc import Generator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sparsefit import backends
from sparsefit.arrays import Array, IntArray
from sparsefit.study.clock import Repeats, Timing, median_interval
from sparsefit.study.columns import MAX_REASON, Outcome, Value
from sparsefit.study.contenders import Contender, ProblemDesign
from sparsefit.study.data_sets import Data
from sparsefit.study.holdout import Holdout, cross_validated, missed, recovered, support
from sparsefit.study.plan import Step
from sparsefit.study.problem_desk import WEIGHTS, own_fraction
from sparsefit.study.worker import Ask, Lost, Record

JUDGE = "judge"
READY_SECONDS = 120.0  # to copy arrays
JUDGE_SECONDS = 300.0
SAME = 1e-9  # share of the largest weight by which an answer is that of the first repeat
WORSE = 1e3  # times the first excess: the answer is of another problem
NOTHINGS = 9  # asks for nothing, of which the median is the clock's own time
Answered = Generator[Ask | Outcome, Record | Lost | None, "Mapping[str, Any] | Lost | str"]


@dataclass
class Crew:
    """What each process has met: contenders, the problem in hand, and its own time per ask [s].

    lost: contenders whose first call was lost, which are not tried again; first: seconds [s] of
    the first calls.
    """

    met: dict[str, set[int]] = field(default_factory=dict)
    holds: dict[str, int] = field(default_factory=dict)
    overhead: dict[str, float] = field(default_factory=dict)
    lost: dict[int, Lost] = field(default_factory=dict)
    first: dict[int, float] = field(default_factory=dict)

    def forget(self, desk: str) -> None:
        """The process of a desk is gone, and with it what it knew."""
        for registered in (self.met, self.holds, self.overhead):
            registered.pop(desk, None)


@dataclass
class Case:
    """A case while it is computed: its contender and tolerance, its timings and its verdict.

    weights: the answer (p, k, n) of its first solve; status and reason: set where it is over.
    """

    cell: int
    number: int
    contender: Contender
    tolerance: float
    repeats: Repeats = field(default_factory=Repeats)
    weights: Array | None = None
    verdict: dict[str, Any] = field(default_factory=dict)
    status: str = ""
    reason: str = ""
    turn: int = 0
    values: dict[str, Value] = field(default_factory=dict)

    @property
    def desk(self) -> str:
        """The process that it is solved in."""
        return f"solver {self.contender.family}"

    def end(self, answer: Lost | str, words: str = "the solve") -> None:
        """It is over: its process was lost, or raised an error."""
        if isinstance(answer, Lost):
            between = " " if answer.status == "timeout" else ": "
            self.status, self.reason = answer.status, f"{words}{between}{answer.reason}"
        else:
            self.status, self.reason = "error", answer[:MAX_REASON]


def size_of(data: Data) -> dict[str, Value]:
    """The columns that tell the size of a problem."""
    sizes = {"samples": data.samples or data.theta.shape[0], "columns": data.theta.shape[1]}
    return {**sizes, "targets": data.target.shape[1]}


@dataclass(frozen=True, eq=False)
class Arena:
    """Cases of one problem, whose arrays lie in a folder, and the processes that solve them."""

    design: ProblemDesign
    unit: int
    data: Data
    folder: Path
    crew: Crew

    def run(self, cases: Sequence[Case]) -> Step:
        """Judge each case, time all by turns until their medians are known, then hold rows out."""
        for case in cases:
            yield from self._begin(case, cases)
        clock, turn = self.design.clock, 0
        rules = (clock.repeats, clock.seconds, clock.precision)
        timed = [case for case in cases if not case.status]
        while timed := [c for c in timed if not c.status and not c.repeats.enough(*rules)]:
            turn += 1
            for case in timed if turn % 2 == 0 else reversed(timed):
                yield from self._repeat(case)
        if self.design.holdout is not None:
            for case in cases:
                if not case.status:
                    yield from self._hold_out(case, self.design.holdout)
        yield from map(self._outcome, cases)

    def _begin(self, case: Case, cases: Sequence[Case]) -> Step:
        """The first solve, which is judged, and timed where it was too long to only warm up."""
        if case.contender.missing:
            case.status, case.reason = "skipped", case.contender.missing
            return
        case.values["load"] = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
        for other in cases:
            looser = other.number == case.number and other.tolerance > case.tolerance
            if looser and other.status == "timeout":
                words = f"not tried: at tolerance {other.tolerance:g} {other.reason}"
                case.status, case.reason = "timeout", words
                return
        answer = yield from self._solve(case)
        if isinstance(answer, Lost | str):
            return
        case.weights = answer["weights"]
        memory = (answer["peak"] or math.nan) - (answer["before"] or math.nan)
        case.values["memory"] = max(memory, 0.0) if memory == memory else math.nan
        case.values["word"] = answer["words"]
        yield from self._judge(case, case.weights)
        case.repeats.note(answer["timing"], first=True)

    def _repeat(self, case: Case) -> Step:
        """One more timed solve; its answer is the first one's, or is judged itself."""
        case.turn += 1
        answer = yield from self._solve(case, seed=case.turn)
        if isinstance(answer, Lost | str):
            return
        weights, first = answer["weights"], case.weights
        assert first is not None
        case.repeats.note(answer["timing"], first=False)
        if np.abs(weights - first).max() <= SAME * np.abs(first).max():
            return
        before = case.verdict.get("excess", math.inf)
        yield from self._judge(case, weights)
        after, requested = case.verdict.get("excess", math.inf), self._asked(case)
        if not case.status and after > max(WORSE * before, requested):
            words = "a timed repeat answered another problem than it was given"
            case.end(f"{words}: off by {after:.1e} of the objective at zero")

    def _solve(
        self,
        case: Case,
        *,
        seed: int = 0,
        rows: IntArray | None = None,
    ) -> Answered:
        """The answer of one solve: weights (p, k, n), words and timing; else the case is over."""
        met = yield from self._meet(case)
        if isinstance(met, Lost | str):
            return met
        path = self.folder / WEIGHTS
        shape = (self._points(case), self.data.theta.shape[1], self.data.target.shape[1])
        into = np.lib.format.open_memmap(path, mode="w+", dtype=float, shape=shape)
        into[...] = np.nan
        into.flush()
        content: dict[str, Any] = {"contender": case.number, "tolerance": case.tolerance}
        content |= {
            "seed": seed,
            "rows": None if rows is None else rows.tolist(),
            "weights": str(path),
        }
        ready = yield from self._ask(case, "ready", content, READY_SECONDS)
        if isinstance(ready, Lost | str):
            return ready
        answer = yield from self._ask(case, "solve", {}, case.contender.limit, timed=True)
        if isinstance(answer, Lost | str):
            return answer
        weights = np.array(into)
        # An odd seed changes the sign of the target: the answer has it too.
        weights = -weights if seed % 2 else weights
        answered = int(np.isfinite(weights).all(axis=(1, 2)).sum())
        words = answer.get("words")
        words = words if isinstance(words, str) else "no words"
        if answered < len(weights):
            case.end(f"{answered} of {len(weights)} points answered: {words}")
            return case.reason
        wall = max(answer["wall"] - self.crew.overhead.get(case.desk, 0.0), 1e-9)
        peaks: dict[str, Any] = {
            "before": _number(ready.get("memory")),
            "peak": _number(answer.get("memory")),
        }
        return {**peaks, "weights": weights, "words": words, "timing": Timing(wall, answer["cpu"])}

    def _meet(self, case: Case) -> Answered:
        """A first call on a small problem, and the problem itself, where a process had neither."""
        crew, desk = self.crew, case.desk
        if case.number in crew.lost:
            case.end(crew.lost[case.number], "its first call")
            return crew.lost[case.number]
        if desk not in crew.overhead:
            walls = []
            for _ in range(NOTHINGS):
                answer = yield from self._ask(case, "nothing", {}, READY_SECONDS, timed=True)
                if isinstance(answer, Lost | str):
                    return answer
                walls.append(answer["wall"])
            crew.overhead[desk] = float(np.median(walls))
        if case.number not in crew.met.setdefault(desk, set()):
            content = {"contender": case.number, "tolerance": case.tolerance}
            words = "its first call"
            first = yield from self._ask(
                case, "first", content, case.contender.first, timed=True, words=words
            )
            if isinstance(first, Lost):
                crew.lost[case.number] = first
                return first
            # One that raises on the small problem may still solve the others.
            case.status = case.reason = ""
            if not isinstance(first, str):
                crew.first.setdefault(case.number, first["wall"])
            crew.met[desk].add(case.number)
        if crew.holds.get(desk) != self.unit:
            answer = yield from self._ask(
                case, "problem", {"folder": str(self.folder)}, READY_SECONDS
            )
            if isinstance(answer, Lost | str):
                return answer
            crew.holds[desk] = self.unit
        return {}

    def _ask(
        self,
        case: Case,
        verb: str,
        content: Mapping[str, Any],
        limit: float,
        *,
        timed: bool = False,
        words: str = "the solve",
        desk: str = "",
    ) -> Answered:
        """The answer of a process, held against what an answer is; else the case is over."""
        desk = desk or case.desk
        answer = yield Ask(verb, content, limit, desk, timed)
        if isinstance(answer, Lost):
            self.crew.forget(desk)
            case.end(answer, words)
            return answer
        inner = answer.get("answer") if answer else None
        error = answer.get("error") if answer else None
        if not isinstance(inner, dict):
            case.end(error if isinstance(error, str) else "the process told no answer")
            return case.reason
        assert answer is not None
        return {**inner, "wall": answer.get("wall", math.nan), "cpu": answer.get("cpu", math.nan)}

    def _judge(self, case: Case, weights: Array) -> Step:
        """The verdict on an answer, from a process of its own; the worst of all counts."""
        if self.crew.holds.get(JUDGE) != self.unit:
            home, words = {"folder": str(self.folder)}, "the judge"
            answer = yield from self._ask(
                case, "problem", home, READY_SECONDS, desk=JUDGE, words=words
            )
            if isinstance(answer, Lost | str):
                return
            self.crew.holds[JUDGE] = self.unit
        path = self.folder / "judged.npy"
        np.save(path, weights)
        content: dict[str, Any] = {"contender": case.number, "weights": str(path)}
        words = "the certificate"
        answer = yield from self._ask(
            case, "verdict", content, JUDGE_SECONDS, desk=JUDGE, words=words
        )
        if isinstance(answer, Lost | str):
            return
        gap, excess = (_or_infinite(answer.get(name)) for name in ("gap", "excess"))
        worst = case.verdict
        case.verdict = {
            "certificate_kind": str(answer.get("kind", "")),
            "certificate": max(gap, worst.get("certificate", 0.0)),
            "excess": max(excess, worst.get("excess", 0.0)),
        }

    def _hold_out(self, case: Case, rules: Holdout) -> Step:
        """Errors on rows that a fit did not see, its support, and how alike two halves are."""
        data, weights = self.data, case.weights
        assert weights is not None
        if data.samples is not None:  # compressed rows are no samples
            return
        m = data.theta.shape[0]
        folds = [part for part in np.array_split(np.arange(m), rules.folds or 1) if len(part)]
        errors, bases = [], []
        for part in folds if rules.folds else []:
            train = np.setdiff1d(np.arange(m), part)
            answer = yield from self._solve(case, rows=train)
            if isinstance(answer, Lost | str):
                words = f"on a fold of the rows: {case.reason}"
                case.reason = words[:MAX_REASON]
                return
            remaining = missed(data.theta[part], data.target[part], answer["weights"])
            errors.append(remaining)
            mean = data.target[train].mean(axis=0)
            bases.append(float(((data.target[part] - mean) ** 2).sum()))
        point = 0
        if errors:
            case.values |= cross_validated(np.array(errors), np.array(bases))
            point = int(np.sum(errors, axis=0).argmin())
        if self.design.fractions:
            case.values["alpha_fraction"] = self.design.fractions[point]
        if data.test is not None:
            theta, target = data.test
            blocks = np.array_split(np.arange(len(theta)), min(rules.folds or 5, len(theta)))
            chosen = weights[point : point + 1]
            remaining = np.array([missed(theta[b], target[b], chosen) for b in blocks])
            mean = data.target.mean(axis=0)
            base = np.array([float(((target[b] - mean) ** 2).sum()) for b in blocks])
            case.values |= cross_validated(remaining, base)
        rms = np.sqrt((data.theta**2).mean(axis=0))
        used = support(weights[point], rms, rules.support)
        case.values["support"] = int(used.sum())
        if data.truth is not None:
            case.values |= recovered(used, data.truth)
        if rules.stability and m >= 4:
            halves = []
            for half in (np.arange(m // 2), np.arange(m // 2, m)):
                answer = yield from self._solve(case, rows=half)
                if isinstance(answer, Lost | str):
                    return
                halves.append(support(answer["weights"][point], rms, rules.support))
            union = (halves[0] | halves[1]).sum()
            shared = (halves[0] & halves[1]).sum()
            case.values["stability"] = float(shared / union) if union else 1.0

    def _points(self, case: Case) -> int:
        """The number of answers: penalties of the path; 1 of a back-end that has none."""
        backend = backends.get(case.contender.backend, **case.contender.settings)
        return len(self.design.fractions) or 1 if own_fraction(backend) else 1

    def _asked(self, case: Case) -> float:
        """The accuracy that a case is held to: its tolerance, or the strictest of the study."""
        return self.design.accuracies[-1] if math.isnan(case.tolerance) else case.tolerance

    def _outcome(self, case: Case) -> Outcome:
        """The row: `ok` where every answer's excess is within what was asked for."""
        status, reason = case.status, case.reason
        excess = case.verdict.get("excess", math.inf)
        if not status:
            status, requested = "ok", self._asked(case)
            if not excess <= requested:
                status = "inaccurate"
                words = str(case.values.get("word", ""))
                content = f"certified {excess:.1e}, asked for {requested:g}"
                reason = f"{content}: {words}" if words else content
        clock, timings = self.design.clock, case.repeats.timings
        walls = median_interval([timing.wall for timing in timings])
        cpus = median_interval([timing.cpu for timing in timings])
        values: dict[str, Value] = {
            **size_of(self.data),
            **dict(zip(("wall", "wall_low", "wall_high"), walls, strict=True)),
            **dict(zip(("cpu", "cpu_low", "cpu_high"), cpus, strict=True)),
            **case.verdict,
            **case.values,
            "points": self._points(case) if not case.contender.missing else 1,
            "repeats": len(timings),
            "known": case.repeats.registered(clock.precision),
            "disturbed": case.repeats.disturbed,
            "first": self.crew.first.get(case.number, math.nan),
        }
        return Outcome(self.unit, case.cell, status, reason[:MAX_REASON], values)


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, int | float) else None


def _or_infinite(value: object) -> float:
    return float(value) if isinstance(value, int | float) else math.inf
