"""A worker process: what runs in it, and the parent's end of it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from threadpoolctl import threadpool_limits

from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.outcome import Event, Outcome, Stage
from sparsefit.study.spec.study import Study

# Processes share the work; threads inside each would only fight for the same cores.
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "BLIS_NUM_THREADS": "1",
    "VECLIB_MAXIMUM_THREADS": "1",
    "NUMEXPR_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "RAYON_NUM_THREADS": "1",
}


@dataclass(frozen=True)
class Job:
    """Cells of one flight; `alone` forbids shared fits, `deaths` counts workers lost on it."""

    flight: int
    cells: tuple[int, ...]
    alone: bool = False
    deaths: int = 0


@dataclass(frozen=True)
class Ready:
    """The worker has started, or has ended its job."""


Message = Event | Ready


def work(study: Study, jobs: Connection, lifeline: Connection) -> None:
    """The worker's life: take a job, send what happens, until the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, args=(lifeline,), daemon=True).start()
    warnings.simplefilter("ignore")
    try:
        # For libraries that were loaded before the environment could tell them.
        with threadpool_limits(limits=1):
            jobs.send(Ready())
            while True:
                job: Job = jobs.recv()
                _do(study, job, jobs)
                jobs.send(Ready())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def _do(study: Study, job: Job, jobs: Connection) -> None:
    todo = [study.cells[index] for index in job.cells]
    for event in run_flight(study, job.flight, todo, alone=job.alone):
        jobs.send(event)


def _end_with_parent(lifeline: Connection) -> None:
    """The parent never writes here; when it dies, even by SIGKILL, the read ends."""
    try:
        lifeline.recv_bytes()
    except (EOFError, OSError):
        os._exit(1)


@dataclass
class Worker:
    """The parent's end: the process, its job, the stage in progress and its deadline."""

    process: SpawnProcess
    pipe: Connection
    lifeline: Connection
    timeout: float
    deadline: float
    ready: bool = False
    warm: bool = False
    job: Job | None = None
    stage: Stage | None = None
    todo: dict[int, None] = field(default_factory=dict)
    since: float = 0.0

    @classmethod
    def start(cls, study: Study, *, patience: float) -> Worker:
        """A new process; it has `patience` seconds to report that it is ready."""
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        stays, lifeline = context.Pipe()
        process = context.Process(target=work, args=(study, theirs, lifeline), daemon=True)
        with _environment(ONE_THREAD), _interrupts_ignored():
            process.start()
        theirs.close()
        lifeline.close()
        return cls(process, ours, stays, study.case_timeout, time.monotonic() + patience)

    @property
    def idle(self) -> bool:
        """Whether it waits for a job."""
        return self.ready and self.job is None

    def give(self, job: Job) -> None:
        """Hand over a job."""
        self.job, self.todo = job, dict.fromkeys(job.cells)
        self.stage, self.since = None, time.monotonic()
        self.deadline = self.since + self.timeout
        # If it has died meanwhile, the end of its pipe says so, and the job goes to another.
        with suppress(OSError):
            self.pipe.send(job)

    def take(self, message: Message) -> tuple[Outcome, float] | None:
        """Note what happened; an outcome comes back with the seconds it took, or NaN."""
        now = time.monotonic()
        self.deadline = now + self.timeout
        if isinstance(message, Ready):
            self.ready, self.job, self.stage, self.deadline = True, None, None, float("inf")
        elif isinstance(message, Stage):
            self.stage, self.deadline = message, now + self.timeout * message.fits
        else:
            self.todo.pop(message.cell, None)
            # The first case of a process pays for what is loaded on first use.
            seconds = now - self.since if self.warm else float("nan")
            self.warm, self.since = True, now
            return message, seconds
        return None

    def kill(self) -> None:
        """End the process for real, and wait until it is gone."""
        self.process.kill()
        self.process.join()
        self.pipe.close()
        self.lifeline.close()


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """A child inherits this: Ctrl-C in the terminal reaches all, and only the parent acts."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
