"""Outcomes of all jobs from killable workers: one that hangs or dies takes only its case along."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait

from sparsefit.errors import SparsefitError
from sparsefit.study.run.channel import GARBLED, Garbled
from sparsefit.study.run.outcome import READING, Outcome, Stage
from sparsefit.study.run.worker import Job, Ready, Worker
from sparsefit.study.spec.study import Study

START_SECONDS = 180.0
MAX_DEATHS = 3
MAX_KILLED = 30  # while they started, in a row: who is killed from outside starts anew
TICK = 0.5  # seconds between looks at the clock, at most
ASLEEP = 3.0  # seconds between them after which this process itself must have been stopped

Timed = tuple[Outcome, float]


def outcomes(
    study: Study,
    jobs: Iterable[Job],
    processes: int,
    stop: Callable[[], bool] | None = None,
) -> Generator[Timed, None, None]:
    """Every cell of every job, as it ends, with the seconds it took; workers end with it.

    Once ``stop`` says so, no fit is begun that is not under way.
    """
    pool = _Pool(study, iter(jobs), processes, stop or _never)
    try:
        while pool.busy:
            pool.hire()
            yield from pool.collect()
    finally:
        for worker in pool.crew:
            worker.kill()


def _never() -> bool:
    return False


# Ours, as pebble times and blames whole tasks: cases that share a flight, a library and a path
# would each need a task of their own (36480 libraries instead of 2280 in one shipped study), and
# its busy workers outlive a parent that is killed.
@dataclass
class _Pool:
    """jobs: those never begun; queue: those to do next, among them what lost workers left.

    looked: when the clock was looked at last; of workers in a row that did not start, stillborn
    ended by themselves, and killed by a signal.
    """

    study: Study
    jobs: Iterator[Job]
    processes: int
    stop: Callable[[], bool]
    queue: deque[Job] = field(default_factory=deque)
    crew: list[Worker] = field(default_factory=list)
    looked: float = field(default_factory=time.monotonic)
    stillborn: int = 0
    killed: int = 0

    @property
    def busy(self) -> bool:
        if self.stop():
            return any(not worker.quiet for worker in self.crew)
        self._fill()
        return bool(self.queue) or any(worker.job for worker in self.crew)

    def _fill(self) -> None:
        while len(self.queue) < self.processes:
            job = next(self.jobs, None)
            if job is None:
                return
            self.queue.append(job)

    def hire(self) -> None:
        """Give idle workers a job; start workers while there is more to do than hands."""
        if self.stop():
            return
        for worker in self.crew:
            self._give(worker)
        self._fill()
        starting = sum(not worker.ready for worker in self.crew)
        wanted = min(self.processes - len(self.crew), len(self.queue) - starting)
        for _ in range(wanted):
            self.crew.append(Worker.start(self.study, patience=START_SECONDS))

    def _give(self, worker: Worker) -> None:
        if worker.idle and self.queue and not self.stop():
            worker.give(self.queue.popleft())
            self._fill()

    def collect(self) -> Generator[Timed, None, None]:
        """Wait until something happens, and say what."""
        if not self.crew:  # asked to stop before there was one
            return
        until = min(worker.deadline for worker in self.crew) - time.monotonic()
        watched = [worker.messages for worker in self.crew]
        sentinels = [worker.child.process.sentinel for worker in self.crew]
        wait([*watched, *sentinels], timeout=min(max(until, 0.0), TICK))
        self._excuse_sleep()
        for worker in list(self.crew):
            try:
                alive = yield from self._drain(worker)
            except Garbled:
                yield from self._lost(worker, "crashed", GARBLED)
                continue
            if not alive:
                worker.child.process.join(timeout=1.0)
                yield from self._lost(worker, "crashed", f"the worker process {worker.child.end}")
            elif time.monotonic() > worker.deadline:
                limit = f"took longer than {self.study.case_timeout:g} s"
                yield from self._lost(worker, "timeout", limit)
            elif worker.stage is None and worker.job and worker.deadline == float("inf"):
                yield from self._lost(worker, "crashed", "the worker process left its job")
            elif self.stop() and worker.quiet:
                self.crew.remove(worker)
                worker.kill()

    def _excuse_sleep(self) -> None:
        """What this process slept, suspended or stopped, its workers are not charged for."""
        now = time.monotonic()
        gap, self.looked = now - self.looked, now
        if gap > ASLEEP:
            for worker in self.crew:
                worker.excuse(gap - TICK)

    def _drain(self, worker: Worker) -> Generator[Timed, None, bool]:
        """Take the messages that have come, of one worker not for ever; False when it is gone."""
        alive = worker.child.process.is_alive()
        try:
            for message in worker.told():
                if isinstance(message, Stage) and message.name != READING and self.stop():
                    worker.stage = None  # what it was told before is done, and this is not begun
                    return True
                timed = worker.take(message)
                if timed:
                    yield timed
                if isinstance(message, Ready):
                    self.stillborn = self.killed = 0
                    self._give(worker)
        except (EOFError, OSError):
            return False
        return alive or worker.receiver.more

    def _lost(self, worker: Worker, status: str, cause: str) -> Generator[Timed, None, None]:
        """End a worker; rows for the cells it takes along, and the others back to the queue."""
        died_of_signal = (worker.child.process.exitcode or 0) < 0
        self.crew.remove(worker)
        worker.kill()
        if not worker.ready:
            self._not_started(cause, by_signal=died_of_signal)
            return
        if worker.job is None:
            return
        victims, rest = _sorted_out(worker, worker.job)
        if rest.cells:
            self.queue.appendleft(rest)
        stage = worker.stage.name if worker.stage else "the flight"
        for cell in victims:
            reason = f"{stage} {cause}" if status == "timeout" else f"{stage}: {cause}"
            yield Outcome(worker.job.flight, cell, status, reason), time.monotonic() - worker.since

    def _not_started(self, cause: str, *, by_signal: bool) -> None:
        """Another worker is started for it, unless that never helps."""
        self.killed += by_signal
        self.stillborn += not by_signal
        if by_signal and self.killed >= MAX_KILLED:
            raise SparsefitError(
                f"{self.killed} worker processes in a row were killed while they started ({cause}):"
                " free memory, or take fewer --processes, and run again to continue"
            )
        if not by_signal and self.stillborn >= MAX_DEATHS:
            raise SparsefitError(
                f"a worker process could not start ({cause}): in a script, call run() under "
                'if __name__ == "__main__"'
            )


def _sorted_out(worker: Worker, job: Job) -> tuple[list[int], Job]:
    """Cells that go down with the stage in progress, and the job that remains."""
    left = list(worker.todo)
    at_stake = set(worker.stage.cells) if worker.stage else set()
    victims = [cell for cell in left if cell in at_stake]
    if worker.stage and worker.stage.fits > 1:
        return [], replace(job, cells=tuple(left), alone=True)
    deaths = job.deaths + (not victims)
    if deaths >= MAX_DEATHS:
        victims = left
    taken = set(victims)
    return victims, replace(job, cells=tuple(c for c in left if c not in taken), deaths=deaths)
