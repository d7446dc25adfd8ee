"""A study: one question, asked of every flight by every back-end, from one TOML file."""

from __future__ import annotations

import hashlib
import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from sparsefit.errors import InputError
from sparsefit.study.spec import outputs
from sparsefit.study.spec.choices import BackendChoice, read_backends
from sparsefit.study.spec.document import (
    Place,
    Table,
    canonical_json,
    distinct,
    integer,
    items,
    only,
    positive,
    read_toml,
    required,
    shown,
    table,
    tables,
    text,
)
from sparsefit.study.spec.setup import SECTION_KEYS, Setup, check_dotted, override, read_setup

MAX_CASES = 2_000_000
NAME = re.compile(r"[a-z0-9_-]{1,64}")
KEYS = (
    "name",
    "question",
    "seed",
    *SECTION_KEYS,
    "backends",
    "protocols",
    "sweep",
    "split",
    "run",
    "outputs",
)
# What a case does not depend on: changing it never makes finished rows those of another study.
PRESENTATION = ("question", "outputs")


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
class Combination:
    """One protocol with one level of every factor, and what they resolve to."""

    protocol: str
    levels: Mapping[str, object]
    setup: Setup


@dataclass(frozen=True, eq=False)
class Study:
    """A validated study file; made by `Study.load` only."""

    path: str
    name: str
    question: str
    seed: int
    count: int
    sections: Mapping[str, Table]
    backends: tuple[BackendChoice, ...]
    protocols: tuple[Protocol, ...]
    sweep: tuple[Factor, ...]
    validate_count: int | None
    case_timeout: float
    tolerance: float
    tables: tuple[str, ...]
    figures: tuple[str, ...]
    answers: tuple[str, ...]
    hash: str

    @classmethod
    def load(cls, path: str | Path) -> Study:
        """Read and check a study file.

        Raises:
            InputError: with the file, the section and the key (or the line) of the first fault.
        """
        document = read_toml(path)
        place = Place(str(path))
        only(document, KEYS, place)
        study = _read(document, place)
        _check_size(study, place)
        for _ in study.combinations():
            pass
        return study

    @property
    def planned(self) -> int:
        """How many cases there are."""
        settings = sum(choice.size for choice in self.backends)
        levels = math.prod(len(factor.levels) for factor in self.sweep)
        return self.count * len(self.protocols) * levels * settings

    @property
    def flights(self) -> Mapping[str, object]:
        """The [flights] section as it was written."""
        return {"count": self.count, **self.sections["flights"]}

    @property
    def store_weights(self) -> bool:
        """Whether weights per length scale are kept beside the cases."""
        return "weights" in self.figures

    def split(self, flight: int) -> str:
        """`validate`, `evaluate` or, without [split], `all`.

        The two are interleaved: with a quantity that is equally spaced over the flights, both
        halves cover its range.
        """
        if self.validate_count is None:
            return "all"
        before = flight * self.validate_count // self.count
        after = (flight + 1) * self.validate_count // self.count
        return "validate" if after > before else "evaluate"

    def combinations(self) -> Iterator[Combination]:
        """Every protocol with every sweep level, in plan order."""
        place = Place(self.path)
        keys = [factor.key for factor in self.sweep]
        for protocol in self.protocols:
            for chosen in itertools.product(*(factor.levels for factor in self.sweep)):
                levels = dict(zip(keys, chosen, strict=True))
                via = _via(protocol, levels)
                sections = override(self.sections, {**protocol.overrides, **levels})
                setup = read_setup(sections, Place(place.file, via=via))
                yield Combination(protocol.name, levels, setup)


def _read(document: dict[str, object], place: Place) -> Study:
    flights = dict(table(required(document, "flights", place), place.at("flights")))
    within = place.within("flights")
    count = integer(required(flights, "count", within), within.at("count"), least=1)
    del flights["count"]
    sections = {name: table(document.get(name, {}), place.at(name)) for name in SECTION_KEYS} | {
        "flights": flights
    }
    read_setup(sections, place)
    sweep = _read_sweep(document, place)
    timeout, tolerance = _read_run(document, place)
    output = outputs.read_outputs(document.get("outputs", {}), place)
    return Study(
        path=place.file,
        name=_name(required(document, "name", place), place.at("name")),
        question=text(required(document, "question", place), place.at("question")),
        seed=integer(required(document, "seed", place), place.at("seed"), least=0),
        count=count,
        sections=sections,
        backends=read_backends(required(document, "backends", place), place.within("backends")),
        protocols=_read_protocols(document, sweep, place),
        sweep=sweep,
        validate_count=_read_split(document, count, place),
        case_timeout=timeout,
        tolerance=tolerance,
        tables=output.tables,
        figures=output.figures,
        answers=output.answers,
        hash=study_hash(document),
    )


def study_hash(document: Table) -> str:
    """sha256 of what the cases depend on: not of comments, blanks, the question, [outputs]."""
    content = {key: value for key, value in document.items() if key not in PRESENTATION}
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()


def _name(value: object, place: Place) -> str:
    name = text(value, place)
    if not NAME.fullmatch(name):
        allowed = "1 to 64 of a-z, 0-9, _ and -: it is the results folder"
        raise place.error(f"must be {allowed}, not {shown(name)}")
    return name


def _read_protocols(
    document: Table, sweep: tuple[Factor, ...], place: Place
) -> tuple[Protocol, ...]:
    if "protocols" not in document:
        return (Protocol("default", {}),)
    here = place.within("protocols")
    listed = tables(document["protocols"], here)
    found = tuple(_read_protocol(entry, here) for entry in listed)
    distinct([protocol.name for protocol in found], here.at("name"))
    swept = {factor.key for factor in sweep}
    for protocol in found:
        for key in swept & set(protocol.overrides):
            raise here.at(key).error(f'is in [sweep] too: "{protocol.name}" cannot also set it')
    return found


def _read_protocol(entry: Table, place: Place) -> Protocol:
    name = text(required(entry, "name", place), place.at("name"))
    overrides = _dotted({key: value for key, value in entry.items() if key != "name"}, place)
    return Protocol(name, overrides)


def _read_sweep(document: Table, place: Place) -> tuple[Factor, ...]:
    here = place.within("sweep")
    dotted = _dotted(table(document.get("sweep", {}), place.at("sweep")), here)
    for key, levels in dotted.items():
        distinct(items(levels, here.at(key)), here.at(key))
    return tuple(Factor(key, tuple(items(dotted[key], here.at(key)))) for key in sorted(dotted))


def _dotted(entries: Table, place: Place) -> dict[str, object]:
    """`"library.target" = ...` and the bare `library.target = ...` are one and the same."""
    flat: dict[str, object] = {}
    for key, value in entries.items():
        nested = isinstance(value, dict) and key in SECTION_KEYS
        inner = table(value, place.at(key)) if nested else {}
        flat |= {f"{key}.{name}": item for name, item in inner.items()} if nested else {key: value}
    for key in flat:
        check_dotted(key, place)
    return flat


def _read_split(document: Table, count: int, place: Place) -> int | None:
    if "split" not in document:
        return None
    here = place.within("split")
    section = table(document["split"], place.at("split"))
    only(section, ("validate", "evaluate"), here)
    parts = [required(section, key, here) for key in ("validate", "evaluate")]
    sizes = [
        positive(part, here.at(key))
        for part, key in zip(parts, ("validate", "evaluate"), strict=True)
    ]
    if all(isinstance(part, int) for part in parts):
        if sum(sizes) != count:
            raise here.error(f"counts sum to {sum(sizes):g}, not to the {count} of flights.count")
        return int(sizes[0])
    if not math.isclose(sum(sizes), 1.0, abs_tol=1e-9):
        raise here.error(f"fractions sum to {sum(sizes):g}, not to 1 (for counts, write integers)")
    validate = round(sizes[0] * count)
    if not 0 < validate < count:
        raise here.error(f"leaves one part of {count} flights empty: use more flights")
    return validate


def _read_run(document: Table, place: Place) -> tuple[float, float]:
    here = place.within("run")
    section = table(document.get("run", {}), place.at("run"))
    only(section, ("case_timeout", "tolerance"), here)
    timeout = positive(section.get("case_timeout", 60.0), here.at("case_timeout"))
    tolerance = positive(section.get("tolerance", 1e-8), here.at("tolerance"))
    if tolerance >= 1.0:
        raise here.at("tolerance").error(f"must be below 1, not {tolerance:g}")
    return timeout, tolerance


def _check_size(study: Study, place: Place) -> None:
    if study.planned > MAX_CASES:
        raise InputError(
            f"{place.file}: plans {study.planned} cases, more than {MAX_CASES}: "
            "shorten [sweep], the back-end settings or flights.count"
        )


def _via(protocol: Protocol, levels: Mapping[str, object]) -> str:
    parts = [f'protocol "{protocol.name}"'] if protocol.overrides else []
    parts += [f"{key} = {shown(value)}" for key, value in levels.items()]
    return f"with {', '.join(parts)}: " if parts else ""
