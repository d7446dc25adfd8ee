"""The design of a study: protocols and sweep crossed with back-ends, every cell resolved."""

from __future__ import annotations

import hashlib
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from sparsefit.backends import settings_of
from sparsefit.codec import Place, shown, text
from sparsefit.study.spec.choices import BackendChoice, Setting, make_backend
from sparsefit.study.spec.document import (
    Section,
    canonical_json,
    distinct,
    items,
    read_section,
    read_sections,
    required,
)
from sparsefit.study.spec.setup import SECTION_KEYS, Setup, SetupReader, check_dotted, override


@dataclass(frozen=True, eq=False)
class Protocol:
    """A named alternative: values for dotted keys; alternatives are not crossed."""

    name: str
    overrides: Mapping[str, object]


@dataclass(frozen=True, eq=False)
class Factor:
    """A swept dotted key and its levels; factors are crossed with everything."""

    key: str
    levels: tuple[object, ...]


@dataclass(frozen=True, eq=False)
class Cell:
    """What is done to every flight: one protocol, sweep level, back-end and setting, resolved.

    `index` is its place in the plan and `key` a hash of those four, which stays the same whatever
    else the study plans. `choice` is the [[backends]] entry, `settings` the settings given there
    and `canonical_settings` all of them, as canonical JSON.
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
    def backend(self) -> str:
        """The name of the back-end."""
        return self.choice.name

    @property
    def label(self) -> str:
        """What the study calls this [[backends]] entry."""
        return self.choice.label

    @property
    def names(self) -> tuple[str, ...]:
        """What a user may call it: its back-end, its label or its protocol."""
        return (self.backend, self.label, self.protocol)


def cross(
    sections: Mapping[str, Section],
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
        (choice, settings, canonical_json(settings_of(make_backend(choice.name, settings))))
        for choice in choices
        for settings in choice.settings()
    ]
    setups = SetupReader(sections)
    index = itertools.count()
    for protocol, levels in itertools.product(protocols, _levels(sweep)):
        within = Place(place.file, via=_via(protocol, levels))
        setup = setups.read(override(sections, {**protocol.overrides, **levels}), within)
        for choice, settings, canonical in fitted:
            identity = canonical_json([protocol.name, levels, choice.name, settings])
            key = hashlib.sha256(identity.encode()).hexdigest()[:16]
            here = (next(index), key, protocol.name, levels, setup)
            yield Cell(*here, choice, settings, canonical)


def _levels(sweep: tuple[Factor, ...]) -> list[dict[str, object]]:
    keys = [factor.key for factor in sweep]
    crossed = itertools.product(*(factor.levels for factor in sweep))
    return [dict(zip(keys, levels, strict=True)) for levels in crossed]


def _via(protocol: Protocol, levels: Mapping[str, object]) -> str:
    parts = [f'protocol "{protocol.name}"'] if protocol.overrides else []
    parts += [f"{key} = {shown(value)}" for key, value in levels.items()]
    return f"with {', '.join(parts)}: " if parts else ""


def read_protocols(
    document: Section, sweep: tuple[Factor, ...], place: Place
) -> tuple[Protocol, ...]:
    """The [[protocols]], or one called "default" without overrides."""
    if "protocols" not in document:
        return (Protocol("default", {}),)
    here = place.within("protocols")
    protocols = tuple(
        _read_protocol(entry, here) for entry in read_sections(document["protocols"], here)
    )
    distinct([protocol.name for protocol in protocols], here.at("name"))
    swept = {factor.key for factor in sweep}
    for protocol in protocols:
        for key in swept & set(protocol.overrides):
            raise here.at(key).error(f'is in [sweep] too: "{protocol.name}" cannot also set it')
    return protocols


def _read_protocol(entry: Section, place: Place) -> Protocol:
    name = text(required(entry, "name", place), place.at("name"))
    overrides = _dotted({key: value for key, value in entry.items() if key != "name"}, place)
    return Protocol(name, overrides)


def read_sweep(document: Section, place: Place) -> tuple[Factor, ...]:
    """The factors of [sweep], sorted by key: their order in the file means nothing."""
    here = place.within("sweep")
    dotted = _dotted(read_section(document.get("sweep", {}), place.at("sweep")), here)
    for key, levels in dotted.items():
        distinct(items(levels, here.at(key)), here.at(key))
    return tuple(Factor(key, tuple(items(dotted[key], here.at(key)))) for key in sorted(dotted))


def _dotted(entries: Section, place: Place) -> dict[str, object]:
    """`"library.target" = ...` and the bare `library.target = ...` are one and the same."""
    flat: dict[str, object] = {}
    for key, value in entries.items():
        if isinstance(value, dict) and key in SECTION_KEYS:
            flat |= {f"{key}.{name}": inner for name, inner in value.items()}
        else:
            flat[key] = value
    for key in flat:
        check_dotted(key, place)
    return flat
