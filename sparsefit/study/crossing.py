"""The cells of a study of flights: protocols x sweep levels x back-ends x settings.

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
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, TypeAlias

from sparsefit import Derivative, Estimator, Library, Readout, backends
from sparsefit.codec import Place, build, made, number, only, shown, text
from sparsefit.errors import SparsefitError, suggestion, told_with
from sparsefit.model import LengthScaleGrid
from sparsefit.model.readout import UNNAMED
from sparsefit.onboard import Stream
from sparsefit.regression.backend import PathBackend
from sparsefit.study.draw import KEYS as FLIGHT_KEYS
from sparsefit.study.draw import FlightRules, read_flight_rules
from sparsefit.study.logged import FILES, Logs, read_logs
from sparsefit.study.quantities import nearest
from sparsefit.study.schema import (
    as_items,
    distinct,
    items,
    key,
    names_of,
    read_section,
    read_sections,
    required,
    taken,
)
from sparsefit.study.toml_file import Section, canonical_json
from sparsefit.study.worker import in_child

Setting: TypeAlias = float | int | str | bool
Sections: TypeAlias = Mapping[str, Section]
Levels: TypeAlias = Mapping[str, object]  # values by dotted key
MOST_POINTS = 100_000  # of the grid of settings of one entry
SECTION_KEYS: dict[str, tuple[str, ...]] = {
    "flights": FLIGHT_KEYS,
    "derivative": names_of(Derivative),
    "library": (*names_of(LengthScaleGrid), *(n for n in names_of(Library) if n != "grid")),
    "readout": names_of(Readout),
    "online": names_of(Stream),
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
    overrides: Levels


@dataclass(frozen=True)
class BackendKeys:
    """The keys of [[backends]] beside settings."""

    name: str = key(
        "The back-end. All its settings, below, may stand beside it, each a value or a list."
    )
    label: str = key("What tables call this entry; without it, the name.", "")


@dataclass(frozen=True, eq=False)
class BackendChoice:
    """One [[backends]] entry: every setting with the values that it takes."""

    name: str
    label: str
    grid: Mapping[str, tuple[Setting, ...]]


@dataclass(frozen=True, eq=False)
class Cell:
    """One protocol, sweep level, back-end and setting, resolved.

    `index` is its place in the plan and `key` a hash of those four, which stays the same whatever
    else the study plans. `settings` are those that the entry `choice` gives, `canonical_settings`
    all of them, as canonical JSON, `own_settings` those that are not at their defaults; `walks`:
    whether the back-end walks a path of penalties.
    """

    index: int
    key: str
    protocol: str
    levels: Levels
    setup: Setup
    choice: BackendChoice
    settings: Mapping[str, Setting]
    canonical_settings: str
    own_settings: str
    walks: bool


Fitted: TypeAlias = tuple[BackendChoice, Mapping[str, Setting], str, str, bool]


def read_setup(sections: Sections, place: Place, parts: dict[object, Any] | None = None) -> Setup:
    """The setup of the sections; `InputError` names the section and the key.

    parts: what was read before, by content, so that setups share what is equal.
    """
    parts = {} if parts is None else parts
    contents = [json.dumps([name, sections.get(name, {})], default=repr) for name in SECTION_KEYS]
    for name, content in zip(SECTION_KEYS, contents, strict=True):
        if content not in parts:
            parts[content] = _read_part(name, sections.get(name, {}), place.within(name))
    setup = Setup(*(parts[content] for content in contents))
    combined = tuple(contents[1:])
    if combined not in parts:
        # What no estimator can combine is refused here, not in the first case.
        read = {name: getattr(setup, name) for name in ("derivative", "library", "readout")}
        with told_with(place.within("online")):
            setup.online.refuse_unfit(made(Estimator, read, place))
        parts[combined] = True
    return setup


def _read_part(name: str, section: Section, place: Place) -> Any:
    if name == "flights":
        return (read_logs if FILES in section else read_flight_rules)(section, place)
    if name == "library":
        only(section, SECTION_KEYS[name], place)
        grid, rest = taken(LengthScaleGrid, section, place)
        # Without a word about the grid, the library keeps the default that is its own.
        return build(Library, ({"grid": grid} if len(rest) < len(section) else {}) | rest, place)
    if name == "readout":
        return build(Readout, {"refine": UNNAMED, **section}, place)
    return build(Derivative if name == "derivative" else Stream, section, place)


def override(sections: Sections, overrides: Levels) -> Sections:
    """The sections with dotted keys (`library.target`) replaced."""
    changed = {name: dict(section) for name, section in sections.items()}
    for dotted, value in overrides.items():
        section, name = dotted.split(".", 1)
        changed.setdefault(section, {})[name] = value
    return changed


def cross(
    sections: Sections,
    protocols: tuple[Protocol, ...],
    sweep: Mapping[str, tuple[object, ...]],
    fitted: Sequence[Fitted],
    place: Place,
) -> Iterator[Cell]:
    """Every cell, in plan order: protocol, sweep levels, back-end, setting (last is fastest).

    Raises:
        InputError: with the protocol and levels that resolve to something that cannot be.
    """
    parts: dict[object, Any] = {}
    index = itertools.count()
    for protocol, levels in itertools.product(protocols, points_of(sweep)):
        words = [f'protocol "{protocol.name}"'] if protocol.overrides else []
        words += [f"{name} = {shown(value)}" for name, value in levels.items()]
        within = Place(place.file, via=f"with {', '.join(words)}: " if words else "")
        setup = read_setup(override(sections, {**protocol.overrides, **levels}), within, parts)
        for choice, settings, canonical, own, walks in fitted:
            identity = canonical_json([protocol.name, levels, choice.name, settings])
            digest = hashlib.sha256(identity.encode()).hexdigest()[:16]
            here = (next(index), digest, protocol.name, levels, setup)
            yield Cell(*here, choice, settings, canonical, own, walks)


def points_of(grid: Mapping[str, tuple[Any, ...]]) -> list[dict[str, Any]]:
    """Every point of a grid, the last key fastest; one empty point where it has no keys."""
    return [dict(zip(grid, chosen, strict=True)) for chosen in itertools.product(*grid.values())]


def read_protocols(
    document: Section, sweep: Mapping[str, tuple[object, ...]], place: Place
) -> tuple[Protocol, ...]:
    """The [[protocols]], or one called "default" without overrides."""
    if "protocols" not in document:
        return (Protocol("default", {}),)
    here, protocols = place.within("protocols"), []
    for entry in read_sections(document["protocols"], here):
        name = text(required(entry, "name", here), here.at("name"))
        changes = {dotted: value for dotted, value in entry.items() if dotted != "name"}
        protocols.append(Protocol(name, _dotted(changes, here)))
        for dotted in set(sweep) & set(protocols[-1].overrides):
            raise here.at(dotted).error(f'is in [sweep] too: "{name}" cannot also set it')
    distinct([protocol.name for protocol in protocols], here.at("name"))
    return tuple(protocols)


def read_sweep(section: object, place: Place) -> dict[str, tuple[object, ...]]:
    """The levels by dotted key, sorted by key: their order in the file means nothing."""
    dotted, sweep = _dotted(read_section(section, place), place), {}
    for name in sorted(dotted):
        sweep[name] = tuple(items(dotted[name], place.at(name)))
        distinct(sweep[name], place.at(name))
    return sweep


def _dotted(entries: Section, place: Place) -> dict[str, object]:
    """Flat dotted keys: `"library.target"` in quotes and bare `library.target` are equal."""
    flat: dict[str, object] = {}
    for name, value in entries.items():
        if isinstance(value, dict) and name in SECTION_KEYS:
            flat |= {f"{name}.{inner}": item for inner, item in value.items()}
        else:
            flat[name] = value
    for dotted in flat:
        section, _, name = dotted.partition(".")
        here, keys = place.at(dotted), SECTION_KEYS.get(section)
        if keys is None:
            near = suggestion(section, SECTION_KEYS)
            raise here.error(f'unknown: the part before the dot, "{section}"' + near)
        if name not in keys:
            near = nearest(name, keys) if section == "flights" else suggestion(name, keys)
            raise here.error(f'unknown: [{section}] has no "{name}"' + near)
    return flat


def read_backends(document: Section, place: Place) -> list[Fitted]:
    """Every point of the [[backends]] of flights, accepted by the back-end itself."""
    fitted: list[Fitted] = []
    here, seen = place.within("backends"), set[str]()
    for entry in read_sections(required(document, "backends", place), here):
        keys, rest = taken(BackendKeys, entry, here)
        choice = BackendChoice(keys.name, keys.label or keys.name, read_grid(rest, here))
        points = points_of(choice.grid)
        try:
            if keys.name in backends.BACKENDS:
                about = about_backend(keys.name, points)
            else:  # code of others
                about = in_child(about_backend, keys.name, points, seconds=120.0)
        except (SparsefitError, TypeError, ValueError) as error:
            raise here.error(str(error)) from None
        for settings, words in zip(points, about, strict=True):
            identity = canonical_json([keys.name, settings])
            if identity in seen:
                raise here.error(f'"{keys.name}" is listed twice with {shown(settings)}')
            seen.add(identity)
            fitted.append((choice, settings, *words))
    return fitted


def read_grid(settings: Section, place: Place) -> dict[str, tuple[Setting, ...]]:
    """The values that each setting takes, by name: a number, a text, true/false, or a list."""
    grid: dict[str, tuple[Setting, ...]] = {}
    for name, value in sorted(settings.items()):
        values: list[Setting] = []
        for item in as_items(value, place.at(name)):
            if not isinstance(item, bool | str | int | float):
                words = "must be a number, text or true/false, or a list of them"
                raise place.at(name).error(f"{words}, not {shown(item)}")
            if not isinstance(item, bool | str):
                number(item, place.at(name))
            values.append(item)
        grid[name] = tuple(values)
    if (size := math.prod(map(len, grid.values()))) > MOST_POINTS:
        raise place.error(f"has a grid of {size} settings: {MOST_POINTS} are the most")
    return grid


def about_backend(name: str, points: Sequence[dict[str, Any]]) -> list[tuple[str, str, bool]]:
    """Of a back-end with each of these settings: all of them, those that are not at their defaults
    (both as canonical JSON), and whether it walks a path of penalties.
    """
    registered: Any = backends.load(name)
    defaults = {item.name: item.default for item in fields(registered)}
    about = []
    for point in points:
        backend = backends.get(name, **point)
        canonical = canonical_json(backends.settings_of(backend))
        content = json.loads(canonical)
        own = {k: v for k, v in content.items() if v != defaults.get(k, MISSING)}
        about.append((canonical, canonical_json(own), isinstance(backend, PathBackend)))
    return about
