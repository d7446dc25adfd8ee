"""The rows of a run that is not finished: `.partial/rows.jsonl`, appended as cases end."""

from __future__ import annotations

import json
import math
import os
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import IO

from sparsefit.study.run.columns import KINDS
from sparsefit.study.run.outcome import Outcome
from sparsefit.whole_file import refusing, write_whole

FOLDER = ".partial"
HEADER = "header.json"
ROWS = "rows.jsonl"
SYNC_SECONDS = 0.5
SYNC_ROWS = 512


def read_header(folder: Path) -> dict[str, object] | None:
    """What run the unfinished rows belong to; None where there is none (or it is torn)."""
    try:
        header = json.loads((folder / FOLDER / HEADER).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return header if isinstance(header, dict) else None


def begin(folder: Path, header: dict[str, object]) -> None:
    """Start anew: the header is in place before the first row is."""
    discard(folder)
    (folder / FOLDER).mkdir()
    write_whole(folder / FOLDER / HEADER, json.dumps(header, sort_keys=True) + "\n")


def discard(folder: Path) -> None:
    """Remove the unfinished rows, if any."""
    if (folder / FOLDER).exists():
        shutil.rmtree(folder / FOLDER)


def read_rows(folder: Path) -> dict[tuple[int, int], Outcome]:
    """The outcomes so far by (flight, cell); reading stops at a torn line."""
    found, _ = _intact(folder / FOLDER / ROWS)
    return found


@dataclass
class Writer:
    """Appends outcomes; what was appended is on the disk within half a second."""

    file: IO[bytes]
    pending: int = 0
    synced: float = field(default_factory=time.monotonic)

    def append(self, outcome: Outcome) -> None:
        """One line; synced when enough have gathered."""
        with refusing(self.file.name):
            self.file.write(_line(outcome))
        self.pending += 1
        if self.pending >= SYNC_ROWS or time.monotonic() - self.synced > SYNC_SECONDS:
            self.sync()

    def sync(self) -> None:
        """Flush to the disk what is pending."""
        if self.pending:
            with refusing(self.file.name):
                self.file.flush()
                os.fsync(self.file.fileno())
        self.pending, self.synced = 0, time.monotonic()


@contextmanager
def appending(folder: Path) -> Iterator[Writer]:
    """A writer behind the last intact line; synced whatever ends the run."""
    path = folder / FOLDER / ROWS
    _, length = _intact(path)
    with refusing(path):
        file = path.open("ab")
        file.truncate(length)
    writer = Writer(file)
    try:
        yield writer
    finally:
        try:
            writer.sync()
        finally:
            with refusing(path):  # closing writes what a full disk did not take
                file.close()


def _intact(path: Path) -> tuple[dict[tuple[int, int], Outcome], int]:
    """Rows before the first line that is torn, and the length in bytes that they take."""
    found: dict[tuple[int, int], Outcome] = {}
    length = 0
    if not path.exists():
        return found, length
    with path.open("rb") as file:
        for line in file:
            outcome = _outcome(line)
            if outcome is None:
                break
            found.setdefault((outcome.flight, outcome.cell), outcome)
            length += len(line)
    return found, length


def _line(outcome: Outcome) -> bytes:
    """Strict JSON: NaN is null, and a float is written so that it reads back the same."""
    record = asdict(outcome)
    record["values"] = {name: None if _is_nan(v) else v for name, v in outcome.values.items()}
    return (json.dumps(record, separators=(",", ":")) + "\n").encode()


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and math.isnan(value)


def _outcome(line: bytes) -> Outcome | None:
    if not line.endswith(b"\n"):
        return None
    try:
        record = json.loads(line)
        record["values"] = {name: KINDS[name].of(v) for name, v in record["values"].items()}
        record["weights"] = tuple((scale, weight) for scale, weight in record["weights"])
        return Outcome(**record)
    except (ValueError, KeyError, TypeError, AttributeError):
        return None
