"""Run a study: compute the cases that have no row, and leave finished results behind.

One run at a time holds a results folder. Rows are on the disk half a second after they are known;
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
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, SparsefitError, is_integer, one_of
from sparsefit.study.columns import FAILED, Outcome
from sparsefit.study.manifest import write_manifest
from sparsefit.study.plan import Plan
from sparsefit.study.pool import outcomes
from sparsefit.study.store import Store, clear, discard

Progress: TypeAlias = Callable[[int, int, float | None], None]
PROGRESS_SECONDS = 0.2  # not more often than an eye can follow


@dataclass(frozen=True)
class RunSummary:
    """The progress of a study, finished or not, and what a run did for it.

    statuses: counts of all rows; stale: how many are of other code than this; versions: how many
    each version made; dropped: rows of cases that the study no longer plans; damaged: rows that
    could not be read; resumed: rows that were there before the run, which computed `computed` cases
    in `seconds` [s] on `processes`.
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


def run(
    plan: Plan,
    folder: Path,
    *,
    processes: int | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    stale: bool = False,
    only: Sequence[str] = (),
    executor: str = "processes",
    scheduler: str | None = None,
    progress: Progress | None = None,
    stopping: Callable[[], None] | None = None,
) -> RunSummary:
    """Run a study into its folder: cases that have a row there are not computed again.

    A row counts for any study that plans its case: one that changed computes what is new, and
    keeps aside what it no longer plans.

    Args:
        processes: how many work, None for as many as there are processors.
        fresh: start over.
        retry_failed: compute cases again that ended as error, timeout or crashed.
        stale: compute cases again that other code has computed.
        only: compute no cases but those of these names.
        executor: "processes" of this machine, or "dask".
        scheduler: the address of dask's; None for a cluster of its own.
        progress: called with (cases done, cases planned, seconds left or None).
        stopping: called at the first interrupt, after which work at hand is finished.

    Raises:
        InputError: if the folder cannot be written, is in use, or is another study's.
        KeyboardInterrupt: interrupted; the rows so far are on the disk.
    """
    one_of("executor", executor, ("processes", "dask"))
    alone = plan.experiment.alone
    if scheduler is not None and executor != "dask":
        raise InputError(f"a scheduler is of dask, not of {executor}: add --executor dask")
    if processes is not None and not is_integer(processes, 1):
        raise InputError(f"processes must be a whole number of at least 1, not {processes!r}")
    if alone and (processes not in (None, 1) or executor != "processes"):
        words = "solvers are timed one at a time, here: leave --processes and --executor away"
        raise InputError(words)
    # In a container there are fewer processors than the machine has.
    here = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    count = 1 if alone else processes or len(here(0))
    compute: Callable[..., Generator[Outcome, None, None]] = outcomes
    if executor == "dask":
        from sparsefit.study.dask_executor import outcomes_on_dask

        compute = partial(outcomes_on_dask, scheduler)
    with locked(folder):
        if fresh:
            clear(folder)
        store = Store.read(folder, plan)
        wanted = ~store.done
        if retry_failed:
            wanted |= store.ended(*FAILED)
        if stale:
            wanted |= store.stale
        if only:
            wanted &= plan.named(only)
        wanted = plan.experiment.whole(wanted, store.done, store.version)
        if store.finished and not wanted.any():
            return RunSummary.of(store, resumed=plan.size)
        with Store.opened(folder, plan) as store:
            batches = plan.experiment.batches(wanted)
            with (
                counted_interrupts(stopping or (lambda: None)) as stop,
                closing(compute(plan.experiment, batches, count, stop, store.sync)) as arriving,
            ):
                summary = _stored(store, wanted, arriving, count, progress)
                if stop() and summary.computed < wanted.sum():
                    raise KeyboardInterrupt
            if summary.computed < wanted.sum():
                words = f"{wanted.sum() - summary.computed} cases ended without a row"
                raise SparsefitError(f"{folder}: {words}: run the study again for these")
            if summary.finished:
                remaining = store.export()
                definition = plan.experiment.definition
                content = {
                    "study": definition.name,
                    "study_hash": definition.hash,
                    "seed": definition.seed,
                    "cases": plan.size,
                    "statuses": dict(sorted(summary.statuses.items())),
                    "wall_seconds": round(summary.seconds, 3),
                    "resumed_cases": summary.resumed,
                    "processes": summary.processes,
                }
                write_manifest(folder, content)
        if summary.finished and not remaining:
            discard(folder)
    return summary


def _stored(
    store: Store,
    wanted: BoolArray,
    arriving: Iterator[Outcome],
    processes: int,
    progress: Progress | None,
) -> RunSummary:
    """Put outcomes into the store as they arrive."""
    plan, begun, shown = store.plan, time.monotonic(), -math.inf
    resumed, total = int((store.done & ~wanted).sum()), int(wanted.sum())
    computed = 0

    def show() -> None:
        spent = time.monotonic() - begun
        ahead = spent / computed * (total - computed) if computed else None
        if progress:
            progress(resumed + computed, resumed + total, ahead)

    show()
    for outcome in arriving:
        store.put(outcome, plan.versions[outcome.cell])
        computed += 1
        if computed == total or time.monotonic() - shown > PROGRESS_SECONDS:
            shown = time.monotonic()
            show()
    return RunSummary.of(
        store,
        resumed=resumed,
        computed=computed,
        seconds=time.monotonic() - begun,
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
