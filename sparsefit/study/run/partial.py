"""The rows of a run that is not finished: `.partial/rows.jsonl`, appended as cases end.

Every line stands for itself: it names its case by its identity, whatever study asked for it, and
carries a checksum (`lines.py`). What is not whole is passed over and counted; of two lines for a
case the later one counts.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any

from sparsefit.errors import InputError
from sparsefit.study.run.lines import Record, outcome_of, packed, record_of, unpacked
from sparsefit.study.run.manifest import read_record
from sparsefit.study.run.outcome import Outcome
from sparsefit.whole_file import refusing, write_whole

FOLDER = ".partial"
HEADER = "header.json"
ROWS = "rows.jsonl"
SYNC_SECONDS = 0.5
SYNC_ROWS = 512
LONGEST = 64 << 20  # bytes of a line that is still read
NEEDED = {"flight": int, "identity": str, "status": str, "version": str, "values": dict}


@dataclass(frozen=True)
class Line:
    """A whole line: which flight and case it is of, where it begins, and how the case ended."""

    flight: int
    identity: str
    place: int
    record: Record


def begun(folder: Path) -> bool:
    """Whether a run is under way here, or was left unfinished."""
    path = folder / FOLDER
    if path.is_symlink() or path.is_file():
        raise InputError(f"{path}: no folder of rows: remove it, or study run --fresh starts over")
    return path.is_dir()


def read_header(folder: Path) -> dict[str, Any] | None:
    """What the unfinished rows were begun for; None where there is none (or it is torn)."""
    return read_record(folder / FOLDER / HEADER)


def begin(folder: Path, header: dict[str, object]) -> None:
    """Start, or go on with what is there; the header says for whom."""
    with refusing(folder / FOLDER):
        (folder / FOLDER).mkdir(exist_ok=True)
    write_whole(folder / FOLDER / HEADER, json.dumps(header, sort_keys=True) + "\n")


def discard(folder: Path) -> None:
    """Remove the unfinished rows, if any."""
    path = folder / FOLDER
    with refusing(path):
        if path.is_symlink() or path.is_file():
            path.unlink()
        elif path.exists():
            shutil.rmtree(path)


def lines(folder: Path) -> Iterator[Line | None]:
    """Every line so far, in the order they were written; None for one that is damaged."""
    return lines_of(folder / FOLDER / ROWS)


def lines_of(path: Path) -> Iterator[Line | None]:
    """Every line of a file of rows, as of `lines`; none where there is no file."""
    if not path.exists():
        return
    if not path.is_file():  # a pipe may have no end
        raise InputError(f"{path}: no regular file: study run --fresh starts over")
    place = 0
    try:
        with path.open("rb") as file:
            while line := file.readline(LONGEST):
                yield _line(line, place)
                place += len(line)
    except OSError as error:
        remedy = "study run --fresh starts over"
        raise InputError(f"{path}: cannot be read: {error.strerror}: {remedy}") from None


def _line(line: bytes, place: int) -> Line | None:
    record = unpacked(line)
    if record is None or not all(isinstance(record.get(k), t) for k, t in NEEDED.items()):
        return None
    return Line(record["flight"], record.pop("identity"), place, record)


def rows_at(folder: Path, places: Iterable[tuple[int, int, int]]) -> Iterator[Outcome]:
    """The rows of (where it begins, flight, cell), of these cases of the plan."""
    path = folder / FOLDER / ROWS
    with path.open("rb") as file:
        for place, flight, cell in places:
            file.seek(place)
            record = unpacked(file.readline())
            if record is None:
                raise InputError(f"{path}: changed while it was read: run the study again")
            yield replace(outcome_of(record), flight=flight, cell=cell)


@dataclass
class Writer:
    """Appends outcomes; what was appended is on the disk within half a second."""

    file: IO[bytes]
    place: int = 0
    pending: int = 0
    synced: float = field(default_factory=time.monotonic)

    def append(self, outcome: Outcome, identity: str) -> int:
        """One line; synced when enough have gathered. Returns where it begins."""
        line, place = packed({"identity": identity, **record_of(outcome)}), self.place
        with refusing(self.file.name):
            self.file.write(line)
        self.place += len(line)
        self.pending += 1
        if self.pending >= SYNC_ROWS or time.monotonic() - self.synced > SYNC_SECONDS:
            self.sync()
        return place

    def sync(self) -> None:
        """Flush to the disk what is pending."""
        if self.pending:
            with refusing(self.file.name):
                self.file.flush()
                os.fsync(self.file.fileno())
        self.pending, self.synced = 0, time.monotonic()


@contextmanager
def appending(folder: Path) -> Iterator[Writer]:
    """A writer behind what is there, on a line of its own; synced whatever ends the run."""
    path = folder / FOLDER / ROWS
    with refusing(path):
        file = os.fdopen(_here(path), "ab")
        if not _ends_a_line(path):
            file.write(b"\n")
            file.flush()
        writer = Writer(file, place=file.tell())
    try:
        yield writer
    finally:
        try:
            writer.sync()
        finally:
            with refusing(path):  # closing writes what a full disk did not take
                file.close()


def _here(path: Path) -> int:
    """Open to append, but not by a link that somebody left: it may lead anywhere."""
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND
    return os.open(path, flags | getattr(os, "O_NOFOLLOW", 0), 0o666)


def _ends_a_line(path: Path) -> bool:
    with path.open("rb") as file, suppress(OSError):
        file.seek(-1, os.SEEK_END)
        return file.read(1) == b"\n"
    return True  # it is empty
