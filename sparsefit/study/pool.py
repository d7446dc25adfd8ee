"""Outcomes of batches from killable workers: a case that hangs or dies ends in its own row.

Each slot is a thread, in which the plan takes batches and sends requests to the workers of a
crew. Foreign code runs in workers only.

On a dask cluster a task is a few batches. It runs them in a slot on the machine of the dask worker,
so that limits hold there as well and a case that hangs or dies does not end the dask worker. Where
a dask worker itself is lost, dask gives its tasks to another; the batches of a task that fails are
tried one by one, and one that fails again is `crashed`.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import chain
from queue import Empty, SimpleQueue
from threading import Event, Lock, Thread
from typing import Any

from sparsefit.errors import InputError, described, optional
from sparsefit.study.columns import Outcome
from sparsefit.study.plan import Batch, Plan
from sparsefit.study.worker import TICK, Crew, memory_limit, scratch


# Not pebble, whose limits are of whole tasks: cases that share a flight, a library and a path would
# each need a task of their own (36480 libraries instead of 2280 in one shipped study), and its busy
# workers outlive a parent that is killed.
def outcomes(
    plan: Plan,
    batches: Iterator[Batch],
    processes: int,
) -> Generator[list[Outcome], None, None]:
    """The outcome of every cell of every batch as it ends; workers end with the generator.

    Those that arrive together are a list; an empty one follows each `TICK` without any.
    """
    arriving, stop, lock = SimpleQueue[list[Outcome] | BaseException | None](), Event(), Lock()

    def taken() -> Iterator[Batch]:
        while True:
            with lock:
                batch = next(batches, None)
            if batch is None:
                return
            yield batch

    memory = memory_limit(plan.definition.rules.max_memory, processes)

    def work() -> None:
        try:
            with (
                scratch() as home,
                closing(Crew(plan.desk, home, memory, stop)) as crew,
            ):
                for together in plan.run(taken(), crew):
                    arriving.put(together)
            arriving.put(None)
        except BaseException as error:
            arriving.put(error)

    slots = [Thread(target=work) for _ in range(processes)]
    try:
        for slot in slots:
            slot.start()
        ended = 0
        while ended < processes:
            try:
                event = arriving.get(timeout=TICK)
            except Empty:
                event = []
            if event is None:
                ended += 1
            elif isinstance(event, BaseException):
                raise event
            else:
                yield event
    finally:
        stop.set()
        for slot in slots:
            if slot.ident is not None:  # started
                slot.join()


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

    hands = sum(client.nthreads().values())
    every = list(batches)
    # A process starts for each task; all are to end at about the same time.
    size = max(1, min(32, len(every) // (4 * max(hands, 1))))
    there = client.scatter(replace(plan), broadcast=True)  # without cached columns
    ended, given, tried = as_completed(), dict[str, list[Batch]](), set[Batch]()

    def submit(chunk: list[Batch]) -> None:
        future = client.submit(run_batches, there, chunk, pure=False)
        given[future.key] = chunk
        ended.add(future)

    for start in range(0, len(every), size):
        submit(every[start : start + size])
    for future in ended:
        mine = given.pop(future.key)
        if future.status == "finished":
            yield future.result()
        elif tried.isdisjoint(mine):
            tried.update(mine)
            for batch in mine:
                submit([batch])
        else:
            reason = f"the dask task failed: {described(future.exception())}"
            for batch in mine:
                yield [Outcome(batch.unit, cell, "crashed", reason) for cell in batch.cells]


def run_batches(plan: Plan, batches: Sequence[Batch]) -> list[Outcome]:
    """The outcomes of batches, computed on a dask worker in a process that can be killed."""
    return list(chain.from_iterable(outcomes(plan, iter(batches), 1)))
