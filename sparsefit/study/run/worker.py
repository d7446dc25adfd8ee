"""A worker process: what runs in it, and the parent's end of it."""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import TypeAlias

from sparsefit.child import Child
from sparsefit.estimator.estimator import Estimator
from sparsefit.flight import simulate_flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import Library
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.study.run.channel import Receiver, Sender
from sparsefit.study.run.execution import run_flight
from sparsefit.study.run.lines import Record, outcome_of, record_of
from sparsefit.study.run.outcome import Event, Outcome, Stage
from sparsefit.study.spec.study import Study


@dataclass(frozen=True)
class Ready:
    """The worker has started, or has ended its job."""


Message: TypeAlias = Event | Ready


@dataclass(frozen=True)
class Job:
    """Cells of one flight; `alone` forbids shared fits, `deaths` counts workers lost on it."""

    flight: int
    cells: tuple[int, ...]
    alone: bool = False
    deaths: int = 0


def work(study: Study, jobs: Connection, messages: Connection) -> None:
    """The worker's life: take a job, send what happens, until the parent is gone."""
    sender = Sender(messages.fileno(), os.getpid())
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        _load()
        sender.send({"ready": True})
        while True:
            job: Job = jobs.recv()
            todo = [study.cells[index] for index in job.cells]
            for event in run_flight(study, job.flight, todo, alone=job.alone):
                _send(sender, event)
            sender.send({"ready": True})


def _send(sender: Sender, event: Event) -> None:
    if isinstance(event, Stage):
        sender.send({"stage": event.name, "cells": event.cells, "fits": event.fits})
        return
    try:
        sender.send(record_of(event))
    except (ValueError, TypeError, OverflowError, RecursionError) as error:
        reason = f"what was read cannot be written: {type(error).__name__}"
        sender.send(record_of(Outcome(event.flight, event.cell, "error", reason)))


def _message(record: Record) -> Message:
    if "ready" in record:
        return Ready()
    if "stage" in record:
        return Stage(record["stage"], tuple(record["cells"]), record["fits"])
    return outcome_of(record)


def _load() -> None:
    """Import what is imported at first use, so that no case is charged for it."""
    vehicle = PointMassVehicle(0.5, (5.0, 3.0))
    flight = simulate_flight(None, vehicle, duration=1.0, sample_rate=20.0, seed=0)
    Estimator(library=Library(LengthScaleGrid(3.0, 5.0, 1.0))).estimate(flight)


@dataclass
class Worker:
    """The parent's end: the process, its job, the stage in progress and its deadline."""

    child: Child
    jobs: Connection
    messages: Connection
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
        jobs, ours = multiprocessing.Pipe(duplex=False)
        messages, theirs = multiprocessing.Pipe(duplex=False)
        child = Child.start(work, study, jobs, theirs)
        jobs.close()
        theirs.close()
        limit = time.monotonic() + patience
        receiver = Receiver(messages.fileno())
        return cls(child, ours, messages, study.case_timeout, limit, receiver)

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

    def told(self) -> Iterator[Message]:
        """What has come by now, as of `Receiver.records`."""
        return map(_message, self.receiver.records())

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
        self.child.kill()
        self.jobs.close()
        self.messages.close()
