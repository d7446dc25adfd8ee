"""Processes in which code of others runs: it may hang, crash, print and start what it wants.

A child leads a group of its own, so that what it starts ends with it, and ends when its parent
does, even by SIGKILL. It computes in one thread; what it prints goes to stderr.
"""

from __future__ import annotations

import ctypes
import json
import multiprocessing
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

# Processes share the work; threads inside each would only fight for the same cores.
ONE_THREAD = dict.fromkeys(
    (
        *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS"),
        *("VECLIB_MAXIMUM_THREADS", "NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS"),
        "RAYON_NUM_THREADS",
    ),
    "1",
)
# Else a `signal.py` in the folder of the user would stand before Python's, until the paths of the
# parent are told.
SAFE = "PYTHONSAFEPATH"
INHERITED = ONE_THREAD | {SAFE: "1"}
PR_SET_PDEATHSIG = 1  # of Linux: a signal for when the parent dies
LONGEST = 1 << 24  # bytes of an answer


@dataclass(frozen=True)
class Child:
    """The parent's end of a process; `lifeline`: nobody writes there, and it ends with the parent.

    The child is started by ``method`` of `multiprocessing`, with ``work(*told)`` to do.
    """

    process: BaseProcess
    lifeline: Connection

    @classmethod
    def start(cls, work: Callable[..., object], *told: object, method: str = "spawn") -> Child:
        """A new process that does the work."""
        context: Any = multiprocessing.get_context(method)
        lifeline, stays = context.Pipe(duplex=False)
        parent = os.getpid() if method == "spawn" else None
        args = (parent, lifeline, os.environ.get(SAFE), work, told)
        process = context.Process(target=_live, args=args, daemon=True)
        with _inherited(), _interrupts_ignored():
            process.start()
        lifeline.close()
        return cls(process, stays)

    @property
    def end(self) -> str:
        """How it ended, `died of SIGSEGV` or `ended with exit code 3`."""
        code = self.process.exitcode
        if code is None or code >= 0:
            return f"ended with exit code {code}"
        name = f"signal {-code}"
        with suppress(ValueError):
            name = signal.Signals(-code).name
        return f"died of {name}{' (out of memory?)' if name == 'SIGKILL' else ''}"

    def kill(self) -> None:
        """End the process for real, with all that it started, and wait until it is gone."""
        if hasattr(os, "killpg") and self.process.pid is not None:
            with suppress(ProcessLookupError, PermissionError):  # not yet a group of its own
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.join()
        self.lifeline.close()


def _live(
    parent: int | None,
    lifeline: Connection,
    safe: str | None,
    work: Callable[..., object],
    told: tuple[object, ...],
) -> None:
    from threadpoolctl import threadpool_limits

    if safe is None:  # what a child starts in its turn looks for modules where the parent would
        os.environ.pop(SAFE, None)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(parent, lifeline)
    # What a back-end prints is no answer of the parent's, and what it asks for nobody types.
    os.dup2(2, 1)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    warnings.simplefilter("ignore")
    with threadpool_limits(limits=1):  # of libraries that were loaded before they could be told
        work(*told)


def _end_with(parent: int | None, lifeline: Connection) -> None:
    """End when the parent does, even by SIGKILL, and all that was started here with it.

    The thread ends the whole group of processes; where a back-end holds the interpreter and no
    thread of ours can run, the system still ends this one.
    """
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    if sys.platform == "linux":
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if parent is not None and os.getppid() != parent:
        os._exit(1)
    threading.Thread(target=_watch, args=(lifeline,), daemon=True).start()


def _watch(lifeline: Connection) -> None:
    """The parent never writes here; when it dies, the read ends."""
    with suppress(EOFError, OSError):
        lifeline.recv_bytes()
    if hasattr(os, "killpg"):
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


@contextmanager
def _inherited() -> Iterator[None]:
    """A child inherits the environment, which is as before after it has started."""
    before = {name: os.environ.get(name) for name in INHERITED}
    os.environ.update(INHERITED)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


@contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """A child inherits this: Ctrl-C in the terminal reaches all, and only the parent acts."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def in_child(work: Callable[..., Any], *told: object, seconds: float) -> Any:
    """What ``work(*told)`` returns, a JSON value, from another process.

    Raises:
        InputError: it raised one, or another error; it died, ended or took longer than ``seconds``.
    """
    from sparsefit.errors import InputError

    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = Child.start(_answer, sender, work, told)
    sender.close()
    try:
        answer = _line(receiver, child.process.sentinel, time.monotonic() + seconds)
        if answer is None:
            raise InputError(f"took longer than {seconds:g} s")
        if not answer.endswith(b"\n"):
            child.process.join(5.0)
            raise InputError(f"its process {child.end}, without an answer")
    finally:
        child.kill()
    try:
        record = json.loads(answer)
    except ValueError:
        raise InputError("wrote into the channel of its process") from None
    if "refused" in record:
        raise InputError(record["refused"])
    return record["done"]


def _line(receiver: Connection, sentinel: int, deadline: float) -> bytes | None:
    """What comes until a line, or the process, ends; None where neither does in time."""
    os.set_blocking(receiver.fileno(), False)
    content = b""
    while not content.endswith(b"\n") and len(content) < LONGEST:
        left = deadline - time.monotonic()
        if left <= 0.0:
            return None
        ended = sentinel in wait([receiver, sentinel], timeout=left)
        try:
            chunk = os.read(receiver.fileno(), LONGEST)
        except BlockingIOError:
            chunk = b""
        content += chunk
        if ended and not chunk:
            return content
    return content


def _answer(sender: Connection, work: Callable[..., Any], told: tuple[object, ...]) -> None:
    owner = os.getpid()
    try:
        record = {"done": work(*told)}
    except Exception as error:  # told to the parent, whatever it is
        from sparsefit.errors import SparsefitError, one_line

        kind = "" if isinstance(error, SparsefitError) else f"{type(error).__name__}: "
        record = {"refused": one_line(f"{kind}{error}")}
    if os.getpid() == owner:
        line = json.dumps(record, allow_nan=False).encode() + b"\n"
        while line:
            line = line[os.write(sender.fileno(), line) :]
