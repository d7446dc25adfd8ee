"""Output of verbs: colours, durations, progress, and checks of files to write."""

from __future__ import annotations

import os
import shutil
import sys
import time
from collections.abc import Collection, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.errors import InputError, one_of

if TYPE_CHECKING:
    from sparsefit.regression import Certificate

COLOURS = {"ok": "32", "inaccurate": "33", "unidentifiable": "33", "misfit": "33", "skipped": "33"}


def coloured(status: str, text: str | None = None) -> str:
    """A status, or a text about it, in its colour where stdout is a terminal that shows colours."""
    text = status if text is None else text
    if not sys.stdout.isatty() or os.environ.get("NO_COLOR") or os.environ.get("TERM") == "dumb":
        return text
    return f"\033[{COLOURS.get(status, '31')}m{text}\033[0m"


def rows_of(pairs: Iterable[tuple[str, str]], width: int = 0) -> list[str]:
    """Lines `label  value` with all values below each other; width [characters] at least."""
    table = list(pairs)
    width = max([width, *(len(label) for label, _ in table)])
    return [f"{label:<{width}}  {value}".rstrip() for label, value in table]


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
        raise InputError(f"cannot write {path}: there is no folder {file.parent}; make it first")
    if os.path.lexists(path) and not force:
        raise InputError(f"{path} exists; add --force or choose another name")


def check_folder(path: str, *, force: bool = False) -> Path:
    """The folder to write, refused before any work where it holds files of others."""
    folder = Path(path)
    if not path.strip():
        raise InputError("the name of the folder to write is empty; give one")
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{path} is a file; choose another name for the folder")
    if folder.is_dir() and any(folder.iterdir()) and not force:
        raise InputError(f"{path} is not empty; add --force or choose another name")
    return folder


def proof(certificate: Certificate | None) -> str:
    """A certificate in words, `duality_gap 1.2e-10`, or `none`."""
    return f"{certificate.kind} {certificate.value:.1e}" if certificate else "none"


def typed(settings: dict[str, Any]) -> str:
    """Settings as they are typed: `alpha_fraction=0.1 separate=false`."""
    return " ".join(
        f"{key}={str(value).lower() if isinstance(value, bool) or value is None else value}"
        for key, value in settings.items()
    )


def duration(seconds: float) -> str:
    """A time span in words: `0.42 s`, `35 s`, `4 min 05 s`, `2 h 10 min`."""
    if seconds < 9.95:
        return f"{seconds:.2g} s"
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest:02d} s"
    return f"{minutes // 60} h {minutes % 60:02d} min"


def terminal_width() -> int:
    """The columns of the terminal; 160 for a pipe or a file, which take wide tables as they are."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else 160


class Progress:
    """Progress on stderr: one line that changes on a terminal, elsewhere one every five seconds."""

    _last = float("-inf")

    def __call__(self, done: int, planned: int, left: float | None) -> None:
        """Tell that `done` of `planned` cases are finished, with the seconds left where known."""
        line = f"{done}/{planned} cases, {100 * done // max(planned, 1)} %"
        if done < planned and left is not None:
            line += f", about {duration(left)} left"
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
