"""The [[problems]] of a study: each entry one or several, from flights, files, names or generators.

An entry may have a `sweep` and a `count`, and any may be altered into degenerate ones. All entries
that are none are refused together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from sparsefit import Estimator, RegressionProblem
from sparsefit.codec import Place, integer, only, shown
from sparsefit.errors import InputError, suggestion
from sparsefit.study.crossing import (
    Setup,
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
    as_items,
    distinct,
    key,
    names_of,
    read_section,
    read_sections,
    record_of,
    required,
    taken,
)
from sparsefit.study.toml_file import Section, canonical_json

SECTIONS = ("flights", "derivative", "library")
KEYS: dict[str, tuple[str, ...]] = {  # beside the kind itself, `name` and `alter`
    "flights": ("library", "sweep"),
    "file": ("test",),
    "dataset": (),
    "generator": ("sweep", "count", *names_of(Generator)),
}
NAMES = {"dataset": DATASETS, "generator": tuple(GENERATORS), "alter": tuple(ALTERATIONS)}
ALTERED = 300  # the child of a flight's stream that an alteration is drawn from
GENERATED = 301  # the child that a generated problem is drawn from


@dataclass(frozen=True)
class ProblemKeys:
    """The keys of [[problems]]; those of a generator stand beside them."""

    name: str = key("What tables call it.", "")
    flights: Mapping[str, object] = key("Keys of `[flights]`: a problem for each flight.", dict)
    file: str = key("An `.npz` file with `theta`, `target` and, if any, `groups`.", "")
    dataset: str = key(f"A data set that ships inside scikit-learn: {', '.join(DATASETS)}.", "")
    generator: str = key(
        "A problem that is drawn, y = Z w + noise, with its true support: "
        f"{', '.join(GENERATORS)}.", ""
    )  # fmt: skip
    test: str = key("A file of rows that are held out, in the form of `file`.", "")
    library: Mapping[str, object] = key("Of a flight, in place of the file's own keys.", dict)
    sweep: Mapping[str, object] = key("Of a flight or generator: a series of problems.", dict)
    alter: tuple[str, ...] = key(
        f"Makes it degenerate: {', '.join(ALTERATIONS)}; or a list.", (AS_IT_IS,)
    )
    count: int = key("How many problems are drawn.", 1, Range(least=1))


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
                if rows.theta.shape[1:] != data.theta.shape[1:]:
                    raise InputError("the test rows have other columns than the file")
            if self.alter != AS_IT_IS:
                random = np.random.default_rng(stream(self.seed, 0, ALTERED))
                data = Data(*altered(self.alter, data.theta, data.target, random), data.groups)
            RegressionProblem.from_arrays(data.theta, data.target, data.groups)
        except InputError as error:
            raise InputError(f"problem {self.name!r}: {error}") from None
        return data


def read_problems(document: Section, seed: int, place: Place) -> tuple[ProblemSource, ...]:
    """The problems of a study file; one `InputError` names every entry that is none."""
    here = place.within("problems")
    base = {name: read_section(document.get(name, {}), place.at(name)) for name in SECTIONS}
    sources: list[ProblemSource] = []
    faults: list[str] = []
    for number, entry in enumerate(read_sections(required(document, "problems", place), here)):
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
    given = [kind for kind in KEYS if kind in entry]
    if len(given) != 1:
        have = " and ".join(given) or "none"
        raise place.error(f"each needs exactly one of {', '.join(KEYS)}, one has {have}")
    kind = given[0]
    only(entry, (kind, "name", "alter", *KEYS[kind]), place)
    keys, own = taken(ProblemKeys, entry, place)
    for field, valid in NAMES.items():
        for name in as_items(entry[field], place.at(field)) if field in entry else ():
            if name not in valid:
                near = suggestion(str(name), valid)
                raise place.at(field).error(f"has unknown value {shown(name)}{near}")
    test = Path(place.file).parent / keys.test if keys.test else None
    beside = [None, digest_of(test) if test else None]  # None: where a key was that went
    series = str(entry.get("name", entry[kind]))
    for name, level, make, identity in _made(kind, keys, own, base, seed, place):
        for alter in keys.alter:
            several = f"{name}, {alter}" if alter != AS_IT_IS else name
            whole = canonical_json([identity, *beside, alter, seed])
            yield ProblemSource(several, make, level, whole, alter, seed, series, test)


def _made(
    kind: str, keys: ProblemKeys, own: Section, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[tuple[str, str, Callable[[], Data], object]]:
    """(name, swept level, what makes its arrays, what determines them) of each of an entry."""
    word = str(getattr(keys, kind))
    if kind == "file":
        path = Path(place.file).parent / word
        yield keys.name or path.stem, "", partial(read_data, path), digest_of(path)
        return
    if kind == "dataset":
        yield keys.name or word, "", partial(read_public, word), word
        return
    count, here = keys.count, place.within("problems.sweep")
    sweep: Mapping[str, tuple[object, ...]]
    before: list[object]
    after: list[object]
    sections = {name: {**base[name], **getattr(keys, name, {})} for name in SECTIONS}
    if kind == "flights":
        if not keys.name:
            raise place.at("name").error("missing: a flight has no other name")
        count = integer(sections["flights"].pop("count", 1), place.at("count"), least=1)
        sweep = read_sweep(keys.sweep, here)
    else:
        only(keys.sweep, names_of(Generator), here)
        sweep = read_grid(keys.sweep, here)
    for level in points_of(sweep):
        words = "".join(f", {key} {shown(value)}" for key, value in level.items())
        make: Callable[[int], Data]
        if kind == "flights":
            changed = override({**sections, "readout": {}}, level)
            setup = read_setup(changed, Place(place.file, via=f'problem "{keys.name}": '))
            make, before, after = partial(_flown, setup, count, seed), [changed], [count, seed]
        else:
            rules = record_of(Generator, {**GENERATORS[word], **own, **level}, place)
            make, before, after = partial(_drawn, rules, seed), [word, asdict(rules)], []
        for number in range(count):
            name = f"{keys.name or word}{f' {number + 1}' * (count > 1)}{words}"
            determined = [*before, number, *after]
            yield name, words.removeprefix(", "), partial(make, number), determined


def _flown(setup: Setup, count: int, seed: int, flight: int) -> Data:
    """The arrays of the problem of a flight, as a study of flights would pose it."""
    fleet = setup.flights.draw(flight, count, seed).fleet(stream(seed, flight, SIMULATION))
    blind = [replace(flown, flow=None) for flown in fleet]
    problem = Estimator(setup.derivative, setup.library).prepare(blind).problem
    return Data(problem.theta, problem.target, problem.groups, samples=problem.sample_count)


def _drawn(rules: Generator, seed: int, number: int) -> Data:
    return rules.draw(np.random.default_rng(stream(seed, number, GENERATED)))
