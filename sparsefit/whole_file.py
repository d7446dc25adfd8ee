"""Files that appear whole or not at all: written beside the target, then renamed over it."""

import errno
import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from sparsefit.errors import InputError

FULL = (errno.ENOSPC, errno.EDQUOT)


def write_whole(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Write bytes, or text as UTF-8, so that a reader meets the old file or the new one.

    Raises:
        InputError: naming the file and what to do, if it cannot be written.
    """
    with whole_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file to fill in a ``with`` block; it takes the place of ``path`` at its end.

    It is made anew in the folder of ``path``, under a name that nobody can foresee and with the
    permissions of any new file: no link that waits there is followed. Where the block or the disk
    fails, it is removed and ``path`` is as it was.

    Raises:
        InputError: naming the file and what to do, if it cannot be written.
    """
    target = Path(path)
    beside = target.parent / f".{target.name[:32]}.{secrets.token_hex(8)}.partial"
    try:
        with refusing(target):
            with beside.open("xb") as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            beside.replace(target)
    finally:
        with suppress(OSError):  # where it could not be made it need not be removed
            beside.unlink()


@contextmanager
def refusing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Tell an `OSError` inside as `InputError`: the file that cannot be written, cause, remedy."""
    try:
        yield
    except OSError as error:
        full = error.errno in FULL
        remedy = "make room, or choose another folder" if full else "check the folder"
        cause = error.strerror or error
        raise InputError(f"cannot write {os.fspath(path)}: {cause}; {remedy}") from None
