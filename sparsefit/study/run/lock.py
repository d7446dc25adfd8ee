"""One run at a time in a results folder: a lock on the folder, and a file that names its process.

The lock on the folder itself is the system's: it goes with its process, however that ends, and
nobody holds it twice. The file `.lock`, kept by `filelock`, tells who it is and reaches other
machines that share the folder: a marker whose process is gone, by its id and the time it began, is
taken over; one from another machine, which cannot be asked, is not.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import SoftFileLock, Timeout

from sparsefit.errors import InputError

try:
    import fcntl
except ImportError:  # Windows: the file alone
    fcntl = None  # type: ignore[assignment]

LOCK = ".lock"


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold the folder; a lock that a dead process left behind is taken over.

    Raises:
        InputError: if another run holds it, or the folder cannot be written.
    """
    with _alone_here(folder):
        if not os.access(folder, os.W_OK):  # where a dead process's lock could not be taken over
            raise InputError(f"{folder}: cannot be written: choose another results folder")
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


@contextmanager
def _alone_here(folder: Path) -> Iterator[None]:
    """Hold the folder against other processes of this machine, where its file system can."""
    if fcntl is None:
        yield
        return
    try:
        place = os.open(folder, os.O_RDONLY)
    except OSError as error:
        cause = f"{error.strerror}: choose another results folder"
        raise InputError(f"{folder}: cannot be read: {cause}") from None
    try:
        try:
            fcntl.flock(place, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(_refusal(folder / LOCK)) from None
        except OSError:  # a file system without such locks: the file alone
            pass
        yield
    finally:
        os.close(place)


def _refusal(path: Path) -> str:
    who = "just starting"
    with suppress(OSError, ValueError):
        pid, host, *_ = path.read_text(encoding="utf-8").split()
        who = f"process {pid} on {host.partition('?')[0]}"  # behind it, where it ran on the host
    return (
        f"{path.parent}: another run is under way ({who}): wait for it or stop it "
        f"(if there is none, remove {path})"
    )
