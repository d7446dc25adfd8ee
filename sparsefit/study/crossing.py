"""What is done to every flight of a study: protocols x sweep levels x back-ends x settings.

    [[protocols]]                        alternatives, which are not crossed with each other
    name = "weak"
    "derivative.method" = "weak"

    [sweep]                              crossed with everything
    "flights.duration" = [5.0, 20.0]

A `Cell` is one of each, resolved: its `Setup` holds the flights, what is derived, and how it is
read; its back-end and settings say who fits.
"""

from __future__ import annotations

import hashlib
import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, TypeAlias

from sparsefit import Derivative, Estimator, LengthScaleGrid, Library, Readout, backends
from sparsefit.codec import Place, build, made, number, only, shown, text
from sparsefit.errors import SparsefitError, suggestion, told_with
from sparsefit.model.readout import UNNAMED
from sparsefit.onboard import Stream
from sparsefit.study.draw import KEYS as FLIGHT_KEYS
from sparsefit.study.draw import FlightRules, nearest, read_flight_rules
from sparsefit.study.logged import FILES, Logs, read_logs
from sparsefit.study.toml_file import (
    Section,
    as_items,
    canonical_json,
    distinct,
    items,
    read_section,
    read_sections,
    required,
)

Setting: TypeAlias = float | int | str | bool
Sections: TypeAlias = Mapping[str, Section]
MOST_SETTINGS = 100_000  # of one [[backends]] entry


def _names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


GRID_KEYS = _names(LengthScaleGrid)
SECTION_KEYS: dict[str, tuple[str, ...]] = {
    "flights": FLIGHT_KEYS,
    "derivative": _names(Derivative),
    "library": GRID_KEYS + tuple(name for name in _names(Library) if name != "grid"),
    "readout": _names(Readout),
    "online": _names(Stream),
}


@dataclass(frozen=True)
class Setup:
    """Everything of a case but the number of its flight and its back-end."""

    flights: FlightRules | Logs
    derivative: Derivative
    library: Library
    readout: Readout
    online: Stream = Stream()


@dataclass(frozen=True, eq=False)
class Protocol:
    """A named alternative: values for dotted keys."""

    name: str
    overrides: Mapping[str, object]


@dataclass(frozen=True, eq=False)
class Factor:
    """A swept dotted key and its levels."""

    key: str
    levels: tuple[object, ...]


@dataclass(frozen=True, eq=False)
class BackendChoice:
    """One [[backends]] entry: every setting with the values it takes."""

    name: str
    label: str
    grid: Mapping[str, tuple[Setting, ...]]

    @property
    def size(self) -> int:
        """The number of settings in the grid."""
        return math.prod(len(values) for values in self.grid.values())

    def settings(self) -> Iterator[dict[str, Setting]]:
        """Every point of the grid, the last key fastest."""
        for chosen in itertools.product(*self.grid.values()):
            yield dict(zip(self.grid, chosen, strict=True))


@dataclass(frozen=True, eq=False)
class Cell:
    """One protocol, sweep level, back-end and setting, resolved.

    `index` is its place in the plan and `key` a hash of those four, which stays the same whatever
    else the study plans. `settings` are those that the entry `choice` gives, `canonical_settings`
    all of them, as canonical JSON.
    """

    index: int
    key: str
    protocol: str
    levels: Mapping[str, object]
    setup: Setup
    choice: BackendChoice
    settings: Mapping[str, Setting]
    canonical_settings: str

    @property
    def names(self) -> tuple[str, ...]:
        """The names by which a user may call it: its back-end, its label or its protocol."""
        return (self.choice.name, self.choice.label, self.protocol)


def read_setup(sections: Sections, place: Place) -> Setup:
    """The setup of the sections; `InputError` names the section and the key."""
    return _SetupReader(sections).read(sections, place)


class _SetupReader:
    """Reads setups that differ from ``sections`` in some; sections they share are read once."""

    def __init__(self, sections: Sections) -> None:
        self._shared = sections
        self._parts: dict[str, Any] = {}
        self._combined = False

    def read(self, sections: Sections, place: Place) -> Setup:
        """The setup of these sections; `InputError` names the section and the key."""
        parts = {name: self._part(name, sections, place) for name in SECTION_KEYS}
        setup = Setup(**parts)
        combined = ("derivative", "library", "readout", "online")
        shared = all(sections.get(name) is self._shared.get(name) for name in combined)
        if not (shared and self._combined):
            # What no estimator can combine is refused here, not in the first case.
            estimator = made(Estimator, {name: parts[name] for name in combined[:3]}, place)
            with told_with(place.within("online")):
                setup.online.refuse_unfit(estimator)
            self._combined = self._combined or shared
        return setup

    def _part(self, name: str, sections: Sections, place: Place) -> Any:
        section: Section = sections.get(name, {})
        if sections.get(name) is not self._shared.get(name):
            return _read_part(name, section, place.within(name))
        if name not in self._parts:
            self._parts[name] = _read_part(name, section, place.within(name))
        return self._parts[name]


def _read_part(name: str, section: Section, place: Place) -> Any:
    if name == "flights":
        read = read_logs if FILES in section else read_flight_rules
        return read(section, place)
    if name == "library":
        only(section, SECTION_KEYS["library"], place)
        grid = {key: value for key, value in section.items() if key in GRID_KEYS}
        rest = {key: value for key, value in section.items() if key not in GRID_KEYS}
        # Without a word about the grid, the library keeps the default that is its own.
        parts = {"grid": build(LengthScaleGrid, grid, place)} if grid else {}
        return build(Library, parts | rest, place)
    if name == "readout":
        return build(Readout, {"refine": UNNAMED, **section}, place)
    return build(Derivative if name == "derivative" else Stream, section, place)


def override(sections: Sections, overrides: Mapping[str, object]) -> Sections:
    """The sections with dotted keys (`library.target`) replaced; the others are the same ones."""
    changed: dict[str, dict[str, object]] = {}
    for dotted, value in overrides.items():
        section, key = dotted.split(".", 1)
        changed.setdefault(section, dict(sections.get(section, {})))[key] = value
    return {**sections, **changed}


def cross(
    sections: Sections,
    protocols: tuple[Protocol, ...],
    sweep: tuple[Factor, ...],
    choices: tuple[BackendChoice, ...],
    place: Place,
) -> Iterator[Cell]:
    """Every cell, in plan order: protocol, sweep levels, back-end, setting (last is fastest).

    Raises:
        InputError: with the protocol and levels that resolve to something that cannot be.
    """
    fitted = [
        (choice, settings, canonical_json(backends.settings_of(_backend(choice.name, settings))))
        for choice in choices
        for settings in choice.settings()
    ]
    setups, index = _SetupReader(sections), itertools.count()
    for protocol, levels in itertools.product(protocols, level_sets(sweep)):
        parts = [f'protocol "{protocol.name}"'] if protocol.overrides else []
        parts += [f"{key} = {shown(value)}" for key, value in levels.items()]
        within = Place(place.file, via=f"with {', '.join(parts)}: " if parts else "")
        setup = setups.read(override(sections, {**protocol.overrides, **levels}), within)
        for choice, settings, canonical in fitted:
            identity = canonical_json([protocol.name, levels, choice.name, settings])
            key = hashlib.sha256(identity.encode()).hexdigest()[:16]
            here = (next(index), key, protocol.name, levels, setup)
            yield Cell(*here, choice, settings, canonical)


def level_sets(sweep: tuple[Factor, ...]) -> list[dict[str, object]]:
    """The levels of all factors crossed, by key; one empty set where nothing is swept."""
    keys = [factor.key for factor in sweep]
    crossed = itertools.product(*(factor.levels for factor in sweep))
    return [dict(zip(keys, levels, strict=True)) for levels in crossed]


def read_protocols(
    document: Section, sweep: tuple[Factor, ...], place: Place
) -> tuple[Protocol, ...]:
    """The [[protocols]], or one called "default" without overrides."""
    if "protocols" not in document:
        return (Protocol("default", {}),)
    here, protocols = place.within("protocols"), []
    for entry in read_sections(document["protocols"], here):
        name = text(required(entry, "name", here), here.at("name"))
        changes = {key: value for key, value in entry.items() if key != "name"}
        protocols.append(Protocol(name, _dotted(changes, here)))
    distinct([protocol.name for protocol in protocols], here.at("name"))
    swept = {factor.key for factor in sweep}
    for protocol in protocols:
        for key in swept & set(protocol.overrides):
            raise here.at(key).error(f'is in [sweep] too: "{protocol.name}" cannot also set it')
    return tuple(protocols)


def read_sweep(document: Section, place: Place) -> tuple[Factor, ...]:
    """The factors of [sweep], sorted by key: their order in the file means nothing."""
    here = place.within("sweep")
    dotted = _dotted(read_section(document.get("sweep", {}), place.at("sweep")), here)
    for key, levels in dotted.items():
        distinct(items(levels, here.at(key)), here.at(key))
    return tuple(Factor(key, tuple(items(dotted[key], here.at(key)))) for key in sorted(dotted))


def _dotted(entries: Section, place: Place) -> dict[str, object]:
    """Flat dotted keys: `"library.target"` in quotes and bare `library.target` are equal."""
    flat: dict[str, object] = {}
    for key, value in entries.items():
        if isinstance(value, dict) and key in SECTION_KEYS:
            flat |= {f"{key}.{name}": inner for name, inner in value.items()}
        else:
            flat[key] = value
    for dotted in flat:
        section, _, key = dotted.partition(".")
        here = place.at(dotted)
        if section not in SECTION_KEYS:
            near = suggestion(section, SECTION_KEYS)
            raise here.error(f'unknown: the part before the dot, "{section}"' + near)
        if key not in SECTION_KEYS[section]:
            keys = SECTION_KEYS[section]
            near = nearest(key) if section == "flights" else suggestion(key, keys)
            raise here.error(f'unknown: [{section}] has no "{key}"' + near)
    return flat


def read_backends(value: object, place: Place) -> tuple[BackendChoice, ...]:
    """The [[backends]] of flights, each name and setting accepted by the back-end itself."""
    choices, seen = [], set()
    for entry in read_sections(value, place):
        name = text(required(entry, "name", place), place.at("name"))
        label = text(entry.get("label", name), place.at("label"))
        grid = {
            key: read_settings(given, place.at(key))
            for key, given in sorted(entry.items())
            if key not in ("name", "label")
        }
        choice = BackendChoice(name, label, grid)
        if choice.size > MOST_SETTINGS:
            words = f'"{name}" has a grid of {choice.size} settings: {MOST_SETTINGS} are the most'
            raise place.error(words)
        for settings in choice.settings():
            try:
                _backend(name, settings)
            except (SparsefitError, TypeError, ValueError) as error:
                raise place.error(str(error)) from None
            identity = canonical_json([name, settings])
            if identity in seen:
                raise place.error(f'"{name}" is listed twice with {shown(settings)}')
            seen.add(identity)
        choices.append(choice)
    return tuple(choices)


def read_settings(value: object, place: Place) -> tuple[Setting, ...]:
    """The values that one setting takes: a number, a text or true/false, or a list of these."""
    listed = as_items(value, place)
    for item in listed:
        if isinstance(item, int | float) and not isinstance(item, bool):
            number(item, place)
        elif not isinstance(item, bool | str):
            words = "must be a number, text or true/false, or a list of them"
            raise place.error(f"{words}, not {shown(item)}")
    return tuple(item for item in listed if isinstance(item, bool | str | int | float))


def _backend(name: str, settings: Mapping[str, Any]) -> backends.Backend:
    return backends.get(name, **settings)
