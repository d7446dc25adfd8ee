"""The [[problems]] of a study: each entry one or several, from flights, files, names or generators.

An entry may have a `sweep` and a `count`, and any may be altered into degenerate ones. All entries
that are none are refused together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sparsefit import Estimator, RegressionProblem
from sparsefit.codec import Place, integer, only, shown, text
from sparsefit.errors import InputError, suggestion
from sparsefit.study.crossing import (
    Setup,
    level_sets,
    override,
    points_of,
    read_grid,
    read_setup,
    read_sweep,
)
from sparsefit.study.data_sets import (
    ALTERATIONS,
    AS_IT_IS,
    DATASETS,
    GENERATORS,
    Data,
    Generator,
    altered,
    digest_of,
    read_data,
    read_public,
)
from sparsefit.study.draw import SIMULATION, stream
from sparsefit.study.schema import (
    Range,
    distinct,
    items,
    key,
    names_of,
    read_section,
    read_sections,
    record_of,
    taken,
)
from sparsefit.study.toml_file import Section, canonical_json

SECTIONS = ("flights", "derivative", "library")
PROBLEM_KINDS = ("flights", "file", "dataset", "generator")
ALTERED = 300  # the child of a flight's stream that an alteration is drawn from
GENERATED = 301  # the child that a generated problem is drawn from


@dataclass(frozen=True)
class ProblemKeys:
    """The keys of [[problems]]; those of a generator stand beside them."""

    name: str = key("What tables call it.", "")
    flights: Mapping[str, object] | None = key(
        "Keys of `[flights]`: a problem for each flight.", None
    )
    file: str = key(
        "An `.npz` file with `theta`, `target` and, where there are any, `groups`; or a `.parquet` "
        "or `.csv` file, whose columns that begin with `target` are targets and all others theta.",
        "",
    )
    dataset: str = key(f"A data set that ships inside scikit-learn: {', '.join(DATASETS)}.", "")
    generator: str = key(
        "A problem that is drawn, y = Z w + noise, with its true support: "
        f"{', '.join(GENERATORS)}.", ""
    )  # fmt: skip
    test: str = key("A file of rows that are held out, in the form of `file`.", "")
    derivative: Mapping[str, object] = key("Of a flight, in place of the file's own section.", dict)
    library: Mapping[str, object] = key("Of a flight, in place of the file's own section.", dict)
    sweep: Mapping[str, object] = key("Of a flight or generator: a series of problems.", dict)
    groups: object = key("Labels of groups, or how many neighbouring columns make one.", None)
    alter: tuple[str, ...] = key(
        f"Makes it degenerate: {', '.join(ALTERATIONS)}; or a list.", (AS_IT_IS,)
    )
    count: int = key("How many problems are drawn.", 1, Range(least=1))


@dataclass(frozen=True, eq=False)
class FlightOrigin:
    """Flight number `flight` of `count` of a setup, from a seed."""

    setup: Setup
    flight: int
    count: int
    seed: int

    def __call__(self) -> Data:
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

    origin: makes its arrays; groups: labels, the number of neighbouring columns in a group, or None
    for the origin's own; series: the entry it belongs to, with its swept `level`; identity: what
    determines its numbers; test: a file of rows that are held out.
    """

    name: str
    origin: Callable[[], Data]
    level: str
    identity: str
    groups: tuple[object, ...] | int | None
    alter: str
    seed: int
    series: str
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
            raise InputError(f"problem {self.name!r}: {error}") from None
        return data

    def _data(self) -> Data:
        data = self.origin().real()
        if self.test is not None:
            rows = read_data(self.test).real()
            data = replace(data, test=(rows.theta, rows.target))
        if self.alter != AS_IT_IS:
            random = np.random.default_rng(stream(self.seed, 0, ALTERED))
            data = Data(*altered(self.alter, data.theta, data.target, random), data.groups)
        if isinstance(self.groups, int):
            return replace(data, groups=np.arange(data.theta.shape[1]) // self.groups)
        return data if self.groups is None else replace(data, groups=np.array(self.groups))


def _generated(rules: Generator, number: int, seed: int) -> Data:
    return rules.draw(np.random.default_rng(stream(seed, number, GENERATED)))


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
    only(entry, (*names_of(ProblemKeys), *names_of(Generator)), place)
    given = [kind for kind in PROBLEM_KINDS if kind in entry]
    if len(given) != 1:
        have = " and ".join(given) or "none"
        raise place.error(f"each needs exactly one of {', '.join(PROBLEM_KINDS)}, one has {have}")
    keys, own = taken(ProblemKeys, entry, place)
    groups = keys.groups
    if groups is not None:
        here = place.at("groups")
        is_list = isinstance(groups, list)
        groups = tuple(items(groups, here)) if is_list else integer(groups, here, least=1)
    distinct(keys.alter, place.at("alter"))
    for name in keys.alter:
        _known(name, ALTERATIONS, place.at("alter"))
    test = Path(place.file).parent / keys.test if keys.test else None
    beside = [entry.get("groups"), digest_of(test) if test else None]
    series = str(entry.get("name", entry[given[0]]))
    for name, origin, level, identity in _origins(given[0], keys, own, base, seed, place):
        for alter in keys.alter:
            several = f"{name}, {alter}" if alter != AS_IT_IS else name
            whole = canonical_json([identity, *beside, alter, seed])
            yield ProblemSource(several, origin, level, whole, groups, alter, seed, series, test)


def _known(name: str, valid: Mapping[str, Any] | tuple[str, ...], place: Place) -> None:
    if name not in valid:
        raise place.error(f"has unknown value {shown(name)}{suggestion(name, valid)}")


Origin = tuple[str, Callable[[], Data], str, object]


def _origins(
    kind: str, keys: ProblemKeys, own: Section, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[Origin]:
    """(name, what makes its arrays, swept level, what determines it) of each of an entry."""
    if kind == "flights":
        yield from _flights(keys, base, seed, place)
        return
    for name in ("derivative", "library"):
        if getattr(keys, name):
            raise place.at(name).error("is for flights: a file or data set has its columns")
    if kind == "file":
        path = Path(place.file).parent / keys.file
        yield keys.name or path.stem, partial(read_data, path), "", digest_of(path)
        return
    word = text(getattr(keys, kind), place.at(kind))
    _known(word, DATASETS if kind == "dataset" else GENERATORS, place.at(kind))
    if kind == "dataset":
        yield keys.name or word, partial(read_public, word), "", word
        return
    only(keys.sweep, names_of(Generator), place.at("sweep"))
    for level in points_of(read_grid(keys.sweep, place)):
        rules = record_of(Generator, {**GENERATORS[word], **own, **level}, place)
        for number in range(keys.count):
            name, words = _numbered(keys.name or word, number, keys.count, level)
            origin = partial(_generated, rules, number, seed)
            yield name, origin, words, [word, asdict(rules), number]


def _numbered(name: str, number: int, count: int, level: Mapping[str, object]) -> tuple[str, str]:
    """The name of one of `count` problems at a level of a sweep, and the level in words."""
    words = ", ".join(f"{key} {shown(value)}" for key, value in level.items())
    return f"{name}{f' {number + 1}' * (count > 1)}{', ' * bool(words)}{words}", words


def _flights(
    keys: ProblemKeys, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[Origin]:
    if not keys.name:
        raise place.at("name").error("missing: a flight has no other name")
    sections = {name: {**base[name], **getattr(keys, name)} for name in SECTIONS}
    count = integer(sections["flights"].pop("count", 1), place.at("count"), least=1)
    for level in level_sets(read_sweep({"sweep": keys.sweep}, place)):
        within = Place(place.file, via=f'problem "{keys.name}": ')
        changed = override({**sections, "readout": {}}, level)
        setup = read_setup(changed, within)
        for flight in range(count):
            name, words = _numbered(keys.name, flight, count, level)
            origin = FlightOrigin(setup, flight, count, seed)
            yield name, origin, words, [changed, flight, count, seed]
