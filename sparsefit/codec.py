"""Frozen dataclasses from mappings, by the types of their fields, and back.

What a type cannot express (a window that must be odd) the record checks itself; its message is put
behind the place of the value.
"""

from __future__ import annotations

import math
import types
import unicodedata
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from sparsefit.errors import LONGEST, InputError, is_integer, is_number, one_line, suggestion
from sparsefit.errors import shown as shown

Record = TypeVar("Record")


@dataclass(frozen=True)
class Place:
    """The place of a value: file, section and key; `via`: the override that it comes from."""

    file: str
    section: str = ""
    key: str = ""
    via: str = ""

    def at(self, key: str) -> Place:
        """The place of one key of this section."""
        return type(self)(self.file, self.section, key, self.via)

    def within(self, section: str) -> Place:
        """The place of one section of this file."""
        return type(self)(self.file, section, "", self.via)

    def error(self, problem: str) -> InputError:
        """The refusal of what stands here: `file: [section] key "x" problem`."""
        section = f"[{self.section}] " if self.section else ""
        key = f'key "{one_line(self.key, LONGEST)}" ' if self.key else ""
        return InputError(f"{self.file}: {self.via}{section}{key}{problem}")


# Ours: msgspec passes over unknown keys, cattrs turns "3" into 3; both name types, not remedies.
def build(kind: type[Record], values: Mapping[str, object], place: Place) -> Record:
    """The frozen dataclass ``kind`` with these values; for those left out its defaults hold.

    A field that is itself a dataclass takes a mapping. Raises InputError, which names the place and
    the nearest valid name, on a key that is none or missing, on a value of another type, on what
    the ``check`` in the metadata of a field refuses (value, place), and on what the record refuses.
    """
    hints = get_type_hints(kind)
    only(values, (field.name for field in fields(cast(Any, kind))), place)
    fitted = {key: _fitted(value, hints[key], place.at(key)) for key, value in values.items()}
    for field in fields(cast(Any, kind)):
        here = place.at(field.name)
        if field.name not in values and field.default is field.default_factory is MISSING:
            raise here.error("missing: give it")
        if "check" in field.metadata and values.get(field.name) is not None:
            field.metadata["check"](values[field.name], here)
    return made(kind, fitted, place)


def made(kind: Callable[..., Record], values: Mapping[str, Any], place: Place) -> Record:
    """``kind(**values)``, its refusal preceded by the place."""
    try:
        return kind(**values)
    except (InputError, TypeError, ValueError) as error:
        raise place.error(str(error)) from None


def plain(record: Any) -> Any:
    """The fields of a dataclass by name, JSON-ready: nested ones as dicts, no numpy scalars."""
    if is_dataclass(record):
        return {field.name: plain(getattr(record, field.name)) for field in fields(record)}
    return record.item() if hasattr(record, "item") else record  # what numpy's scalars have


def finite_or_none(value: Any) -> Any:
    """``value`` as JSON can hold it: None for NaN and infinity, at any depth, tuples as lists."""
    if isinstance(value, dict):
        return {key: finite_or_none(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite_or_none(item) for item in value]
    if hasattr(value, "tolist"):  # what numpy's arrays and scalars have
        return finite_or_none(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def only(values: Iterable[str], valid: Iterable[str], place: Place) -> None:
    """Refuse the first key that is not in `valid`, with the nearest valid one."""
    known = list(valid)
    for key in values:
        if key not in known:
            raise place.at(key).error("unknown" + suggestion(key, known))


def text(value: object, place: Place) -> str:
    """One non-empty line of text."""
    if not isinstance(value, str):
        raise place.error(f"must be text in quotes, not {shown(value)}")
    if not value.strip() or "\n" in value:
        raise place.error("must be one non-empty line of text")
    if {"Cc", "Cs", "Zl", "Zp"} & set(map(unicodedata.category, value)):  # no table survives these
        raise place.error(f"must not hold control characters: {shown(value)}")
    return value


def mapping(value: object, place: Place) -> Mapping[str, object]:
    """Named values: an object of JSON, a table of TOML."""
    if not isinstance(value, Mapping):
        raise place.error(f"must be an object or a table, not {shown(value)}")
    return value


def number(value: object, place: Place) -> float:
    """A finite number; a boolean is none."""
    if not is_number(value):
        kind = "a finite number" if type(value) in (float, int) else "a number"
        raise place.error(f"must be {kind}, not {shown(value)}")
    return float(value)


def integer(value: object, place: Place, *, least: float = -math.inf) -> int:
    """A whole number of at least `least`; a boolean is none."""
    if not is_integer(value, least):
        small = f"at least {least}, not {value}" if is_integer(value) else ""
        raise place.error(f"must be {small or f'a whole number, not {shown(value)}'}")
    return value


def _fitted(value: object, hint: Any, place: Place) -> object:
    """`value` as the annotation asks; None where it may be, else the first other type counts."""
    if get_origin(hint) in (Union, types.UnionType):
        if value is None and type(None) in get_args(hint):
            return None
        (hint, *_) = [option for option in get_args(hint) if option is not type(None)]
    if get_origin(hint) is Literal:
        if value in (options := get_args(hint)) and not isinstance(value, bool):
            return value
        known = [str(option) for option in options]
        near = suggestion(value, known) if isinstance(value, str) else suggestion("", known)
        raise place.error(f"has unknown value {shown(value)}{near}")
    if hint is float:
        return number(value, place)
    if hint is int:
        return integer(value, place, least=0)
    if hint is str:
        return text(value, place)
    if get_origin(hint) is tuple:
        items = list(value) if isinstance(value, list | tuple) else [value]  # one needs no list
        hints = get_args(hint)
        if hints[-1] is ...:
            hints = hints[:1] * len(items)
        if len(items) != len(hints):
            raise place.error(f"must be {len(hints)} values in a list, not {shown(value)}")
        return tuple(_fitted(item, kind, place) for item, kind in zip(items, hints, strict=True))
    if get_origin(hint) is Mapping:
        _, item = get_args(hint)
        return {str(key): _fitted(one, item, place) for key, one in mapping(value, place).items()}
    if is_dataclass(hint) and not isinstance(value, cast(type, hint)):
        inner = ".".join(name for name in (place.section, place.key) if name)
        return build(cast(type[Any], hint), mapping(value, place), place.within(inner))
    if isinstance(hint, type) and not isinstance(value, hint):
        kind = "true or false" if hint is bool else hint.__name__
        raise place.error(f"must be {kind}, not {shown(value)}")
    return value
