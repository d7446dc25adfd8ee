"""Files that are written whole or not at all, and files that are read within a size.

A file is written beside its target, then renamed over it. Only regular files are read. An
`InputError` names the file, the cause and the remedy.
"""

import errno
import os
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO

from sparsefit.errors import InputError

REMEDIES = {  # by the number of an OSError; of others the path is to be checked
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "make room, or choose another folder"),
    **dict.fromkeys(
        (errno.EACCES, errno.EPERM, errno.EROFS), "change its permissions, or choose another"
    ),
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EISDIR: "choose another name",
}


def write_whole(path: str | os.PathLike[str], content: bytes | str) -> None:
    """Write bytes, or text as UTF-8, as `whole_file` does."""
    with whole_file(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)


def write_files(folder: Path, files: Mapping[str, bytes]) -> list[Path]:
    """Write files into an existing folder, each whole; return their paths in this order."""
    for name, content in files.items():
        write_whole(folder / name, content)
    return [folder / name for name in files]


def read_whole(path: str | os.PathLike[str], *, most: int) -> bytes:
    """The content of a `regular_file` of at most ``most`` bytes."""
    with regular_file(path, most=most) as file:
        return file.read()


@contextmanager
def regular_file(path: str | os.PathLike[str], *, most: int) -> Iterator[BinaryIO]:
    """A regular file of at most ``most`` bytes, open for reading in a ``with`` block.

    Raises InputError where it is missing, empty, unreadable or too long, or is a device or a pipe.
    """
    with refusing(path, "read"):
        try:
            status = os.stat(path)
        except ValueError as error:  # a zero byte in the name
            raise OSError(str(error)) from None
        fault = ""
        if stat.S_ISDIR(status.st_mode):
            fault = "a folder; give a file in it"
        elif not stat.S_ISREG(status.st_mode):
            fault = "no regular file; give another"
        elif not status.st_size:
            fault = "empty; give another, or write it again"
        elif status.st_size > most:
            size = f"{status.st_size / 1e6:.0f} MB, more than {most / 1e6:.0f} MB"
            fault = f"too long, {size}; is it the right file?"
        if fault:
            raise InputError(f"cannot read {os.fspath(path)}: it is {fault}")
        with Path(path).open("rb") as file:
            yield file


@contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """A binary file to write in a ``with`` block, which replaces ``path`` at its end.

    It is created in the folder of ``path`` under a random name, so that no link is followed, with
    the permissions of a new file. Where the block or the disk fails, it is removed and ``path`` is
    unchanged. Raises InputError if it cannot be written.
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
def refusing(path: str | os.PathLike[str], deed: str = "write") -> Iterator[None]:
    """Raise an `OSError` of the block as an `InputError` with the path, its cause and a remedy."""
    try:
        yield
    except OSError as error:
        cause, remedy = error.strerror or error, REMEDIES.get(error.errno or 0, "check the path")
        raise InputError(f"cannot {deed} {os.fspath(path)}: {cause}; {remedy}") from None
