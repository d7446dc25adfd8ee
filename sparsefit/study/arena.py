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
from sparsefit.arrays import Array
from sparsefit.study.clock import Repeats, Timing, median_interval
from sparsefit.study.columns import MAX_REASON, Outcome, Value
from sparsefit.study.contenders import Contender, ProblemDesign
from sparsefit.study.data_sets import Data
from sparsefit.study.holdout import cross_validated, missed, recovered, support
from sparsefit.study.keys import Holdout
from sparsefit.study.plan import Step
from sparsefit.study.problem_desk import WEIGHTS, own_fraction
from sparsefit.study.worker import Answer, Ask

JUDGE = "judge"
READY_SECONDS, JUDGE_SECONDS = 120.0, 300.0  # to copy arrays, to certify
SAME = 1e-9  # share of the largest weight by which an answer is that of the first repeat
WORSE = 1e3  # times the first excess: the answer is of another problem
NOTHINGS = 9  # asks for nothing, of which the median is the clock's own time


class Over(Exception):  # noqa: N818 - it ends a case, and is no error of ours
    """The status and the reason with which a case is over: its process was lost, or raised."""


@dataclass
class Crew:
    """The history of each process: contenders, and its own time per ask [s].

    lost: how contenders ended whose first call was lost, which are not tried again; first: seconds
    [s] of the first calls.
    """

    met: dict[str, set[int]] = field(default_factory=dict)
    overhead: dict[str, float] = field(default_factory=dict)
    lost: dict[int, tuple[str, str]] = field(default_factory=dict)
    first: dict[int, float] = field(default_factory=dict)


@dataclass
class Case:
    """A case while it is computed: its contender and tolerance, its timings and its verdict.

    points: the penalties of its path, 1 of a back-end that has none; weights: the answer (p, k, n)
    of its first solve; status and reason: set where it is over.
    """

    cell: int
    number: int
    contender: Contender
    tolerance: float
    points: int
    repeats: Repeats = field(default_factory=Repeats)
    weights: Array | None = None
    verdict: dict[str, Any] = field(default_factory=dict)
    status: str = ""
    reason: str = ""
    values: dict[str, Value] = field(default_factory=dict)

    @property
    def desk(self) -> str:
        """The process that it is solved in."""
        return f"solver {self.contender.family}"


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

    def case(self, cell: int) -> Case:
        """The case of a cell, before it begins."""
        number, stop = self.design.cells[cell]
        contender, points = self.design.contenders[number], 1
        if not contender.missing:
            backend = backends.get(contender.backend, **contender.settings)
            points = len(self.design.fractions) or 1 if own_fraction(backend) else 1
        return Case(cell, number, contender, stop, points)

    def run(self, cells: Sequence[int]) -> Step:
        """Judge each case, time all by turns until their medians are known, then hold rows out."""
        cases = [self.case(cell) for cell in cells]
        for case in cases:
            yield from self._tried(case, self._begin(case, cases))
        clock, turn = self.design.clock, 0
        rules = (clock.repeats, clock.seconds, clock.precision)
        timed = list(cases)
        while timed := [c for c in timed if not c.status and not c.repeats.enough(*rules)]:
            turn += 1
            for case in timed if turn % 2 == 0 else reversed(timed):
                yield from self._tried(case, self._repeat(case, turn))
        for case in cases:
            if self.design.holdout is not None and not case.status:
                yield from self._tried(case, self._hold_out(case, self.design.holdout))
        yield from map(self._outcome, cases)

    def _tried(self, case: Case, steps: Step) -> Step:
        try:
            yield from steps
        except Over as over:
            case.status, case.reason = over.args

    def _begin(self, case: Case, cases: Sequence[Case]) -> Step:
        """The first solve, which is judged, and timed where it was too long to only warm up."""
        if case.contender.missing:
            raise Over("skipped", case.contender.missing)
        case.values["load"] = os.getloadavg()[0] if hasattr(os, "getloadavg") else math.nan
        for other in cases:
            looser = other.number == case.number and other.tolerance > case.tolerance
            if looser and other.status == "timeout":
                words = f"not tried: at tolerance {other.tolerance:g} {other.reason}"
                raise Over("timeout", words)
        case.weights, timing = yield from self._solve(case)
        yield from self._judge(case, case.weights)
        case.repeats.note(timing, first=True)

    def _repeat(self, case: Case, turn: int) -> Step:
        """One more timed solve; its answer is the first one's, or is judged itself."""
        weights, timing = yield from self._solve(case, seed=turn)
        first, before = case.weights, case.verdict["excess"]
        assert first is not None
        case.repeats.note(timing, first=False)
        if np.abs(weights - first).max() <= SAME * np.abs(first).max():
            return
        yield from self._judge(case, weights)
        after = case.verdict["excess"]
        if after > max(WORSE * before, self._requested(case)):
            words = "a timed repeat answered another problem than it was given"
            raise Over("error", f"{words}: off by {after:.1e} of the objective at zero")

    def _solve(
        self, case: Case, *, seed: int = 0, without: tuple[int, int] | None = None
    ) -> Generator[Ask | Outcome, Answer | None, tuple[Array, Timing]]:
        """The weights (p, k, n) of one solve of all rows, or of those without a range."""
        yield from self._meet(case)
        path = self.folder / WEIGHTS
        shape = (case.points, self.data.theta.shape[1], self.data.target.shape[1])
        into = np.lib.format.open_memmap(path, mode="w+", dtype=float, shape=shape)
        into[...] = np.nan
        into.flush()
        rows = {"folder": str(self.folder), "seed": seed, "without": without, "weights": str(path)}
        ready = yield from self._ready(case, rows)
        answer = yield from self._ask(case, "solve", {}, case.contender.limit, timed=True)
        # An odd seed changes the sign of the target: the answer has it too.
        weights = -np.array(into) if seed % 2 else np.array(into)
        answered = int(np.isfinite(weights).all(axis=(1, 2)).sum())
        words = str(answer.content.get("words", "no words"))[:MAX_REASON]
        if answered < len(weights):
            raise Over("error", f"{answered} of {len(weights)} points answered: {words}")
        if case.weights is None:
            memory = _number(answer.content, "memory") - _number(ready.content, "memory")
            case.values |= {"memory": memory if memory > 0.0 else 0.0 * memory, "word": words}
        wall = max(answer.wall - self.crew.overhead.get(case.desk, 0.0), 1e-9)
        # A command is charged for neither its start nor its files.
        wall, cpu = answer.content.get("clock") or (wall, answer.cpu)
        return weights, Timing(wall, cpu)

    def _ready(
        self, case: Case, rows: Mapping[str, Any]
    ) -> Generator[Ask | Outcome, Answer | None, Answer]:
        """Have the process of a case copy its rows; of none of these, small ones."""
        own = {"contender": case.number, "tolerance": case.tolerance}
        small = {"folder": "", "seed": 0, "without": None, "weights": ""}
        return (yield from self._ask(case, "ready", {**own, **small, **rows}, READY_SECONDS))

    def _meet(self, case: Case) -> Step:
        """The clock's own time of a process, and a first call on a small problem."""
        crew, desk = self.crew, case.desk
        if case.number in crew.lost:
            raise Over(*crew.lost[case.number])
        if desk not in crew.overhead:
            walls = []
            for _ in range(NOTHINGS):
                answer = yield from self._ask(case, "nothing", {}, READY_SECONDS, timed=True)
                walls.append(answer.wall)
            crew.overhead[desk] = float(np.median(walls))
        if case.number in crew.met.setdefault(desk, set()):
            return
        yield from self._ready(case, {})
        try:
            words, limit = "its first call", case.contender.first
            first = yield from self._ask(case, "solve", {}, limit, timed=True, words=words)
            crew.first.setdefault(case.number, first.wall)
        except Over as over:
            if over.args[0] != "error":
                crew.lost[case.number] = over.args[0], over.args[1]
                raise
            # One that raises on the small problem may still solve the others.
        crew.met[desk].add(case.number)

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
    ) -> Generator[Ask | Outcome, Answer | None, Answer]:
        """The answer of a process. Raises Over where it is lost, or the code raised."""
        desk = desk or case.desk
        answer = yield Ask(verb, content, limit, desk, timed)
        assert answer is not None
        if answer.lost:
            self.crew.met.pop(desk, None)
            self.crew.overhead.pop(desk, None)
        if answer.status != "ok":
            raise Over(answer.status, answer.words(words)[:MAX_REASON])
        return answer

    def _judge(self, case: Case, weights: Array) -> Step:
        """The verdict on an answer, from a process of its own; the worst of all counts."""
        path = self.folder / "judged.npy"
        np.save(path, weights)
        content = {"folder": str(self.folder), "contender": case.number, "weights": str(path)}
        how: Any = {"desk": JUDGE, "words": "the certificate"}
        answer = yield from self._ask(case, "verdict", content, JUDGE_SECONDS, **how)
        worst, verdict = case.verdict, answer.content
        case.verdict = {"certificate_kind": str(verdict.get("kind", ""))}
        for name, key in (("certificate", "gap"), ("excess", "excess")):
            value = _number(verdict, key)
            value = math.inf if math.isnan(value) else value  # no proof is no answer
            case.verdict[name] = max(value, worst.get(name, 0.0))

    def _hold_out(self, case: Case, rules: Holdout) -> Step:
        """Errors on rows that a fit did not see, its support, and how alike two halves are."""
        data, weights, m = self.data, case.weights, self.data.theta.shape[0]
        assert weights is not None
        if data.samples is not None:  # compressed rows are no samples
            return
        folds = np.array_split(np.arange(m), rules.folds) if rules.folds else []
        errors, bases = [], []
        for low, high in [(int(f[0]), int(f[-1]) + 1) for f in folds if len(f)]:
            try:
                fitted, _ = yield from self._solve(case, without=(low, high))
            except Over as over:
                status, reason = over.args
                raise Over(status, f"on a fold of the rows: {reason}"[:MAX_REASON]) from None
            part, mean = data.target[low:high], np.delete(data.target, np.s_[low:high], 0).mean(0)
            errors.append(missed(data.theta[low:high], part, fitted))
            bases.append(float(((part - mean) ** 2).sum()))
        point = 0
        if errors:
            case.values |= cross_validated(np.array(errors), np.array(bases))
            point = int(np.sum(errors, axis=0).argmin())
        if self.design.fractions:
            case.values["alpha_fraction"] = self.design.fractions[point]
        if data.test is not None:
            theta, target = data.test
            blocks = np.array_split(np.arange(len(target)), min(rules.folds or 5, len(target)))
            chosen = weights[point : point + 1]
            remaining = np.array([missed(theta[b], target[b], chosen) for b in blocks])
            mean = data.target.mean(axis=0)
            base = np.array([float(((target[b] - mean) ** 2).sum()) for b in blocks])
            case.values |= cross_validated(remaining, base)
        rms = np.sqrt(np.asarray((data.theta * data.theta).mean(axis=0)))
        used = support(weights[point], rms, rules.support)
        case.values["support"] = int(used.sum())
        if data.truth is not None:
            case.values |= recovered(used, data.truth)
        if rules.stability and m >= 4:
            halves = []
            for other in ((m // 2, m), (0, m // 2)):
                fitted, _ = yield from self._solve(case, without=other)
                halves.append(support(fitted[point], rms, rules.support))
            union, shared = (halves[0] | halves[1]).sum(), (halves[0] & halves[1]).sum()
            case.values["stability"] = float(shared / union) if union else 1.0

    def _requested(self, case: Case) -> float:
        """The accuracy that a case is held to: its tolerance, or the strictest of the study."""
        return self.design.accuracies[-1] if math.isnan(case.tolerance) else case.tolerance

    def _outcome(self, case: Case) -> Outcome:
        """The row: `ok` where every answer's excess is within what was asked for."""
        status, reason = case.status or "ok", case.reason
        if not case.status and not case.verdict["excess"] <= self._requested(case):
            status, words = "inaccurate", str(case.values.get("word", ""))
            reason = f"certified {case.verdict['excess']:.1e}, asked for {self._requested(case):g}"
            reason = f"{reason}: {words}" if words else reason
        timings = case.repeats.timings
        walls = median_interval([timing.wall for timing in timings])
        cpus = median_interval([timing.cpu for timing in timings])
        values: dict[str, Value] = {
            **size_of(self.data),
            **dict(zip(("wall", "wall_low", "wall_high"), walls, strict=True)),
            **dict(zip(("cpu", "cpu_low", "cpu_high"), cpus, strict=True)),
            **case.verdict,
            **case.values,
            "points": case.points,
            "repeats": len(timings),
            "known": case.repeats.registered(self.design.clock.precision),
            "disturbed": case.repeats.disturbed,
            "first": self.crew.first.get(case.number, math.nan),
        }
        return Outcome(self.unit, case.cell, status, reason[:MAX_REASON], values)


def _number(content: Mapping[str, Any], name: str) -> float:
    """A number that a process told, NaN for anything else."""
    value = content.get(name)
    return float(value) if isinstance(value, int | float) else math.nan
