"""The design of a study: every planned case, before any is run."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from sparsefit.backends import settings_of
from sparsefit.study.spec.choices import Setting, make_backend
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.setup import Setup
from sparsefit.study.spec.study import Combination, Study


@dataclass(frozen=True, eq=False)
class Cell:
    """What is done to every flight: one protocol, sweep level, back-end and setting.

    `key` is a hash of those four: it stays the same whatever else the study plans. `choice`
    counts the [[backends]] entries; `settings` are those given, `canonical_settings` all.
    """

    index: int
    key: str
    protocol: str
    levels: Mapping[str, object]
    setup: Setup
    choice: int
    settings: Mapping[str, Setting]
    backend: str
    label: str
    canonical_settings: str


class Case(NamedTuple):
    """One flight x one cell: one row of `cases.parquet`."""

    flight: int
    cell: Cell

    @property
    def case_id(self) -> str:
        """Readable by flight, stable from run to run: `0007-3f9c0d6a41b2e857`."""
        return case_id(self.flight, self.cell.key)


@dataclass(frozen=True)
class Counts:
    """How large a study is, for `study plan`."""

    flights: int
    protocols: int
    levels: Mapping[str, int]
    settings: Mapping[str, int]
    simulations: int
    problems: int
    fits: int
    cases: int


def case_id(flight: int, key: str) -> str:
    """The identity of a case."""
    return f"{flight:04d}-{key}"


def cells(study: Study) -> tuple[Cell, ...]:
    """Every cell, in plan order: protocol, sweep levels, back-end, setting (last is fastest)."""
    fitted = [
        (number, settings, choice.name, choice.label, _full_settings(choice.name, settings))
        for number, choice in enumerate(study.backends)
        for settings in choice.settings()
    ]
    crossed = ((one, back) for one in study.combinations() for back in fitted)
    return tuple(
        Cell(i, _key(one, back[2], back[1]), one.protocol, one.levels, one.setup, *back)
        for i, (one, back) in enumerate(crossed)
    )


def plan(study: Study) -> tuple[Case, ...]:
    """Every case, flight by flight, in the order of the rows of `cases.parquet`."""
    every = cells(study)
    return tuple(Case(flight, cell) for flight in range(study.count) for cell in every)


def counts(study: Study) -> Counts:
    """What a run has to do: what is shared is done, and counted, once."""
    every = cells(study)
    return Counts(
        flights=study.count,
        protocols=len(study.protocols),
        levels={factor.key: len(factor.levels) for factor in study.sweep},
        settings={choice.label: choice.size for choice in study.backends},
        simulations=study.count * len({flight_key(cell) for cell in every}),
        problems=study.count * len({problem_key(cell) for cell in every}),
        fits=study.count * len({fit_key(cell) for cell in every}),
        cases=study.planned,
    )


def flight_key(cell: Cell) -> object:
    """Cells of equal key fly the same flight."""
    return cell.setup.flights


def problem_key(cell: Cell) -> object:
    """Cells of equal key solve the same regression problem."""
    return (cell.setup.flights, cell.setup.derivative, cell.setup.library)


def fit_key(cell: Cell) -> object:
    """Cells of equal key read the same fit."""
    return (problem_key(cell), cell.choice, cell.canonical_settings)


def grouped(every: Iterable[Cell], key: str) -> list[tuple[Cell, ...]]:
    """Cells of equal `flight`, `problem` or `fit`, in order of first appearance."""
    of = {"flight": flight_key, "problem": problem_key, "fit": fit_key}[key]
    groups: dict[object, list[Cell]] = {}
    for cell in every:
        groups.setdefault(of(cell), []).append(cell)
    return [tuple(group) for group in groups.values()]


def _key(one: Combination, backend: str, settings: Mapping[str, Setting]) -> str:
    identity = canonical_json([one.protocol, one.levels, backend, settings])
    return hashlib.sha256(identity.encode()).hexdigest()[:16]


def _full_settings(name: str, settings: Mapping[str, Setting]) -> str:
    """Canonical JSON of all settings, defaults included: a row says all that was used."""
    return canonical_json(settings_of(make_backend(name, settings)))
