"""The [[backends]] of a study: a name, a label, and a grid over the settings."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from sparsefit import backends
from sparsefit.codec import Place, number, shown, text
from sparsefit.errors import SparsefitError
from sparsefit.study.spec.document import (
    Section,
    canonical_json,
    distinct,
    items,
    read_sections,
    required,
)

Setting = float | int | str | bool


@dataclass(frozen=True, eq=False)
class BackendChoice:
    """One [[backends]] entry: every setting with the values it takes."""

    name: str
    label: str
    grid: Mapping[str, tuple[Setting, ...]]

    @property
    def size(self) -> int:
        """How many settings the grid holds."""
        return math.prod(len(values) for values in self.grid.values())

    def settings(self) -> Iterator[dict[str, Setting]]:
        """Every point of the grid, the last key fastest."""
        for chosen in itertools.product(*self.grid.values()):
            yield dict(zip(self.grid, chosen, strict=True))


def make_backend(name: str, settings: Mapping[str, Any]) -> backends.Backend:
    """The back-end with these settings; needs no data."""
    return backends.get(name, **settings)


def read_backends(value: object, place: Place) -> tuple[BackendChoice, ...]:
    """The choices, each name and setting accepted by the back-end itself."""
    choices = tuple(_read_choice(entry, place) for entry in read_sections(value, place))
    seen: set[str] = set()
    for choice in choices:
        for settings in choice.settings():
            identity = canonical_json([choice.name, settings])
            if identity in seen:
                raise place.error(f'"{choice.name}" is listed twice with {shown(settings)}')
            seen.add(identity)
    return choices


def _read_choice(entry: Section, place: Place) -> BackendChoice:
    name = text(required(entry, "name", place), place.at("name"))
    label = text(entry.get("label", name), place.at("label"))
    grid = {
        key: _values(value, place.at(key))
        for key, value in sorted(entry.items())
        if key not in ("name", "label")
    }
    choice = BackendChoice(name, label, grid)
    if choice.size > 100_000:
        raise place.error(f'"{name}" has a grid of {choice.size} settings: 100000 are the most')
    for settings in choice.settings():
        _accepted(name, settings, place)
    return choice


def _accepted(name: str, settings: Mapping[str, Setting], place: Place) -> None:
    try:
        make_backend(name, settings)
    except (SparsefitError, TypeError, ValueError) as error:
        raise place.error(str(error)) from None


def _values(value: object, place: Place) -> tuple[Setting, ...]:
    if not isinstance(value, list):
        return (_setting(value, place),)
    distinct(items(value, place), place)
    return tuple(_setting(item, place) for item in value)


def _setting(value: object, place: Place) -> Setting:
    if isinstance(value, bool | str):
        return value
    if isinstance(value, int | float):
        number(value, place)
        return value
    raise place.error(f"must be a number, text or true/false, or a list of them, not {value!r}")
