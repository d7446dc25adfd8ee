"""The [[problems]] of a study of solvers: flights, files of numbers, and public data sets.

An entry is one of them, or several: a flight may have a ``count`` and a ``sweep``, and any may be
altered into degenerate ones.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sparsefit.codec import Place, integer, only, shown, text
from sparsefit.errors import InputError, suggestion
from sparsefit.estimator.estimator import Estimator
from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.spec.alterations import ALTERATIONS, AS_IT_IS
from sparsefit.study.spec.data_files import Arrays, digest, read_data
from sparsefit.study.spec.design import Factor, read_sweep
from sparsefit.study.spec.document import (
    Section,
    canonical_json,
    distinct,
    items,
    read_section,
    read_sections,
)
from sparsefit.study.spec.draw import SIMULATION, stream
from sparsefit.study.spec.public_data import DATASETS, read_public
from sparsefit.study.spec.setup import Setup, override, read_setup

KINDS = ("flights", "file", "dataset")
SECTIONS = ("flights", "derivative", "library")
ALTERED = 300  # the child of a flight's stream that an alteration is drawn from


@dataclass(frozen=True, eq=False)
class FlightOrigin:
    """Flight number `flight` of `count` of a setup, from a seed."""

    setup: Setup
    flight: int
    count: int
    seed: int

    def problem(self) -> RegressionProblem:
        """The regression problem of the flight, as a study of flights would pose it."""
        setup = self.setup
        draw = setup.flights.draw(self.flight, self.count, self.seed)
        fleet = draw.fleet(stream(self.seed, self.flight, SIMULATION))
        blind = [replace(flown, flow=None) for flown in fleet]
        return Estimator(setup.derivative, setup.library).prepare(blind).problem


@dataclass(frozen=True, eq=False)
class DataOrigin:
    """A data file, or a public data set by its name."""

    source: Path | str

    def arrays(self) -> Arrays:
        """theta, target and labels of groups."""
        if isinstance(self.source, Path):
            return read_data(self.source)
        return read_public(self.source)


Origin: TypeAlias = FlightOrigin | DataOrigin


@dataclass(frozen=True, eq=False)
class ProblemSource:
    """One problem: where it comes from, and what is done to it.

    groups: labels, the number of neighbouring columns in a group, or None for the origin's own;
    alter: a name in `ALTERATIONS`; series: the entry it belongs to, with its swept level; identity:
    what determines its numbers, as canonical JSON.
    """

    name: str
    kind: str
    origin: Origin
    groups: tuple[object, ...] | int | None
    alter: str
    seed: int
    series: str
    level: str
    identity: str

    def build(self) -> RegressionProblem:
        """The regression problem.

        Raises:
            InputError: naming the problem, where its numbers make none.
        """
        try:
            return self._build()
        except InputError as error:
            told = str(error).startswith(str(getattr(self.origin, "source", "\0")))
            where = "" if told else f'problem "{self.name}": '
            raise InputError(f"{where}{error}") from None

    def _build(self) -> RegressionProblem:
        if isinstance(self.origin, FlightOrigin):
            problem = self.origin.problem()
            if self.groups is None and self.alter == AS_IT_IS:
                return problem
            theta, target, groups = problem.theta, problem.target, problem.groups
        else:
            theta, target, labels = self.origin.arrays()
            checked = RegressionProblem.from_arrays(theta, target, labels)
            theta, target, groups = checked.theta, checked.target, checked.groups
        draw = np.random.default_rng(stream(self.seed, 0, ALTERED))
        theta, target = ALTERATIONS[self.alter](theta, target, draw)
        return RegressionProblem.from_arrays(theta, target, self._labels(theta.shape[1], groups))

    def _labels(self, columns: int, own: ArrayLike) -> ArrayLike:
        if self.groups is None:
            return own
        if isinstance(self.groups, int):
            return np.arange(columns) // self.groups
        return np.array(self.groups)


def read_problems(document: Section, seed: int, place: Place) -> tuple[ProblemSource, ...]:
    """The problems of a study file; `InputError` names the entry that is none."""
    here = place.within("problems")
    if "problems" not in document:
        raise place.at("problems").error("missing: write one [[problems]] or more")
    base = {name: read_section(document.get(name, {}), place.at(name)) for name in SECTIONS}
    found = [
        source
        for number, entry in enumerate(read_sections(document["problems"], here))
        for source in _read_entry(entry, base, seed, number, here)
    ]
    distinct([source.name for source in found], here.at("name"))
    return tuple(found)


KEYS = ("name", *KINDS, "derivative", "library", "sweep", "groups", "alter")


def _read_entry(
    entry: Section, base: Mapping[str, Section], seed: int, number: int, place: Place
) -> Iterator[ProblemSource]:
    only(entry, KEYS, place)
    given = [key for key in KINDS if key in entry]
    if len(given) != 1:
        have = " and ".join(given) or "none"
        raise place.error(f"each needs exactly one of {', '.join(KINDS)}, one has {have}")
    groups, alterations = _groups(entry, place), _alterations(entry, place)
    series = str(entry.get("name", entry[given[0]]))
    for name, level, origin, identity in _origins(given[0], entry, base, seed + number, place):
        for alter in alterations:
            several = f"{name}, {alter}" if alter != AS_IT_IS else name
            whole = canonical_json([identity, entry.get("groups"), alter, seed])
            yield ProblemSource(
                several, given[0], origin, groups, alter, seed + number, series, level, whole
            )


def _origins(
    kind: str, entry: Section, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[tuple[str, str, Origin, object]]:
    """(name, swept level, origin, what determines it) of each problem of an entry."""
    if kind == "flights":
        yield from _flights(entry, base, seed, place)
        return
    for key in ("derivative", "library", "sweep"):
        if key in entry:
            raise place.at(key).error("is for flights: a file or data set has its columns")
    word = text(entry[kind], place.at(kind))
    if kind == "dataset":
        if word not in DATASETS:
            near = suggestion(word, DATASETS)
            raise place.at(kind).error(f"has unknown value {shown(word)}{near}")
        yield text(entry.get("name", word), place.at("name")), "", DataOrigin(word), word
        return
    path = Path(place.file).parent / word
    name = text(entry.get("name", Path(word).stem), place.at("name"))
    yield name, "", DataOrigin(path), digest(path)


def _flights(
    entry: Section, base: Mapping[str, Section], seed: int, place: Place
) -> Iterator[tuple[str, str, Origin, object]]:
    if "name" not in entry:
        raise place.at("name").error("missing: a flight has no other name")
    name = text(entry["name"], place.at("name"))
    sections = {
        key: {**base[key], **read_section(entry.get(key, {}), place.at(key))} for key in SECTIONS
    }
    count = integer(sections["flights"].pop("count", 1), place.at("count"), least=1)
    whole = {**sections, "readout": {}}
    for level in _levels(read_sweep(entry, place)):
        within = Place(place.file, via=f'problem "{name}": ')
        changed = override(whole, level)
        setup = read_setup(changed, within)
        words = ", ".join(f"{key} {shown(value)}" for key, value in level.items())
        for flight in range(count):
            number = f" {flight + 1}" if count > 1 else ""
            full = f"{name}{number}{', ' if words else ''}{words}"
            origin = FlightOrigin(setup, flight, count, seed)
            yield full, words, origin, [changed, flight, count, seed]


def _levels(sweep: tuple[Factor, ...]) -> Iterator[dict[str, object]]:
    keys = [factor.key for factor in sweep]
    for levels in itertools.product(*(factor.levels for factor in sweep)):
        yield dict(zip(keys, levels, strict=True))


def _groups(entry: Section, place: Place) -> tuple[object, ...] | int | None:
    value = entry.get("groups")
    if value is None:
        return None
    if isinstance(value, list):
        return tuple(items(value, place.at("groups")))
    return integer(value, place.at("groups"), least=1)


def _alterations(entry: Section, place: Place) -> list[str]:
    value = entry.get("alter", AS_IT_IS)
    here = place.at("alter")
    names = [
        text(one, here) for one in (items(value, here) if isinstance(value, list) else [value])
    ]
    distinct(names, here)
    for name in names:
        if name not in ALTERATIONS:
            raise here.error(f"has unknown value {shown(name)}{suggestion(name, ALTERATIONS)}")
    return names
