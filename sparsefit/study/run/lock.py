"""One run at a time in a results folder: a lock file that names its process."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import time
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from sparsefit.errors import InputError

LOCK = ".lock"
GRACE = 10.0  # s: a lock without content is one that is just being written


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder; a lock that a dead process left behind is taken over.

    Raises:
        InputError: if another run holds it, or the folder cannot be written.
    """
    path = folder / LOCK
    token = _acquire(path)
    try:
        yield
    finally:
        if _content(path) == token:
            path.unlink()


def _acquire(path: Path) -> str:
    mine = json.dumps(_owner() | {"token": uuid.uuid4().hex})
    for _ in range(10):
        if _create(path, mine):
            return mine
        held = _content(path)
        if held is None:
            continue
        if _alive(path, held):
            raise InputError(_refusal(path, held))
        _set_aside(path, held)
    raise InputError(f"{path.parent}: cannot be locked: remove {path} if no run is under way")


def _create(path: Path, content: str) -> bool:
    """Write the lock if there is none; exclusive creation is atomic on every platform."""
    try:
        descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o644)
    except FileExistsError:
        return False
    except OSError as error:
        raise InputError(
            f"{path.parent}: cannot be written: {error.strerror}: choose another results folder"
        ) from None
    with os.fdopen(descriptor, "w", encoding="utf-8") as file:
        file.write(content)
    return True


def _set_aside(path: Path, stale: str) -> None:
    """Remove a stale lock, and nothing else: a rename shows what was really there."""
    aside = path.with_name(f"{path.name}.{uuid.uuid4().hex}")
    with contextlib.suppress(FileNotFoundError):
        path.rename(aside)
        found = _content(aside)
        if found is not None and found != stale:
            _create(path, found)
        aside.unlink()


def _content(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return None


def _owner() -> dict[str, object]:
    pid = os.getpid()
    return {"pid": pid, "host": socket.gethostname(), "started": _started(pid)}


def _started(pid: int) -> str | None:
    """When a living process began, where the system tells: an id may be used again."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rsplit(")", 1)[1].split()
    except (OSError, IndexError):
        return None
    return None if stat[0] == "Z" else stat[19]


def _alive(path: Path, held: str) -> bool:
    """Whether the owner may still run; elsewhere, or on Windows, that cannot be asked safely."""
    try:
        owner = json.loads(held)
        pid, host, started = int(owner["pid"]), owner["host"], owner["started"]
    except (ValueError, KeyError, TypeError):
        return _age(path) < GRACE
    if host != socket.gethostname() or os.name == "nt":
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return bool(started == _started(pid))


def _age(path: Path) -> float:
    try:
        return time.time() - path.stat().st_mtime
    except OSError:
        return 0.0


def _refusal(path: Path, held: str) -> str:
    try:
        owner = json.loads(held)
        who = f"process {owner['pid']} on {owner['host']}"
    except (ValueError, KeyError, TypeError):
        who = "just starting"
    return (
        f"{path.parent}: another run is under way ({who}): wait for it or stop it "
        f"(if there is none, remove {path})"
    )
