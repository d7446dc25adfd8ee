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
from sparsefit.codec import Place, integer, only, shown
from sparsefit.errors import InputError
from sparsefit.study.crossing import Setup, override, points_of, read_grid, read_setup, read_sweep
from sparsefit.study.data_sets import (
    GENERATORS,
    Data,
    altered,
    digest_of,
    drawn,
    read_data,
    read_public,
    shapes_of,
)
from sparsefit.study.draw import SIMULATION, stream
from sparsefit.study.keys import Generator, ProblemKeys
from sparsefit.study.schema import distinct, entries, names_of, record_of, section_of, taken
from sparsefit.study.toml_file import Section, canonical_json

SECTIONS = ("flights", "derivative", "library")
BESIDE: dict[str, tuple[str, ...]] = {  # a kind -> the keys beside it, `name` and `alter`
    "flights": ("library", "sweep"),
    "file": ("test",),
    "dataset": (),
    "generator": ("sweep", "count", *names_of(Generator)),
}
AS_IT_IS = "as it is"
ALTERED = 300  # the child of a flight's stream that an alteration is drawn from
GENERATED = 301  # the child that a generated problem is drawn from


@dataclass(frozen=True, eq=False)
class ProblemSource:
    """One problem: what makes its arrays, and what is done to them.

    series: the entry it belongs to, with its swept `level`; identity: what determines its numbers;
    test: a file of rows that are held out.
    """

    name: str
    make: Callable[[], Data]
    level: str
    identity: str
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
            data = self.make().real()
            if self.test is not None:
                rows = read_data(self.test).real()
                data = replace(data, test=(rows.theta, rows.target))
            if self.alter != AS_IT_IS:
                random = np.random.default_rng(stream(self.seed, 0, ALTERED))
                data = Data(*altered(self.alter, data.theta, data.target, random), data.groups)
            RegressionProblem.from_arrays(data.theta, data.target, data.groups)
        except InputError as error:
            raise InputError(f"problem {self.name!r}: {error}") from None
        return data


def read_problems(document: Section, seed: int, place: Place) -> tuple[ProblemSource, ...]:
    """The problems of a study file; one `InputError` names every entry that is none."""
    here, faults = place.within("problems"), list[str]()
    base = {name: section_of(document, name, place) for name in SECTIONS}
    sources: list[ProblemSource] = []
    for number, entry in enumerate(entries(document, "problems", place)):
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
    """The problems of one entry, each as it is or altered."""
    kinds = [kind for kind in BESIDE if kind in entry]
    if len(kinds) != 1:
        have = " and ".join(kinds) or "none"
        raise place.error(f"each needs exactly one of {', '.join(BESIDE)}, one has {have}")
    (kind,) = kinds
    only(entry, (kind, "name", "alter", *BESIDE[kind]), place)
    keys, rest = taken(ProblemKeys, entry, place)
    folder, test, beside = Path(place.file).parent, None, None
    made: Iterator[tuple[str, str, Callable[[], Data], Any]]
    if kind == "file":
        path = folder / keys.file
        shape = shapes_of(path)["theta"]
        if keys.test:
            test = folder / keys.test
            if shapes_of(test)["theta"][1:] != shape[1:]:
                raise place.at("test").error(f'"{keys.test}": its rows have other columns')
            beside = digest_of(test)
        made = iter([(keys.name or path.stem, "", partial(read_data, path), digest_of(path))])
    elif kind == "dataset":
        word = str(keys.dataset)
        made = iter([(keys.name or word, "", partial(read_public, word), word)])
    elif kind == "flights":
        made = _flights(keys, base, seed, place)
    else:
        made = _drawn(keys, rest, seed, place)
    for name, level, make, identity in made:
        for alter in keys.alter:
            several = f"{name}, {alter}" if alter != AS_IT_IS else name
            whole = canonical_json([identity, None, beside, alter, seed])
            series = str(entry.get("name", entry[kind]))
            yield ProblemSource(several, make, level, whole, alter, seed, series, test)


def _flights(
    keys: ProblemKeys, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[tuple[str, str, Callable[[], Data], Any]]:
    """Name, swept level, what makes the arrays and what determines them, of each flight."""
    if not keys.name:
        raise place.at("name").error("missing: a flight has no other name")
    sections = {name: {**base[name], **getattr(keys, name, {})} for name in SECTIONS}
    count = integer(sections["flights"].pop("count", 1), place.at("count"), least=1)
    for level in points_of(read_sweep(keys.sweep, place.within("problems.sweep"))):
        changed = override({**sections, "readout": {}}, level)
        setup = read_setup(changed, Place(place.file, via=f'problem "{keys.name}": '))
        for number in range(count):
            name, words = _named(keys.name, number, count, level)
            make = partial(_flown, setup, number, count, seed)
            yield name, words, make, [changed, number, count, seed]


def _flown(setup: Setup, flight: int, count: int, seed: int) -> Data:
    """The arrays of the problem of a flight, as a study of flights would pose it."""
    fleet = setup.flights.draw(flight, count, seed).fleet(stream(seed, flight, SIMULATION))
    blind = [replace(flown, flow=None) for flown in fleet]
    problem = Estimator(setup.derivative, setup.library).prepare(blind).problem
    return Data(problem.theta, problem.target, problem.groups, samples=problem.sample_count)


def _drawn(
    keys: ProblemKeys, own: Section, seed: int, place: Place
) -> Iterator[tuple[str, str, Callable[[], Data], Any]]:
    """Name, swept level, what makes the arrays and what determines them, of each that is drawn."""
    here, kind = place.within("problems.sweep"), str(keys.generator)
    only(keys.sweep, names_of(Generator), here)
    for level in points_of(read_grid(keys.sweep, here)):
        rules = record_of(Generator, {**GENERATORS[kind], **own, **level}, place)
        for number in range(keys.count):
            name, words = _named(keys.name or kind, number, keys.count, level)
            make = partial(_made, rules, seed, number)
            yield name, words, make, [kind, asdict(rules), number]


def _made(rules: Generator, seed: int, number: int) -> Data:
    return drawn(rules, np.random.default_rng(stream(seed, number, GENERATED)))


def _named(name: str, number: int, count: int, level: Mapping[str, Any]) -> tuple[str, str]:
    """The name of one of ``count`` problems at a swept level, and the words of the level."""
    words = ", ".join(f"{key} {shown(value)}" for key, value in level.items())
    numbered = f"{name} {number + 1}" if count > 1 else name
    return ", ".join(filter(None, (numbered, words))), words
