"""A process in which solvers are run: it times them one after the other, and can be killed.

BLAS has one thread, what solvers print goes nowhere, and a contender is imported and compiled on a
small problem before it is timed for the first time; that first call is told apart.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import time
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from sparsefit.arrays import Array
from sparsefit.child import Child
from sparsefit.errors import SparsefitError, described
from sparsefit.regression.backend import PenalisedBackend
from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.run.channel import GARBLED, Garbled, Receiver, Sender
from sparsefit.study.run.lines import Record
from sparsefit.study.run.solver_solve import (
    PeakMemory,
    Task,
    Timing,
    Verdict,
    fresh,
    judged,
    keep_what_is_loaded,
    reference_bounds,
    solve,
    timed,
)
from sparsefit.study.spec.choices import make_backend
from sparsefit.study.spec.solver_study import SolverCase, SolverStudy

START_SECONDS = 120.0
HAND_SECONDS = 300.0  # until it says that it begins
FIRST_SECONDS = 180.0  # of the first call: it may compile
JUDGE_SECONDS = 120.0
LONGEST_REASON = 300  # letters
PATIENCE = 10.0  # times the limit of a solve, on the wall: a machine that is busy fails nobody


@dataclass(frozen=True)
class Ask:
    """What the worker is to do with a case: ``first`` (compile), ``judge`` or ``time`` it."""

    what: str
    case: SolverCase


@dataclass(frozen=True, eq=False)
class Hand:
    """The problem that the next cases are of."""

    problem: RegressionProblem


@dataclass(frozen=True)
class Begun:
    """The work begins now and may take this long [s]; on the wall `patience` times as long."""

    seconds: float
    what: str
    patience: float = 1.0


@dataclass(frozen=True)
class Answer:
    """What came of an `Ask`: a time, a verdict where it was judged, megabytes, or an error."""

    timing: Timing | None = None
    verdict: Verdict | None = None
    memory: float = math.nan
    error: str = ""


@dataclass(frozen=True)
class Lost:
    """The process was killed at its limit (``timeout``) or died (``crashed``), with the reason."""

    status: str
    reason: str


def work(study: SolverStudy, asks: Connection, answers: Connection) -> None:
    """The worker's life: answer what is asked, until the parent is gone."""
    silent = os.open(os.devnull, os.O_WRONLY)
    os.dup2(silent, 1)
    os.dup2(silent, 2)
    sender = Sender(answers.fileno(), os.getpid())
    desk = _Desk(study, sender)
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        sender.send(asdict(Answer()))
        while True:
            ask: Ask | Hand = asks.recv()
            try:
                answer = desk.answer(ask)
            except Exception as error:  # a solver may raise anything
                answer = Answer(error=described(error, LONGEST_REASON))
            sender.send(asdict(answer))


def _message(record: Record) -> Begun | Answer:
    if "seconds" in record:
        return Begun(**record)
    timing, verdict = record.pop("timing"), record.pop("verdict")
    return Answer(timing and Timing(**timing), verdict and Verdict(**verdict), **record)


@dataclass
class _Desk:
    """The problem in hand with its reference bounds, by what is minimised."""

    study: SolverStudy
    sender: Sender
    problem: RegressionProblem | None = None
    bounds: dict[str, Array] = field(default_factory=dict)

    def answer(self, ask: Ask | Hand) -> Answer:
        if isinstance(ask, Hand):
            self.problem, self.bounds = ask.problem, {}
            keep_what_is_loaded()
            return Answer()
        contender = self.study.contenders[ask.case.contender]
        limit = contender.limit or self.study.clock.limit
        backend = make_backend(contender.backend, contender.settings)
        # What has no penalty has no path: it is fitted once.
        path = self.study.fractions if isinstance(backend, PenalisedBackend) else ()
        task = Task(backend, path, ask.case.tolerance, contender.certified)
        if ask.what == "first":
            self._begin(max(limit, FIRST_SECONDS), "compiling")
            _, timing = timed(lambda: solve(task, small_problem()))
            keep_what_is_loaded()
            return Answer(timing)
        assert self.problem is not None
        clone = fresh(self.problem)
        memory = PeakMemory() if ask.what == "judge" else None
        self._begin(limit, "the solve", PATIENCE)
        solutions, timing = timed(lambda: solve(task, clone))
        megabytes = memory.megabytes() if memory else math.nan
        if ask.what != "judge":
            return Answer(timing)
        self._begin(JUDGE_SECONDS, "the certificate", PATIENCE)
        bounds = self._bounds(contender.problem_of, task)
        return Answer(timing, judged(self.problem, task, solutions, bounds), megabytes)

    def _begin(self, seconds: float, what: str, patience: float = 1.0) -> None:
        self.sender.send(asdict(Begun(seconds, what, patience)))

    def _bounds(self, solved: str, task: Task) -> Array:
        if solved not in self.bounds and self.problem is not None:
            self.bounds[solved] = reference_bounds(self.problem, task)
        return self.bounds[solved]


def small_problem() -> RegressionProblem:
    """Twelve columns in groups of three, two targets: what a contender is first called on."""
    draw = np.random.default_rng(0)
    theta = draw.standard_normal((40, 12))
    target = theta[:, :2] @ draw.standard_normal((2, 2)) + 0.1 * draw.standard_normal((40, 2))
    return RegressionProblem.from_arrays(theta, target, np.arange(12) // 3)


@dataclass(frozen=True)
class _Process:
    """A process that works, and both channels to it."""

    child: Child
    asks: Connection
    answers: Connection
    receiver: Receiver

    @classmethod
    def start(cls, study: SolverStudy) -> _Process:
        asks, ours = multiprocessing.Pipe(duplex=False)
        answers, theirs = multiprocessing.Pipe(duplex=False)
        child = Child.start(work, study, asks, theirs)
        asks.close()
        theirs.close()
        return cls(child, ours, answers, Receiver(answers.fileno()))

    def how_it_ended(self) -> str:
        self.child.process.join(timeout=2.0)
        return self.child.end

    def end(self) -> None:
        self.child.kill()
        self.asks.close()
        self.answers.close()


class Worker:
    """The parent's end of a process; started when first asked, and again after a loss."""

    def __init__(self, study: SolverStudy) -> None:
        self._study = study
        self._process: _Process | None = None

    @property
    def pid(self) -> int | None:
        """The process, where there is one now."""
        return None if self._process is None else self._process.child.process.pid

    def ask(self, ask: Ask | Hand) -> Answer | Lost:
        """The answer, or how the process was lost over it."""
        process = self._process or self._start()
        try:
            process.asks.send(ask)
        except OSError:
            return self._lost("crashed", "the process died before the solve")
        return self._receive(process, HAND_SECONDS)

    def close(self) -> None:
        """End the process for real, and wait until it is gone."""
        if self._process is not None:
            self._process.end()
        self._process = None

    def _start(self) -> _Process:
        self._process = process = _Process.start(self._study)
        started = self._receive(process, START_SECONDS)
        if isinstance(started, Lost):
            raise SparsefitError(
                f"the worker process could not start ({started.reason}): in a script, call run() "
                'under if __name__ == "__main__"'
            )
        return process

    def _receive(self, process: _Process, seconds: float) -> Answer | Lost:
        """Wait for the answer; every `Begun` sets a new limit.

        Seconds are of the process's CPU where the system tells them, so that a busy machine fails
        no solver, and then `Begun.patience` times as many on the wall.
        """
        now, began = Begun(seconds, "the process"), self._clocks()
        while True:
            process.answers.poll(self._left(began, now))
            try:
                for record in process.receiver.records():
                    message = _message(record)
                    if isinstance(message, Answer):
                        return message
                    now, began = message, self._clocks()
            except Garbled:
                return self._lost("crashed", f"{now.what}: {GARBLED}")
            except (EOFError, OSError):
                return self._lost("crashed", f"{now.what}: the process {process.how_it_ended()}")
            if self._left(began, now) <= 0.0:
                cpu = self._clocks()[0] - began[0]
                kind = "" if not cpu < now.seconds else f" ({cpu:.1f} s of CPU)"
                limit = now.seconds * now.patience if kind else now.seconds
                return self._lost("timeout", f"{now.what} took longer than {limit:g} s{kind}")

    def _clocks(self) -> tuple[float, float]:
        """CPU seconds of the process (NaN where unknown), and of the wall."""
        return _cpu_seconds(self.pid), time.monotonic()

    def _left(self, began: tuple[float, float], what: Begun) -> float:
        """Seconds of wall that it may go on at least; 0 where the limit is reached."""
        cpu, wall = (now - then for now, then in zip(self._clocks(), began, strict=True))
        if math.isnan(cpu):
            return max(what.seconds - wall, 0.0)
        return max(min(what.seconds - cpu, what.patience * what.seconds - wall), 0.0)

    def _lost(self, status: str, reason: str) -> Lost:
        self.close()
        return Lost(status, reason)


def _cpu_seconds(pid: int | None) -> float:
    """CPU seconds that a process has used, by /proc; NaN where there is none."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        return sum(map(int, words[11:13])) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, AttributeError):
        return math.nan
