"""The process between a run and a worker, which ends all processes that the worker has started.

    parent ── requests (stdin) ──> guardian ── fork ──> worker: foreign code
           <── answers (stdout) ───────────────────────

The guardian runs as a script and imports nothing of sparsefit. It reads no request: it only waits
for the hangup of their pipe, when the run ends, even by SIGKILL. Processes that leave the worker's
session become children of the guardian when their parent ends (a subreaper, of Linux). The guardian
kills them all when the worker or the run ends; the worker is killed when the guardian ends. Its
argument is the folder of the run's files, which it removes if the run was killed: a run that closes
its channel itself says so before, by SIGTERM.
"""

import ctypes
import os
import pickle
import select
import signal
import sys
import threading
from contextlib import suppress
from pathlib import Path

PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36  # of Linux


def main() -> None:
    """Fork the worker, wait for its end, end the rest, and exit as it did (128 + signal)."""
    _prctl(PR_SET_CHILD_SUBREAPER, 1)
    guardian, worker = os.getpid(), os.fork()
    if not worker:
        os.setpgid(0, 0)
        _prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
        if os.getppid() != guardian:
            os._exit(1)
        work()
        os._exit(0)
    os.close(1)
    closing = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: closing.set())
    threading.Thread(target=_watch, args=(worker,), daemon=True).start()
    _, status = os.waitpid(worker, 0)
    _end(os.killpg, worker)
    with suppress(ChildProcessError):
        while children := children_of(guardian):
            for child in children:
                _end(os.kill, child)
            os.waitpid(-1, 0)
    if hangup(0) and not closing.is_set():
        import shutil  # takes longer than a worker's start

        for folder in sys.argv[1:]:
            shutil.rmtree(folder, ignore_errors=True)
    code = os.waitstatus_to_exitcode(status)
    os._exit(code if code >= 0 else 128 - code)


def work() -> None:
    """Call the function of the first message with its arguments, on the parent's `sys.path`.

    The channels move to other descriptors: foreign code prints to stderr and reads /dev/null.
    """
    requests, answers = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    try:
        sys.path[:] = pickle.load(requests)
        serve, arguments = pickle.load(requests)
    except EOFError:  # the parent is gone
        return
    serve(requests, answers, *arguments)


def children_of(process: int) -> list[int]:
    """The child processes of a process, adopted ones included; none without /proc."""
    children: list[int] = []
    with suppress(OSError):
        for path in Path(f"/proc/{process}/task").glob("*/children"):
            children += map(int, path.read_text(encoding="ascii").split())
    return children


def hangup(patience: float | None = None) -> bool:
    """Whether the parent closes the channel of requests, or dies, within a time [ms], or ever."""
    channel = select.poll()
    channel.register(0, 0)  # reports POLLHUP, and no request
    return bool(channel.poll(patience))


def _watch(worker: int) -> None:
    hangup()
    _end(os.killpg, worker)
    _end(os.kill, worker)


def _end(kill: object, process: int) -> None:
    with suppress(ProcessLookupError, PermissionError):
        kill(process, signal.SIGKILL)  # type: ignore[operator]


def _prctl(option: int, value: int) -> None:
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(option, value)


if __name__ == "__main__":
    main()
