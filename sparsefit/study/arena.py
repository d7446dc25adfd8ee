"""Solvers of one objective on one problem: each answer is certified, all are timed by turns.

The parent's side of a study of problems. An answer is weights in a file of known shape; every timed
repeat has one, and is certified itself where it differs from the first. A worker that is lost ends
the case that it was at.

Times are wall times by the parent's clock, which code that is timed cannot change, of a process and
all that it starts. The CPU time beside it is less where a solver sleeps, works in another process,
or the machine is disturbed.

    holdout_error = sum over folds |Y - Theta W|^2 / |Y - mean(Y_train)|^2   on the rows held out

A fold is a block of neighbouring rows, as neighbours in time are correlated. The penalty of a fold
is chosen on the other folds.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.columns import MAX_REASON, Outcome, Value
from sparsefit.study.data_sets import Data
from sparsefit.study.keys import Clock
from sparsefit.study.problem_desk import Contender, fractions_of, small_problem
from sparsefit.study.worker import Answer, Crew, NoAnswerError, Worker, disturbed

JUDGE = "judge"
FOLDS = 5  # blocks of neighbouring rows that are held out in turn
IN_USE = 1e-3  # share of the largest weight (of columns of unit rms), above which a column is used
ACCURACIES = (1e-4, 1e-6, 1e-8)  # certified, at which success and time are counted
READY_SECONDS = 120.0  # to copy arrays
SOLVE, FIRST = "the solve", "its first call"  # in reasons


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and its 95 % interval by order statistics; NaN ends below six values.

    The true median lies between the j-th smallest and the j-th largest of n values with
    probability 1 - 2 P(B < j), B binomial of n and 1/2, for any distribution.
    """
    if not len(values):
        return math.nan, math.nan, math.nan
    ordered, n = np.sort(values), len(values)
    below = np.cumsum([math.comb(n, j) * 0.5**n for j in range(n)])  # P(B <= j)
    outside = int(np.searchsorted(below, 0.025, "right"))
    ends = (ordered[outside - 1], ordered[-outside]) if outside else (math.nan, math.nan)
    return float(np.median(ordered)), float(ends[0]), float(ends[1])


@dataclass
class Case:
    """A case while it is computed: its contender, its times and its columns.

    points: the number of penalties p, 1 of a back-end without; weights: the answer (p, k, n) of its
    first solve; walls, cpus: the times [s] of its repeats; spent: the sum of all wall times; status
    and reason: set where the case has ended early.
    """

    cell: int
    contender: Contender
    points: int = 1
    weights: Array | None = None
    walls: list[float] = field(default_factory=list)
    cpus: list[float] = field(default_factory=list)
    spent: float = 0.0
    status: str = ""
    reason: str = ""
    values: dict[str, Any] = field(default_factory=dict)

    @contextmanager
    def ending(self, where: str = "") -> Iterator[None]:
        """A step that ends the case where it has no answer."""
        try:
            yield
        except NoAnswerError as failed:
            self.status, self.reason = failed.status, f"{where}{failed.reason}"

    def note(self, wall: float, cpu: float, *, first: bool = False) -> None:
        """Add the times of a solve; a first one below .3 s is a warm-up and is not counted."""
        self.spent += wall
        if not first or wall > 0.3:
            self.walls.append(wall)
            self.cpus.append(cpu)

    def enough(self, clock: Clock) -> bool:
        """Whether the repeats suffice."""
        spent = self.walls and self.spent >= clock.seconds
        return bool(spent or len(self.walls) >= clock.repeats or self.times(clock)["known"])

    def times(self, clock: Clock) -> dict[str, Value]:
        """Medians, their intervals, whether that of the wall time is as narrow as requested, and
        whether another program disturbed the machine.
        """
        wall, low, high = median_interval(self.walls)
        cpu, cpu_low, cpu_high = median_interval(self.cpus)
        return {
            **{"wall": wall, "wall_low": low, "wall_high": high},
            **{"cpu": cpu, "cpu_low": cpu_low, "cpu_high": cpu_high},
            "repeats": len(self.walls),
            "known": high - low <= 2.0 * clock.precision * wall,
            "disturbed": disturbed(wall, cpu),
        }


@dataclass(eq=False)
class Arena:
    """The solvers' workers, and the problem that they solve.

    overhead: the time [s] of an empty request to a worker; holds: the problem that a worker has the
    rows of; lost: the ends of contenders whose first call was lost, which are not tried again;
    first: the times [s] of first calls; unit, data: the current problem.
    """

    plan: Any  # the experiment with problems, which makes the arena
    crew: Crew
    overhead: dict[Worker, float] = field(default_factory=dict)
    holds: dict[Worker, int] = field(default_factory=dict)
    lost: dict[tuple[str, str], NoAnswerError] = field(default_factory=dict)
    first: dict[tuple[str, str], float] = field(default_factory=dict)
    unit: int = field(init=False)
    data: Data = field(init=False)

    @np.errstate(over="ignore", invalid="ignore")  # of answers of any size
    def outcomes(self, unit: int, data: Data, cells: Sequence[int]) -> list[Outcome]:
        """Certify each case, time all by turns until their medians are known, cross-validate."""
        self.unit, self.data, clock, turn = unit, data, self.plan.definition.clock, 0
        cases = [Case(cell, self.plan.contenders[cell]) for cell in cells]
        for case in cases:
            with case.ending():
                self._begin(case, cases)
        timed = list(cases)
        while timed := [c for c in timed if not c.status and not c.enough(clock)]:
            turn += 1
            for case in timed if turn % 2 == 0 else reversed(timed):
                with case.ending():
                    self._repeat(case, turn)
        for case in cases:
            if self.plan.holds_out and not case.status:
                with case.ending("on a part of the rows: "):
                    self._hold_out(case)
        return list(map(self._outcome, cases))

    def _begin(self, case: Case, cases: Sequence[Case]) -> None:
        """The first solve, which is certified, and counts as a repeat unless it is a warm-up."""
        if case.contender.missing:
            raise NoAnswerError("skipped", case.contender.missing)
        case.points = len(fractions_of(case.contender.settled, self.plan.fractions)) or 1
        case.values["load"] = os.getloadavg()[0]
        for other in cases:
            alike = other.contender.names == case.contender.names
            looser = other.contender.tolerance > case.contender.tolerance
            if alike and looser and other.status == "timeout":
                words = f"not tried: at tolerance {other.contender.tolerance:g} {other.reason}"
                raise NoAnswerError("timeout", words)
        case.weights, *seconds = self._solve(case)
        self._judge(case, case.weights)
        case.note(*seconds, first=True)

    def _repeat(self, case: Case, turn: int) -> None:
        """One more timed solve, certified where its answer differs from the first."""
        weights, *seconds = self._solve(case, seed=turn if case.contender.even else 2 * turn)
        first, before = case.weights, case.values["excess"]
        assert first is not None
        case.note(*seconds)
        if np.abs(weights - first).max() <= 1e-9 * np.abs(first).max():
            return
        self._judge(case, weights)
        after = case.values["excess"]
        if after > max(1e3 * before, self._requested(case)):
            words = "a timed repeat answered another problem than it was given"
            raise NoAnswerError("error", f"{words}: off by {after:.1e} of the objective at zero")

    def _solve(
        self, case: Case, *, seed: int = 0, without: tuple[int, int] | None = None
    ) -> tuple[Array, float, float]:
        """Weights (p, k, n) of a solve of all rows, or without a range; wall and CPU [s]."""
        worker = self._acquainted(case)
        shape = (case.points, self.data.theta.shape[1], self.data.target.shape[1])
        with (self.crew.home / "weights").open("w+b") as file:
            np.full(shape, np.nan).tofile(file)
            file.flush()
            rows = {"contender": case.cell, "seed": seed, "without": without}
            content = {**rows, "weights": file.name, "shape": shape}
            ready = worker.ask("ready", content, READY_SECONDS, work=SOLVE)
            limit = case.contender.killed(shape[2])
            answer = worker.ask("solve", {}, limit, work=SOLVE, timed=True)
            _in_time(answer, SOLVE)
            file.seek(0)
            written = np.fromfile(file, count=math.prod(shape))
        weights = np.full(shape, np.nan)
        # The solver may have truncated the file. An odd seed changes the sign of the target.
        weights.flat[: written.size] = -written if seed % 2 else written
        answered = int(np.isfinite(weights).all(axis=(1, 2)).sum())
        words = str(answer.content.get("words", "no words"))[:MAX_REASON]
        if answered < len(weights):
            reason = f"{answered} of {len(weights)} points answered with finite weights"
            raise NoAnswerError("error", f"{reason}: {words}")
        if case.weights is None:
            memory = _number(answer.content, "memory") - _number(ready.content, "memory")
            case.values |= {"memory": memory if memory > 0.0 else 0.0 * memory, "word": words}
        wall = max(answer.wall - self.overhead[worker], 1e-9)
        # The time of a command is its own, without its start and its files; no other's is believed.
        own = answer.content.get("clock") if case.contender.command else None
        wall, cpu = own or (wall, answer.cpu)
        return weights, wall, cpu

    def _acquainted(self, case: Case) -> Worker:
        """The worker of a case, its overhead measured, after a first call of the contender."""
        names = case.contender.names
        if names in self.lost:
            raise self.lost[names]
        worker = self._holding(f"solver {case.contender.family}")
        if worker not in self.overhead:
            asks = [worker.ask("nothing", {}, READY_SECONDS, work=SOLVE, timed=True)
                    for _ in range(9)]  # fmt: skip
            self.overhead[worker] = float(np.median([answer.wall for answer in asks]))
        # Some compile anew for sparse columns; one that was called before does nothing.
        content = {"contender": case.cell, "sparse": not isinstance(self.data.theta, np.ndarray)}
        limit = case.contender.killed(small_problem().targets, first=True)
        try:
            first = worker.ask("first", content, limit, work=FIRST, timed=True)
            _in_time(first, FIRST)
            if first.content:
                self.first.setdefault(names, first.wall)
        except NoAnswerError as failed:  # one that raises there may still solve the others
            if failed.lost:
                self.lost[names] = failed
                raise
        return worker

    def _holding(self, desk: str) -> Worker:
        """The worker of a desk, which has the rows of the problem, and no others."""
        worker = self.crew.worker(desk)
        if self.holds.get(worker) != self.unit:
            rows = replace(self.data, truth=None, test=None)
            worker.ask("hold", {"data": rows}, READY_SECONDS, work="copying the rows")
            self.holds[worker] = self.unit
        return worker

    def _judge(self, case: Case, weights: Array) -> None:
        """Certify an answer in a process of its own; the worst of the case counts."""
        content, judge = {"contender": case.cell, "weights": weights}, self._holding(JUDGE)
        verdict = judge.ask("verdict", content, 300.0, work="the certificate").content
        case.values["certificate_kind"] = str(verdict.get("kind", ""))
        for name, key in (("certificate", "gap"), ("excess", "excess")):
            value = _number(verdict, key)
            value = math.inf if math.isnan(value) else value  # no proof
            case.values[name] = max(value, case.values.get(name, 0.0))

    def _hold_out(self, case: Case) -> None:
        """Cross-validate: held-out errors, the support, and its stability under halves of rows."""
        data, weights, m = self.data, case.weights, len(self.data.target)
        assert weights is not None
        if data.samples is not None:  # compressed rows are no samples
            return
        errors, bases = list[Array](), list[float]()
        for fold in np.array_split(np.arange(m), min(FOLDS, m)):
            out = slice(int(fold[0]), int(fold[-1]) + 1)
            fitted, *_ = self._solve(case, without=(out.start, out.stop))
            errors.append(missed(data.theta[out], data.target[out], fitted))
            bases.append(_squares(data.target[out], np.delete(data.target, out, 0)))
        case.values |= cross_validated(np.array(errors), np.array(bases))
        point = int(np.sum(errors, axis=0).argmin())
        if self.plan.fractions:
            case.values["alpha_fraction"] = self.plan.fractions[point]
        if data.test is not None:
            theta, target = data.test.theta, data.test.target
            blocks = np.array_split(np.arange(len(target)), min(FOLDS, len(target)))
            chosen = weights[point : point + 1]
            remaining = np.array([missed(theta[b], target[b], chosen) for b in blocks])
            base = np.array([_squares(target[b], data.target) for b in blocks])
            case.values |= cross_validated(remaining, base)
        rms = np.sqrt(np.asarray((data.theta * data.theta).mean(axis=0)))
        used = support(weights[point], rms)
        case.values["support"] = int(used.sum())
        if data.truth is not None:
            case.values |= recovered(used, data.truth)
        if m >= 4:
            halves = []
            for other in ((m // 2, m), (0, m // 2)):
                fitted, *_ = self._solve(case, without=other)
                halves.append(support(fitted[point], rms))
            union, shared = (halves[0] | halves[1]).sum(), (halves[0] & halves[1]).sum()
            case.values["stability"] = float(shared / union) if union else 1.0

    def _requested(self, case: Case) -> float:
        """The excess that a case may have: its tolerance, or the strictest accuracy of a study."""
        tolerance = case.contender.tolerance
        return ACCURACIES[-1] if math.isnan(tolerance) else tolerance

    def _outcome(self, case: Case) -> Outcome:
        """The outcome: `ok` where the excess of every answer is at most the one requested."""
        status, reason, requested = case.status or "ok", case.reason, self._requested(case)
        if not case.status and not case.values["excess"] <= requested:
            status = "inaccurate"
            reason = f"certified {case.values['excess']:.1e}, asked for {requested:g}"
            if (word := case.values.get("word", "")) != "returned":
                reason = f"{reason}: {word}".removesuffix(": ")
        values = {
            "samples": self.data.samples or self.data.theta.shape[0],
            "columns": self.data.theta.shape[1],
            "targets": self.data.target.shape[1],
            **case.times(self.plan.definition.clock),
            **case.values,
            "points": case.points,
            "first": self.first.get(case.contender.names, math.nan),
        }
        return Outcome(self.unit, case.cell, status, reason[:MAX_REASON], values)


def _squares(target: Array, seen: Array) -> float:
    """The sum of squares of target rows about the mean of the training rows."""
    return float(((target - seen.mean(axis=0)) ** 2).sum())


def _in_time(answer: Answer, work: str) -> None:
    """Raise NoAnswerError where a command, which has limits of its own, was ended at one."""
    if "late" in answer.content:
        raise NoAnswerError("timeout", str(answer.content["late"]), work)


def _number(content: Mapping[str, Any], name: str) -> float:
    """A number in an answer, NaN for anything else."""
    value = content.get(name)
    return float(value) if isinstance(value, int | float) else math.nan


def missed(theta: Array, target: Array, weights: Array) -> Array:
    """The sums of squared residuals (p,) of answers (p, k, n) on rows."""
    return np.array([float(((target - theta @ each) ** 2).sum()) for each in weights])


def cross_validated(errors: Array, bases: Array) -> dict[str, Value]:
    """The held-out error, and its standard error over the folds.

    errors (f, p): sums of squared residuals of each fold at each penalty; bases (f,): those about
    the mean. The penalty of a fold is chosen on the other folds.
    """
    others = errors.sum(axis=0) - errors
    chosen = others.argmin(axis=1) if len(errors) > 1 else np.zeros(len(errors), int)
    missed = errors[np.arange(len(errors)), chosen]
    shares = missed / np.maximum(bases, 1e-300)
    spread = float(shares.std(ddof=1) / math.sqrt(len(shares))) if len(shares) > 1 else math.nan
    total = float(missed.sum() / max(bases.sum(), 1e-300))
    return {"holdout_error": total, "holdout_error_se": spread}


def support(weights: Array, rms: Array) -> BoolArray:
    """The support (k,) of weights (k, n): columns above `IN_USE` of the largest effect."""
    sizes = np.sqrt((weights**2).sum(axis=1)) * rms
    used: BoolArray = sizes > IN_USE * sizes.max(initial=0.0)
    return used


def recovered(used: BoolArray, truth: BoolArray) -> dict[str, Value]:
    """Precision, recall and F1 of a support against the true one."""
    hits = float((used & truth).sum())
    precision = hits / used.sum() if used.any() else math.nan
    recall = hits / truth.sum() if truth.any() else math.nan
    f1 = 2.0 * hits / (used.sum() + truth.sum()) if used.any() or truth.any() else math.nan
    recovered = {"precision": float(precision), "recall": float(recall), "f1": float(f1)}
    return {"true_support": int(truth.sum()), **recovered}
