"""One run at a time in a results folder: a lock file that names its process.

`filelock` keeps it: exclusive creation, and a marker whose process is gone, by its id and the time
it began, is taken over; one from another machine, which cannot be asked, is not.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import SoftFileLock, Timeout

from sparsefit.errors import InputError

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder; a lock that a dead process left behind is taken over.

    Raises:
        InputError: if another run holds it, or the folder cannot be written.
    """
    lock = SoftFileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(_refusal(folder / LOCK)) from None
    except OSError as error:
        cause = f"{error.strerror}: choose another results folder"
        raise InputError(f"{folder}: cannot be written: {cause}") from None
    try:
        yield
    finally:
        lock.release()


def _refusal(path: Path) -> str:
    who = "just starting"
    with suppress(OSError, ValueError):
        pid, host, *_ = path.read_text(encoding="utf-8").split()
        who = f"process {pid} on {host.partition('?')[0]}"  # behind it, where it ran on the host
    return (
        f"{path.parent}: another run is under way ({who}): wait for it or stop it "
        f"(if there is none, remove {path})"
    )
