"""Records as the schema of a study file: type, default, range, unit and sentence of every key.

    @dataclass(frozen=True)
    class RunRule:
        case_timeout: float = key("Seconds that one case may take.", 60.0, POSITIVE, "s")

`read` makes the record of a section, and refuses by file, section and key, with the nearest name;
`sentences` are what help texts and the documentation say of each key.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, TypeVar, cast

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
    """A field of a record, what it holds in a sentence, and the range of its numbers."""
    metadata = {"sentence": sentence, "range": range, "unit": unit}
    if callable(default):
        return field(default_factory=default, metadata=metadata)
    return field(default=default, metadata=metadata)


def described(sentence: str, unit: str, range: Range, default: Any = MISSING) -> str:
    """The words of a key: its sentence, unit, range and default."""
    words = [sentence, unit and f"[{unit}]", range.words and f"({range.words})"]
    if default not in (MISSING, None, "", ()):
        words.append(f"Default {shown(default)}.")
    return " ".join(word for word in words if word)


def sentences(kind: type[Any]) -> dict[str, str]:
    """Key -> its words, of every field; empty where `key` did not declare it."""
    content = {}
    for item in fields(kind):
        words = described(default=item.default, **item.metadata) if item.metadata else ""
        needed = words and item.default is item.default_factory is MISSING
        content[item.name] = f"{words} Needed." if needed else words
    return content


def names_of(kind: type[Any]) -> tuple[str, ...]:
    """The keys of a record."""
    return tuple(item.name for item in fields(kind))


def record_of(kind: type[Record], values: Section, place: Place) -> Record:
    """The record with these values; `InputError` names the key that does not fit."""
    record = build(kind, values, place)
    for item in fields(cast(Any, kind)):
        value, here = values.get(item.name), place.at(item.name)
        if "range" in item.metadata and value is not None:
            for each in items(value, here):
                if isinstance(each, int | float):
                    item.metadata["range"].check(each, here, item.metadata["unit"])
    return record


def read(kind: type[Record], document: Section, name: str, place: Place) -> Record:
    """The record of the section ``name``, of defaults where there is none."""
    return record_of(kind, section_of(document, name, place), place.within(name))


def taken(kind: type[Record], values: Section, place: Place) -> tuple[Record, dict[str, object]]:
    """The record of those keys that are its fields, and the other keys."""
    rest = dict(values)
    own = {name: rest.pop(name) for name in names_of(kind) if name in rest}
    return record_of(kind, own, place), rest


def section_of(document: Section, name: str, place: Place) -> Section:
    """The table ``[name]``, empty where there is none."""
    value = document.get(name, {})
    if not isinstance(value, Mapping):
        raise place.at(name).error(f"must be a table, not {shown(value)}")
    return cast(Section, value)


def entries(document: Section, name: str, place: Place) -> list[Section]:
    """The tables ``[[name]]``, of which there must be one."""
    here = place.within(name)
    value = required(document, name, place)
    if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
        raise here.error(f"must be written as [[{name}]]")
    return cast(list[Section], items(value, here))


def required(section: Section, name: str, place: Place) -> object:
    """The value of a key that a study must give."""
    if name not in section:
        raise place.at(name).error("missing: give it")
    return section[name]


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
