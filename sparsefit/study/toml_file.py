"""One TOML file as typed values, in bounded time and memory.

    read_toml("study.toml") -> {"name": "smoke", "flights": {"count": 4}, ...}

Whatever does not fit is refused by file, section and key (`codec.Place`). A dotted key of d parts
costs a parser d² steps and d tables, so keys are bounded before the text is parsed.
"""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias

from sparsefit.errors import InputError
from sparsefit.whole_file import read_whole

Section: TypeAlias = Mapping[str, object]
LARGEST = 1_000_000  # bytes of a study file, which are parsed within a second
DEEPEST = 32  # tables and lists in one another
KEY = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
LONG_KEY = re.compile(rf"{KEY}(?:[ \t]*+\.[ \t]*+{KEY}){{{DEEPEST},}}+")
LONG_NUMBER = re.compile(r"[\da-fA-F_]{301}")  # no number that anything is computed with


def read_toml(path: str | Path) -> dict[str, object]:
    """The tables of a TOML file.

    Raises:
        InputError: with the file and, where it is not TOML, the line; also of a file that is too
            large, nested too deeply or holds an integer beyond 300 digits.
    """
    try:
        text = read_whole(path, most=LARGEST).decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}: not UTF-8 text: save the study file as UTF-8") from None
    if (long := LONG_KEY.search(text)) is not None:
        line = text.count("\n", 0, long.start()) + 1
        raise InputError(f"{path}:{line}: a key of more than {DEEPEST} parts: shorten it")
    if LONG_NUMBER.search(text):
        raise InputError(f"{path}: holds an integer of more than 300 digits: write a smaller one")
    try:
        parsed = tomllib.loads(text)
        depth = _depth(parsed)
    except tomllib.TOMLDecodeError as error:
        at = re.search(r"at line (\d+)", str(error))
        line = int(at.group(1)) if at else text.count("\n") + 1
        raise InputError(f"{path}:{line}: not TOML: {error}") from None
    except RecursionError:
        depth = DEEPEST + 1
    if depth > DEEPEST:
        raise InputError(f"{path}: nested too deeply for a study file: at most {DEEPEST} levels")
    return parsed


def _depth(value: object) -> int:
    """The levels of tables and lists in one another, a value that is none counted."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return 1 + max(map(_depth, inner), default=0)


def canonical_json(value: object) -> str:
    """JSON with sorted keys, without blanks, 10.0 written as 10: equal content, equal text."""
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), default=str)


def _plain(value: object) -> object:
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def digest(content: str) -> str:
    """16 hexadecimal digits of the sha256 of a text."""
    return hashlib.sha256(content.encode(errors="backslashreplace")).hexdigest()[:16]


def numbered(names: Iterable[str]) -> list[str]:
    """The names, the second of equal ones with `-2` behind: cases that differ in nothing else."""
    seen: Counter[str] = Counter()
    content = []
    for name in names:
        seen[name] += 1
        content.append(name if seen[name] == 1 else f"{name}-{seen[name]}")
    return content
