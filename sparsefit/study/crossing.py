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
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields
from typing import Any, TypeAlias

from sparsefit import Derivative, Estimator, Library, Readout, backends
from sparsefit.codec import Place, build, made, number, only, shown
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
    Named,
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


@dataclass(frozen=True)
class ProtocolWords:
    """The names of a protocol in tables."""

    name: str = key("What tables call it. Needed.")
    world: str = key("What they call all protocols that change the flights as this one does.", "")
    reading: str = key("What they call all that change the estimator as this one does.", "")


@dataclass(frozen=True, eq=False)
class Protocol:
    """A named alternative: values for dotted keys."""

    words: ProtocolWords
    overrides: Mapping[str, object]

    @property
    def name(self) -> str:
        """Its name."""
        return self.words.name


@dataclass(frozen=True, eq=False)
class Factor:
    """A swept dotted key and its levels."""

    key: str
    levels: tuple[object, ...]


@dataclass(frozen=True, eq=False)
class BackendChoice:
    """One [[backends]] entry: every setting with the values it takes.

    points: every point of the grid, the last key fastest, with what `about_backend` tells of it.
    """

    name: str
    label: str
    grid: Mapping[str, tuple[Setting, ...]]
    points: tuple[tuple[Mapping[str, Setting], str, str, bool], ...]


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
    levels: Mapping[str, object]
    setup: Setup
    choice: BackendChoice
    settings: Mapping[str, Setting]
    canonical_settings: str
    own_settings: str
    walks: bool

    @property
    def names(self) -> tuple[str, ...]:
        """The names by which a user may call it: its back-end, its label or its protocol."""
        return (self.choice.name, self.choice.label, self.protocol)


def points_of(grid: Mapping[str, tuple[Any, ...]]) -> Iterator[dict[str, Any]]:
    """Every point of a grid, the last key fastest; one empty point where it has no keys."""
    for chosen in itertools.product(*grid.values()):
        yield dict(zip(grid, chosen, strict=True))


def read_setup(sections: Sections, place: Place, parts: dict[object, Any] | None = None) -> Setup:
    """The setup of the sections; `InputError` names the section and the key.

    parts: what was read before, by content, so that setups share what is equal.
    """
    parts = {} if parts is None else parts
    texts = [json.dumps([name, sections.get(name, {})], default=repr) for name in SECTION_KEYS]
    for name, text in zip(SECTION_KEYS, texts, strict=True):
        if text not in parts:
            parts[text] = _read_part(name, sections.get(name, {}), place.within(name))
    setup = Setup(*(parts[text] for text in texts))
    combined = tuple(texts[1:])
    if combined not in parts:
        # What no estimator can combine is refused here, not in the first case.
        content = {name: getattr(setup, name) for name in ("derivative", "library", "readout")}
        with told_with(place.within("online")):
            setup.online.refuse_unfit(made(Estimator, content, place))
        parts[combined] = True
    return setup


def _read_part(name: str, section: Section, place: Place) -> Any:
    if name == "flights":
        read = read_logs if FILES in section else read_flight_rules
        return read(section, place)
    if name == "library":
        only(section, SECTION_KEYS[name], place)
        grid, rest = taken(LengthScaleGrid, section, place)
        # Without a word about the grid, the library keeps the default that is its own.
        return build(Library, ({"grid": grid} if len(rest) < len(section) else {}) | rest, place)
    if name == "readout":
        return build(Readout, {"refine": UNNAMED, **section}, place)
    return build(Derivative if name == "derivative" else Stream, section, place)


def override(sections: Sections, overrides: Mapping[str, object]) -> Sections:
    """The sections with dotted keys (`library.target`) replaced."""
    changed = {name: dict(section) for name, section in sections.items()}
    for dotted, value in overrides.items():
        section, name = dotted.split(".", 1)
        changed.setdefault(section, {})[name] = value
    return changed


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
    fitted = [(choice, *point) for choice in choices for point in choice.points]
    parts: dict[object, Any] = {}
    index = itertools.count()
    for protocol, levels in itertools.product(protocols, level_sets(sweep)):
        words = [f'protocol "{protocol.name}"'] if protocol.overrides else []
        words += [f"{name} = {shown(value)}" for name, value in levels.items()]
        within = Place(place.file, via=f"with {', '.join(words)}: " if words else "")
        setup = read_setup(override(sections, {**protocol.overrides, **levels}), within, parts)
        for choice, settings, canonical, own, walks in fitted:
            identity = canonical_json([protocol.name, levels, choice.name, settings])
            digest = hashlib.sha256(identity.encode()).hexdigest()[:16]
            here = (next(index), digest, protocol.name, levels, setup)
            yield Cell(*here, choice, settings, canonical, own, walks)


def level_sets(sweep: tuple[Factor, ...]) -> list[dict[str, object]]:
    """The levels of all factors crossed, by key; one empty set where nothing is swept."""
    return list(points_of({factor.key: factor.levels for factor in sweep}))


def read_protocols(
    document: Section, sweep: tuple[Factor, ...], place: Place
) -> tuple[Protocol, ...]:
    """The [[protocols]], or one called "default" without overrides."""
    if "protocols" not in document:
        return (Protocol(ProtocolWords("default"), {}),)
    here, protocols = place.within("protocols"), []
    for entry in read_sections(document["protocols"], here):
        words, changes = taken(ProtocolWords, entry, here)
        protocols.append(Protocol(words, _dotted(changes, here)))
    distinct([protocol.name for protocol in protocols], here.at("name"))
    swept = {factor.key for factor in sweep}
    for protocol in protocols:
        for name in swept & set(protocol.overrides):
            raise here.at(name).error(f'is in [sweep] too: "{protocol.name}" cannot also set it')
    return tuple(protocols)


def read_sweep(document: Section, place: Place) -> tuple[Factor, ...]:
    """The factors of [sweep], sorted by key: their order in the file means nothing."""
    here = place.within("sweep")
    dotted = _dotted(read_section(document.get("sweep", {}), place.at("sweep")), here)
    for name, levels in dotted.items():
        distinct(items(levels, here.at(name)), here.at(name))
    return tuple(Factor(name, tuple(items(dotted[name], here))) for name in sorted(dotted))


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
        here = place.at(dotted)
        if section not in SECTION_KEYS:
            near = suggestion(section, SECTION_KEYS)
            raise here.error(f'unknown: the part before the dot, "{section}"' + near)
        if name not in SECTION_KEYS[section]:
            keys = SECTION_KEYS[section]
            near = nearest(name, keys) if section == "flights" else suggestion(name, keys)
            raise here.error(f'unknown: [{section}] has no "{name}"' + near)
    return flat


def read_backends(document: Section, place: Place) -> tuple[BackendChoice, ...]:
    """The [[backends]] of flights, each name and setting accepted by the back-end itself."""
    choices, here = [], place.within("backends")
    seen: set[str] = set()
    for entry in read_sections(required(document, "backends", place), here):
        names, rest = taken(Named, entry, here)
        grid = read_grid(dict(sorted(rest.items())), here)
        size, name = math.prod(map(len, grid.values())), names.name
        if size > 100_000:
            words = f'"{name}" has a grid of {size} settings: 100000 are the most'
            raise here.error(words)
        points, foreign = list(points_of(grid)), name not in backends.BACKENDS
        try:
            if foreign:
                about = in_child(about_backend, name, points, seconds=120.0)
            else:
                about = about_backend(name, points)
        except (SparsefitError, TypeError, ValueError) as error:
            raise here.error(str(error)) from None
        for settings in points:
            identity = canonical_json([name, settings])
            if identity in seen:
                raise here.error(f'"{name}" is listed twice with {shown(settings)}')
            seen.add(identity)
        told = tuple((point, *words) for point, words in zip(points, about, strict=True))
        choices.append(BackendChoice(name, names.label or name, grid, told))
    return tuple(choices)


def read_grid(settings: Section, place: Place) -> dict[str, tuple[Setting, ...]]:
    """The values that each setting takes: a number, a text or true/false, or a list of these."""
    grid: dict[str, tuple[Setting, ...]] = {}
    for name, value in settings.items():
        listed = as_items(value, place.at(name))
        for item in listed:
            if isinstance(item, int | float) and not isinstance(item, bool):
                number(item, place.at(name))
            elif not isinstance(item, bool | str):
                words = "must be a number, text or true/false, or a list of them"
                raise place.at(name).error(f"{words}, not {shown(item)}")
        grid[name] = tuple(item for item in listed if isinstance(item, bool | str | int | float))
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
