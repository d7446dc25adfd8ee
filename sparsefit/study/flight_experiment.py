"""The experiment with flights: units are flights, candidates are readings with their back-ends.

A case flies a flight in a condition, fits it and reads it. Cells of one unit share the flight, the
library and the path of penalties where these are equal, and a back-end of others has a worker of
its own, so that what it does to its process reaches nobody else's rows.
"""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Callable, Generator, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

from sparsefit import backends
from sparsefit.arrays import BoolArray
from sparsefit.errors import is_real
from sparsefit.study.columns import (
    FLIGHT_COLUMNS,
    PARAMETERS,
    STATUSES,
    Column,
    Outcome,
    checked_values,
    kinds_of,
)
from sparsefit.study.crossing import Cell, Protocol, Setup
from sparsefit.study.definition import Definition, FlightDesign
from sparsefit.study.draw import FlightRules
from sparsefit.study.flight_desk import FlightDesk, draw_of, path_fractions, truth_of
from sparsefit.study.logged import Logs
from sparsefit.study.manifest import code_version
from sparsefit.study.plan import Batch, Step
from sparsefit.study.toml_file import canonical_json, digest, numbered
from sparsefit.study.worker import Ask, Lost, Record

SPACED = "linspace"  # the rule by which a flight depends on how many there are
OURS = "flights"  # the desk of all back-ends of sparsefit
FLIGHT_KINDS = kinds_of(FLIGHT_COLUMNS)


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
class FlightExperiment:
    """Flights x (conditions x readings x back-ends x settings), as `Experiment` asks for it."""

    definition: Definition

    @property
    def design(self) -> FlightDesign:
        """The flights and cells of the study file."""
        return self.definition.flights

    @property
    def columns(self) -> Sequence[Column]:
        """The columns of `cases.parquet`."""
        return FLIGHT_COLUMNS

    @property
    def judged(self) -> Sequence[str]:
        """The estimates."""
        return [f"est_{name}" for name in PARAMETERS]

    @property
    def alone(self) -> bool:
        """Any number of processes may work."""
        return False

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
        swept = [factor.key for factor in self.design.sweep]
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

    def whole(self, wanted: BoolArray, done: BoolArray, version: Sequence[str]) -> BoolArray:
        """Every case stands for itself."""
        return wanted

    def truth(self, unit: int, cell: int) -> Mapping[str, Any]:
        """The true flow."""
        variant, truths = self._variant[cell], self._truths
        if (unit, variant) not in truths:
            if len(truths) > 4096:
                truths.clear()
            draw = draw_of(self.definition, unit, self.design.cells[cell])
            truths[unit, variant] = truth_of(draw)
        return truths[unit, variant]

    @cached_property
    def _truths(self) -> dict[tuple[int, int], Mapping[str, Any]]:
        return {}

    @cached_property
    def _variant(self) -> list[int]:
        return self._numbers(flight_key)

    def end(self) -> None:
        """Workers leave nothing behind."""

    def cost(self, unit: int, cell: int) -> int:
        """The number of the fit."""
        return unit * len(self.design.cells) + self._fit[cell]

    @cached_property
    def _fit(self) -> list[int]:
        return self._numbers(fit_key)

    def _numbers(self, key: Callable[[Cell], Hashable]) -> list[int]:
        """The number of the group of equal key that each cell belongs to."""
        numbers = [0] * len(self.design.cells)
        for number, group in enumerate(sharing(self.design.cells, key)):
            for cell in group:
                numbers[cell.index] = number
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
        for cell, (variant, desk) in enumerate(zip(self._variant, self._desks, strict=True)):
            groups.setdefault((variant, desk), []).append(cell)
        for unit in np.flatnonzero(wanted.any(axis=1)).tolist():
            for group in groups.values():
                if cells := [cell for cell in group if wanted[unit, cell]]:
                    yield Batch(unit, tuple(cells))

    def run(self, batch: Batch) -> Step:
        """Fly, prepare each library, then fit and read; a step that is lost costs its own cells."""
        cells = [self.design.cells[index] for index in batch.cells]
        reason = yield from self._begin(batch.unit, "fly", "simulating the flight", cells)
        if not reason:
            for group in sharing(cells, problem_key):
                yield from self._run_problem(batch.unit, group)

    def _begin(
        self, unit: int, verb: str, words: str, cells: list[Cell]
    ) -> Generator[Ask | Outcome, Record | Lost | None, str]:
        """Ask for a step that all cells need; where there is none, all of them are rows."""
        answer = yield self._ask(verb, unit, cells, 1)
        if isinstance(answer, Lost) and answer.status == "crashed":  # killed from outside, maybe
            answer = yield self._ask(verb, unit, cells, 1)
        if isinstance(answer, Lost):
            yield from (self._lost(unit, cell, words, answer) for cell in cells)
            return "lost"
        reason = _text(answer, "failed")
        if reason:
            yield from (self._outcome(unit, cell, "error", reason) for cell in cells)
        return reason

    def _run_problem(self, unit: int, cells: list[Cell]) -> Step:
        reason = yield from self._begin(unit, "prepare", "building the library", cells)
        if reason:
            return
        for group in _fits(cells):
            fits = max(len(path_fractions(group[0])) if len(group) > 1 else 1, 1)
            answer = yield self._ask("cases", unit, group, fits + len(group) - 1)
            rows = self._rows(unit, group, answer)
            if isinstance(rows, list):
                yield from rows
            elif len(group) == 1:
                yield self._lost(unit, group[0], "fitting", rows)
            else:  # a path that is lost is tried fit by fit: the blame belongs to one of them
                for cell in group:
                    answer = yield self._ask("cases", unit, [cell], 1)
                    again = self._rows(unit, [cell], answer)
                    if isinstance(again, Lost):
                        yield self._lost(unit, cell, "fitting", again)
                    else:
                        yield from again

    def _ask(self, verb: str, unit: int, cells: list[Cell], fits: int) -> Ask:
        content = {"unit": unit, "cells": [cell.index for cell in cells]}
        limit = self.definition.run.case_timeout * fits
        return Ask(verb, content, limit, self._desks[cells[0].index])

    def _rows(
        self, unit: int, cells: list[Cell], answer: Record | Lost | None
    ) -> list[Outcome] | Lost:
        """The outcomes that an answer tells, each held against the plan; Lost where it is odd."""
        if isinstance(answer, Lost):
            return answer
        if error := _text(answer, "error"):
            return [self._outcome(unit, cell, "error", error) for cell in cells]
        content = answer.get("answer") if answer else None
        rows = content.get("rows") if isinstance(content, dict) else None
        try:
            if not isinstance(rows, list) or [row["cell"] for row in rows] != [
                cell.index for cell in cells
            ]:
                raise ValueError("not the cases that were asked for")
            return [self._checked(unit, cell, row) for cell, row in zip(cells, rows, strict=True)]
        except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
            return Lost("crashed", f"the worker process told no outcome: {error}"[:200])

    def _checked(self, unit: int, cell: Cell, row: Record) -> Outcome:
        """An outcome of the vocabulary, with columns of their kinds."""
        status, reason = row["status"], row["reason"]
        if status not in STATUSES or not isinstance(reason, str):
            raise ValueError(f"a status that there is not: {status!r}"[:80])
        values = checked_values(FLIGHT_KINDS, row["values"])
        estimate = [float(values.get(f"est_{name}", math.nan)) for name in PARAMETERS]
        if status == "ok" and not all(map(math.isfinite, estimate)):
            raise ValueError("ok without an estimate")
        weights = tuple((_real(pair[0]), _real(pair[1])) for pair in row["weights"])
        shared = _real(row["shared"])
        stored = {**values, **self.truth(unit, cell.index)}
        return Outcome(unit, cell.index, status, reason, stored, shared, weights)

    def _lost(self, unit: int, cell: Cell, words: str, lost: Lost) -> Outcome:
        between = " " if lost.status == "timeout" else ": "
        return self._outcome(unit, cell, lost.status, f"{words}{between}{lost.reason}")

    def _outcome(self, unit: int, cell: Cell, status: str, reason: str) -> Outcome:
        return Outcome(unit, cell.index, status, reason, self.truth(unit, cell.index))


def _text(answer: Record | Lost | None, name: str) -> str:
    """A text in an answer, of an error in its stead; empty where there is none."""
    if not isinstance(answer, dict):
        return ""
    inner = answer.get("answer")
    value = answer.get("error") or (inner.get(name) if isinstance(inner, dict) else None)
    return value if isinstance(value, str) else ""


def _real(value: Any) -> float:
    return math.nan if value is None else float(value)


def _fits(cells: list[Cell]) -> list[list[Cell]]:
    """Cells in groups that one ask fits: one fit, or those of a path over `alpha_fraction`."""
    groups: dict[tuple[object, str], list[Cell]] = {}
    for cell in cells:
        single = not path_fractions(cell)
        shared = {key: v for key, v in cell.settings.items() if single or key != "alpha_fraction"}
        groups.setdefault((cell.choice, canonical_json(shared)), []).append(cell)
    return list(groups.values())


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
    defaults: dict[str, dict[str, object]] = {}
    for cell in design.cells:
        if id(cell.setup) not in setups:
            setups[id(cell.setup)] = _told(cell.setup, design.count)
        name = cell.choice.name
        if name not in defaults:
            registered: tuple[Field[Any], ...] = fields(backends.load(name))  # type: ignore[arg-type]
            defaults[name] = {item.name: item.default for item in registered}
        settings = json.loads(cell.canonical_settings)
        content = {k: v for k, v in settings.items() if v != defaults[name].get(k, MISSING)}
        yield digest("\n".join((common, setups[id(cell.setup)], name, canonical_json(content))))


def _told(setup: Setup, count: int) -> str:
    flights = setup.flights
    if isinstance(flights, Logs):  # what was logged, wherever the file lies
        pieces = [[piece.digest, piece.start, piece.end] for piece in flights.pieces]
        content = [canonical_json([pieces, _content(flights.vehicle)])]
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
    log = "" if flights.thrust_log == "measured" else f" {flights.thrust_log}"
    return f"{count if spaced else 0} {flights.cells} {flights.spectrum}{log} {'; '.join(rules)}"


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
        self._swept = [factor.key for factor in design.sweep]

    def condition(self, cell: Cell) -> str:
        """The world, and the levels of swept conditions."""
        levels = [level_words(k, cell.levels[k]) for k in self._swept if _of_flight(k)]
        return ", ".join(part for part in (self.worlds[cell.protocol], *levels) if part)

    def candidate(self, cell: Cell) -> list[object]:
        """What determines a candidate: reading, levels of the estimator's factors, back-end."""
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

    Protocols that agree in this half share them: what the first of them gives as `world` or
    `reading`, the name of the only one, the parts between commas that the names of all of them have
    in common, or else the keys and values.
    """
    halves = {
        protocol.name: canonical_json(
            {k: v for k, v in protocol.overrides.items() if _of_flight(k) == flights}
        )
        for protocol in protocols
    }
    given = {
        halves[p.name]: word
        for p in reversed(protocols)
        if (word := p.words.world if flights else p.words.reading)
    }
    if len(set(halves.values())) == 1 and not given:
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
    return {name: given.get(half) or words[half] for name, half in halves.items()}


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
