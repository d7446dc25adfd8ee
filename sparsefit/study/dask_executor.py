"""Outcomes of batches from the workers of a dask cluster, on one machine or on many.

A task is a few batches. It runs them through a pool of its own (`pool`) on the machine of the dask
worker, so that limits hold there as here, and a case that hangs or dies costs its own row, not the
worker. Where a dask worker itself is lost, dask gives its tasks to another; batches that have cost
several workers are tried one by one, and one that does it again is `crashed`.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence

from sparsefit.errors import InputError, described, optional
from sparsefit.study.columns import Outcome
from sparsefit.study.plan import Batch, Experiment
from sparsefit.study.pool import outcomes


def outcomes_on_dask(
    scheduler: str,
    experiment: Experiment,
    batches: Iterable[Batch],
    idle: Callable[[float], None],
) -> Generator[Outcome, None, None]:
    """Every cell of every batch, as its task ends, from the scheduler at an address.

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
        hands = sum(client.nthreads().values())
        if not hands:
            raise InputError(f"the dask scheduler {scheduler} has no workers yet: start some first")
        every = list(batches)
        # A process starts for each task; all are to end at about the same time.
        size = max(1, min(32, len(every) // (4 * hands)))
        there = client.scatter(experiment, broadcast=True)
        ended, given, tried = dask.as_completed(), dict[str, list[Batch]](), set[Batch]()

        def submit(chunk: list[Batch]) -> None:
            future = client.submit(run_batches, there, chunk, pure=False)
            given[future.key] = chunk
            ended.add(future)

        for start in range(0, len(every), size):
            submit(every[start : start + size])
        for future in ended:
            mine = given.pop(future.key)
            if future.status == "finished":
                yield from future.result()
            elif tried.isdisjoint(mine):
                tried.update(mine)
                for batch in mine:
                    submit([batch])
            else:
                reason = f"the dask task failed: {described(future.exception())}"
                for batch in mine:
                    yield from (
                        Outcome(batch.unit, cell, "crashed", reason) for cell in batch.cells
                    )
            idle(0.0)


def run_batches(experiment: Experiment, batches: Sequence[Batch]) -> list[Outcome]:
    """On a dask worker: the outcomes of batches, from a process that can be killed."""
    return list(outcomes(experiment, iter(batches), 1))
