"""Which code makes a row: the version of sparsefit and a digest of the sources that compute."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import sparsefit
from sparsefit.backends import distribution
from sparsefit.study.run.manifest import sparsefit_version

ROOMS = (
    *("flight", "regression", "backends", "derivative", "library", "modes", "uncertainty"),
    *("estimator", "score.py", "study/spec", "study/run/execution.py", "study/run/reading.py"),
)
DOCSTRING = re.compile(r'(\A|:(?:  #[^\n]*)?\n)( *)r?"""(?:[^"\\]|\\.|"(?!""))*"""\n')
COMMENT = re.compile(r"""(?m)^\s*#.*\n|^\s*\n|  #[^"'\n]*$""")


def version_of(backend: str) -> str:
    """`0.3.0+1a2b3c4d`, and the distribution and version that a plug-in comes from."""
    return " ".join(
        part for part in (f"{sparsefit_version()}+{_digest()}", _plugin(backend)) if part
    )


@cache
def _plugin(backend: str) -> str:
    return distribution(backend)


@cache
def _digest() -> str:
    """The first 8 digits of the sha256 of what determines numbers, the same on every machine."""
    digest = hashlib.sha256()
    for path in _sources(Path(sparsefit.__file__).parent):
        text = without_words(path.read_text(encoding="utf-8"))
        digest.update(f"{path.name}\0{text}\0".encode())
    return digest.hexdigest()[:8]


def without_words(source: str) -> str:
    """A Python source without what changes no number: docstrings, comments and empty lines.

    By its text, which is the same for every version of Python, and quick; comments stay where a
    string of several lines might hold what looks like one.
    """
    text = DOCSTRING.sub(r'\1\2""\n', source)
    return text if '"""' in text else COMMENT.sub("", text)


def _sources(package: Path) -> Iterator[Path]:
    for room in ROOMS:
        place = package / room
        yield from [place] if place.is_file() else sorted(place.rglob("*.py"))
