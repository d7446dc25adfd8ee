"""A worker process: what runs in it, and the parent's end of it."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnProcess

from threadpoolctl import threadpool_limits

from sparsefit.estimator.estimator import Estimator
from sparsefit.flight import simulate_flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import Library
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.study.run.channel import Message, Ready, Receiver, Sender
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.outcome import Outcome, Stage
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
PR_SET_PDEATHSIG = 1  # of Linux: a signal for when the parent dies


@dataclass(frozen=True)
class Job:
    """Cells of one flight; `alone` forbids shared fits, `deaths` counts workers lost on it."""

    flight: int
    cells: tuple[int, ...]
    alone: bool = False
    deaths: int = 0


def work(
    study: Study, jobs: Connection, messages: Connection, lifeline: Connection, parent: int
) -> None:
    """The worker's life: take a job, send what happens, until the parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(parent, lifeline)
    # What a back-end prints is no answer of the parent's, and what it asks for nobody types.
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    warnings.simplefilter("ignore")
    sender = Sender(messages.fileno(), os.getpid())
    try:
        # For libraries that were loaded before the environment could tell them.
        with threadpool_limits(limits=1):
            _load()
            sender.send(Ready())
            while True:
                job: Job = jobs.recv()
                todo = [study.cells[index] for index in job.cells]
                for event in run_flight(study, job.flight, todo, alone=job.alone):
                    sender.send(event)
                sender.send(Ready())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return


def _load() -> None:
    """Import what is imported at first use, so that no case is charged for it."""
    vehicle = PointMassVehicle(0.5, (5.0, 3.0))
    flight = simulate_flight(None, vehicle, duration=1.0, sample_rate=20.0, seed=0)
    Estimator(library=Library(LengthScaleGrid(3.0, 5.0, 1.0))).estimate(flight)


def _end_with(parent: int, lifeline: Connection) -> None:
    """End when the parent does, even by SIGKILL, and all that was started here with it.

    The thread ends the whole group of processes; where a back-end holds the interpreter and no
    thread of ours can run, the system still ends this one.
    """
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)
    threading.Thread(target=_watch, args=(lifeline,), daemon=True).start()


def _watch(lifeline: Connection) -> None:
    """The parent never writes here; when it dies, the read ends."""
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    if hasattr(os, "killpg"):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


@dataclass
class Worker:
    """The parent's end: the process, its job, the stage in progress and its deadline."""

    process: SpawnProcess
    jobs: Connection
    messages: Connection
    lifeline: Connection
    timeout: float
    deadline: float
    receiver: Receiver
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
        jobs, ours = context.Pipe(duplex=False)
        messages, theirs = context.Pipe(duplex=False)
        lifeline, stays = context.Pipe(duplex=False)
        told = (study, jobs, theirs, lifeline, os.getpid())
        process = context.Process(target=work, args=told, daemon=True)
        with environment(ONE_THREAD), _interrupts_ignored():
            process.start()
        for end in (jobs, theirs, lifeline):
            end.close()
        limit = time.monotonic() + patience
        receiver = Receiver(messages.fileno())
        return cls(process, ours, messages, stays, study.case_timeout, limit, receiver)

    @property
    def idle(self) -> bool:
        """Whether it waits for a job."""
        return self.ready and self.job is None

    @property
    def quiet(self) -> bool:
        """Whether no fit of it is lost if it ends now: it has none, or is about to begin one."""
        return self.job is None or self.stage is None

    def give(self, job: Job) -> None:
        """Hand over a job."""
        self.job, self.todo = job, dict.fromkeys(job.cells)
        self.stage, self.since = None, time.monotonic()
        self.deadline = self.since + self.timeout
        # If it has died meanwhile, the end of its pipe says so, and the job goes to another.
        with suppress(OSError):
            self.jobs.send(job)

    def take(self, message: Message) -> tuple[Outcome, float] | None:
        """Note what happened; an outcome comes back with the seconds it took, or NaN."""
        now = time.monotonic()
        self.deadline = now + self.timeout
        if isinstance(message, Ready):
            self.ready, self.stage, self.deadline = True, None, float("inf")
            self.job = None if not self.todo else self.job
        elif isinstance(message, Stage):
            self.stage, self.deadline = message, now + self.timeout * message.fits
        elif self.job and message.flight == self.job.flight and message.cell in self.todo:
            del self.todo[message.cell]
            # The first case of a process pays for what is loaded on first use.
            seconds = now - self.since if self.warm else float("nan")
            self.warm, self.since = True, now
            return message, seconds
        return None

    def excuse(self, seconds: float) -> None:
        """Do not charge seconds in which nobody ran."""
        self.deadline += seconds
        self.since += seconds

    def kill(self) -> None:
        """End the process for real, with all that it started, and wait until it is gone."""
        if hasattr(os, "killpg") and self.process.pid is not None:
            with suppress(ProcessLookupError, PermissionError):  # not yet a group of its own
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.join()
        for end in (self.jobs, self.messages, self.lifeline):
            end.close()


@contextmanager
def environment(values: Mapping[str, str]) -> Iterator[None]:
    """Variables of the environment for processes that are started within, as before after it."""
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
