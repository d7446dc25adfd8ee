"""Outcomes of batches from killable workers: one that hangs or dies costs its own case.

Each slot of the pool runs a batch of the experiment as a coroutine: it yields an `Ask`, is sent the
`Answer` of a worker, and yields outcomes. Limits are kept here, on the wall; time in which this
process itself was stopped is not charged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field

from sparsefit.errors import SparsefitError
from sparsefit.study.columns import Outcome
from sparsefit.study.plan import Batch, Experiment, Step
from sparsefit.study.worker import Answer, Ask, Worker, memory_limit, wait_for

TICK = 0.5  # seconds between looks at the clock, at most


def outcomes(
    experiment: Experiment,
    batches: Iterator[Batch],
    processes: int,
    stop: Callable[[], bool] = lambda: False,
    idle: Callable[[float], None] = lambda patience: None,
) -> Generator[Outcome, None, None]:
    """Every cell of every batch as it ends.

    Workers end with the generator. Once ``stop`` says so, nothing is asked that is not under way.
    ``idle`` is called before workers are waited for, with the longest [s] that this takes.
    """
    pool = Pool(experiment, batches, processes, stop, idle)
    try:
        yield from pool.run()
    finally:
        for slot in pool.slots:
            for worker in slot.crew.values():
                worker.close()
            if slot.steps is not None:
                slot.steps.close()
        experiment.end()


@dataclass(eq=False)
class Slot:
    """One place where a batch runs: its coroutine, its workers by desk, and what one is asked."""

    steps: Step | None = None
    crew: dict[str, Worker] = field(default_factory=dict)
    ask: Ask | None = None


# Ours, as pebble times and blames whole tasks: cases that share a flight, a library and a path
# would each need a task of their own (36480 libraries instead of 2280 in one shipped study), and
# its busy workers outlive a parent that is killed.
@dataclass(eq=False)
class Pool:
    """Slots and what is to be done; stillborn, killed: workers in a row that did not start."""

    experiment: Experiment
    batches: Iterator[Batch]
    processes: int
    stop: Callable[[], bool]
    idle: Callable[[float], None]
    slots: list[Slot] = field(default_factory=list)
    stillborn: int = 0
    killed: int = 0

    def run(self) -> Iterator[Outcome]:
        """All outcomes; a slot is added while there are batches and fewer than `processes`."""
        looked = time.monotonic()
        while True:
            while len(self.slots) < self.processes and self._next(slot := Slot()):
                self.slots.append(slot)
                yield from self._advance(slot, None)
            busy = [(slot, slot.crew[slot.ask.desk]) for slot in self.slots if slot.ask]
            if not busy:
                return
            self.idle(TICK)
            until = min(worker.deadline for _, worker in busy) - time.monotonic()
            wait_for([worker for _, worker in busy], min(until, TICK))
            gap, looked = time.monotonic() - looked, time.monotonic()
            for slot, worker in busy:
                if gap > 6.0 * TICK:  # this process itself was stopped
                    worker.deadline += gap - TICK
                answer = worker.receive()
                if answer is not None:
                    yield from self._take(slot, answer)

    def _take(self, slot: Slot, answer: Answer) -> Iterator[Outcome]:
        """Go on with the answer of a slot's worker; one that did not even start is replaced."""
        ask, slot.ask = slot.ask, None
        assert ask is not None
        if answer.lost:
            slot.crew.pop(ask.desk)
        if answer.started:
            self.stillborn = self.killed = 0
            yield from self._advance(slot, answer)
            return
        self.killed += answer.by_signal
        self.stillborn += not answer.by_signal
        if self.killed >= 30:  # memory may be free again later
            raise SparsefitError(
                f"{self.killed} worker processes in a row were killed while they started "
                f"({answer.reason}): free memory, or take fewer --processes, and run it again"
            )
        if self.stillborn >= 3:
            raise SparsefitError(f"a worker process could not start ({answer.reason})")
        self._send(slot, ask)

    def _advance(self, slot: Slot, answer: Answer | None) -> Iterator[Outcome]:
        """Go on with the batch of a slot, and with the next, until a worker is at work.

        Outcomes are told once it is: it does not wait for what is done with them.
        """
        ended = []
        while slot.steps is not None or self._next(slot):
            assert slot.steps is not None
            try:
                event = slot.steps.send(answer)
            except StopIteration:
                slot.steps = event = None
            answer = None
            if isinstance(event, Ask):
                if not self.stop():
                    self._send(slot, event)
                break
            if event is not None:
                ended.append(event)
        yield from ended

    def _send(self, slot: Slot, ask: Ask) -> None:
        """Ask the worker of a desk, which is started where there is none."""
        if ask.desk not in slot.crew:
            make, arguments = self.experiment.desk(ask.desk)
            memory = memory_limit(self.experiment.definition.run.max_memory, self.processes)
            slot.crew[ask.desk] = Worker.start(make, arguments, memory=memory)
        slot.ask = ask
        slot.crew[ask.desk].send(ask)

    def _next(self, slot: Slot) -> bool:
        """Begin the next batch; whether there is one."""
        batch = None if self.stop() else next(self.batches, None)
        if batch is not None:
            slot.steps = self.experiment.run(batch)
        return batch is not None
