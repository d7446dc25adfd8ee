"""A process in which code of others runs, asked one thing at a time, and killed at its limit.

    worker = Worker.start(Desk, (definition,), memory=2000.0)   # Desk(definition) lives in there
    worker.send(Ask("cases", {"unit": 3}, limit=60.0))
    worker.receive()            # None while it works; the answer, a mapping; or Lost

The parent keeps the clock: an ask has its limit, whatever the process says. An answer is one line
of JSON with a checksum and the number of its ask; all else that comes through the channel ends
the process. Nothing that the process says is believed before `plan` checked it (`runner`).
"""

from __future__ import annotations

import ctypes
import gc
import json
import math
import multiprocessing
import os
import select
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, Protocol, TypeAlias
from zlib import crc32

from sparsefit.child import Child
from sparsefit.errors import described
from sparsefit.study.clock import cpu_seconds

Record: TypeAlias = dict[str, Any]
CHUNK = 1 << 20  # bytes that are read at once
LONGEST = 64 << 20  # bytes of one answer
GARBLED = "the message channel of the worker process was written into"
SHARE = 0.8  # of the machine's memory that all workers together may take
START_SECONDS = 180.0


class Desk(Protocol):
    """The object that lives in a worker and answers."""

    def answer(self, verb: str, **content: Any) -> Mapping[str, Any]:
        """The answer to an ask, as JSON can hold it."""
        ...


@dataclass(frozen=True)
class Ask:
    """One thing that a worker is to do within `limit` seconds [s] on the wall.

    desk: which process of several is asked, so that code of others shares none with ours; timed:
    whether the answer comes with its seconds, "wall" and "cpu", by the parent's clock.
    """

    verb: str
    content: Mapping[str, Any]
    limit: float
    desk: str = ""
    timed: bool = False


@dataclass(frozen=True)
class Lost:
    """The process was killed at its limit (``timeout``) or died (``crashed``), with the reason.

    started: whether it had answered before; by_signal: whether it was killed from outside.
    """

    status: str
    reason: str
    started: bool = True
    by_signal: bool = False


def packed(record: Mapping[str, Any]) -> bytes:
    """One line: a CRC-32 and the JSON of the record; ValueError or TypeError where it has none."""
    body = json.dumps(record, separators=(",", ":")).encode()
    return b"%08x %s\n" % (crc32(body), body)


def unpacked(line: bytes) -> Record | None:
    """The record of a line without its end; None where it is not whole."""
    if line[8:9] != b" " or line[:8] != b"%08x" % crc32(line[9:]):
        return None
    try:
        record = json.loads(line[9:])
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None


def serve(
    make: Callable[..., Desk],
    content: tuple[Any, ...],
    memory: float,
    asks: Connection,
    answers: Connection,
) -> None:
    """The life of the process: answer until the parent is gone.

    A copy of it, made by code that forks, ends where it would answer.
    """
    owner = os.getpid()
    _leave_tracker()
    if math.isfinite(memory):
        _limit_memory(memory)
    desk = make(*content)
    _reply(answers, {"number": 0})
    with suppress(EOFError, BrokenPipeError, ConnectionResetError):
        while True:
            number, verb, arguments = asks.recv()
            record: Record = {}
            try:
                record = {"number": number, "answer": desk.answer(verb, **arguments)}
                line = packed(record)
            except MemoryError as error:
                gc.collect()
                line = packed({"number": number, "error": f"memory: {described(error)}"})
            except BaseException as error:  # code of others may raise anything, SystemExit too
                line = packed({"number": number, "error": described(error)})
            if os.getpid() != owner:
                os._exit(0)
            while line:
                line = line[os.write(answers.fileno(), line) :]


def _leave_tracker() -> None:
    """Close the pipe to the parent's tracker of resources, which code of others may write into."""
    tracker: Any = getattr(resource_tracker, "_resource_tracker", None)
    with suppress(OSError, AttributeError, TypeError):
        os.close(tracker._fd)
        tracker._fd = None


def _reply(answers: Connection, record: Record) -> None:
    os.write(answers.fileno(), packed(record))


def _limit_memory(megabytes: float) -> None:
    """Let allocations beyond the limit fail; of Linux, where private memory is counted."""
    with suppress(ImportError, ValueError, OSError):
        import resource

        most = int(megabytes * 1e6)
        resource.setrlimit(resource.RLIMIT_DATA, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def memory_limit(requested: float | None, processes: int) -> float:
    """Megabytes [MB] that a worker may take: those asked for, or its share of the machine's."""
    if requested is not None:
        return requested
    try:
        total = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    except (ValueError, OSError, AttributeError):
        return math.inf
    with suppress(OSError, ValueError):  # of a container, which may have less
        total = min(total, int(Path("/sys/fs/cgroup/memory.max").read_text()) / 1e6)
    return SHARE * total / max(processes, 1)


@dataclass
class Worker:
    """The parent's end of a process.

    number: of the last ask; ready: whether the process has started; busy: whether it works;
    began: the parent's clock and the process's CPU [s] when a timed ask was sent.
    """

    child: Child
    asks: Connection
    answers: Connection
    deadline: float
    limit: float = START_SECONDS
    number: int = 0
    ready: bool = False
    busy: bool = True
    buffer: bytearray = field(default_factory=bytearray)
    began: tuple[float, float] | None = None

    @classmethod
    def start(
        cls, make: Callable[..., Desk], content: tuple[Any, ...], *, memory: float = math.inf
    ) -> Worker:
        """A new process with ``make(*told)`` in it; it is busy until it has started."""
        asks, ours = multiprocessing.Pipe(duplex=False)
        answers, theirs = multiprocessing.Pipe(duplex=False)
        child = Child.start(serve, make, content, memory, asks, theirs)
        asks.close()
        theirs.close()
        os.set_blocking(answers.fileno(), False)
        return cls(child, ours, answers, time.monotonic() + START_SECONDS)

    def send(self, ask: Ask) -> None:
        """Ask; if the process has died meanwhile, `receive` says so."""
        self.number += 1
        self.busy, self.limit = True, ask.limit
        self.deadline = time.monotonic() + ask.limit
        self.began = (0.0, cpu_seconds(self.child.process.pid)) if ask.timed else None
        with suppress(OSError):
            message = ForkingPickler.dumps((self.number, ask.verb, dict(ask.content)))
            if ask.timed:
                self.began = (time.perf_counter(), self.began[1] if self.began else math.nan)
            self.asks.send_bytes(message)

    def receive(self) -> Record | Lost | None:
        """The answer that has come, {"answer": ...} or {"error": ...}; None while it works."""
        heard = time.perf_counter()
        try:
            while chunk := os.read(self.answers.fileno(), CHUNK):
                heard = time.perf_counter()
                self.buffer += chunk
                if len(self.buffer) > LONGEST:
                    return self._lost("crashed", GARBLED)
            return self._ended()
        except BlockingIOError:
            pass
        except OSError:
            return self._ended()
        message = self._message()
        if self.began is not None and isinstance(message, dict):
            began, cpu = self.began
            used = cpu_seconds(self.child.process.pid) - cpu
            message |= {"wall": heard - began, "cpu": used}
            self.began = None
        return message

    def _message(self) -> Record | Lost | None:
        line, end, rest = bytes(self.buffer).partition(b"\n") if self.buffer else (b"", b"", b"")
        if end:
            record = unpacked(line)
            self.buffer = bytearray(rest)
            if rest or record is None or record.get("number") != self.number:
                return self._lost("crashed", GARBLED)
            if not self.ready:
                self.ready, self.busy, record = True, False, {"answer": {}}
            self.busy = False
            return record
        if time.monotonic() > self.deadline:
            return self._lost("timeout", f"took longer than {self.limit:g} s")
        return None

    def _ended(self) -> Record | Lost | None:
        """The process closed its end: its last words, if they are whole, or how it ended."""
        if b"\n" in self.buffer and not isinstance(message := self._message(), Lost):
            return message
        self.child.process.join(timeout=1.0)
        code = self.child.process.exitcode or 0
        reason = f"the worker process {self.child.end}"
        return self._lost("crashed", reason, by_signal=code < 0)

    def _lost(self, status: str, reason: str, *, by_signal: bool = False) -> Lost:
        self.close()
        return Lost(status, reason, self.ready, by_signal)

    def ask(self, ask: Ask) -> Record | Lost:
        """The answer, waited for; a process that has not started yet is waited for too."""
        if not self.ready:
            started = self._awaited()
            if isinstance(started, Lost):
                return started
        self.send(ask)
        return self._awaited()

    def _awaited(self) -> Record | Lost:
        while (message := self.receive()) is None:
            wait_for([self], self.deadline - time.monotonic())
        return message

    def peak_memory(self) -> float:
        """The most memory [MB] that the process ever had; NaN where the system does not say."""
        with suppress(OSError, ValueError):
            path = Path(f"/proc/{self.child.process.pid}/status")
            for line in path.read_text(encoding="ascii").splitlines():
                if line.startswith("VmHWM"):
                    return float(line.split()[1]) / 1e3
        return math.nan

    def excuse(self, seconds: float) -> None:
        """Do not charge seconds [s] in which the parent was stopped or suspended."""
        self.deadline += seconds

    def close(self) -> None:
        """End the process for real, with all that it started, and wait until it is gone."""
        self.child.kill()
        self.asks.close()
        self.answers.close()


def wait_for(workers: Sequence[Worker], seconds: float) -> None:
    """Until one of the workers says something or ends, or this many seconds [s] are over."""
    heard = [w.answers.fileno() for w in workers] + [w.child.process.sentinel for w in workers]
    if not hasattr(select, "poll"):
        wait(list(heard), timeout=max(seconds, 0.0))
        return
    poll = select.poll()
    for descriptor in heard:
        poll.register(descriptor, select.POLLIN)
    poll.poll(max(seconds, 0.0) * 1e3)


def trim_memory() -> None:
    """Give freed memory back to the system, where the C library can."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
