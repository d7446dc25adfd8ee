"""The process between a run and a worker, which ends all that the worker has started.

    parent ── lifeline (stdin) ──> guardian ── fork ──> worker: code of others

The guardian is run as a file, and imports nothing of sparsefit. Processes that leave the worker's
session become the guardian's when their own parent ends (a subreaper, of Linux). All of them end
when the worker does, and when the run does, even by SIGKILL; the worker ends with the guardian.
"""

import ctypes
import os
import pickle
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # of Linux


def main(asks: int, answers: int) -> None:
    """Fork the worker, wait for its end, end the rest, and exit as it did (128 + signal)."""
    _prctl(PR_SET_CHILD_SUBREAPER, 1)
    guardian, worker = os.getpid(), os.fork()
    if not worker:
        os.setpgid(0, 0)
        _prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != guardian:
            os._exit(1)
        work(asks, answers)
        os._exit(0)
    os.close(asks)
    os.close(answers)
    threading.Thread(target=_watch, args=(worker,), daemon=True).start()
    _, status = os.waitpid(worker, 0)
    _end(os.killpg, worker)
    with suppress(ChildProcessError):
        while children := children_of(guardian):
            for child in children:
                _end(os.kill, child)
            os.waitpid(-1, 0)
    code = os.waitstatus_to_exitcode(status)
    os._exit(code if code >= 0 else 128 - code)


def work(asks: int, answers: int) -> None:
    """Serve with the function and arguments of the first message, on the parent's paths.

    What is printed is no answer of the parent's, and what is asked for nobody types.
    """
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    stream = os.fdopen(asks, "rb")
    try:
        sys.path[:] = pickle.load(stream)
        serve, arguments = pickle.load(stream)
    except EOFError:  # the parent is gone
        return
    serve(stream, answers, *arguments)


def children_of(process: int) -> list[int]:
    """The processes that a process has started, or that have fallen to it; none without /proc."""
    children: list[int] = []
    with suppress(OSError):
        for path in Path(f"/proc/{process}/task").glob("*/children"):
            children += map(int, path.read_text(encoding="ascii").split())
    return children


def _watch(worker: int) -> None:
    """End the worker when the parent closes the lifeline, or dies: nobody writes there."""
    os.read(0, 1)
    _end(os.killpg, worker)
    _end(os.kill, worker)


def _end(kill: object, process: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        kill(process, signal.SIGKILL)  # type: ignore[operator]


def _prctl(option: int, value: int) -> None:
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, value)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
