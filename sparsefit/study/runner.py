"""Run a study: compute the cases that have no row, and leave finished results behind.

One run at a time holds a results folder. Each row is in the store before the next is waited for;
an interrupted run, even by SIGKILL, goes on from there. The first Ctrl-C asks for the fits at hand
to be finished, the second stops at once.
"""

from __future__ import annotations

import fcntl
import math
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, SparsefitError, is_integer, one_of
from sparsefit.study.columns import FAILED
from sparsefit.study.manifest import write_manifest
from sparsefit.study.plan import Plan
from sparsefit.study.pool import Outcomes, outcomes
from sparsefit.study.store import Store, clear, discard

Progress: TypeAlias = Callable[[int, int, float | None], None]
EXECUTORS = ("processes", "dask")
PROGRESS_SECONDS = 0.2  # not more often than an eye can follow


@dataclass(frozen=True)
class Request:
    """The work that a run is asked to do beside computing the cases without a row.

    processes: how many work, None for as many as there are processors; fresh: start over;
    retry_failed: compute cases again that ended as error, timeout or crashed; stale: those that
    other code has computed; only: no cases but those of these names; executor: "processes" of this
    machine or "dask", at the address of a scheduler or on a cluster of its own.
    """

    processes: int | None = None
    fresh: bool = False
    retry_failed: bool = False
    stale: bool = False
    only: Sequence[str] = ()
    executor: str = "processes"
    scheduler: str | None = None

    def checked(self, *, alone: bool) -> int:
        """The number of processes; `alone`: of an experiment in which one works at a time."""
        one_of("executor", self.executor, EXECUTORS)
        words = ""
        if self.scheduler is not None and self.executor != "dask":
            words = f"a scheduler is of dask, not of {self.executor}: add --executor dask"
        elif self.processes is not None and not is_integer(self.processes, 1):
            words = f"processes must be a whole number of at least 1, not {self.processes!r}"
        elif alone and self.processes not in (None, 1):
            words = "solvers are timed one at a time: leave --processes away"
        elif alone and self.executor != "processes":
            words = "solvers are timed on this machine: leave --executor away"
        if words:
            raise InputError(words)
        # In a container there are fewer processors than the machine has.
        here = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
        return 1 if alone else self.processes or len(here(0))


@dataclass(frozen=True)
class RunSummary:
    """The progress of a study, finished or not, and what a run did for it.

    statuses: counts of all rows; stale: how many are of other code than this; versions: how many
    each version made; dropped: rows of cases that the study no longer plans; damaged: rows that
    could not be read; resumed: rows that were there before the run, of which `computed` cases,
    `seconds` [s] and `solver_seconds` of `processes` in the back-ends tell.
    """

    folder: Path
    planned: int
    statuses: Mapping[str, int]
    stale: int = 0
    versions: Mapping[str, int] = field(default_factory=dict)
    dropped: int = 0
    damaged: int = 0
    resumed: int = 0
    computed: int = 0
    seconds: float = 0.0
    solver_seconds: float = 0.0
    processes: int = 1

    @classmethod
    def of(cls, store: Store, **run: Any) -> RunSummary:
        """The summary of what is in a store."""
        counts = (store.statuses, int(store.stale.sum()), store.versions, store.unplanned)
        return cls(store.folder, store.plan.size, *counts, store.damaged, **run)

    @property
    def done(self) -> int:
        """The number of rows."""
        return sum(self.statuses.values())

    @property
    def finished(self) -> bool:
        """Whether every planned case is a row."""
        return self.done == self.planned

    @property
    def nothing_to_do(self) -> bool:
        """Whether all that was asked for was there before."""
        return self.computed == 0


def run(
    plan: Plan,
    folder: Path,
    request: Request = Request(),
    progress: Progress | None = None,
    stopping: Callable[[], None] | None = None,
) -> RunSummary:
    """Run a study into its folder: cases that have a row there are not computed again.

    A row counts for any study that plans its case: one that changed computes what is new, and
    keeps aside what it no longer plans.

    Args:
        progress: called with (cases done, cases planned, seconds left or None).
        stopping: called at the first interrupt, after which work at hand is finished.

    Raises:
        InputError: if the folder cannot be written, is in use, or is another study's.
        KeyboardInterrupt: interrupted; the rows so far are on the disk.
    """
    processes = request.checked(alone=plan.experiment.alone)
    with locked(folder):
        if request.fresh:
            clear(folder)
        store = Store.read(folder, plan)
        wanted = ~store.done
        if request.retry_failed:
            wanted |= store.ended(*FAILED)
        if request.stale:
            wanted |= store.stale
        if request.only:
            wanted &= plan.named(request.only)
        wanted = plan.experiment.whole(wanted, store.done, store.version)
        if store.finished and not wanted.any():
            return RunSummary.of(store, resumed=plan.size)
        with Store.opened(folder, plan) as store:
            summary = _run(store, wanted, request, processes, progress, stopping)
            if summary.finished:
                remaining = store.export()
                content = {
                    "study": plan.experiment.definition.name,
                    "study_hash": plan.experiment.definition.hash,
                    "seed": plan.experiment.definition.seed,
                    "cases": plan.size,
                    "statuses": dict(sorted(summary.statuses.items())),
                    "wall_seconds": round(summary.seconds, 3),
                    "solver_seconds": round(summary.solver_seconds, 3),
                    "resumed_cases": summary.resumed,
                    "processes": summary.processes,
                }
                write_manifest(folder, content)
        if summary.finished and not remaining:
            discard(folder)
    return summary


def _run(
    store: Store,
    wanted: BoolArray,
    request: Request,
    processes: int,
    progress: Progress | None,
    stopping: Callable[[], None] | None,
) -> RunSummary:
    """Compute the cases wanted; each row is in the store before the next is waited for."""
    plan, begun = store.plan, time.monotonic()
    resumed, computed = int((store.done & ~wanted).sum()), int(wanted.sum())
    pace, shown = Pace(wanted.sum(axis=0), processes), -math.inf
    solving: dict[int, float] = {}
    missing, batches = wanted.copy(), plan.experiment.batches(wanted)
    compute: Callable[..., Outcomes] = outcomes
    if request.executor == "dask":
        from sparsefit.study.dask_executor import outcomes_on_dask

        compute = partial(outcomes_on_dask, request.scheduler)
    with (
        counted_interrupts(stopping or (lambda: None)) as stop,
        closing(compute(plan.experiment, batches, processes, stop)) as arriving,
    ):
        for outcome, spent in chain([(None, math.nan)], arriving):
            if outcome is not None:
                store.put(outcome, plan.versions[outcome.cell])
                missing[outcome.unit, outcome.cell] = False
                seconds = float(outcome.values.get("seconds", 0.0)) - outcome.shared_seconds
                solving[plan.experiment.cost(outcome.unit, outcome.cell)] = seconds
                pace.note(outcome.cell, spent)
            if progress and (not pace.cases or time.monotonic() - shown > PROGRESS_SECONDS):
                shown = time.monotonic()
                progress(resumed + computed - pace.cases, resumed + computed, pace.eta)
        if stop() and missing.any():
            raise KeyboardInterrupt
    if missing.any():
        name = plan.experiment.definition.name
        words = f"{missing.sum()} cases of {name} ended without a row: run the study again"
        raise SparsefitError(f"{words}; what was computed is there")
    return RunSummary.of(
        store,
        resumed=resumed,
        computed=computed,
        seconds=time.monotonic() - begun,
        solver_seconds=math.fsum(value for value in solving.values() if value == value),
        processes=processes,
    )


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder, made if need be, against other runs by a lock that goes with its process.

    Raises:
        InputError: if another run holds it, or the folder cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        cause = f"cannot be made: {error.strerror}: choose another results folder"
        raise InputError(f"{folder}: {cause}") from None
    if not os.access(folder, os.W_OK):
        raise InputError(f"{folder}: cannot be written: choose another results folder")
    place = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # of a file system without such locks
            try:
                fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                words = "another run is under way: wait for it or stop it"
                raise InputError(f"{folder}: {words}") from None
        yield
    finally:
        os.close(place)


@contextmanager
def counted_interrupts(requested: Callable[[], None]) -> Iterator[Callable[[], bool]]:
    """Inside, the first interrupt calls ``asked``; the function tells whether there was one.

    The second raises KeyboardInterrupt, and later ones are ignored. Where somebody else handles
    interrupts, or this is not the main thread, all stays as it is.
    """
    mine = threading.current_thread() is threading.main_thread()
    if not mine or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda: False
        return
    heard: list[bool] = []

    def hear(_signal: int, _frame: Any) -> None:
        if heard:
            signal.signal(signal.SIGINT, signal.SIG_IGN)
            raise KeyboardInterrupt
        heard.append(True)
        requested()

    signal.signal(signal.SIGINT, hear)
    try:
        yield lambda: bool(heard)
    finally:
        if signal.getsignal(signal.SIGINT) is hear:
            signal.signal(signal.SIGINT, signal.default_int_handler)


# Ours, as cells differ in cost: over five replayed studies, tqdm's estimate was 24-143 % off in the
# median and the mean pace 3-24 %; this was 2-11 %.
class Pace:
    """The cases that are left of every cell (c,), and the mean seconds [s] of those seen.

    The mean of a cell forgets over 10 cases, so that it follows a trend.
    """

    def __init__(self, remaining: Any, processes: int) -> None:
        self.remaining = list(map(int, remaining))
        self.mean = [math.nan] * len(self.remaining)
        self.seen = [0] * len(self.remaining)
        self.cases, self.processes = sum(self.remaining), processes

    def note(self, cell: int, seconds: float) -> None:
        """One case of `cell` ended after `seconds` of a worker's time; NaN: not representative."""
        self.cases -= 1
        self.remaining[cell] -= 1
        if seconds == seconds:
            self.seen[cell] += 1
            before = self.mean[cell] if self.seen[cell] > 1 else seconds
            self.mean[cell] = before + (seconds - before) / min(self.seen[cell], 10)

    @property
    def eta(self) -> float | None:
        """Seconds left; None while less than half of the cells with cases left was seen.

        A cell never seen counts as the median of those seen: the first case of a flight carries
        the simulation and the library, and must not stand for all.
        """
        remaining, mean = np.array(self.remaining), np.array(self.mean)
        seen = np.isfinite(mean)
        if not remaining.any():
            return 0.0
        if not seen.any() or 2 * (seen & (remaining > 0)).sum() < (remaining > 0).sum():
            return None
        return float(remaining @ np.where(seen, mean, np.median(mean[seen]))) / self.processes
