"""Outcomes of jobs from the workers of a dask cluster, on one machine or on many.

A task is a few jobs. It runs them through a pool of its own (`pool.py`) on the machine of the dask
worker, so that limits hold there as here, and a case that hangs or dies costs its own row, not the
worker. Where a dask worker itself is lost, dask gives its tasks to another one; jobs that have cost
several workers are tried one by one, and one that does it again is `crashed`.
"""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from itertools import islice
from typing import Any

from sparsefit.errors import InputError, MissingExtra, described
from sparsefit.study.run.lines import Record, outcome_of, record_of
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.pool import Timed, outcomes
from sparsefit.study.run.worker import Job
from sparsefit.study.spec.study import Study

LARGEST = 32  # jobs of a task: a process starts for each task
SHARES = 4  # tasks for every hand, at least, so that all end at about the same time
AHEAD = 2  # tasks for every hand that are handed out at once
CONNECT_SECONDS = 30.0

Told = list[tuple[Record, float]]


def outcomes_on_dask(
    study: Study,
    jobs: Iterator[Job],
    count: int,
    *,
    scheduler: str | None,
    processes: int,
    stop: Callable[[], bool],
) -> Generator[Timed, None, None]:
    """Every cell of every one of the ``count`` jobs, as its task ends, with the seconds it took.

    scheduler: its address, or None for a cluster of ``processes`` workers on this machine, which
    ends with the run. Once ``stop`` says so, no task is begun that is not handed out.

    Raises:
        MissingExtra: dask is not installed.
        InputError: the scheduler cannot be reached, or has no workers.
    """
    dask = distributed()
    with ExitStack() as stack:
        client = _client(dask, scheduler, processes, stack)
        hands = sum(client.nthreads().values())
        if not hands:
            raise InputError(f"the dask scheduler {scheduler} has no workers yet: start some first")
        size = max(1, min(LARGEST, count // (SHARES * hands)))
        yield from _Tasks(dask, client, study, hands * AHEAD).results(_chunks(jobs, size), stop)


class _Tasks:
    """Tasks that are handed out, and the jobs of each."""

    def __init__(self, dask: Any, client: Any, study: Study, most: int) -> None:
        self._client, self._most, self._study = client, most, study
        self._there = client.scatter(study, broadcast=True)
        self._ended = dask.as_completed()
        self._jobs: dict[str, Sequence[Job]] = {}

    def results(
        self, chunks: Iterator[list[Job]], stop: Callable[[], bool]
    ) -> Generator[Timed, None, None]:
        for chunk in islice(chunks, self._most):
            self._submit(chunk)
        while self._jobs:
            future = next(self._ended)
            given = self._jobs.pop(future.key)
            if future.status == "finished":
                for record, seconds in future.result():
                    yield outcome_of(record), seconds
            else:
                yield from self._failed(given, future)
            if not stop():
                for chunk in islice(chunks, 1):
                    self._submit(chunk)

    def _submit(self, given: Sequence[Job]) -> None:
        future = self._client.submit(do_jobs, self._there, list(given), pure=False)
        self._jobs[future.key] = given
        self._ended.add(future)

    def _failed(self, given: Sequence[Job], future: Any) -> Iterator[Timed]:
        """Jobs of a task that has cost dask workers are tried alone, and then given up."""
        if len(given) > 1 or not given[0].deaths:
            for job in given:
                self._submit([replace(job, deaths=1)])
            return
        error = future.exception()
        reason = f"the dask task failed: {described(error)}"
        for cell in given[0].cells:
            yield Outcome(given[0].flight, cell, "crashed", reason), float("nan")


def do_jobs(study: Study, jobs: Sequence[Job]) -> Told:
    """On a dask worker: what comes of these jobs, from a process that can be killed."""
    # A dask worker is a daemon, which multiprocessing lets start nothing; ours end with it anyway.
    current: Any = multiprocessing.current_process()
    current._config["daemon"] = False
    return [(record_of(outcome), seconds) for outcome, seconds in outcomes(study, jobs, 1)]


def _chunks(jobs: Iterator[Job], size: int) -> Iterator[list[Job]]:
    while chunk := list(islice(jobs, size)):
        yield chunk


def _client(dask: Any, scheduler: str | None, processes: int, stack: ExitStack) -> Any:
    if scheduler is None:
        cluster = dask.LocalCluster(
            n_workers=processes, threads_per_worker=1, dashboard_address=None, processes=True
        )
        return stack.enter_context(dask.Client(stack.enter_context(cluster)))
    try:
        return stack.enter_context(dask.Client(scheduler, timeout=CONNECT_SECONDS))
    except (OSError, ValueError) as error:
        cause = described(error)
        raise InputError(f"the dask scheduler {scheduler} cannot be reached: {cause}") from None


def distributed() -> Any:
    """The package of dask's scheduler; MissingExtra where it is not installed."""
    try:
        return import_module("distributed")
    except ImportError:
        raise MissingExtra(
            "dask is not installed: pip install 'sparsefit[dask]', or leave --executor out"
        ) from None
