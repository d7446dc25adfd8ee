"""Outcomes of all jobs from killable workers: one that hangs or dies takes only its case along."""

from __future__ import annotations

import signal
import time
from collections import deque
from collections.abc import Generator, Sequence
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait

from sparsefit.errors import SparsefitError
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.worker import Job, Worker
from sparsefit.study.spec.study import Study

START_SECONDS = 180.0
MAX_DEATHS = 3
MAX_MESSAGES = 256

Timed = tuple[Outcome, float]


def outcomes(study: Study, jobs: Sequence[Job], processes: int) -> Generator[Timed, None, None]:
    """Every cell of every job, as it ends, with the seconds it took; workers end with it."""
    pool = _Pool(study, deque(jobs), processes)
    try:
        while pool.busy:
            pool.hire()
            yield from pool.collect()
    finally:
        for worker in pool.crew:
            worker.kill()


# Ours, as pebble times and blames whole tasks: cases that share a flight, a library and a path
# would each need a task of their own (36480 libraries instead of 2280 in one shipped study), and
# its busy workers outlive a parent that is killed.
@dataclass
class _Pool:
    study: Study
    queue: deque[Job]
    processes: int
    crew: list[Worker] = field(default_factory=list)

    @property
    def busy(self) -> bool:
        return bool(self.queue) or any(worker.job for worker in self.crew)

    def hire(self) -> None:
        """Give idle workers a job; start workers while there is more to do than hands."""
        for worker in self.crew:
            if worker.idle and self.queue:
                worker.give(self.queue.popleft())
        starting = sum(not worker.ready for worker in self.crew)
        wanted = min(self.processes - len(self.crew), len(self.queue) - starting)
        for _ in range(wanted):
            self.crew.append(Worker.start(self.study, patience=START_SECONDS))

    def collect(self) -> Generator[Timed, None, None]:
        """Wait until something happens, and say what."""
        until = min(worker.deadline for worker in self.crew) - time.monotonic()
        watched = [worker.pipe for worker in self.crew]
        sentinels = [worker.process.sentinel for worker in self.crew]
        wait([*watched, *sentinels], timeout=min(max(until, 0.0), 1.0))
        for worker in list(self.crew):
            alive = yield from self._drain(worker)
            if not alive:
                yield from self._lost(worker, "crashed", _cause(worker))
            elif time.monotonic() > worker.deadline:
                limit = f"took longer than {self.study.case_timeout:g} s"
                yield from self._lost(worker, "timeout", limit)

    def _drain(self, worker: Worker) -> Generator[Timed, None, bool]:
        """Take messages that have come, of one worker not for ever; False when it is gone."""
        alive = worker.process.is_alive()
        for _ in range(MAX_MESSAGES):
            try:
                if not worker.pipe.poll():
                    return alive
                message = worker.pipe.recv()
            except (EOFError, OSError):
                return False
            timed = worker.take(message)
            if timed:
                yield timed
            if worker.idle and self.queue:
                worker.give(self.queue.popleft())
        return True

    def _lost(self, worker: Worker, status: str, cause: str) -> Generator[Timed, None, None]:
        """End a worker; rows for the cells it takes along, and the others back to the queue."""
        worker.process.join(timeout=1.0 if status == "crashed" else 0.0)
        cause = _cause(worker) if status == "crashed" else cause
        self.crew.remove(worker)
        worker.kill()
        if not worker.ready:
            raise SparsefitError(
                f"a worker process could not start ({cause}): in a script, call run() under "
                'if __name__ == "__main__"'
            )
        if worker.job is None:
            return
        victims, rest = _sorted_out(worker, worker.job)
        if rest.cells:
            self.queue.appendleft(rest)
        stage = worker.stage.name if worker.stage else "the flight"
        for cell in victims:
            reason = f"{stage} {cause}" if status == "timeout" else f"{stage}: {cause}"
            yield Outcome(worker.job.flight, cell, status, reason), time.monotonic() - worker.since


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
    rest = tuple(cell for cell in left if cell not in set(victims))
    return victims, replace(job, cells=rest, deaths=deaths)


def _cause(worker: Worker) -> str:
    code = worker.process.exitcode
    if code is None or code >= 0:
        return f"the worker process ended with exit code {code}"
    try:
        name = signal.Signals(-code).name
    except ValueError:
        name = f"signal {-code}"
    memory = " (out of memory?)" if name == "SIGKILL" else ""
    return f"the worker process died of {name}{memory}"
