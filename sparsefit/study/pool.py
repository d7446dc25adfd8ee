"""Outcomes of batches from killable workers: one that hangs or dies costs its own case.

Each slot runs batches of the experiment as coroutines: they yield an `Ask`, are sent the `Answer`
of a worker, and yield outcomes. Limits are kept here, on the wall; time in which this process
itself was stopped is not charged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass, field

from sparsefit.errors import SparsefitError
from sparsefit.study.columns import Outcome
from sparsefit.study.plan import Asking, Batch, Experiment
from sparsefit.study.worker import Answer, Ask, Worker, memory_limit, wait_for

TICK = 0.5  # seconds between looks at the clock, at most


# Ours, as pebble times and blames whole tasks: cases that share a flight, a library and a path
# would each need a task of their own (36480 libraries instead of 2280 in one shipped study), and
# its busy workers outlive a parent that is killed.
def outcomes(
    experiment: Experiment,
    batches: Iterator[Batch],
    processes: int,
    idle: Callable[[float], None] = lambda patience: None,
) -> Generator[Outcome, None, None]:
    """Every cell of every batch as it ends; workers end with the generator.

    ``idle`` is called before workers are waited for, with the longest [s] that this takes.
    """
    memory = memory_limit(experiment.definition.rules.max_memory, processes)
    slots = [Slot(experiment, _steps(experiment, batches), memory) for _ in range(processes)]
    lost, looked = 0, time.monotonic()
    try:
        for slot in slots:
            yield from slot.go_on(None)
        while busy := [(slot, slot.crew[slot.ask.desk]) for slot in slots if slot.ask]:
            idle(TICK)
            until = min(worker.deadline for _, worker in busy) - time.monotonic()
            wait_for([worker for _, worker in busy], min(until, TICK))
            gap, looked = time.monotonic() - looked, time.monotonic()
            for slot, worker in busy:
                if gap > 6.0 * TICK:  # this process itself was stopped
                    worker.deadline += gap - TICK
                if (answer := worker.receive()) is None:
                    continue
                lost = 0 if answer.started else lost + 1
                if lost >= 5:  # at fewer, memory may be free again later
                    raise SparsefitError(
                        f"{lost} worker processes in a row ended while they started "
                        f"({answer.reason}): free memory, or take fewer --processes"
                    )
                yield from slot.go_on(answer)
    finally:
        for slot in slots:
            for worker in slot.crew.values():
                worker.close()
            slot.steps.close()
        experiment.end()


def _steps(experiment: Experiment, batches: Iterator[Batch]) -> Asking[None]:
    for batch in batches:
        yield from experiment.run(batch)


@dataclass(eq=False)
class Slot:
    """One place where batches run: their steps, its workers by desk, and what one is asked."""

    experiment: Experiment
    steps: Asking[None]
    memory: float
    crew: dict[str, Worker] = field(default_factory=dict)
    ask: Ask | None = None

    def go_on(self, answer: Answer | None) -> list[Outcome]:
        """Go on with an answer until a worker is at work, or nothing is left to do.

        A worker that did not even start is replaced, and asked again.
        """
        ask, self.ask = self.ask, None
        if ask and answer and answer.lost:
            self.crew.pop(ask.desk)
        if ask and answer and not answer.started:
            self._send(ask)
            return []
        ended = list[Outcome]()
        while True:
            try:
                event = self.steps.send(answer)
            except StopIteration:
                return ended
            answer = None
            if isinstance(event, Ask):
                self._send(event)
                return ended
            ended.append(event)

    def _send(self, ask: Ask) -> None:
        """Ask the worker of a desk, which is started where there is none."""
        if ask.desk not in self.crew:
            make, arguments = self.experiment.desk(ask.desk)
            self.crew[ask.desk] = Worker.start(make, arguments, memory=self.memory)
        self.ask = ask
        self.crew[ask.desk].send(ask)
