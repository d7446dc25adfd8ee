"""Run a study: compute what is not there, and leave finished results behind."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, SparsefitError, is_integer, one_of
from sparsefit.study.run import partial
from sparsefit.study.run.again import Again, stale
from sparsefit.study.run.folder import clear, made_folder
from sparsefit.study.run.held import begin, found, is_finished
from sparsefit.study.run.interrupts import counted_interrupts
from sparsefit.study.run.kind import Kind, Place, Spent
from sparsefit.study.run.kinds import kind_of
from sparsefit.study.run.ledger import Ledger
from sparsefit.study.run.lock import locked
from sparsefit.study.run.manifest import write_manifest
from sparsefit.study.run.pace import Pace
from sparsefit.study.run.summary import RunStatus, RunSummary
from sparsefit.study.run.unplanned import set_aside, take_back
from sparsefit.study.spec.identity import AnyStudy

Progress: TypeAlias = Callable[[int, int, float | None], None]
Publish: TypeAlias = Callable[[AnyStudy, Path], None]

EXECUTORS = ("processes", "dask")
PROGRESS_SECONDS = 0.2


def run(
    study: AnyStudy,
    results_dir: str | Path = "results",
    *,
    processes: int | None = None,
    progress: Progress | None = None,
    fresh: bool = False,
    retry_failed: bool = False,
    renew_stale: bool = False,
    only: Sequence[str] = (),
    publish: Publish | None = None,
    stopping: Callable[[], None] | None = None,
    executor: str = "processes",
    scheduler: str | None = None,
) -> RunSummary:
    """Run `study` into `results_dir/<name>`: cases that have a row there are not computed again.

    A row counts for any study that plans its case: one that changed computes what is new, and
    keeps aside what it no longer plans. Interrupted, it goes on from there the next time.

    Args:
        processes: worker processes; as many as there are processors when None.
        progress: called with (cases done, cases planned, seconds left or None).
        fresh: start over, whatever the folder holds.
        retry_failed: compute cases again that ended as error, timeout or crashed.
        renew_stale: compute cases again that other code than this has computed.
        only: names of back-ends, labels or protocols (`*` for any letters), or case ids; no other
            case is computed, and the study may stay unfinished.
        publish: called with the study and its folder once all rows are there, be it from now or
            from before: what draws tables and figures from them.
        stopping: called at the first interrupt, after which what is under way is finished.
        executor: "processes" of this machine, or "dask": the workers of the ``scheduler`` at this
            address, or of a local cluster where there is none.

    Raises:
        InputError: if the folder cannot be written, is in use, or is another study's.
        KeyboardInterrupt: interrupted; the rows so far are on the disk.
    """
    workers = _checked_processes(processes)
    one_of("executor", executor, EXECUTORS)
    if scheduler is not None and executor != "dask":
        raise InputError(f"a scheduler is of dask, not of {executor}: add --executor dask")
    kind = kind_of(study)
    place = kind.placed(Place(executor, scheduler, workers), asked=processes)
    again = Again(retry_failed, renew_stale, tuple(only))
    folder = made_folder(study, results_dir)
    with locked(folder):
        if fresh:
            clear(folder)
        ledger = found(study, folder)
        take_back(ledger, folder)
        wanted = again.wanted(ledger)
        if is_finished(study, folder, ledger) and not wanted.any():
            summary = _summary(folder, ledger, resumed=study.planned)
        else:
            this = _Run(study, folder, ledger, progress, stopping, place, kind)
            summary = this.finish(wanted)
        if publish and summary.finished:
            publish(study, folder)
    return summary


@dataclass(frozen=True)
class _Run:
    """One run of a study in its folder, and what the folder held."""

    study: AnyStudy
    folder: Path
    ledger: Ledger
    progress: Progress | None
    stopping: Callable[[], None] | None
    place: Place
    kind: Kind

    def finish(self, wanted: BoolArray) -> RunSummary:
        """Do what is wanted; only when all rows are written are the unfinished ones let go."""
        begun = time.monotonic()
        ledger, known = self.ledger, int((self.ledger.done & ~wanted).sum())
        time_in_solvers = self.kind.spent()
        self._begin()
        missing = wanted & ~self._work(wanted, time_in_solvers)
        if missing.any():
            raise SparsefitError(
                f"{int(missing.sum())} cases of {self.study.name} ended without a row: run the "
                "study again; what was computed is there"
            )
        seconds, solving = time.monotonic() - begun, time_in_solvers.total
        if ledger.done.all():
            self._write(known, seconds, solving)
        return _summary(
            self.folder,
            ledger,
            resumed=known,
            computed=int(wanted.sum()),
            seconds=seconds,
            solver_seconds=solving,
            processes=self.place.processes,
        )

    def _begin(self) -> None:
        """What an earlier run left goes where the rows of this one will be."""
        from sparsefit.study.run.earlier import earlier_rows  # Arrow: workers import this module

        begin(self.study, self.folder)
        with partial.appending(self.folder) as rows:
            for outcome in earlier_rows(self.ledger, self.folder):
                self.ledger.enter(rows, outcome)

    def _work(self, wanted: BoolArray, solving: Spent) -> BoolArray:
        """Each row is on the disk before the next is waited for; which of those wanted came."""
        ledger, kind = self.ledger, self.kind
        versions = [kind.version(cell) for cell in range(len(self.study.cells))]
        came = np.zeros_like(wanted)
        pace = Pace.start(wanted.sum(axis=0), self.place.processes)
        kept = int((ledger.done & ~wanted).sum())
        report = _Report(kept + int(wanted.sum()), self.progress, kept)
        report.say(pace)
        with (
            counted_interrupts(self.stopping or _nothing) as stop,
            partial.appending(self.folder) as rows,
            closing(kind.compute(wanted, self.place, stop)) as arriving,
        ):
            for outcome, seconds in arriving:
                ledger.enter(rows, replace(outcome, version=versions[outcome.cell]))
                came[outcome.flight, outcome.cell] = True
                solving.note(outcome)
                pace.note(outcome.cell, seconds)
                report.done += 1
                report.say(pace)
            if stop() and not came[wanted].all():
                raise KeyboardInterrupt
        return came

    def _write(self, known: int, seconds: float, solving: float) -> None:
        from sparsefit.study.run.store import write_rows  # data frames, as above

        set_aside(self.ledger, self.folder)
        write_rows(self.study, lambda: self.ledger.rows(self.folder), self.folder)
        write_manifest(
            self.study,
            self.folder,
            statuses=self.ledger.statuses,
            wall_seconds=seconds,
            solver_seconds=solving,
            processes=self.place.processes,
            resumed=known,
            more=self.kind.made_with(),
        )
        partial.discard(self.folder)


def _nothing() -> None:
    """Nobody is told."""


def _summary(
    folder: Path,
    ledger: Ledger,
    *,
    resumed: int,
    computed: int = 0,
    seconds: float = 0.0,
    solver_seconds: float = 0.0,
    processes: int = 1,
) -> RunSummary:
    return RunSummary(
        folder,
        ledger.study.planned,
        resumed,
        ledger.statuses,
        seconds,
        solver_seconds,
        processes,
        computed,
        stale=int(stale(ledger).sum()),
        dropped=ledger.unplanned,
        damaged=ledger.damaged,
    )


def status(study: AnyStudy, results_dir: str | Path = "results") -> RunStatus:
    """How far `study` is in `results_dir/<name>`; changes nothing, also while it runs."""
    folder = Path(results_dir) / study.name
    ledger = found(study, folder)
    finished = is_finished(study, folder, ledger)
    counted = (ledger.statuses, int(stale(ledger).sum()), ledger.versions)
    return RunStatus(folder, study.planned, int(ledger.done.sum()), finished, *counted)


@dataclass
class _Report:
    """Tells how far the run is, not more often than an eye can follow."""

    planned: int
    progress: Progress | None
    done: int
    last: float = float("-inf")

    def say(self, pace: Pace) -> None:
        now = time.monotonic()
        if self.progress and (self.done == self.planned or now - self.last > PROGRESS_SECONDS):
            self.last = now
            self.progress(self.done, self.planned, pace.eta)


def _checked_processes(processes: int | None) -> int:
    if processes is None:
        return _processors()
    if not is_integer(processes, 1):
        raise InputError(f"processes must be a whole number of at least 1, not {processes!r}")
    return processes


def _processors() -> int:
    """Those this process may use, which in a container are fewer than there are."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
