"""Records as the schema of a study file: type, default, range, unit and sentence of every key.

    @dataclass(frozen=True)
    class RunRule:
        case_timeout: float = key("Seconds that one case may take.", 60.0, POSITIVE, "s")

`codec.build` makes the record, and refuses by file, section and key, with the nearest name;
`sentences` are what help texts and the documentation say of each key.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, TypeVar

from sparsefit.codec import Place, build, shown
from sparsefit.study.toml_file import Section, canonical_json

Record = TypeVar("Record")


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


def key(sentence: str, default: Any = MISSING, range: Range = ANY, unit: str = "") -> Any:
    """A field of a record, what it holds in a sentence, and the range of its numbers.

    A default that can be called makes one.
    """

    def check(value: object, place: Place) -> None:
        for item in items(value, place):
            if isinstance(item, int | float):
                range.check(item, place, unit)

    content = {"default_factory" if callable(default) else "default": default}
    words = described(sentence, unit, range, MISSING if callable(default) else default)
    words += " Needed." if default is MISSING else ""
    return field(**content, metadata={"words": words, "unit": unit, "check": check})


def described(sentence: str, unit: str, range: Range, default: Any = MISSING) -> str:
    """The words of a key: its sentence, unit, range and default."""
    words = [sentence, unit and f"[{unit}]", range.words and f"({range.words})"]
    if default not in (MISSING, None, "", ()):
        words.append(f"Default {shown(default)}.")
    return " ".join(word for word in words if word)


def sentences(kind: type[Any]) -> dict[str, str]:
    """Key -> its words, of every field; empty where `key` did not declare it."""
    return {item.name: item.metadata.get("words", "") for item in fields(kind)}


def names_of(kind: type[Any]) -> tuple[str, ...]:
    """The keys of a record."""
    return tuple(item.name for item in fields(kind))


def taken(kind: type[Record], values: Section, place: Place) -> tuple[Record, dict[str, object]]:
    """The record of those keys that are its fields, and the other keys."""
    rest = dict(values)
    own = {name: rest.pop(name) for name in names_of(kind) if name in rest}
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
