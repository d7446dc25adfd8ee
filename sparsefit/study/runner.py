"""Run a study: compute the cases that have no row, and write the finished results.

A results folder is locked by one run at a time. Rows are written to disk within half a second; a
run that was interrupted, by Ctrl-C or SIGKILL, is resumed from there. `merge` collects parts that
ran in several places, with `--only` for instance.

Each process has a slot, a thread in which the plan takes batches and sends requests to the workers
of a crew: foreign code runs in workers only, and a case that hangs or dies ends in its own row.

On a dask cluster a task is a few batches. It runs them in a slot on the machine of the dask worker,
so that limits hold there as well and a case that hangs or dies does not end the dask worker. Where
a dask worker itself is lost, dask gives its tasks to another; the cases of a task that fails twice
are `crashed`.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import closing, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event
from typing import Any, NamedTuple, TypeAlias

from sparsefit.errors import InputError, described, is_integer, optional
from sparsefit.study.columns import Outcome
from sparsefit.study.plan import Batch, Plan
from sparsefit.study.store import CASES, MANIFEST, STORE, Row, Store, check_whole, discard
from sparsefit.study.worker import TICK, Crew, memory_limit, scratch
from sparsefit.whole_file import refusing

PAGES = ("README.md", "report.html")  # that tell of rows
Progress: TypeAlias = Callable[[int, int, float | None], None]


@dataclass(frozen=True)
class RunSummary:
    """The progress of a study, finished or not, and of its last run.

    statuses: counts of all rows; stale: of rows of another version of the code; versions: of rows
    by version; dropped: rows of cases that the study no longer plans; damaged: rows that could not
    be read; written: whether `cases.parquet` has the rows; resumed: rows from before the run, which
    computed `computed` cases in `seconds` [s] on `processes`.
    """

    folder: Path
    planned: int
    statuses: Mapping[str, int]
    stale: int = 0
    versions: Mapping[str, int] = field(default_factory=dict)
    dropped: int = 0
    damaged: int = 0
    written: bool = True
    resumed: int = 0
    computed: int = 0
    seconds: float = 0.0
    processes: int = 1

    @classmethod
    def of(cls, store: Store, **run: Any) -> RunSummary:
        """The summary of a store."""
        of_all = (store.status, store.version)
        statuses, versions = (Counter(filter(None, values.flat)) for values in of_all)
        counts = (statuses, int(store.stale.sum()), versions, store.unplanned, store.damaged)
        return cls(store.folder, store.plan.size, *counts, **run)

    @property
    def done(self) -> int:
        """The number of rows."""
        return sum(self.statuses.values())

    @property
    def finished(self) -> bool:
        """Whether every planned case is a row of `cases.parquet`."""
        return self.written and self.done == self.planned


def run(
    plan: Plan,
    folder: Path,
    *,
    processes: int | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    stale: bool = False,
    only: Sequence[str] = (),
    scheduler: str | None = None,
    progress: Progress | None = None,
) -> RunSummary:
    """Compute the cases of a study that have no row in its folder.

    A row is valid for any study that plans its case: a study that has changed computes its new
    cases, and drops those that it no longer plans once it is finished.

    The options are those of `Study.run`, and so are the errors.
    """
    begun, shown = time.monotonic(), 0.0
    if processes is not None and not is_integer(processes, 1):
        raise InputError(f"processes must be a whole number of at least 1, not {processes!r}")
    if plan.alone and (processes not in (None, 1) or scheduler):
        words = "solvers are timed one at a time, here: leave --processes and --scheduler away"
        raise InputError(words)
    # A container may have fewer processors than the machine.
    here = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    count = 1 if plan.alone else processes or len(here(0))
    named = plan.named(only) if only else True
    with locked(folder), dask_client(scheduler) if scheduler else nullcontext() as client:
        if fresh:
            plan.check()  # before rows are discarded
            discard(folder, CASES, MANIFEST, *PAGES)
        store = Store.read(folder, plan)
        wanted = ~store.done | (store.failed & retry_failed) | (store.stale & stale)
        wanted = plan.whole(wanted & named, store.version)
        if store.finished and not wanted.any():
            return RunSummary.of(store, resumed=plan.size)
        plan.check()
        resumed, total, computed = int((store.done & ~wanted).sum()), int(wanted.sum()), 0
        with Store.opened(folder, plan) as store:
            batches = plan.batches(wanted)
            if client:
                arriving, patience = outcomes_on_dask(client, plan, batches), 0.0
            else:
                arriving, patience = outcomes(plan, batches, count), TICK
            tell, first = progress or (lambda *_: None), (0, 0.0)
            tell(resumed, resumed + total, None)
            with closing(arriving):
                for together in arriving:
                    for outcome in together:
                        store.put(outcome, plan.versions[outcome.cell])
                    store.sync(patience)
                    computed, now = computed + len(together), time.monotonic()
                    first = first if first[0] else (computed, now)
                    if computed == total or now - shown > 0.2:  # [s], what an eye can follow
                        done = computed - first[0]  # without those beside the start of workers
                        ahead = (now - first[1]) / done * (total - computed) if done > 4 else None
                        tell(resumed + computed, resumed + total, ahead)
                        shown = now
            seconds = round(time.monotonic() - begun, 3)
            made = {"resumed": resumed, "computed": computed, "seconds": seconds}
            summary = RunSummary.of(store, **made, processes=count)
            if summary.finished:
                statuses = dict(sorted(summary.statuses.items()))
                work = {"wall_seconds": seconds, "resumed_cases": resumed}
                store.export({"statuses": statuses, **work, "processes": count})
        if summary.finished:
            discard(folder)
    return summary


# Not pebble, whose limits are of whole tasks: cases that share a flight, a library and a path would
# each need a task of their own (36480 libraries instead of 2280 in one shipped study), and its busy
# workers outlive a parent that is killed.
def outcomes(
    plan: Plan, batches: Iterator[Batch], processes: int
) -> Generator[list[Outcome], None, None]:
    """The outcome of every cell of every batch as it ends; workers end with the generator.

    Those that arrive together are a list; an empty one follows each `TICK` without any.
    """
    arriving, stop = SimpleQueue[list[Outcome] | Future[None]](), Event()
    memory, waiting = memory_limit(plan.definition.run.max_memory, processes), deque(batches)

    def taken() -> Iterator[Batch]:
        with suppress(IndexError):  # empty
            while True:
                yield waiting.popleft()

    def work() -> None:
        with scratch() as home, closing(Crew(plan.desk, home, memory, stop)) as crew:
            for together in plan.run(taken(), crew):
                arriving.put(together)

    ended = 0
    with ThreadPoolExecutor(processes) as slots:
        try:
            for _ in range(processes):
                slots.submit(work).add_done_callback(arriving.put)
            while ended < processes:
                event: list[Outcome] | Future[None] = []
                with suppress(Empty):
                    event = arriving.get(timeout=TICK)
                if isinstance(event, Future):
                    event.result()  # raises what has ended the slot
                    ended += 1
                else:
                    yield event
        finally:
            stop.set()


@contextmanager
def dask_client(scheduler: str) -> Iterator[Any]:
    """The client of the dask scheduler at an address.

    Raises:
        MissingExtra: dask is not installed.
        InputError: the scheduler cannot be reached, or has no workers.
    """
    dask = optional("distributed", "dask is not installed, leave --scheduler out or", "dask")
    try:
        connected = dask.Client(scheduler, timeout=10.0)
    except (OSError, ValueError) as error:
        cause = described(error)
        raise InputError(f"the dask scheduler {scheduler} cannot be reached: {cause}") from None
    with connected as client:
        if not client.nthreads():
            raise InputError(f"the dask scheduler {scheduler} has no workers yet: start some first")
        yield client


def outcomes_on_dask(
    client: Any, plan: Plan, batches: Iterable[Batch]
) -> Generator[list[Outcome], None, None]:
    """The outcomes of every batch, as its task ends on a dask worker."""
    from distributed import as_completed

    every = list(batches)
    # A process starts for each task; all are to end at about the same time.
    size = max(1, min(32, len(every) // (4 * max(sum(client.nthreads().values()), 1))))
    chunks = [every[start : start + size] for start in range(0, len(every), size)]
    there = client.scatter(replace(plan), broadcast=True)  # without cached columns
    tasks = client.map(run_batches, chunks, plan=there, pure=False, retries=1)
    chunk_of = dict(zip(tasks, chunks, strict=True))
    for task in as_completed(tasks):
        if task.status == "finished":
            yield task.result()
        else:
            reason = f"the dask task failed: {described(task.exception())}"
            for batch in chunk_of[task]:
                yield [Outcome(batch.unit, cell, "crashed", reason) for cell in batch.cells]
        task.release()


def run_batches(batches: Sequence[Batch], plan: Plan) -> list[Outcome]:
    """The outcomes of batches, computed on a dask worker in a process that can be killed."""
    return list(chain.from_iterable(outcomes(plan, iter(batches), 1)))


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Create the folder and lock it against other runs; the lock ends with its process.

    Raises:
        InputError: if another run has locked it, or the folder cannot be written.
    """
    with refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
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


class MergedPart(NamedTuple):
    """A folder that was merged: the number of its rows, and of those that were new."""

    folder: Path
    rows: int
    taken: int


def merge(plan: Plan, folder: Path, parts: Sequence[str | Path]) -> list[MergedPart]:
    """Copy the rows of other results folders of a study into its own.

    A Parquet file needs its checksum in the manifest beside it. Once all rows are there the study
    is finished, as if it had been run here. The errors are those of `Study.merge`.
    """
    name = plan.definition.name
    if plan.alone:
        words = "its solvers are timed by turns, in one run: there is nothing to merge"
        raise InputError(f"{name}: {words}")
    merged, stored = list[MergedPart](), dict[Path, list[Row]]()
    for part in map(Path, parts):
        if (part / CASES).is_file():
            check_whole(part / CASES, strict=True)
        elif not (part / STORE).is_file():
            raise InputError(f"{part}: holds no rows of {name}: give a results folder of the study")
        stored[part] = Store.read(part, plan, "leave this part out").rows()
    with locked(folder):
        rows = {row.case_id: (folder, row) for row in Store.read(folder, plan).rows()}
        for part, theirs in stored.items():
            for row in theirs:
                first, other = rows.setdefault(row.case_id, (part, row))
                if not row.agrees(other):
                    words = f"differs between {first} and {part}: leave one of them out"
                    raise InputError(f"case {row.case_id} {words}")
            taken = sum(first is part for first, _ in rows.values())  # of its own folder, none
            merged.append(MergedPart(part, len(theirs), taken))
        with Store.opened(folder, plan) as own:
            for first, row in rows.values():
                if first != folder:
                    own.put_row(row)
    if len(rows) == plan.size:  # only its order is left
        run(plan, folder, processes=1)
    return merged
