"""Solvers of one objective on one problem: each is judged once, all are timed by turns.

The parent's side: which process is asked what, in which order, and what its answers count for. An
answer is weights in a file of known shape; every timed repeat has one, and one that is not that of
the first is judged itself. A process that is lost costs the case that it was at.

There is one clock, the parent's: seconds on the wall of a process and of all that it starts. Code
that is timed can change its own clock and not this. CPU time stands beside the wall: a solver that
sleeps, or works elsewhere, has less of it; a disturbed machine too.

    holdout_error = sum over folds |Y - Theta W|^2 / |Y - mean(Y_train)|^2   on the rows held out

A fold is a block of neighbouring rows, as neighbours in time are alike. The penalty of a fold is
chosen on the others.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.columns import MAX_REASON, Outcome, Value
from sparsefit.study.contenders import ACCURACIES, FOLDS, IN_USE, ProblemDesign
from sparsefit.study.data_sets import Data
from sparsefit.study.keys import Clock
from sparsefit.study.plan import Asking
from sparsefit.study.problem_desk import Contender, own_fraction, small_problem, write_data
from sparsefit.study.worker import Answer, Ask, disturbed

JUDGE = "judge"
READY_SECONDS = 120.0  # to copy arrays


def median_interval(values: Sequence[float]) -> tuple[float, float, float]:
    """Median and its 95 % interval by order statistics; NaN ends below six values.

    Between the j-th smallest and the j-th largest of n lies the true median with probability
    1 - 2 P(B < j), B binomial of n and 1/2, whatever the distribution.
    """
    if not len(values):
        return math.nan, math.nan, math.nan
    ordered, n = np.sort(values), len(values)
    below = np.cumsum([math.comb(n, j) * 0.5**n for j in range(n)])  # P(B <= j)
    outside = int(np.searchsorted(below, 0.025, "right"))
    ends = (ordered[outside - 1], ordered[-outside]) if outside else (math.nan, math.nan)
    return float(np.median(ordered)), float(ends[0]), float(ends[1])


@dataclass
class Repeats:
    """Seconds [s] of the repeats of a case, by the clock `wall` and of `cpu`; spent: all of it."""

    seconds: dict[str, list[float]] = field(default_factory=lambda: {"wall": [], "cpu": []})
    spent: float = 0.0

    def note(self, wall: float, cpu: float, *, first: bool) -> None:
        """One more run; a first one below .3 s has only warmed up, and is not counted."""
        self.spent += wall
        if not first or wall > 0.3:
            self.seconds["wall"].append(wall)
            self.seconds["cpu"].append(cpu)

    def enough(self, clock: Clock) -> bool:
        """Whether no more is to be timed."""
        made = len(self.seconds["wall"])
        spent = made and self.spent >= clock.seconds
        return bool(spent or made >= clock.repeats or self.columns(clock)["known"])

    def columns(self, clock: Clock) -> dict[str, Value]:
        """Medians, intervals, whether the median of the wall is known as well as asked for, and
        whether the wall ran ahead of the CPU.
        """
        wall, low, high = median_interval(self.seconds["wall"])
        cpu, *ends = median_interval(self.seconds["cpu"])
        return {
            **{"wall": wall, "wall_low": low, "wall_high": high},
            **{"cpu": cpu, "cpu_low": ends[0], "cpu_high": ends[1]},
            "repeats": len(self.seconds["wall"]),
            "known": high - low <= 2.0 * clock.precision * wall,
            "disturbed": disturbed(wall, cpu),
        }


class Over(Exception):  # noqa: N818 - it ends a case, and is no error of ours
    """The status and the reason with which a case is over: its process was lost, or raised."""


@dataclass
class Case:
    """A case while it is computed: its contender and tolerance, its times and its columns.

    points: the penalties of its path, 1 of a back-end that has none; weights: the answer (p, k, n)
    of its first solve; status and reason: set where it is over.
    """

    cell: int
    number: int
    contender: Contender
    tolerance: float
    points: int = 1
    repeats: Repeats = field(default_factory=Repeats)
    weights: Array | None = None
    status: str = ""
    reason: str = ""
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def desk(self) -> str:
        """The process that it is solved in."""
        return f"solver {self.contender.family}"

    @property
    def call(self) -> dict[str, Any]:
        """Who is called there."""
        return {"contender": self.number, "tolerance": self.tolerance}


def size_of(data: Data) -> dict[str, Value]:
    """The columns that tell the size of a problem."""
    sizes = {"samples": data.samples or data.theta.shape[0], "columns": data.theta.shape[1]}
    return {**sizes, "targets": data.target.shape[1]}


@dataclass(eq=False)
class Arena:
    """The processes that solve one problem after the other, and what each of them has met.

    home: where the arrays of problems lie; met: the contenders of each process; overhead: its own
    time per ask [s]; lost: how contenders ended whose first call was lost, which are not tried
    again; first: seconds [s] of the first calls; unit, data, file: the problem at work.
    """

    design: ProblemDesign
    home: TemporaryDirectory[str] = field(default_factory=TemporaryDirectory)
    met: dict[str, set[int]] = field(default_factory=dict)
    overhead: dict[str, float] = field(default_factory=dict)
    lost: dict[int, tuple[str, str]] = field(default_factory=dict)
    first: dict[int, float] = field(default_factory=dict)
    unit: int = field(init=False)
    data: Data = field(init=False)
    file: Path = field(init=False)

    def run(self, unit: int, data: Data, cells: Sequence[int]) -> Asking[None]:
        """Judge each case, time all by turns until their medians are known, then hold rows out."""
        self.unit, self.data, self.file = unit, data, Path(self.home.name) / f"{unit}.npz"
        if not self.file.exists():
            write_data(data, self.file)
        cases, clock, turn = [self._case(cell) for cell in cells], self.design.clock, 0
        for case in cases:
            yield from self._tried(case, self._begin(case, cases))
        timed = list(cases)
        while timed := [c for c in timed if not c.status and not c.repeats.enough(clock)]:
            turn += 1
            for case in timed if turn % 2 == 0 else reversed(timed):
                yield from self._tried(case, self._repeat(case, turn))
        for case in cases:
            if self.design.holds_out and not case.status:
                yield from self._tried(case, self._hold_out(case), "on a part of the rows: ")
        yield from map(self._outcome, cases)

    def _case(self, cell: int) -> Case:
        number, stop = self.design.cells[cell]
        case = Case(cell, number, self.design.contenders[number], stop)
        if not case.contender.missing:
            backend = case.contender.settled
            case.points = len(self.design.fractions) or 1 if own_fraction(backend) else 1
        return case

    def _tried(self, case: Case, steps: Asking[None], where: str = "") -> Asking[None]:
        try:
            yield from steps
        except Over as over:
            case.status, case.reason = over.args[0], f"{where}{over.args[1]}"

    def _begin(self, case: Case, cases: Sequence[Case]) -> Asking[None]:
        """The first solve, which is judged, and timed where it was too long to only warm up."""
        if case.contender.missing:
            raise Over("skipped", case.contender.missing)
        case.values["load"] = os.getloadavg()[0]
        for other in cases:
            looser = other.number == case.number and other.tolerance > case.tolerance
            if looser and other.status == "timeout":
                words = f"not tried: at tolerance {other.tolerance:g} {other.reason}"
                raise Over("timeout", words)
        case.weights, *seconds = yield from self._solve(case)
        yield from self._judge(case, case.weights)
        case.repeats.note(*seconds, first=True)

    def _repeat(self, case: Case, turn: int) -> Asking[None]:
        """One more timed solve; its answer is the first one's, or is judged itself."""
        weights, *seconds = yield from self._solve(case, seed=turn)
        first, before = case.weights, case.values["excess"]
        assert first is not None
        case.repeats.note(*seconds, first=False)
        if np.abs(weights - first).max() <= 1e-9 * np.abs(first).max():
            return
        yield from self._judge(case, weights)
        after = case.values["excess"]
        if after > max(1e3 * before, self._requested(case)):
            words = "a timed repeat answered another problem than it was given"
            raise Over("error", f"{words}: off by {after:.1e} of the objective at zero")

    def _solve(
        self, case: Case, *, seed: int = 0, without: tuple[int, int] | None = None
    ) -> Asking[tuple[Array, float, float]]:
        """Weights (p, k, n) of one solve of all rows, or without a range; its wall and CPU [s]."""
        yield from self._meet(case)
        path = self.file.with_name("weights.npy")
        shape = (case.points, self.data.theta.shape[1], self.data.target.shape[1])
        into = np.lib.format.open_memmap(path, mode="w+", dtype=float, shape=shape)
        into[...] = np.nan
        into.flush()
        rows = {"file": str(self.file), "seed": seed, "without": without, "weights": str(path)}
        ready = yield from self._ask(case, "ready", {**case.call, **rows}, READY_SECONDS)
        limit = case.contender.killed(shape[2])
        answer = yield from self._ask(case, "solve", {}, limit, timed=True)
        # An odd seed changes the sign of the target: the answer has it too.
        weights = -np.array(into) if seed % 2 else np.array(into)
        answered = int(np.isfinite(weights).all(axis=(1, 2)).sum())
        words = str(answer.content.get("words", "no words"))[:MAX_REASON]
        if answered < len(weights):
            raise Over("error", f"{answered} of {len(weights)} points answered: {words}")
        if case.weights is None:
            memory = _number(answer.content, "memory") - _number(ready.content, "memory")
            case.values |= {"memory": memory if memory > 0.0 else 0.0 * memory, "word": words}
        wall = max(answer.wall - self.overhead.get(case.desk, 0.0), 1e-9)
        # A command is charged for neither its start nor its files; the word of others is none.
        own = answer.content.get("clock") if case.contender.command else None
        wall, cpu = own or (wall, answer.cpu)
        return weights, wall, cpu

    def _meet(self, case: Case) -> Asking[None]:
        """The clock's own time of a process, and a first call on a small problem."""
        desk = case.desk
        if case.number in self.lost:
            raise Over(*self.lost[case.number])
        if desk not in self.overhead:
            walls = []
            for _ in range(9):
                answer = yield from self._ask(case, "nothing", {}, READY_SECONDS, timed=True)
                walls.append(answer.wall)
            self.overhead[desk] = float(np.median(walls))
        if case.number in self.met.setdefault(desk, set()):
            return
        try:
            words = "its first call"
            limit = case.contender.killed(small_problem().targets, first=True)
            first = yield from self._ask(case, "first", case.call, limit, timed=True, words=words)
            self.first.setdefault(case.number, first.wall)
        except Over as over:
            if over.args[0] != "error":
                self.lost[case.number] = over.args[0], over.args[1]
                raise
            # One that raises on the small problem may still solve the others.
        self.met[desk].add(case.number)

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
    ) -> Asking[Answer]:
        """The answer of a process. Raises Over where it is lost, or the code raised."""
        desk = desk or case.desk
        answer: Answer = yield Ask(verb, content, limit, desk, timed)
        if answer.lost:
            self.met.pop(desk, None)
            self.overhead.pop(desk, None)
        if answer.status != "ok":
            raise Over(answer.status, answer.words(words)[:MAX_REASON])
        if "late" in answer.content:
            raise Over("timeout", f"{words} {answer.content['late']}"[:MAX_REASON])
        return answer

    def _judge(self, case: Case, weights: Array) -> Asking[None]:
        """The verdict on an answer, from a process of its own; the worst of all counts."""
        path = self.file.with_name("judged.npy")
        np.save(path, weights)
        content = {"file": str(self.file), "contender": case.number, "weights": str(path)}
        how: Any = {"desk": JUDGE, "words": "the certificate"}
        answer = yield from self._ask(case, "verdict", content, 300.0, **how)
        case.values["certificate_kind"] = str(answer.content.get("kind", ""))
        for name, key in (("certificate", "gap"), ("excess", "excess")):
            value = _number(answer.content, key)
            value = math.inf if math.isnan(value) else value  # no proof is no answer
            case.values[name] = max(value, case.values.get(name, 0.0))

    def _hold_out(self, case: Case) -> Asking[None]:
        """Errors on rows that a fit did not see, its support, and how alike two halves are."""
        data, weights, m = self.data, case.weights, len(self.data.target)
        assert weights is not None
        if data.samples is not None:  # compressed rows are no samples
            return
        errors, bases = list[Array](), list[float]()
        for fold in np.array_split(np.arange(m), min(FOLDS, m)):
            out = slice(int(fold[0]), int(fold[-1]) + 1)
            fitted, *_ = yield from self._solve(case, without=(out.start, out.stop))
            errors.append(missed(data.theta[out], data.target[out], fitted))
            bases.append(_squares(data.target[out], np.delete(data.target, out, 0)))
        case.values |= cross_validated(np.array(errors), np.array(bases))
        point = int(np.sum(errors, axis=0).argmin())
        if self.design.fractions:
            case.values["alpha_fraction"] = self.design.fractions[point]
        if data.test is not None:
            theta, target = data.test
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
                fitted, *_ = yield from self._solve(case, without=other)
                halves.append(support(fitted[point], rms))
            union, shared = (halves[0] | halves[1]).sum(), (halves[0] & halves[1]).sum()
            case.values["stability"] = float(shared / union) if union else 1.0

    def _requested(self, case: Case) -> float:
        """The accuracy that a case is held to: its tolerance, or the strictest of the study."""
        return ACCURACIES[-1] if math.isnan(case.tolerance) else case.tolerance

    def _outcome(self, case: Case) -> Outcome:
        """The row: `ok` where every answer's excess is within what was asked for."""
        status, reason, requested = case.status or "ok", case.reason, self._requested(case)
        if not case.status and not case.values["excess"] <= requested:
            status = "inaccurate"
            words = (f"certified {case.values['excess']:.1e}, asked for {requested:g}",)
            reason = ": ".join(filter(None, (*words, case.values.get("word", ""))))
        values = {
            **size_of(self.data),
            **case.repeats.columns(self.design.clock),
            **case.values,
            "points": case.points,
            "first": self.first.get(case.number, math.nan),
        }
        return Outcome(self.unit, case.cell, status, reason[:MAX_REASON], values)


def _squares(target: Array, seen: Array) -> float:
    """The squares of target rows about the mean of those that were seen."""
    return float(((target - seen.mean(axis=0)) ** 2).sum())


def _number(content: Mapping[str, Any], name: str) -> float:
    """A number that a process told, NaN for anything else."""
    value = content.get(name)
    return float(value) if isinstance(value, int | float) else math.nan


def missed(theta: Array, target: Array, weights: Array) -> Array:
    """The squares (p,) that answers (p, k, n) leave of rows."""
    return np.array([float(((target - theta @ each) ** 2).sum()) for each in weights])


def cross_validated(errors: Array, bases: Array) -> dict[str, Value]:
    """The held-out share of the squares, and its standard error over the folds.

    errors (f, p): squares missed in each fold at each penalty; bases (f,): those about the mean.
    The penalty of a fold is chosen on the others, so that it has not been seen there.
    """
    others = errors.sum(axis=0) - errors
    chosen = others.argmin(axis=1) if len(errors) > 1 else np.zeros(len(errors), int)
    missed = errors[np.arange(len(errors)), chosen]
    shares = missed / np.maximum(bases, 1e-300)
    spread = float(shares.std(ddof=1) / math.sqrt(len(shares))) if len(shares) > 1 else math.nan
    total = float(missed.sum() / max(bases.sum(), 1e-300))
    return {"holdout_error": total, "holdout_error_se": spread}


def support(weights: Array, rms: Array) -> BoolArray:
    """Which columns (k,) are in use, of weights (k, n)."""
    sizes = np.sqrt((weights**2).sum(axis=1)) * rms
    used: BoolArray = sizes > IN_USE * sizes.max(initial=0.0)
    return used


def recovered(used: BoolArray, truth: BoolArray) -> dict[str, Value]:
    """Precision, recall and F1 of the columns in use against the true ones."""
    hits = float((used & truth).sum())
    precision = hits / used.sum() if used.any() else math.nan
    recall = hits / truth.sum() if truth.any() else math.nan
    f1 = 2.0 * hits / (used.sum() + truth.sum()) if used.any() or truth.any() else math.nan
    recovered = {"precision": float(precision), "recall": float(recall), "f1": float(f1)}
    return {"true_support": int(truth.sum()), **recovered}
