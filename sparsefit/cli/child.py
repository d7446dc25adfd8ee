"""Code of others in a process of its own, with a limit of time: it cannot end or hang ours."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

LONGEST = 1 << 24  # bytes of an answer


def in_child(work: Callable[..., Any], *told: object, seconds: float) -> Any:
    """What ``work(*told)`` returns, a JSON value, from another process.

    What it prints goes to stderr, and what it starts ends with it.

    Raises:
        InputError: it raised one, or another error; it died, ended or took longer than ``seconds``.
    """
    from sparsefit.errors import InputError

    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_answer, args=(sender, work, told), daemon=True)
    process.start()
    sender.close()
    try:
        answer = _line(receiver, process.sentinel, time.monotonic() + seconds)
        if answer is None:
            raise InputError(f"took longer than {seconds:g} s")
        if not answer.endswith(b"\n"):
            process.join(5.0)
            raise InputError(_ended(process.exitcode))
    finally:
        _end(process.pid)
        process.kill()
        process.join()
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
    if hasattr(os, "setpgid"):
        os.setpgid(0, 0)
    os.dup2(2, 1)
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


def _end(pid: int | None) -> None:
    if pid is not None and hasattr(os, "killpg"):
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)


def _ended(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            return f"its process died of {signal.Signals(-code).name}"
    return f"its process ended with exit code {code}, without an answer"
