"""The [[problems]] of a study: each entry one or several, from flights, files, names or generators.

An entry may have a `sweep` and a `count`, and any may be altered into degenerate ones. All entries
that are none are refused together.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from sparsefit import Estimator, RegressionProblem
from sparsefit.codec import Place, build, integer, only, shown, text
from sparsefit.errors import InputError, suggestion
from sparsefit.study.crossing import Setup, level_sets, override, read_setup, read_sweep
from sparsefit.study.data_sets import (
    ALTERATIONS,
    AS_IT_IS,
    DATASETS,
    GENERATORS,
    Data,
    Generator,
    digest_of,
    read_data,
    read_public,
)
from sparsefit.study.draw import SIMULATION, stream
from sparsefit.study.toml_file import (
    Section,
    as_items,
    canonical_json,
    distinct,
    items,
    read_section,
    read_sections,
)

SECTIONS = ("flights", "derivative", "library")
PROBLEM_KINDS = ("flights", "file", "dataset", "generator")
PROBLEM_KEYS = (
    *("name", *PROBLEM_KINDS, "test", "derivative", "library", "sweep", "groups", "alter", "count"),
    *(item.name for item in fields(Generator)),
)
ALTERED = 300  # the child of a flight's stream that an alteration is drawn from
GENERATED = 301  # the child that a generated problem is drawn from


@dataclass(frozen=True, eq=False)
class FlightOrigin:
    """Flight number `flight` of `count` of a setup, from a seed."""

    setup: Setup
    flight: int
    count: int
    seed: int

    def data(self) -> Data:
        """The arrays of the flight's regression problem, as a study of flights would pose it."""
        setup = self.setup
        draw = setup.flights.draw(self.flight, self.count, self.seed)
        fleet = draw.fleet(stream(self.seed, self.flight, SIMULATION))
        blind = [replace(flown, flow=None) for flown in fleet]
        problem = Estimator(setup.derivative, setup.library).prepare(blind).problem
        return Data(problem.theta, problem.target, problem.groups, samples=problem.sample_count)


@dataclass(frozen=True, eq=False)
class ProblemSource:
    """One problem: where it comes from, and what is done to it.

    origin: a flight, a data file, the name of a data set, or a generator with its number; groups:
    labels, the number of neighbouring columns in a group, or None for the origin's own; series: the
    entry it belongs to, with its swept `level`; identity: what determines its numbers.
    """

    name: str
    origin: FlightOrigin | Path | str | tuple[Generator, int]
    groups: tuple[object, ...] | int | None
    alter: str
    seed: int
    series: str
    level: str
    identity: str
    test: Path | None = None

    def build(self) -> Data:
        """The arrays of the problem, checked as a regression problem.

        Raises:
            InputError: naming the problem, where its numbers make none.
        """
        try:
            data = self._data()
            RegressionProblem.from_arrays(data.theta, data.target, data.groups)
            if data.test is not None and data.test[0].shape[1:] != data.theta.shape[1:]:
                raise InputError("the test rows have other columns than the file")
        except InputError as error:
            in_file = isinstance(self.origin, Path) and str(error).startswith(str(self.origin))
            where = "" if in_file else f"problem {self.name!r}: "
            raise InputError(f"{where}{error}") from None
        return data

    def _data(self) -> Data:
        origin = self.origin
        if isinstance(origin, FlightOrigin):
            data = origin.data()
        elif isinstance(origin, tuple):
            random = stream(self.seed, origin[1], GENERATED)
            data = origin[0].draw(np.random.default_rng(random))
        else:
            data = read_data(origin) if isinstance(origin, Path) else read_public(origin)
        theta = np.asarray(data.theta, float)
        target = np.asarray(data.target, float).reshape(len(theta), -1)
        data = replace(data, theta=theta, target=target)
        if self.test is not None:
            holdout_rows = read_data(self.test)
            rows = np.asarray(holdout_rows.theta, float)
            data = replace(
                data, test=(rows, np.asarray(holdout_rows.target, float).reshape(len(rows), -1))
            )
        if self.alter != AS_IT_IS:
            random = stream(self.seed, 0, ALTERED)
            altered = ALTERATIONS[self.alter](theta, target, np.random.default_rng(random))
            data = Data(*altered, data.groups)
        if isinstance(self.groups, int):
            return replace(data, groups=np.arange(theta.shape[1]) // self.groups)
        return data if self.groups is None else replace(data, groups=np.array(self.groups))


def read_problems(document: Section, seed: int, place: Place) -> tuple[ProblemSource, ...]:
    """The problems of a study file; one `InputError` names every entry that is none."""
    here = place.within("problems")
    if "problems" not in document:
        raise place.at("problems").error("missing: write one [[problems]] or more")
    base = {name: read_section(document.get(name, {}), place.at(name)) for name in SECTIONS}
    sources: list[ProblemSource] = []
    faults: list[str] = []
    for number, entry in enumerate(read_sections(document["problems"], here)):
        try:
            sources += _read_entry(entry, base, seed + number, here)
        except InputError as error:
            faults.append(str(error))
    if faults:
        raise InputError("; ".join(faults))
    distinct([source.name for source in sources], here.at("name"))
    return tuple(sources)


def _read_entry(
    entry: Section, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[ProblemSource]:
    only(entry, PROBLEM_KEYS, place)
    given = [key for key in PROBLEM_KINDS if key in entry]
    if len(given) != 1:
        have = " and ".join(given) or "none"
        raise place.error(f"each needs exactly one of {', '.join(PROBLEM_KINDS)}, one has {have}")
    groups: tuple[object, ...] | int | None = None
    if "groups" in entry:
        labels, here = entry["groups"], place.at("groups")
        groups = tuple(items(labels, here)) if isinstance(labels, list) else None
        groups = integer(labels, here, least=1) if groups is None else groups
    alterations = [
        text(name, place.at("alter"))
        for name in as_items(entry.get("alter", AS_IT_IS), place.at("alter"))
    ]
    for name in alterations:
        if name not in ALTERATIONS:
            near = suggestion(name, ALTERATIONS)
            raise place.at("alter").error(f"has unknown value {shown(name)}{near}")
    test = (
        Path(place.file).parent / text(entry["test"], place.at("test")) if "test" in entry else None
    )
    series = str(entry.get("name", entry[given[0]]))
    stored = [entry.get("groups"), digest_of(test) if test else None]
    for name, level, origin, identity in _origins(given[0], entry, base, seed, place):
        for alter in alterations:
            several = f"{name}, {alter}" if alter != AS_IT_IS else name
            whole = canonical_json([identity, *stored, alter, seed])
            content = (groups, alter, seed, series, level, whole, test)
            yield ProblemSource(several, origin, *content)


def _origins(
    kind: str, entry: Section, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[tuple[str, str, Any, object]]:
    """(name, swept level, origin, what determines it) of each problem of an entry."""
    if kind == "flights":
        yield from _flights(entry, base, seed, place)
        return
    for key in ("derivative", "library"):
        if key in entry:
            raise place.at(key).error("is for flights: a file or data set has its columns")
    word = text(entry[kind], place.at(kind))
    if kind == "generator":
        yield from _generated(word, entry, place)
        return
    if kind == "dataset":
        if word not in DATASETS:
            near = suggestion(word, DATASETS)
            raise place.at(kind).error(f"has unknown value {shown(word)}{near}")
        yield text(entry.get("name", word), place.at("name")), "", word, word
        return
    path = Path(place.file).parent / word
    yield text(entry.get("name", path.stem), place.at("name")), "", path, digest_of(path)


def _generated(word: str, entry: Section, place: Place) -> Iterator[tuple[str, str, Any, object]]:
    """The problems of a generator: each level of its sweep, `count` times."""
    if word not in GENERATORS:
        near = suggestion(word, GENERATORS)
        raise place.at("generator").error(f"has unknown value {shown(word)}{near}")
    name = text(entry.get("name", word), place.at("name"))
    names = [item.name for item in fields(Generator)]
    own = {key: entry[key] for key in names if key in entry}
    sweep = read_section(entry.get("sweep", {}), place.at("sweep"))
    only(sweep, names, place.at("sweep"))
    listed = [as_items(values, place.at(key)) for key, values in sweep.items()]
    for values in itertools.product(*listed):
        level = dict(zip(sweep, values, strict=True))
        rules = build(Generator, {**GENERATORS[word], **own, **level}, place)
        words = ", ".join(f"{key} {shown(value)}" for key, value in level.items())
        count = integer(entry.get("count", 1), place.at("count"), least=1)
        for number in range(count):
            behind = f" {number + 1}" if count > 1 else ""
            full = f"{name}{behind}{', ' if words else ''}{words}"
            yield full, words, (rules, number), [word, asdict(rules), number]


def _flights(
    entry: Section, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[tuple[str, str, Any, object]]:
    if "name" not in entry:
        raise place.at("name").error("missing: a flight has no other name")
    name = text(entry["name"], place.at("name"))
    sections = {
        key: {**base[key], **read_section(entry.get(key, {}), place.at(key))} for key in SECTIONS
    }
    count = integer(sections["flights"].pop("count", 1), place.at("count"), least=1)
    for level in level_sets(read_sweep(entry, place)):
        within = Place(place.file, via=f'problem "{name}": ')
        changed = override({**sections, "readout": {}}, level)
        setup = read_setup(changed, within)
        words = ", ".join(f"{key} {shown(value)}" for key, value in level.items())
        for flight in range(count):
            number = f" {flight + 1}" if count > 1 else ""
            full = f"{name}{number}{', ' if words else ''}{words}"
            origin = FlightOrigin(setup, flight, count, seed)
            yield full, words, origin, [changed, flight, count, seed]
