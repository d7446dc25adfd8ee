"""A TOML file as typed values, in bounded time and memory; records are the schema of its sections.

    read_toml("study.toml") -> {"name": "smoke", "flights": {"count": 4}, ...}

    @dataclass(frozen=True)
    class RunRule:
        case_timeout: float = key(60.0, POSITIVE, "s")

`codec.build` makes the record, and refuses by file, section and key, with the nearest name;
`sentences` are what help texts and the documentation say of each key. A dotted key of d parts costs
a parser d² steps and d tables, so keys are bounded before the text is parsed.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias, TypeVar, cast

from sparsefit.codec import Place, build, shown
from sparsefit.errors import InputError
from sparsefit.whole_file import read_whole

Record = TypeVar("Record")
Section: TypeAlias = Mapping[str, object]
LARGEST = 1_000_000  # bytes of a study file, which are parsed within a second
DEEPEST = 32  # tables and lists in one another
KEY = r"""(?:(?<![\w-])[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
LONG_KEY = re.compile(rf"{KEY}(?:[ \t]*+\.[ \t]*+{KEY}){{{DEEPEST},}}+")
# No number that anything is computed with.
LONG_NUMBER = re.compile(r"(?<![\w\"'])(?:0[xob][\da-fA-F_]|\d)[\da-fA-F_]{300}")


def read_toml(path: str | Path) -> dict[str, object]:
    """The tables of a TOML file.

    Raises:
        InputError: with the file and, where it is not TOML, the line; also of a file that is too
            large, nested too deeply or holds an integer beyond 300 digits.
    """
    try:
        text = read_whole(path, most=LARGEST).decode("utf-8-sig")
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
    """JSON with sorted keys, without blanks, 10.0 written as 10: equal content, equal text.

    Of a record, the settings that are not at their defaults: a new setting changes no text.
    """
    return json.dumps(_plain(value), sort_keys=True, separators=(",", ":"), default=str)


def _plain(value: object) -> object:
    if is_dataclass(value) and not isinstance(value, type):
        content = {item: getattr(value, item.name) for item in fields(value) if item.repr}
        return {item.name: _plain(own) for item, own in content.items() if own != _default(item)}
    if isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _default(item: Field[Any]) -> object:
    return item.default if item.default_factory is MISSING else item.default_factory()


def digest(content: str) -> str:
    """16 hexadecimal digits of the sha256 of a text."""
    return hashlib.sha256(content.encode(errors="backslashreplace")).hexdigest()[:16]


def digest_of(path: Path) -> str:
    """sha256 of a file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def numbered(names: Iterable[str]) -> list[str]:
    """The names, the second of equal ones with `-2` behind: cases that differ in nothing else."""
    seen: Counter[str] = Counter()
    content = []
    for name in names:
        seen[name] += 1
        content.append(name if seen[name] == 1 else f"{name}-{seen[name]}")
    return content


@dataclass(frozen=True)
class Range:
    """Numbers from ``least`` to ``most``, which are in it, or between ``above`` and ``below``."""

    least: float = -math.inf
    most: float = math.inf
    above: float = -math.inf
    below: float = math.inf

    @property
    def words(self) -> str:
        """`above 0 and at most 1`; empty for all numbers."""
        ends = {"above": self.above, "at least": self.least, "below": self.below,
                "at most": self.most}  # fmt: skip
        return " and ".join(f"{word} {end:g}" for word, end in ends.items() if math.isfinite(end))

    def check(self, value: float, place: Place, unit: str = "") -> None:
        """Refuse a number outside."""
        if not (self.least <= value <= self.most and self.above < value < self.below):
            raise place.error(f"must be {self.words}{f' [{unit}]' * bool(unit)}, not {value:g}")


ANY, POSITIVE, NOT_NEGATIVE = Range(), Range(above=0.0), Range(least=0.0)
SHARE, INSIDE = Range(least=0.0, most=1.0), Range(above=0.0, below=1.0)


def key(default: Any = MISSING, range: Range = ANY, unit: str = "") -> Any:
    """A field of a record of keys with its range and unit; a list must not be empty.

    default: its value, or a function without arguments that returns it; none: the key is required.
    """

    def check(value: object, place: Place) -> None:
        for item in items(value, place):
            if isinstance(item, int | float) and range.words:  # of others its type is what counts
                range.check(item, place, unit)

    content = {"default_factory" if callable(default) else "default": default}
    return field(**content, metadata={"unit": unit, "range": range, "check": check})


@cache
def shipped(file: str) -> dict[str, dict[str, Any]]:
    """The tables of a TOML file of this package; of `keys.toml`, section -> key -> its meaning."""
    return tomllib.loads((resources.files(__package__) / file).read_text(encoding="utf-8"))


def described(meaning: str, unit: str, range: Range, default: Any = MISSING) -> str:
    """The words of a key: its meaning, unit, range and default."""
    words = [meaning, unit and f"[{unit}]", range.words and f"({range.words})"]
    if default not in (MISSING, None, "", ()):
        words.append(f"Default {json.dumps(default)}.")
    return " ".join(word for word in words if word)


def sentences(kind: type[Any], section: str) -> dict[str, str]:
    """Key -> its words, of every field of a record of a section or, in common, of "study"."""
    words, every = dict[str, str](), shipped("keys.toml")
    means = every["study"] | every[section]
    for item in fields(kind):
        unit, range = item.metadata.get("unit", ""), item.metadata.get("range", ANY)
        needed = " Needed." if item.default is item.default_factory is MISSING else ""
        words[item.name] = described(means[item.name], unit, range, item.default) + needed
    return words


def names_of(kind: type[Any]) -> tuple[str, ...]:
    """The keys of a record."""
    return tuple(item.name for item in fields(kind))


def taken(kind: type[Record], values: Section, place: Place) -> tuple[Record, dict[str, object]]:
    """The record of those keys that are its fields, and the other keys.

    Another key that is near one that is missing is refused as a slip of that.
    """
    rest = dict(values)
    own = {name: rest.pop(name) for name in names_of(kind) if name in rest}
    for item in fields(cast(Any, kind)):
        needed = item.default is item.default_factory is MISSING and item.name not in own
        for slip in get_close_matches(item.name, rest, 1) if needed else ():
            raise place.at(slip).error(f'unknown: did you mean "{item.name}"?')
    return build(kind, own, place), rest


def items(value: object, place: Place) -> Sequence[object]:
    """The items of a list, of which there must be one; a value that is no list is one item."""
    if not isinstance(value, list | tuple):
        return [value]
    if not value:
        raise place.error("must not be an empty list: remove the key or give values")
    return value


def distinct(value: object, place: Place) -> Sequence[object]:
    """`items`, none of them twice."""
    listed, seen = items(value, place), set[str]()
    for item in listed:
        canonical = canonical_json(item)
        if canonical in seen:
            raise place.error(f"lists {shown(item)} twice")
        seen.add(canonical)
    return listed
