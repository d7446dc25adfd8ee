"""A worker: a process that runs foreign code, one request at a time, and is killed at its limit.

    worker = Worker(Desk, (definition,), memory=2000.0)      # Desk(definition) lives in there
    worker.ask("cases", {"unit": 3}, limit=60.0).content     # what its method `cases` returns

    in_child(work, 4, seconds=60.0)                          # one call, and its value

Limits and times are the parent's. A request is a pickle; an answer is one line of JSON with the
number of its request; the worker is killed after any other message. It computes in one thread, in a
process group of its own, which Ctrl-C does not reach. `guardian` ends it with all processes that it
has started. A desk is the object whose methods are requested.
"""

from __future__ import annotations

import gc
import json
import math
import os
import pickle
import resource
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any, BinaryIO

from sparsefit.errors import InputError, SparsefitError, described, one_line
from sparsefit.study import guardian
from sparsefit.whole_file import refusing

# The cores are shared among processes: threads in each would only compete for them.
ONE_THREAD = dict.fromkeys(
    (
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"),
        *("VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS"),
        "RAYON_NUM_THREADS",
    ),
    "1",
)
START_SECONDS = 180.0
STARTS = 5  # in a row that may fail: at fewer, memory may be free again later
TICK = 0.5  # seconds between looks at the clock, at most
GARBLED = "the message channel of the worker process was written into"


@dataclass(frozen=True)
class Answer:
    """The value of a desk's method, its wall time [s] by the parent's clock, and its CPU time [s].

    cpu: of the worker and all processes that it started; NaN where the request was not timed.
    """

    content: Mapping[str, Any]
    wall: float
    cpu: float


class NoAnswerError(Exception):
    """A request without an answer; the reason names the work.

    status: "error" where the method raised, "timeout" where the worker was killed at its limit,
    "crashed" where it died or broke the protocol.
    """

    def __init__(self, status: str, reason: str, work: str = "") -> None:
        named = {"timeout": f"{work} {reason}", "crashed": f"{work}: {reason}"}
        self.status, self.reason = status, named.get(status, reason) if work else reason
        super().__init__(self.status, self.reason)

    @property
    def lost(self) -> bool:
        """Whether the worker has ended."""
        return self.status in ("timeout", "crashed")


def serve(
    asks: BinaryIO,
    answers: BinaryIO,
    make: Callable[..., object],
    arguments: tuple[Any, ...],
    memory: float,
) -> None:
    """The worker's main loop: make the desk, which is answer 0, then answer each request.

    A copy of the process, from code that forks, ends before it answers.
    """
    warnings.simplefilter("ignore")
    with suppress(ValueError, OSError, OverflowError):  # OverflowError: no limit
        most = int(memory * 1e6)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))  # of Linux, private memory
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    owner, number, desk, verb, content = os.getpid(), 0, None, "", {}
    while True:
        try:
            answer = None
            if desk is None:
                desk = make(*arguments)
                gc.collect()
                gc.freeze()  # later collections skip what is loaded now
            else:
                answer = getattr(desk, verb)(**content)
            line = json.dumps({"number": number, "answer": answer or {}})
        except BaseException as error:  # foreign code may raise anything, SystemExit too
            reason = described(error)
            if isinstance(error, MemoryError):
                gc.collect()
                reason = f"memory: {reason}"
            line = json.dumps({"number": number, "error": reason})
        if os.getpid() != owner:
            os._exit(0)
        try:
            answers.write(f"{line}\n".encode())
            answers.flush()
            number, verb, content = pickle.load(asks)
        except (EOFError, OSError):  # the parent is gone
            return


def memory_limit(requested: float | None, processes: int) -> float:
    """Memory [MB] of a worker: as requested, or its share of the machine's, 256 at the least."""
    if requested is not None:
        return requested
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    with suppress(OSError, ValueError):  # of a container, which may have less
        total = min(total, int(Path("/sys/fs/cgroup/memory.max").read_text()) / 1e6)
    return max(0.8 * total / processes, 256.0)


class Worker:
    """The parent's side of a process with the desk ``make(*arguments)``.

    memory: its limit [MB]; stop: an event, set when its answers are no longer needed; home: the
    `scratch` folder of its temporary files.

    Raises:
        NoAnswerError: the process died, or making the desk raised.
    """

    def __init__(
        self,
        make: Callable[..., object],
        arguments: tuple[Any, ...] = (),
        *,
        memory: float = math.inf,
        stop: Event | None = None,
        home: Path | None = None,
    ) -> None:
        files = {"TMPDIR": str(home)} if home else {}
        self._process = subprocess.Popen(
            [sys.executable, "-P", guardian.__file__, *files.values()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            process_group=0,
            env={**os.environ, **ONE_THREAD, **files},
        )
        pipes: Any = (self._process.stdin, self._process.stdout)
        self._requests, self._answers = pipes
        self._poll, self._room = select.poll(), select.poll()
        self._poll.register(self._answers, select.POLLIN)
        self._room.register(self._requests, select.POLLOUT)
        os.set_blocking(self._requests.fileno(), False)
        self._buffer, self._stop, self._number = bytearray(), stop or Event(), 0
        with self._ending():
            self._write(sys.path, (serve, (make, arguments, memory)))
            self._answer(self._line(START_SECONDS), raised="crashed")

    @property
    def alive(self) -> bool:
        """Whether it takes requests."""
        return not self._requests.closed

    def ask(
        self, verb: str, content: Mapping[str, Any], limit: float, *, work: str = "",
        timed: bool = False,
    ) -> Answer:  # fmt: skip
        """Call a method of the desk, killed after `limit` [s]; work: its name in a reason.

        Raises:
            NoAnswerError: the method raised, took longer than the limit, or the process died.
            CancelledError: `stop` was set.
        """
        with self._ending(work):
            self._number += 1
            cpu, begun = cpu_seconds(self._process.pid) if timed else math.nan, time.perf_counter()
            self._write((self._number, verb, dict(content)))
            line = self._line(limit)
            wall = time.perf_counter() - begun
            cpu = cpu_seconds(self._process.pid) - cpu if timed else math.nan
            return Answer(self._answer(line), wall, cpu)

    @contextmanager
    def _ending(self, work: str = "") -> Iterator[None]:
        """Close the worker where its answer is lost, and name the work in the reason."""
        try:
            yield
        except NoAnswerError as failed:
            if failed.lost:
                self.close()
            raise NoAnswerError(failed.status, failed.reason, work) from None
        except BaseException:
            self.close()
            raise

    def _write(self, *messages: object) -> None:
        with suppress(BrokenPipeError):  # it has died: `_line` raises
            for message in messages:
                content = memoryview(pickle.dumps(message, protocol=5))  # arrays are not copied
                while content:
                    if not self._room.poll(1e3 * START_SECONDS):
                        raise NoAnswerError("timeout", "took no request")
                    content = content[self._requests.write(content) or 0 :]

    def _line(self, seconds: float) -> bytes:
        """The next line, within a time [s] that leaves out how long this process was stopped."""
        seen = time.monotonic()
        deadline = seen + seconds
        while b"\n" not in self._buffer:
            if self._stop.is_set():
                raise CancelledError
            heard = self._poll.poll(1e3 * min(max(deadline - seen, 0.0), TICK))
            before, seen = seen, time.monotonic()
            if seen - before > 6.0 * TICK:  # this process was stopped
                deadline += seen - before - TICK
            if heard:
                chunk = os.read(self._answers.fileno(), 1 << 16)
                if not chunk:
                    raise NoAnswerError("crashed", self._end())
                self._buffer += chunk
            if len(self._buffer) > 64 << 20:
                raise NoAnswerError("crashed", GARBLED)
            if seen > deadline and b"\n" not in self._buffer:
                raise NoAnswerError("timeout", f"took longer than {seconds:g} s")
        line, _, self._buffer = self._buffer.partition(b"\n")
        return bytes(line)

    def _answer(self, line: bytes, *, raised: str = "error") -> dict[str, Any]:
        """The value in an answer to the last request; raised: the status of one that raised."""
        try:
            match json.loads(line):
                case {"number": self._number, "answer": dict(value)} if not self._buffer:
                    return value
                case {"number": self._number, "error": str(error)} if not self._buffer:
                    raise NoAnswerError(raised, error)
        except (ValueError, RecursionError):
            pass
        raise NoAnswerError("crashed", GARBLED)

    def _end(self) -> str:
        """A description of the end of a process that has closed its channel."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        code = self._process.returncode
        if code is None:
            return "the worker process closed its message channel"
        words, number = f"ended with exit code {code}", -code if code < 0 else code - 128
        if number > 0:
            name = signal.Signals(number).name if number in signal.valid_signals() else number
            words = f"died of {name}{' (out of memory?)' if name == 'SIGKILL' else ''}"
        return f"the worker process {words}"

    def close(self) -> None:
        """End the process and all that it has started, and wait for its end."""
        self._process.terminate()
        self._requests.close()
        try:
            self._process.wait(10.0)
        except subprocess.TimeoutExpired:  # stopped by the code that it guards
            self._process.kill()
            self._process.wait()
        self._answers.close()


@dataclass(eq=False)
class Crew:
    """The workers of one slot.

    desk: returns the class of a desk and its arguments, by name; home: the `scratch` folder of
    their files; memory: the limit of each [MB]; stop: set when answers are no longer needed.
    """

    desk: Callable[[str], tuple[type, tuple[Any, ...]]]
    home: Path
    memory: float
    stop: Event
    _workers: dict[str, Worker] = field(default_factory=dict)

    def worker(self, desk: str) -> Worker:
        """The worker of a desk, started where there is none or it has ended."""
        reason = ""
        if desk in self._workers and self._workers[desk].alive:
            return self._workers[desk]
        limits: Any = {"memory": self.memory, "stop": self.stop, "home": self.home}
        for _ in range(STARTS):
            try:
                worker = self._workers[desk] = Worker(*self.desk(desk), **limits)
                return worker
            except (NoAnswerError, OSError) as failed:
                reason = failed.reason if isinstance(failed, NoAnswerError) else described(failed)
        raise SparsefitError(
            f"{STARTS} worker processes in a row ended while they started ({reason}): free "
            "memory, or take fewer --processes"
        )

    def close(self) -> None:
        """End the workers."""
        for worker in self._workers.values():
            worker.close()


@contextmanager
def scratch() -> Iterator[Path]:
    """A folder for the files of a run and of its workers, which is removed at the end.

    Where the run is killed, `guardian` removes it.
    """
    with refusing("the folder of temporary files"):
        home = Path(tempfile.mkdtemp(prefix="sparsefit-study-"))
    try:
        yield home
    finally:
        shutil.rmtree(home, ignore_errors=True)


def cpu_seconds(pid: int) -> float:
    """CPU time [s] of a process and its children; NaN where the system does not report it."""
    total = math.nan
    with suppress(OSError, OverflowError):
        # The number of the clock of another process, as of `clock_getcpuclockid` of Linux.
        total = time.clock_gettime((~pid << 3) | 2)
    with suppress(OSError, ValueError):
        words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
        ended = sum(map(int, words[13:15])) / os.sysconf("SC_CLK_TCK")
        total += ended + sum(map(cpu_seconds, guardian.children_of(pid)))
    return total


def disturbed(wall: float, cpu: float) -> bool:
    """Whether the wall time [s] exceeds the CPU time [s] by 10 % and the clocks' own .2 ms."""
    return wall > 1.1 * cpu + 2e-4


def peak_memory() -> float:
    """The peak resident memory [MB] of this process."""
    unit = 1e6 if sys.platform == "darwin" else 1e3  # bytes and kilobytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


class _Caller:
    """The desk of `in_child`: any function."""

    def call(self, work: Callable[..., Any], arguments: Sequence[Any]) -> Mapping[str, Any]:
        """The value of a function, or the message of its SparsefitError."""
        try:
            return {"value": work(*arguments)}
        except SparsefitError as error:
            return {"refused": one_line(str(error))}


def in_child(work: Callable[..., Any], *arguments: object, seconds: float) -> Any:
    """The value of ``work(*arguments)``, JSON-ready, computed in another process.

    Raises:
        InputError: ``work`` raised, or the process died or took longer than ``seconds``.
    """
    try:
        with closing(Worker(_Caller)) as worker:
            answer = worker.ask("call", {"work": work, "arguments": arguments}, seconds).content
    except NoAnswerError as failed:
        raise InputError(failed.reason.replace("the worker process", "its process")) from None
    if "value" not in answer:
        raise InputError(str(answer.get("refused", "its process returned no value")))
    return answer["value"]
