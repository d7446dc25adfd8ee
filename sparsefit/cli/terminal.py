"""Output of verbs: one way to print an outcome, colours, progress, and checks of files to write."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from datetime import timedelta
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from sparsefit.errors import InputError, one_line, one_of

COLOURS = {"ok": "32", "inaccurate": "33", "unidentifiable": "33", "misfit": "33", "skipped": "33"}


class Reply(NamedTuple):
    """The outcome of a verb: a JSON-ready record, lines in place of its rows, and the exit code."""

    record: Mapping[str, Any]
    lines: Iterable[str] | None = None
    code: int = 0


def emit(reply: Reply, *, as_json: bool) -> None:
    """Print an outcome: as JSON, as its lines, or as a row for each value of its record."""
    if as_json:
        print(json.dumps(reply.record, indent=2, allow_nan=False, ensure_ascii=False))
    else:
        lines = rows(entries(reply.record)) if reply.lines is None else reply.lines
        print("\n".join(lines).removeprefix("\n"))
    sys.stdout.flush()


def entries(record: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Labels and texts of the values of a record, and of the records within it."""
    for key, value in record.items():
        label = f"{before}{key}"
        if isinstance(value, Mapping):
            yield from entries(value, f"{label} ")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for item in value:
                yield "", ""
                yield from entries(item)
        elif isinstance(value, list):
            words = f"{len(value)}: {'; '.join(map(str, value))}" if value else "none"
            yield label, one_line(words, terminal_width())
        else:
            text = f"{value:.6g}" if isinstance(value, float) else one_line(word(value))
            yield label, coloured(text) if key == "status" else text


def rows(pairs: Iterable[tuple[str, str]], width: int = 0) -> list[str]:
    """Lines `label  value` with all values below each other; width [characters] at least.

    On a terminal, a long value takes several lines.
    """
    table = list(pairs)
    width = max([width, *(len(label) for label, _ in table)])
    return filled((f"{label:<{width}}  {value}".rstrip() for label, value in table), width + 2)


def filled(lines: Iterable[str], indent: int = 2) -> list[str]:
    """Lines that a terminal does not break within a word, all but the first of one indented."""
    if not sys.stdout.isatty():
        return list(lines)
    width, before = max(terminal_width(), indent + 30), " " * indent
    wrap = partial(textwrap.fill, subsequent_indent=before, break_on_hyphens=False)
    return [wrap(line, width, break_long_words=False) if line else "" for line in lines]


def coloured(status: str) -> str:
    """A status in its colour where stdout is a terminal that shows colours."""
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return status
    return f"\033[{COLOURS.get(status, '31')}m{status}\033[0m"


def check_output(path: str, *, force: bool, endings: Collection[str] = ()) -> None:
    """Refuse, before any work, a file that cannot be written or would be overwritten.

    endings: suffixes, lower case, of the formats that can be written; empty for any.
    """
    file = Path(path)
    if not path.strip():
        raise InputError("the name of the file to write is empty; give one")
    if file.exists() and not file.is_file():
        kind = "a folder; give a file in it" if file.is_dir() else "no regular file; give another"
        raise InputError(f"cannot write {path}: it is {kind}")
    if endings:
        one_of("file type", file.suffix.lower() or file.name, endings)
    if not file.parent.is_dir():
        raise InputError(f"cannot write {path}: {file.parent} is no folder; make it first")
    if os.path.lexists(path) and not force:
        raise InputError(f"{path} exists; add --force or choose another name")


def word(value: object) -> str:
    """A value as it is typed: `true`, `none`, `0.1`."""
    return str(value).lower() if isinstance(value, bool) or value is None else str(value)


def terminal_width() -> int:
    """The columns of the terminal; 160 for a pipe or a file, which take wide tables as they are."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else 160


class Progress:
    """Progress on stderr: one line that changes on a terminal, elsewhere one every five seconds."""

    def __init__(self, what: str = "cases") -> None:
        self._what, self._last = what, float("-inf")

    def __call__(self, done: int, planned: int, left: float | None) -> None:
        """Tell that `done` of `planned` are finished, with the seconds left where known."""
        line = f"{done}/{planned} {self._what}, {100 * done // max(planned, 1)} %"
        if done < planned and left is not None:
            span = f"{left:.2g} s" if left < 59.5 else timedelta(seconds=round(left))
            line += f", about {span} left"
        now = time.monotonic()
        if sys.stderr.isatty():
            print(f"\r{line}\033[K", end="", file=sys.stderr, flush=True)
        elif done == planned or now - self._last >= 5.0:
            self._last = now
            print(line, file=sys.stderr, flush=True)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the last line on the screen."""
        if sys.stderr.isatty():
            print(file=sys.stderr)
