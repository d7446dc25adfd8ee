"""A process in which code of others runs, asked one thing at a time, and killed at its limit.

    worker = Worker.start(Desk, (definition,), memory=2000.0)   # Desk(definition) lives in there
    worker.send(Ask("cases", {"unit": 3}, limit=60.0))
    worker.receive()                                            # None while it works; an Answer

    in_child(work, 4, seconds=60.0)                             # one call, and its value

The parent keeps limit and clock, whatever the process says. An ask is a pickle; an answer is one
line of JSON with its checksum and the number of its ask, and all else that comes through the
channel ends the process. A worker computes in one thread, in a group of processes of its own,
which Ctrl-C does not reach; `guardian` ends it and all that it has started.
"""

from __future__ import annotations

import gc
import json
import math
import os
import pickle
import resource
import select
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO
from zlib import crc32

from sparsefit.errors import InputError, SparsefitError, described, one_line
from sparsefit.study import guardian

# Processes share the work; threads inside each would only fight for the same cores.
ONE_THREAD = dict.fromkeys(
    (
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"),
        *("VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS"),
        "RAYON_NUM_THREADS",
    ),
    "1",
)
START_SECONDS = 180.0
GARBLED = "the message channel of the worker process was written into"


@dataclass(frozen=True)
class Ask:
    """A method of a desk that a worker is to call within `limit` seconds [s] on the wall.

    desk: which process of several is asked, so that code of others shares none with ours; timed:
    whether the answer tells its seconds.
    """

    verb: str
    content: Mapping[str, Any]
    limit: float
    desk: str = ""
    timed: bool = False


@dataclass(frozen=True)
class Answer:
    """The outcome of an ask.

    status: "ok", with its content; "error" of the code that was asked; "timeout" or "crashed" where
    the process was killed at its limit or died, with the reason. wall, cpu: seconds [s] by the
    parent's clock, the second of the process and of all that it started. started: whether the
    process ever began to answer.
    """

    status: str
    reason: str = ""
    content: Mapping[str, Any] = field(default_factory=dict)
    wall: float = math.nan
    cpu: float = math.nan
    started: bool = True

    @property
    def lost(self) -> bool:
        """Whether the process is gone."""
        return self.status in ("timeout", "crashed")

    def words(self, work: str) -> str:
        """The reason, with the work that was lost: `fitting took longer than 6 s`."""
        between = {"timeout": " ", "crashed": ": "}.get(self.status)
        return f"{work}{between}{self.reason}" if between else self.reason


def packed(record: Mapping[str, Any]) -> bytes:
    """One line: a CRC-32 and the JSON of the record; ValueError or TypeError where it has none."""
    body = json.dumps(record, separators=(",", ":")).encode()
    return b"%08x %s\n" % (crc32(body), body)


def unpacked(line: bytes) -> dict[str, Any]:
    """The record of a line without its end; empty where it is not whole."""
    if line[8:9] != b" " or line[:8] != b"%08x" % crc32(line[9:]):
        return {}
    try:
        record = json.loads(line[9:])
    except (ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def serve(
    asks: BinaryIO,
    answers: int,
    make: Callable[..., object],
    arguments: tuple[Any, ...],
    memory: float,
) -> None:
    """The life of the process: make the desk, which is answer 0, and answer until no ask comes.

    A copy of it, made by code that forks, ends where it would answer.
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
                gc.freeze()  # later collections pass over what is loaded now
            else:
                answer = getattr(desk, verb)(**content)
            line = packed({"number": number, "answer": answer or {}})
        except MemoryError as error:
            gc.collect()
            line = packed({"number": number, "error": f"memory: {described(error)}"})
        except BaseException as error:  # code of others may raise anything, SystemExit too
            line = packed({"number": number, "error": described(error)})
        if os.getpid() != owner:
            os._exit(0)
        try:
            while line:
                line = line[os.write(answers, line) :]
            number, verb, content = pickle.load(asks)
        except (EOFError, OSError):  # the parent is gone
            return


def memory_limit(requested: float | None, processes: int) -> float:
    """Megabytes [MB] that a worker may take: those asked for, or its share of the machine's."""
    if requested is not None:
        return requested
    total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    with suppress(OSError, ValueError):  # of a container, which may have less
        total = min(total, int(Path("/sys/fs/cgroup/memory.max").read_text()) / 1e6)
    return 0.8 * total / max(processes, 1)


@dataclass(eq=False)
class Worker:
    """The parent's end of a process: the guardian, and the two pipes of the worker.

    number: of the last ask; started: whether the desk is made; ask: what it is to do; sent: when,
    on the wall and of CPU [s]; deadline: when it is killed.
    """

    process: subprocess.Popen[bytes]
    asks: int
    answers: int
    deadline: float
    number: int = 0
    started: bool = False
    ask: Ask | None = None
    sent: tuple[float, float] = (math.nan, math.nan)
    buffer: bytearray = field(default_factory=bytearray)

    @classmethod
    def start(
        cls, make: Callable[..., object], arguments: tuple[Any, ...], *, memory: float = math.inf
    ) -> Worker:
        """A new process in which ``make(*arguments)`` answers."""
        theirs, asks = os.pipe()
        answers, ours = os.pipe()
        process = subprocess.Popen(
            [sys.executable, "-P", guardian.__file__, str(theirs), str(ours)],
            stdin=subprocess.PIPE,
            pass_fds=(theirs, ours),
            process_group=0,
            env={**os.environ, **ONE_THREAD},
        )
        os.close(theirs)
        os.close(ours)
        os.set_blocking(answers, False)
        worker = cls(process, asks, answers, time.monotonic() + START_SECONDS)
        worker._write(sys.path, (serve, (make, arguments, memory)))
        return worker

    def _write(self, *messages: object) -> None:
        content = b"".join(map(pickle.dumps, messages))
        with suppress(BrokenPipeError):  # it has died: `receive` says so
            while content:
                content = content[os.write(self.asks, content) :]

    def send(self, ask: Ask) -> None:
        """Ask, once the last answer has come; limit and clock begin when the desk is made."""
        self.number, self.ask = self.number + 1, ask
        if self.started:
            self._begin()
        self._write((self.number, ask.verb, dict(ask.content)))

    def _begin(self) -> None:
        assert self.ask is not None
        cpu = cpu_seconds(self.process.pid) if self.ask.timed else math.nan
        self.deadline = time.monotonic() + self.ask.limit
        self.sent = (time.perf_counter(), cpu)

    def receive(self) -> Answer | None:
        """The answer to the last ask; None while it works."""
        heard, ended = time.perf_counter(), False
        try:
            while chunk := os.read(self.answers, 1 << 16):
                heard = time.perf_counter()
                self.buffer += chunk
                if len(self.buffer) > 64 << 20:
                    return self._lost("crashed", GARBLED)
            ended = True
        except BlockingIOError:
            pass
        while b"\n" in self.buffer:
            line, _, rest = self.buffer.partition(b"\n")
            record, self.buffer = unpacked(bytes(line)), rest
            if not self.started and record.get("number") == 0:
                if "error" in record:
                    return self._lost("crashed", str(record["error"]))
                self.started = True
                if self.ask is not None:
                    self._begin()
                continue
            content, error = record.get("answer", {}), record.get("error", "")
            whole = record.get("number") == self.number and not self.buffer
            if not (whole and isinstance(content, dict) and isinstance(error, str)):
                return self._lost("crashed", GARBLED)
            wall, cpu = math.nan, math.nan
            if self.ask is not None and self.ask.timed:
                wall, cpu = heard - self.sent[0], cpu_seconds(self.process.pid) - self.sent[1]
            return Answer("error" if error else "ok", error, content, wall, cpu)
        if ended:
            return self._ended()
        if time.monotonic() > self.deadline:
            limit = self.ask.limit if self.started and self.ask else START_SECONDS
            return self._lost("timeout", f"took longer than {limit:g} s")
        return None

    def _ended(self) -> Answer:
        """The process closed its end: how it ended."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        code = self.process.returncode
        if code is None:
            return self._lost("crashed", "the worker process closed its message channel")
        words, number = f"ended with exit code {code}", -code if code < 0 else code - 128
        if number > 0:
            name = signal.Signals(number).name if number in signal.valid_signals() else number
            words = f"died of {name}{' (out of memory?)' if name == 'SIGKILL' else ''}"
        return self._lost("crashed", f"the worker process {words}")

    def _lost(self, status: str, reason: str) -> Answer:
        self.close()
        return Answer(status, reason, started=self.started)

    def wait(self, ask: Ask) -> Answer:
        """The answer to an ask, waited for."""
        self.send(ask)
        while (answer := self.receive()) is None:
            wait_for([self], self.deadline - time.monotonic())
        return answer

    def close(self) -> None:
        """End the process for real, with all that it started, and wait until it is gone."""
        assert self.process.stdin is not None
        if self.process.stdin.closed:
            return
        self.process.stdin.close()
        os.close(self.asks)
        try:
            self.process.wait(10.0)
        except subprocess.TimeoutExpired:  # stopped, by what it guards
            self.process.kill()
            self.process.wait()
        os.close(self.answers)


def wait_for(workers: Sequence[Worker], seconds: float) -> None:
    """Until one of the workers says something or ends, or this many seconds [s] are over."""
    poll = select.poll()
    for worker in workers:
        poll.register(worker.answers, select.POLLIN)
    poll.poll(max(seconds, 0.0) * 1e3)


def cpu_seconds(pid: int) -> float:
    """Seconds of CPU [s] that a process and its children have used; NaN where none are told."""
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
    """Whether the wall [s] ran ahead of the CPU [s]; the clocks themselves may differ by .2 ms."""
    return wall > 1.1 * cpu + 2e-4


def resident(name: str = "VmHWM") -> float | None:
    """Memory [MB] of this process, the most that it ever had or "VmRSS"; None without /proc."""
    with suppress(OSError, ValueError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith(name):
                return float(line.split()[1]) / 1e3
    return None


class _Caller:
    """The desk of `in_child`."""

    def call(self, work: Callable[..., Any], arguments: Sequence[Any]) -> Mapping[str, Any]:
        """The value of a function."""
        try:
            return {"value": work(*arguments)}
        except SparsefitError as error:
            return {"refused": one_line(str(error))}


def in_child(work: Callable[..., Any], *arguments: object, seconds: float) -> Any:
    """The value of ``work(*arguments)``, as JSON holds it, from another process.

    Raises:
        InputError: it raised one, or another error; it died, ended or took longer than ``seconds``.
    """
    worker = Worker.start(_Caller, ())
    try:
        answer = worker.wait(Ask("call", {"work": work, "arguments": arguments}, seconds))
    finally:
        worker.close()
    if answer.status == "ok" and "value" in answer.content:
        return answer.content["value"]
    reason = answer.reason.replace("the worker process", "its process")
    raise InputError(answer.content.get("refused") or reason)
