"""Run a study: compute the cases that have no row, and leave finished results behind.

One run at a time holds a results folder. Rows are on the disk half a second after they are known;
an interrupted run, by Ctrl-C or SIGKILL, goes on from there.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from sparsefit.errors import InputError, is_integer
from sparsefit.study.manifest import write_manifest
from sparsefit.study.plan import Plan
from sparsefit.study.pool import outcomes
from sparsefit.study.store import Store, clear, discard
from sparsefit.whole_file import refusing

Progress: TypeAlias = Callable[[int, int, float | None], None]


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
        statuses, versions = (Counter(filter(None, all_)) for all_ in (store.status, store.version))
        counts = (statuses, int(store.stale.sum()), versions, store.unplanned, store.damaged)
        return cls(store.folder, store.plan.size, *counts, **run)

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
    scheduler: str | None = None,
    progress: Progress | None = None,
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
        scheduler: the address of a dask scheduler, whose workers compute in place of processes of
            this machine.
        progress: called with (cases done, cases planned, seconds left or None).

    Raises:
        InputError: if the folder cannot be written, is in use, or is another study's.
        KeyboardInterrupt: interrupted; the rows so far are on the disk.
    """
    experiment, begun, shown = plan.experiment, time.monotonic(), 0.0
    if processes is not None and not is_integer(processes, 1):
        raise InputError(f"processes must be a whole number of at least 1, not {processes!r}")
    if experiment.alone and (processes not in (None, 1) or scheduler):
        words = "solvers are timed one at a time, here: leave --processes and --scheduler away"
        raise InputError(words)
    # In a container there are fewer processors than the machine has.
    here = getattr(os, "sched_getaffinity", lambda _: range(os.cpu_count() or 1))
    count = 1 if experiment.alone else processes or len(here(0))
    with locked(folder):
        if fresh:
            clear(folder)
        store = Store.read(folder, plan)
        wanted = ~store.done
        if retry_failed:
            wanted |= store.failed
        if stale:
            wanted |= store.stale
        if only:
            wanted &= plan.named(only)
        wanted = experiment.whole(wanted, store.done, store.version)
        if store.finished and not wanted.any():
            return RunSummary.of(store, resumed=plan.size)
        experiment.check()
        resumed, total, computed = int((store.done & ~wanted).sum()), int(wanted.sum()), 0
        with Store.opened(folder, plan) as store:
            batches = experiment.batches(wanted)
            if scheduler:
                from sparsefit.study.dask_executor import outcomes_on_dask

                arriving = outcomes_on_dask(scheduler, experiment, batches, store.sync)
            else:
                arriving = outcomes(experiment, batches, count, store.sync)
            tell = progress or (lambda *_: None)
            tell(resumed, resumed + total, None)
            with closing(arriving):
                for outcome in arriving:
                    store.put(outcome, plan.versions[outcome.cell])
                    computed, spent = computed + 1, time.monotonic() - begun
                    if computed == total or spent - shown > 0.2:  # [s], what an eye can follow
                        shown = spent
                        ahead = spent / computed * (total - computed)
                        tell(resumed + computed, resumed + total, ahead)
            seconds = time.monotonic() - begun
            made = {"resumed": resumed, "computed": computed, "seconds": seconds}
            summary = RunSummary.of(store, **made, processes=count)
            if summary.finished:
                remaining = store.export()
                definition = experiment.definition
                content = {
                    "study": definition.name,
                    "study_hash": definition.hash,
                    "seed": definition.seed,
                    "cases": plan.size,
                    "statuses": dict(sorted(summary.statuses.items())),
                    "wall_seconds": round(seconds, 3),
                    "resumed_cases": resumed,
                    "processes": count,
                }
                write_manifest(folder, content)
        if summary.finished and not remaining:
            discard(folder)
    return summary


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder, made if need be, against other runs by a lock that goes with its process.

    Raises:
        InputError: if another run holds it, or the folder cannot be written.
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
