"""Outcomes of batches from killable workers: one that hangs or dies costs its own case.

Each slot of the pool runs a batch of the experiment as a coroutine: it yields an `Ask`, is sent the
answer of a worker (or how that was lost), and yields outcomes. The limit of an ask is kept here, on
the wall; time in which this process itself was stopped is not charged.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field, replace

from sparsefit.errors import SparsefitError
from sparsefit.study.columns import Outcome
from sparsefit.study.plan import Batch, Experiment, Step
from sparsefit.study.worker import Ask, Lost, Record, Worker, memory_limit, wait_for

MAX_STILLBORN = 3  # workers in a row that ended while they started
MAX_KILLED = 30  # or were killed from outside: memory may be free again later
TICK = 0.5  # seconds between looks at the clock, at most
ASLEEP = 3.0  # seconds between them after which this process itself must have been stopped


def outcomes(
    experiment: Experiment,
    batches: Iterator[Batch],
    processes: int,
    stop: Callable[[], bool] = lambda: False,
) -> Generator[Outcome, None, None]:
    """Every cell of every batch, as it ends; workers end with the generator.

    Once ``stop`` says so, nothing is asked that is not under way.
    """
    memory = memory_limit(experiment.definition.run.max_memory, processes)
    pool = Pool(experiment, batches, processes, memory, stop)
    try:
        yield from pool.run()
    finally:
        pool.close()
        experiment.end()


@dataclass
class Slot:
    """One place where a batch runs: its coroutine, the workers it asks, and the one at work.

    pending: the ask that waits for its worker to start; since: when the last outcome came; warm:
    whether a first case has paid for what a process loads on first use.
    """

    steps: Step | None = None
    crew: dict[str, Worker] = field(default_factory=dict)
    working: Worker | None = None
    pending: Ask | None = None
    since: float = 0.0
    warm: bool = False


# Ours, as pebble times and blames whole tasks: cases that share a flight, a library and a path
# would each need a task of their own (36480 libraries instead of 2280 in one shipped study), and
# its busy workers outlive a parent that is killed.
@dataclass
class Pool:
    """Slots and what is to be done; stillborn, killed: workers in a row that did not start."""

    experiment: Experiment
    batches: Iterator[Batch]
    processes: int
    memory: float
    stop: Callable[[], bool]
    slots: list[Slot] = field(default_factory=list)
    looked: float = field(default_factory=time.monotonic)
    stillborn: int = 0
    killed: int = 0

    def run(self) -> Generator[Outcome, None, None]:
        """All outcomes; a slot is added while there are batches and fewer than `processes`."""
        while True:
            while len(self.slots) < self.processes and not self.stop():
                slot = Slot()
                if not self._next(slot):
                    break
                self.slots.append(slot)
                yield from self._advance(slot, None)
            busy = [slot for slot in self.slots if slot.working]
            if not busy:
                return
            self._wait(busy)
            for slot in busy:
                assert slot.working is not None
                answer = slot.working.receive()
                if answer is not None:
                    yield from self._take(slot, answer)

    def close(self) -> None:
        """End every worker."""
        for slot in self.slots:
            for worker in slot.crew.values():
                worker.close()
            if slot.steps is not None:
                slot.steps.close()

    def _wait(self, busy: list[Slot]) -> None:
        """Until a worker says something, ends, or reaches its limit."""
        workers = [slot.working for slot in busy if slot.working]
        until = min(worker.deadline for worker in workers) - time.monotonic()
        wait_for(workers, min(until, TICK))
        now = time.monotonic()
        gap, self.looked = now - self.looked, now
        if gap > ASLEEP:
            for slot, worker in zip(busy, workers, strict=True):
                worker.excuse(gap - TICK)
                slot.since += gap - TICK

    def _take(self, slot: Slot, answer: Record | Lost) -> Generator[Outcome, None, None]:
        """The message of a slot's worker: it has started, has answered, or was lost."""
        ask, worker = slot.pending, slot.working
        slot.pending = slot.working = None
        if isinstance(answer, Lost):
            slot.crew = {name: item for name, item in slot.crew.items() if item is not worker}
            slot.warm = False
            if not answer.started and ask is not None:
                self._count_unstarted(answer)
                yield from self._ask(slot, ask)
                return
        elif ask is not None:
            self.stillborn = self.killed = 0
            yield from self._ask(slot, ask)
            return
        yield from self._advance(slot, answer)

    def _advance(self, slot: Slot, answer: Record | Lost | None) -> Generator[Outcome, None, None]:
        """Go on with the batch of a slot, and with the next, until a worker is at work."""
        while slot.steps is not None or self._next(slot):
            assert slot.steps is not None
            try:
                event = slot.steps.send(answer)
            except StopIteration:
                slot.steps, answer = None, None
                if self.stop():
                    return
                continue
            answer = None
            if isinstance(event, Ask):
                if not self.stop():
                    yield from self._ask(slot, event)
                return
            now = time.monotonic()
            # The first case of a process pays for what is loaded on first use.
            spent = now - slot.since if slot.warm else math.nan
            slot.since, slot.warm = now, True
            yield replace(event, seconds_spent=spent)

    def _ask(self, slot: Slot, ask: Ask) -> Generator[Outcome, None, None]:
        """Ask the worker that the ask is for; one that is not there is started first."""
        worker = slot.crew.get(ask.desk)
        if worker is None:
            make, content = self.experiment.desk(ask.desk)
            memory = self.memory
            slot.crew[ask.desk] = slot.working = Worker.start(make, content, memory=memory)
            slot.pending = ask
            return
        worker.send(ask)
        slot.working = worker
        yield from ()

    def _next(self, slot: Slot) -> bool:
        """Begin the next batch; whether there is one."""
        batch = None if self.stop() else next(self.batches, None)
        if batch is None:
            return False
        slot.steps, slot.since = self.experiment.run(batch), time.monotonic()
        return True

    def _count_unstarted(self, lost: Lost) -> None:
        """Another worker is started for one that did not, unless that never helps."""
        self.killed += lost.by_signal
        self.stillborn += not lost.by_signal
        if self.killed >= MAX_KILLED:
            raise SparsefitError(
                f"{self.killed} worker processes in a row were killed while they started "
                f"({lost.reason}): free memory, or take fewer --processes, and run it again"
            )
        if self.stillborn >= MAX_STILLBORN:
            raise SparsefitError(
                f"a worker process could not start ({lost.reason}): in a script, call run() under "
                'if __name__ == "__main__"'
            )
