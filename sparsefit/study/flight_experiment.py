"""The experiment with flights: units are flights, candidates are readings with their back-ends.

A case flies a flight in a condition, fits it and reads it. Cells of one unit share the flight, the
library and the path of penalties where these are equal, and a back-end of others has a worker of
its own, so that what it does to its process reaches nobody else's rows.
"""

from __future__ import annotations

import json
import math
from collections import Counter, deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sparsefit import backends
from sparsefit.arrays import BoolArray
from sparsefit.errors import is_real
from sparsefit.study.columns import FLIGHT_COLUMNS, PARAMETERS, Outcome, kinds_of, outcome_of
from sparsefit.study.crossing import Cell, Protocol, Setup
from sparsefit.study.definition import Definition, FlightDesign
from sparsefit.study.draw import FlightRules
from sparsefit.study.flight_desk import ALPHA, FlightDesk, draw_of, path_fractions, truth_of
from sparsefit.study.logged import Logs
from sparsefit.study.manifest import code_version
from sparsefit.study.plan import Batch, Experiment, Step
from sparsefit.study.toml_file import canonical_json, digest, numbered
from sparsefit.study.worker import Answer, Ask

SPACED = "linspace"  # the rule by which a flight depends on how many there are
OURS = "flights"  # the desk of all back-ends of sparsefit
FLIGHT_KINDS = kinds_of(FLIGHT_COLUMNS)
WORK = {"fly": "simulating the flight", "prepare": "building the library", "cases": "fitting"}


def flight_key(cell: Cell) -> Hashable:
    """Cells of equal key fly one flight."""
    return cell.setup.flights


def problem_key(cell: Cell) -> Hashable:
    """Cells of equal key solve one regression problem."""
    setup = cell.setup
    return (setup.flights, setup.derivative, setup.library, setup.online)


def fit_key(cell: Cell) -> Hashable:
    """Cells of equal key read one fit."""
    return (problem_key(cell), cell.choice, cell.canonical_settings)


def sharing(cells: Iterable[Cell], key: Callable[[Cell], Hashable]) -> list[list[Cell]]:
    """The cells in groups of equal key, in order of first appearance."""
    groups: dict[Hashable, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(key(cell), []).append(cell)
    return list(groups.values())


@dataclass(frozen=True, eq=False)
class FlightExperiment(Experiment):
    """Flights x (conditions x readings x back-ends x settings)."""

    columns = FLIGHT_COLUMNS
    judged = tuple(f"est_{name}" for name in PARAMETERS)

    @property
    def design(self) -> FlightDesign:
        """The flights and cells of the study file."""
        return self.definition.flights

    def units(self) -> dict[str, list[Any]]:
        """The flights, which are known by their numbers."""
        count = self.design.count
        return {
            "flight": list(range(count)),
            "unit": [f"{number:04d}" for number in range(count)],
            "split": [self.design.split(number) for number in range(count)],
            "identity": [""] * count,
        }

    def cells(self) -> dict[str, list[Any]]:
        """Condition, candidate, title and factors of every cell."""
        return self._cells

    @cached_property
    def _cells(self) -> dict[str, list[Any]]:
        cells, words = self.design.cells, _Words(self.design)
        candidates = [words.candidate(cell) for cell in cells]
        return {
            "condition": [words.condition(cell) for cell in cells],
            "candidate": [digest(canonical_json(content))[:12] for content in candidates],
            "title": [words.title(cell) for cell in cells],
            "world": [words.worlds[cell.protocol] for cell in cells],
            "reading": [words.readings[cell.protocol] for cell in cells],
            "protocol": [cell.protocol for cell in cells],
            "backend": [cell.choice.name for cell in cells],
            "settings": [cell.canonical_settings for cell in cells],
            "label": [cell.choice.label for cell in cells],
            **{key: words.levels(key) for key in self.factors()},
            "identity": numbered(_identities(self.definition)),
        }

    def factors(self) -> dict[str, str]:
        """The swept keys, and those that protocols set."""
        swept = list(self.design.sweep)
        content = [key for protocol in self.design.protocols for key in protocol.overrides]
        every = dict.fromkeys([*swept, *content])
        return {key: "condition" if _of_flight(key) else "candidate" for key in every}

    def case_id(self, unit: int, cell: int) -> str:
        """The number of the flight and the key of the cell: `0007-3f9c0d6a41b2e857`."""
        return f"{unit:04d}-{self.design.cells[cell].key}"

    def names(self, cell: int) -> Sequence[str]:
        """The back-end, the label and the protocol."""
        return self.design.cells[cell].names

    def version(self, cell: int) -> str:
        """The code, and a plug-in's."""
        return code_version(backends.distribution(self.design.cells[cell].choice.name))

    def truth(self, unit: int, cell: int) -> Mapping[str, Any]:
        """The columns of the true flow."""
        return truth_of(draw_of(self.definition, unit, self.design.cells[cell]))

    def cost(self, unit: int, cell: int) -> int:
        """The number of the fit."""
        return unit * len(self.design.cells) + self._shared["fit"][cell]

    @cached_property
    def _shared(self) -> dict[str, list[int]]:
        """The numbers of the flight, problem, ask and fit that each cell shares with others."""
        keys = {"flight": flight_key, "problem": problem_key, "ask": _ask_key, "fit": fit_key}
        numbers = {name: [0] * len(self.design.cells) for name in keys}
        for name, key in keys.items():
            for number, group in enumerate(sharing(self.design.cells, key)):
                for cell in group:
                    numbers[name][cell.index] = number
        return numbers

    def desk(self, name: str) -> tuple[Any, tuple[Any, ...]]:
        """All of a flight's steps; back-ends of others have a process of their own."""
        return FlightDesk, (self.definition,)

    @cached_property
    def _desks(self) -> list[str]:
        names = [cell.choice.name for cell in self.design.cells]
        return [OURS if name in backends.BACKENDS else f"back-end {name}" for name in names]

    def batches(self, wanted: BoolArray) -> Iterator[Batch]:
        """A batch per flight, condition and desk, so that nothing is simulated twice."""
        groups: dict[tuple[int, str], list[int]] = {}
        for cell, key in enumerate(zip(self._shared["flight"], self._desks, strict=True)):
            groups.setdefault(key, []).append(cell)
        for unit in np.flatnonzero(wanted.any(axis=1)).tolist():
            row = wanted[unit].tolist()
            for group in groups.values():
                if cells := [cell for cell in group if row[cell]]:
                    yield Batch(unit, tuple(cells))

    def run(self, batch: Batch) -> Step:
        """Fly, prepare each library, then fit and read; a step that is lost costs its own cells.

        A path that is lost is tried fit by fit: the blame belongs to one of them.
        """
        steps = deque([("fly", list(batch.cells))])
        for group in self._split(batch.cells, "problem"):
            steps += [("prepare", group), *(("cases", fit) for fit in self._split(group, "ask"))]
        ended: set[int] = set()
        while steps:
            verb, cells = steps.popleft()
            if cells[0] in ended:
                continue
            ask = self._ask(verb, batch.unit, cells)
            answer = yield ask
            if answer and answer.status == "crashed" and verb != "cases":  # from outside, maybe
                answer = yield ask
            assert answer is not None
            try:
                told = self._told(batch.unit, cells, answer) if verb == "cases" else []
            except (ValueError, TypeError, LookupError, RecursionError) as error:
                reason = f"the worker process told no outcome: {error}"
                answer, told = Answer("crashed", reason[:200]), []
            if answer.status != "ok" and verb == "cases" and len(cells) > 1:
                steps.extendleft((verb, [cell]) for cell in reversed(cells))
            elif answer.status != "ok":
                reason = answer.words(WORK[verb])
                for cell in cells:
                    truth = self.truth(batch.unit, cell)
                    yield Outcome(batch.unit, cell, answer.status, reason, truth)
                ended |= set(cells)
            yield from told

    def _split(self, cells: Iterable[int], name: str) -> list[list[int]]:
        """Cells in groups of equal number, in order of first appearance."""
        groups: dict[int, list[int]] = {}
        for cell in cells:
            groups.setdefault(self._shared[name][cell], []).append(cell)
        return list(groups.values())

    def _ask(self, verb: str, unit: int, cells: list[int]) -> Ask:
        fits = 1
        if verb == "cases" and len(cells) > 1:
            fits = max(len(path_fractions(self.design.cells[cells[0]])), 1) + len(cells) - 1
        limit = self.definition.run.case_timeout * fits
        return Ask(verb, {"unit": unit, "cells": cells}, limit, self._desks[cells[0]])

    def _told(self, unit: int, cells: list[int], answer: Answer) -> list[Outcome]:
        """The outcomes that an answer tells, each held against the plan; raises where it is odd."""
        if answer.status != "ok":
            return []
        outcomes = []
        for cell, (own, status, reason, body) in zip(cells, answer.content["rows"], strict=True):
            outcome = outcome_of(unit, own, status, reason, body, FLIGHT_KINDS)
            estimate = [float(outcome.values.get(name, math.nan)) for name in self.judged]
            if own != cell:
                raise ValueError("not the cases that were asked for")
            if status == "ok" and not all(map(math.isfinite, estimate)):
                raise ValueError("ok without an estimate")
            outcomes.append(outcome)
        return outcomes


def _ask_key(cell: Cell) -> Hashable:
    """Cells of equal key are fitted by one ask: one fit, or those of a path over penalties."""
    along = {ALPHA} if path_fractions(cell) else set()
    shared = {key: value for key, value in cell.settings.items() if key not in along}
    return (problem_key(cell), cell.choice, canonical_json(shared))


def _of_flight(key: str) -> bool:
    return key.startswith("flights.")


def _identities(definition: Definition) -> Iterator[str]:
    """Of every cell a hash of all that determines its numbers, whatever study asks for it.

    That is the seed and the flight rules, how it is derived, fitted and read, to which tolerance:
    not the names that a study gives to these, nor what else it plans. A setting at its default
    counts as absent, so that a new one leaves the rest as it is.
    """
    design, run = definition.flights, definition.run
    flown = ["on board"] if definition.on_board else []
    common = canonical_json([definition.seed, run.tolerance, run.prediction_flights, *flown])
    setups: dict[int, str] = {}
    for cell in design.cells:
        if id(cell.setup) not in setups:
            setups[id(cell.setup)] = _told(cell.setup, design.count)
        told = (common, setups[id(cell.setup)], cell.choice.name, cell.own_settings)
        yield digest("\n".join(told))


def _told(setup: Setup, count: int) -> str:
    flights = setup.flights
    if isinstance(flights, Logs):  # what was logged, wherever the file lies
        pieces = [[piece.digest, piece.start, piece.end] for piece in flights.pieces]
        content = [canonical_json([pieces, _content(flights.pieces[0].vehicle)])]
    else:
        content = [_told_rules(flights, count)]
    content += [
        canonical_json(_content(p)) for p in (setup.derivative, setup.library, setup.readout)
    ]
    if setup.online.asked:
        content.append(canonical_json(_content(setup.online)))
    return ",".join(content)


def _told_rules(flights: FlightRules, count: int) -> str:
    spaced = any(entry.rule == SPACED for _, entry in flights.entries)
    rules = (f"{name} {entry.rule} {entry.values!r}" for name, entry in flights.entries)
    words, cells = flights.words, flights.words.flow == "cellular"
    log = "" if words.thrust_log == "measured" else f" {words.thrust_log}"
    told = f"{cells} {words.turbulence_spectrum}{log}"
    return f"{count if spaced else 0} {told} {'; '.join(rules)}"


def _content(value: object) -> object:
    """A record as its name and the fields that are not at their defaults."""
    if is_dataclass(value):
        content = {}
        for item in fields(value):
            default = item.default
            if item.default_factory is not MISSING:
                default = item.default_factory()
            if getattr(value, item.name) != default:
                content[item.name] = _content(getattr(value, item.name))
        return [type(value).__name__, content]
    if isinstance(value, list | tuple):
        return [_content(item) for item in value]
    return value


class _Words:
    """The words for the conditions and candidates of a study, told by what differs."""

    def __init__(self, design: FlightDesign) -> None:
        self._design = design
        self.worlds = _halves(design.protocols, flights=True)
        self.readings = _halves(design.protocols, flights=False)
        self._settings = _setting_words(design.cells)
        self._swept = list(design.sweep)

    def condition(self, cell: Cell) -> str:
        """The world, and the levels of swept conditions."""
        levels = [level_words(k, cell.levels[k]) for k in self._swept if _of_flight(k)]
        return ", ".join(part for part in (self.worlds[cell.protocol], *levels) if part)

    def candidate(self, cell: Cell) -> list[object]:
        """The settings of a candidate: reading, levels of the estimator's factors, back-end."""
        own = {key: cell.levels[key] for key in self._swept if not _of_flight(key)}
        reading = self.readings[cell.protocol]
        return [reading, own, cell.choice.name, cell.choice.label, cell.canonical_settings]

    def title(self, cell: Cell) -> str:
        """The shortest words that tell the candidate of a cell from the others."""
        levels = [level_words(k, cell.levels[k]) for k in self._swept if not _of_flight(k)]
        chosen = f" with {', '.join(levels)}" if levels else ""
        reading = self.readings[cell.protocol]
        setting = self._settings[cell.choice.name, cell.choice.label, cell.canonical_settings]
        return f"{reading}: {setting}{chosen}" if reading else f"{setting}{chosen}"

    def levels(self, key: str) -> list[Any]:
        """The level of a factor in every cell: numbers where all are, else text."""
        given = json.loads(self._design.given.get(key, "null"))
        overrides = {p.name: p.overrides.get(key, given) for p in self._design.protocols}
        levels = [cell.levels.get(key, overrides[cell.protocol]) for cell in self._design.cells]
        numbers = [float(level) for level in levels if is_real(level)]
        if len(numbers) == len(levels):
            return numbers
        texts = (level if isinstance(level, str) else canonical_json(level) for level in levels)
        return ["" if level == "null" else level for level in texts]


def level_words(key: str, level: object) -> str:
    """A level in words: `duration 5`, `measurement_noise 0.2 / 0.05`."""
    if isinstance(level, list | tuple):
        words = " / ".join(f"{item:g}" if is_real(item) else str(item) for item in level)
    else:
        words = f"{level:g}" if is_real(level) else str(level)
    return f"{key.partition('.')[2]} {words}"


def _halves(protocols: Sequence[Protocol], *, flights: bool) -> dict[str, str]:
    """Words for what each protocol changes of the flights, or of the estimator.

    Protocols that agree in this half share them: the name of the only one, the parts between commas
    that the names of all of them have in common, or else the keys and values.
    """
    halves = {
        protocol.name: canonical_json(
            {k: v for k, v in protocol.overrides.items() if _of_flight(k) == flights}
        )
        for protocol in protocols
    }
    if len(set(halves.values())) == 1:
        alone = len(protocols) == 1 and protocols[0].overrides and not flights
        return {name: name if alone else "" for name in halves}
    words = {}
    for half in dict.fromkeys(halves.values()):
        names = [name.split(", ") for name, own in halves.items() if own == half]
        words[half] = ", ".join(p for p in names[0] if all(p in other for other in names))
    counts = Counter(words.values())
    for half, word in words.items():
        if not word or counts[word] > 1:
            content = (level_words(key, value) for key, value in json.loads(half).items())
            words[half] = ", ".join(content) or "as the study says"
    return {name: words[half] for name, half in halves.items()}


def _setting_words(cells: Sequence[Cell]) -> dict[tuple[str, str, str], str]:
    """The words of each (back-end, label, settings): its label, and the settings that vary."""
    every = dict.fromkeys((c.choice.name, c.choice.label, c.canonical_settings) for c in cells)
    settings = {key: json.loads(key[2]) for key in every}
    labels = Counter(label for _, label, _ in every)
    words = {}
    for key in every:
        name, label, _ = key
        others = [settings[other] for other in every if other[0] == name]
        names = dict.fromkeys(setting for other in others for setting in other)
        varied = [s for s in names if len({repr(other.get(s)) for other in others}) > 1]
        # A label that was given for one setting alone says enough.
        content = [] if label != name and labels[label] == 1 else varied
        shown = [f"{s}={settings[key][s]}" for s in content if s in settings[key]]
        words[key] = " ".join([label, *shown])
    return words
