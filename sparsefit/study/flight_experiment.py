"""The experiment with flights: units are flights, candidates are readings with their back-ends.

A case flies a flight in a condition, fits it and reads it. Cells of one unit share the flight, the
library and the path of penalties where these are equal, and a back-end of others has a worker of
its own, so that what it does to its process reaches nobody else's rows.
"""

from __future__ import annotations

import json
import math
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sparsefit import backends
from sparsefit.arrays import BoolArray
from sparsefit.errors import InputError, is_real
from sparsefit.study.columns import FLIGHT_COLUMNS, PARAMETERS, Outcome, kinds_of, outcome_of
from sparsefit.study.crossing import Cell, FlightDesign, Protocols, named
from sparsefit.study.flight_desk import ALPHA, FlightDesk, path_fractions, truth_of
from sparsefit.study.manifest import code_version
from sparsefit.study.plan import Asking, Batch, Experiment, telling
from sparsefit.study.schema import canonical_json, digest, numbered
from sparsefit.study.worker import Answer, Ask

AS_SAID = "as the study says"
BATCH, PROBLEM, FIT = range(3)  # what cells share
WORK = {"fly": "simulating the flight", "prepare": "building the library", "cases": "fitting"}


@dataclass(frozen=True, eq=False)
class FlightExperiment(Experiment):
    """Flights x (conditions x readings x back-ends x settings)."""

    columns = FLIGHT_COLUMNS

    @property
    def design(self) -> FlightDesign:
        """The flights and cells of the study file."""
        return self.definition.flights

    @cached_property
    def units(self) -> dict[str, list[Any]]:
        """The flights, which are known by their numbers."""
        count = self.design.count
        return {
            "flight": list(range(count)),
            "unit": [f"{number:04d}" for number in range(count)],
            "split": [self.design.split(number) for number in range(count)],
            "identity": [""] * count,
        }

    @cached_property
    def cells(self) -> dict[str, list[Any]]:
        """Condition, candidate, title and factors of every cell."""
        cells, protocols = self.design.cells, self.design.protocols
        worlds = _halves(protocols)
        readings, words = _halves(protocols, worlds), _setting_words(cells)
        conditions, candidates, aspects = list[str](), list[str](), list[tuple[str, ...]]()
        for cell in cells:
            own = {k: level for k, level in cell.levels.items() if not _of_flight(k)}
            levels = [level_words(k, v) for k, v in cell.levels.items() if k not in own]
            world, reading = worlds[cell.protocol], readings[cell.protocol]
            conditions.append(", ".join(filter(None, (world, *levels))))
            fitted = (cell.choice.name, cell.choice.label, cell.canonical_settings)
            candidates.append(digest(canonical_json([reading, own, *fitted]))[:12])
            chosen = ", ".join(level_words(k, v) for k, v in own.items())
            aspects.append((reading, words[fitted], chosen))
        titles = dict(zip(candidates, _titles(aspects), strict=True)) | self.design.titles
        return {
            "condition": conditions,
            "candidate": candidates,
            "title": [titles[name] for name in candidates],
            "world": [worlds[cell.protocol] for cell in cells],
            "reading": [readings[cell.protocol] for cell in cells],
            "protocol": [cell.protocol for cell in cells],
            "backend": [cell.choice.name for cell in cells],
            "settings": [cell.canonical_settings for cell in cells],
            "label": [cell.choice.label for cell in cells],
            **{key: self._levels(key) for key in self.factors()},
            "identity": numbered(map(self._identity, cells)),
        }

    def _levels(self, key: str) -> list[Any]:
        """The level of a factor in every cell: numbers where all are, else text."""
        given, protocols = self.design.given.get(key), self.design.protocols
        levels = [
            cell.levels.get(key, protocols[cell.protocol].get(key, given))
            for cell in self.design.cells
        ]
        if all(map(is_real, levels)):
            return [float(level) for level in levels if is_real(level)]
        texts = (level if isinstance(level, str) else canonical_json(level) for level in levels)
        return ["" if level == "null" else level for level in texts]

    def _identity(self, cell: Cell) -> str:
        """A hash of all that determines the numbers of a cell, whatever study asks for it.

        That is how it is flown, derived, fitted and read, to which tolerance: not the names that
        a study gives to these, nor what else it plans.
        """
        definition, setup = self.definition, repr(cell.setup)
        count = self.design.count if "linspace" in setup else 0  # a rule that spaces flights
        run = (definition.seed, definition.rules.tolerance, definition.rules.prediction_flights)
        content = (*run, definition.on_board, count, setup, cell.choice.name, cell.own_settings)
        return digest("\n".join(map(str, content)))

    def factors(self) -> dict[str, str]:
        """The swept keys, and those that protocols set."""
        content = [key for overrides in self.design.protocols.values() for key in overrides]
        every = dict.fromkeys([*self.design.sweep, *content])
        return {key: "condition" if _of_flight(key) else "candidate" for key in every}

    def case_id(self, unit: int, cell: int) -> str:
        """The number of the flight and the key of the cell: `0007-3f9c0d6a41b2e857`."""
        return f"{unit:04d}-{self.design.cells[cell].key}"

    def version(self, cell: int) -> str:
        return code_version(backends.distribution(self.design.cells[cell].choice.name))

    def truth(self, unit: int, cell: int) -> Mapping[str, Any]:
        rules, design = self.design.cells[cell].setup.flights, self.design
        try:
            return truth_of(rules.draw(unit, design.count, self.definition.seed))
        except InputError:  # an infinite L_w/tau_w, which the reason of the case says
            return {}

    @cached_property
    def _shared(self) -> list[list[int]]:
        """The numbers of the batch, problem and fit that each cell shares with others.

        A batch is of a condition and a desk, so that nothing is simulated twice; a fit is one, or
        those of a path over penalties.
        """
        numbers: dict[object, int] = {}
        shared = []
        for cell in self.design.cells:
            setup, along = cell.setup, {ALPHA} if path_fractions(cell) else set()
            others = canonical_json({k: v for k, v in cell.settings.items() if k not in along})
            problem = (setup.flights, setup.derivative, setup.library, setup.online)
            keys = ((setup.flights, self._desk_of(cell)), problem, (problem, cell.choice, others))
            shared.append([numbers.setdefault(key, len(numbers)) for key in keys])
        return shared

    def desk(self, name: str) -> tuple[Any, tuple[Any, ...]]:
        """All of a flight's steps; back-ends of others have a process of their own."""
        return FlightDesk, (self.definition,)

    def _desk_of(self, cell: Cell) -> str:
        name = cell.choice.name
        return "flights" if name in backends.BACKENDS else f"back-end {name}"

    def batches(self, wanted: BoolArray) -> Iterator[Batch]:
        for unit, row in enumerate(wanted):
            for cells in self._split(np.flatnonzero(row).tolist(), BATCH):
                yield Batch(unit, tuple(cells))

    def run(self, batch: Batch) -> Asking[None]:
        """Fly, prepare each library, then fit and read; a step that is lost costs its own cells.

        A path that is lost is tried fit by fit: the blame belongs to one of them.
        """
        steps = deque([("fly", list(batch.cells))])
        for group in self._split(batch.cells, PROBLEM):
            steps += [("prepare", group), *(("cases", fit) for fit in self._split(group, FIT))]
        ended: set[int] = set()
        while steps:
            verb, cells = steps.popleft()
            if cells[0] in ended:
                continue
            fits, cell = 1, self.design.cells[cells[0]]
            if verb == "cases" and len(cells) > 1:
                fits = max(len(path_fractions(cell)), 1) + len(cells) - 1
            limit = self.definition.rules.case_timeout * fits
            content = {"unit": batch.unit, "cells": cells}
            ask = Ask(verb, content, limit, self._desk_of(cell))
            answer: Answer = yield ask
            if answer.status == "crashed" and verb != "cases":  # from outside, maybe
                answer = yield ask
            if answer.status == "ok" and verb == "cases":
                try:
                    yield from self._outcomes(batch.unit, cells, answer)
                except (ValueError, TypeError, LookupError, RecursionError) as error:
                    reason = f"the worker process told no outcome: {error}"
                    answer = Answer("crashed", reason[:200])
            if answer.status != "ok" and verb == "cases" and len(cells) > 1:
                steps.extendleft((verb, [cell]) for cell in reversed(cells))
            elif answer.status != "ok":
                reason = answer.words(WORK[verb])
                for own in cells:
                    truth = self.truth(batch.unit, own)
                    yield Outcome(batch.unit, own, answer.status, reason, truth)
                ended |= set(cells)

    def _split(self, cells: Iterable[int], level: int) -> list[list[int]]:
        """Cells in groups of equal number, in order of first appearance."""
        groups: dict[int, list[int]] = {}
        for cell in cells:
            groups.setdefault(self._shared[cell][level], []).append(cell)
        return list(groups.values())

    def _outcomes(self, unit: int, cells: list[int], answer: Answer) -> list[Outcome]:
        """The outcomes that an answer tells, held against the plan; raises where it is odd."""
        outcomes, kinds = [], kinds_of(self.columns)
        for cell, (own, *content) in zip(cells, answer.content["rows"], strict=True):
            outcome = outcome_of(kinds, unit, own, *content)
            estimate = [outcome.values.get(f"est_{name}", math.nan) for name in PARAMETERS]
            if own != cell:
                raise ValueError("not the cases that were asked for")
            if outcome.status == "ok" and not np.isfinite(np.array(estimate, float)).all():
                raise ValueError("ok without an estimate")
            outcomes.append(outcome)
        return outcomes


def _of_flight(key: str) -> bool:
    return key.startswith("flights.")


def level_words(key: str, level: object) -> str:
    """A level in words: `duration 5`, `measurement_noise 0.2 / 0.05`."""
    levels = level if isinstance(level, list | tuple) else [level]
    words = " / ".join(f"{item:g}" if is_real(item) else str(item) for item in levels)
    return f"{key.partition('.')[2]} {words}"


def _halves(protocols: Protocols, worlds: Mapping[str, str] | None = None) -> dict[str, str]:
    """Words for what each protocol changes of the flights or, given their words, of the estimator.

    Protocols that agree in this half share them: the name of the only one, the parts between commas
    that the names of all of them have in common, or else the keys and values. Parts that name the
    flights are left out of the others where what is left tells these apart.
    """
    halves: dict[str, list[str]] = {}
    for name, overrides in protocols.items():
        own = {k: v for k, v in overrides.items() if _of_flight(k) == (worlds is None)}
        halves.setdefault(canonical_json(own), []).append(name)
    if len(halves) == 1:
        alone = len(protocols) == 1 and any(protocols.values()) and worlds is not None
        return {name: name if alone else "" for name in protocols}

    def common(names: Iterable[str]) -> list[str]:
        first, *others = [name.split(", ") for name in names]
        return [part for part in first if all(part in other for other in others)]

    words = {half: ", ".join(common(alike)) for half, alike in halves.items()}
    if worlds is not None:
        shorter = {}
        for half, alike in halves.items():
            flown = common(worlds[name] for name in alike)
            shorter[half] = ", ".join(part for part in common(alike) if part not in flown)
        counts = Counter(shorter.values())
        words |= {half: word for half, word in shorter.items() if word and counts[word] == 1}
    counts = Counter(words.values())
    for half, word in words.items():
        if not word or counts[word] > 1:
            content = (level_words(key, value) for key, value in json.loads(half).items())
            words[half] = ", ".join(content) or AS_SAID
    return {name: words[half] for half, alike in halves.items() for name in alike}


def _titles(aspects: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """The shortest name of each (reading, back-end, levels) that tells it apart."""
    for (_, backend, _), (reading, name, levels) in zip(aspects, telling(aspects), strict=True):
        if reading == AS_SAID or not (reading or name or levels):
            reading, name = "", backend
        names = ": ".join(filter(None, (reading, name)))
        yield " with ".join(filter(None, (names, levels)))


def _setting_words(cells: Sequence[Cell]) -> dict[tuple[str, str, str], str]:
    """The words of each (back-end, label, settings): its label, and what varies within that."""
    every = dict.fromkeys((c.choice.name, c.choice.label, c.canonical_settings) for c in cells)
    settings = {key: {"backend": key[0], **json.loads(key[2])} for key in every}
    words = {}
    for key, own in settings.items():
        alike = [settings[other] for other in every if other[1] == key[1]]
        varied = [name for name in own if any(other.get(name) != own[name] for other in alike)]
        words[key] = named(key[1], {name: own[name] for name in varied})
    return words
