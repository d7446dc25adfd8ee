"""Run a study: resume what is there, do what is missing, and leave finished results behind."""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np

from sparsefit.errors import InputError, is_integer
from sparsefit.study.run import partial
from sparsefit.study.run.folder import (
    Outcomes,
    clear,
    is_finished,
    made_folder,
    refuse_foreign,
    resume,
)
from sparsefit.study.run.lock import locked
from sparsefit.study.run.manifest import write_manifest
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.pace import Pace
from sparsefit.study.run.pool import outcomes
from sparsefit.study.run.worker import Job
from sparsefit.study.spec.plan import fit_key, flight_key, sharing
from sparsefit.study.spec.study import Study

Progress: TypeAlias = Callable[[int, int, float | None], None]
Publish: TypeAlias = Callable[[Study, Path], None]

PROGRESS_SECONDS = 0.2


@dataclass(frozen=True)
class RunSummary:
    """What a run did: `resumed` rows were there before; `statuses` counts all rows.

    `solver_seconds` of `processes` times `seconds` were spent in the back-ends.
    """

    folder: Path
    planned: int
    resumed: int
    statuses: Mapping[str, int]
    seconds: float
    solver_seconds: float = 0.0
    processes: int = 1

    @property
    def nothing_to_do(self) -> bool:
        """Whether the study was finished before."""
        return self.resumed == self.planned


@dataclass(frozen=True)
class RunStatus:
    """How far a study is, finished or not: counts of its rows by status."""

    folder: Path
    planned: int
    done: int
    finished: bool
    statuses: Mapping[str, int]


def run(
    study: Study,
    results_dir: str | Path = "results",
    *,
    processes: int | None = None,
    progress: Progress | None = None,
    fresh: bool = False,
    publish: Publish | None = None,
) -> RunSummary:
    """Run `study` into `results_dir/<name>`; interrupted, it goes on from there the next time.

    Args:
        processes: worker processes; as many as there are processors when None.
        progress: called with (cases done, cases planned, seconds left or None).
        fresh: start over, whatever the folder holds.
        publish: called with the study and its folder once all rows are there, be it from now or
            from before: what draws tables and figures from them.

    Raises:
        InputError: if the folder cannot be written, is in use, or is another study's.
    """
    workers = _checked_processes(processes)
    folder = made_folder(study, results_dir)
    with locked(folder):
        if fresh:
            clear(folder)
        refuse_foreign(study, folder)
        if is_finished(folder):
            summary = RunSummary(folder, study.planned, study.planned, _statuses(folder), 0.0)
        else:
            summary = _finish(study, folder, workers, progress)
        if publish:
            publish(study, folder)
    return summary


def _finish(study: Study, folder: Path, processes: int, progress: Progress | None) -> RunSummary:
    """Do what is missing; only when all of it is written are the unfinished rows let go."""
    begun = time.monotonic()
    known = resume(study, folder)
    done = _work(study, folder, dict(known), processes, progress)
    seconds = time.monotonic() - begun
    statuses = Counter(outcome.status for outcome in done.values())
    fresh = [outcome for key, outcome in done.items() if key not in known]
    solving = solver_seconds(study, fresh)
    from sparsefit.study.run.store import write_cases  # data frames: workers import this module

    write_cases(study, done.values(), folder)
    write_manifest(
        study,
        folder,
        statuses=statuses,
        wall_seconds=seconds,
        solver_seconds=solving,
        processes=processes,
        resumed=len(known),
    )
    partial.discard(folder)
    counted = (study.planned, len(known), statuses, seconds)
    return RunSummary(folder, *counted, solver_seconds=solving, processes=processes)


def solver_seconds(study: Study, rows: Iterable[Outcome]) -> float:
    """Seconds in back-ends: what several cases or fits share is counted once."""
    fits: dict[tuple[int, object], float] = {}
    for outcome in rows:
        seconds = float(outcome["seconds"])
        if not math.isnan(seconds):
            fit = (outcome.flight, fit_key(study.cells[outcome.cell]))
            fits[fit] = seconds - outcome.shared_seconds
    return float(sum(fits.values()))


def status(study: Study, results_dir: str | Path = "results") -> RunStatus:
    """How far `study` is in `results_dir/<name>`; changes nothing, also while it runs."""
    folder = Path(results_dir) / study.name
    refuse_foreign(study, folder)
    if is_finished(folder):
        return RunStatus(folder, study.planned, study.planned, True, _statuses(folder))
    rows = partial.read_rows(folder)
    statuses = Counter(outcome.status for outcome in rows.values())
    return RunStatus(folder, study.planned, len(rows), False, statuses)


def _statuses(folder: Path) -> Counter[str]:
    """How many cases of a finished study ended in each status."""
    from sparsefit.study.run.store import read_cases

    return Counter(read_cases(folder)["status"])


def _work(
    study: Study,
    folder: Path,
    done: Outcomes,
    processes: int,
    progress: Progress | None,
) -> Outcomes:
    """Everything that is not in `done`; each row is on the disk before the next is waited for."""
    left = np.full(len(study.cells), study.count, np.int64)
    for _, cell in done:
        left[cell] -= 1
    pace = Pace.start(left, processes)
    report = _Report(study.planned, progress)
    report.say(len(done), pace)
    todo = jobs(study, done)
    with (
        partial.appending(folder) as rows,
        closing(outcomes(study, todo, min(processes, max(len(todo), 1)))) as arriving,
    ):
        for outcome, seconds in arriving:
            rows.append(outcome)
            done[outcome.flight, outcome.cell] = outcome
            pace.note(outcome.cell, seconds)
            report.say(len(done), pace)
    return done


def jobs(study: Study, done: Outcomes) -> list[Job]:
    """What is missing, one job per flight and variant of it: nothing is simulated twice."""
    variants = [[cell.index for cell in group] for group in sharing(study.cells, flight_key)]
    missing = (
        Job(flight, tuple(index for index in variant if (flight, index) not in done))
        for flight in range(study.count)
        for variant in variants
    )
    return [job for job in missing if job.cells]


@dataclass
class _Report:
    """Tells how far the run is, not more often than an eye can follow."""

    planned: int
    progress: Progress | None
    last: float = float("-inf")

    def say(self, done: int, pace: Pace) -> None:
        now = time.monotonic()
        if self.progress and (done == self.planned or now - self.last > PROGRESS_SECONDS):
            self.last = now
            self.progress(done, self.planned, pace.eta)


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
