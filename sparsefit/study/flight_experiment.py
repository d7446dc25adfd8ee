"""The experiment with flights: units are flights, candidates are readings with their back-ends.

A case simulates a flight in a condition, or reads one from a log, and estimates its flow. Cells of
one unit share the flight, the library and the path of penalties where these are equal. A back-end
of another package runs in a worker of its own, where it cannot change the rows of others.
"""

from __future__ import annotations

import json
import math
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, product
from typing import Any

import numpy as np

from sparsefit import backends
from sparsefit.arrays import BoolArray
from sparsefit.codec import Place, integer, shown
from sparsefit.errors import InputError, is_real
from sparsefit.study import crossing
from sparsefit.study.columns import FLIGHT_COLUMNS, PARAMETERS, STATUSES, Outcome, kinds_of
from sparsefit.study.crossing import ALPHA, Cell, Protocols
from sparsefit.study.draw import Logged, Logs
from sparsefit.study.flight_desk import FlightDesk, truth_of
from sparsefit.study.keys import FlightFile
from sparsefit.study.plan import Batch, Plan, code_version, telling
from sparsefit.study.schema import canonical_json, digest, distinct, numbered
from sparsefit.study.worker import Answer, Crew, NoAnswerError

UNCHANGED = "unchanged flights"  # the condition of a protocol that sets no key of the flights
BATCH, PROBLEM, FIT = range(3)  # what cells share
WORK = {"fly": "simulating the flight", "prepare": "building the library",
        "cases": "fitting", "alone": "fitting"}  # fmt: skip


@dataclass(frozen=True, eq=False)
class FlightExperiment(Plan):
    """Flights x (conditions x readings x back-ends x settings).

    protocols, sweep: what each named alternative overrides, and levels, by dotted key; points: the
    cells that are made of every flight; titled: titles by candidate, of the study that the cells
    are a part of, if any; on_board: whether every estimator is flown sample by sample, as it would
    be exported.
    """

    definition: FlightFile
    count: int
    protocols: Protocols
    sweep: Mapping[str, tuple[object, ...]]
    points: tuple[Cell, ...]
    titled: dict[str, str] = field(default_factory=dict)
    on_board: bool = False
    kind = "flights"
    stored = FLIGHT_COLUMNS

    @classmethod
    def read(cls, file: FlightFile, place: Place) -> FlightExperiment:
        """The flights and cells of a study file, every combination resolved."""
        sections = {name: dict(getattr(file, name)) for name in crossing.SECTION_KEYS}
        flights, within, here = sections["flights"], place.within("flights"), place.within("sweep")
        count, parts = 0, dict[str, Any]()
        if "files" not in flights:
            if "count" not in flights:
                raise within.at("count").error("missing: give it")
            count = integer(flights.pop("count"), within.at("count"), least=1)
        drawn = crossing.read_setup(sections, place, parts).flights
        if isinstance(drawn, Logs):
            count = len(drawn.pieces)
        # The order of keys in the file means nothing.
        swept = sorted(crossing.dotted_keys(file.sweep, here).items())
        sweep = {name: tuple(distinct(value, here.at(name))) for name, value in swept}
        fitted = crossing.read_backends(file, place.within("backends"))
        protocols = crossing.read_protocols(file, sweep, place.within("protocols"))
        planned = count * len(protocols) * math.prod(map(len, sweep.values())) * len(fitted)
        if planned > crossing.MOST_CASES:
            words = f"plans {planned} cases, more than {crossing.MOST_CASES}: shorten [sweep]"
            raise InputError(f"{place.file}: {words}, the back-end settings or flights.count")
        if (split := file.split) is not None and split.validate + split.evaluate != count:
            words = f"counts sum to {split.validate + split.evaluate}, not to the {count}"
            raise place.within("split").error(f"{words} of flights.count")
        points = list[Cell]()  # back-ends and their settings vary fastest
        for (protocol, own), levels in product(protocols.items(), crossing.points_of(sweep)):
            via = [f'protocol "{protocol}"'] if own else []
            via += [f"{name} = {shown(value)}" for name, value in levels.items()]
            within = Place(place.file, via=f"with {', '.join(via)}: " if via else "")
            changed = {name: dict(section) for name, section in sections.items()}
            for dotted, value in {**own, **levels}.items():
                section, _, name = dotted.partition(".")
                changed[section][name] = value
            setup = crossing.read_setup(changed, within, parts)
            points += [Cell(protocol, levels, setup, backend) for backend in fitted]
        return cls(file, place.file, count, protocols, sweep, tuple(points))

    def split(self, flight: int) -> str:
        """`validate`, `evaluate` or, without [split], `all`.

        The two are interleaved: with a quantity that is equally spaced over the flights, both
        halves cover its range.
        """
        if (split := self.definition.split) is None:
            return "all"
        before, after = (n * split.validate // self.count for n in (flight, flight + 1))
        return "validate" if after > before else "evaluate"

    @cached_property
    def units(self) -> dict[str, list[Any]]:
        """The flights: simulated ones are known by their numbers, logged ones by their content."""
        count, pieces = self.count, self._pieces
        numbers = [f"{number:04d}" for number in range(count)]
        return {
            "flight": list(range(count)),
            "unit": numbers,
            "split": [self.split(number) for number in range(count)],
            "case_id": numbered(digest(repr(each)) for each in pieces) or numbers,
            **({"log": [piece.label for piece in pieces]} if pieces else {}),
        }

    @cached_property
    def _pieces(self) -> tuple[Logged, ...]:
        """The pieces of logs that every cell flies; none where flights are simulated."""
        flights = {cell.setup.flights for cell in self.points}
        logs = flights.pop()
        return logs.pieces if isinstance(logs, Logs) and not flights else ()

    @cached_property
    def cells(self) -> dict[str, list[Any]]:
        """Condition, candidate, title and factors of every cell."""
        cells, protocols = self.points, self.protocols
        worlds = _half_words(protocols)
        readings = _half_words(protocols, worlds)
        points = [cell.backend for cell in cells]
        fitted = [(point.name, point.label, point.canonical_settings) for point in points]
        words = setting_words(fitted)
        conditions, candidates, aspects = list[str](), list[str](), list[tuple[str, ...]]()
        for cell, key in zip(cells, fitted, strict=True):
            own = {k: level for k, level in cell.levels.items() if not _of_flight(k)}
            levels = [level_words(k, v) for k, v in cell.levels.items() if k not in own]
            world, reading = worlds[cell.protocol], readings[cell.protocol]
            conditions.append(", ".join(filter(None, (world, *levels))))
            candidates.append(digest(canonical_json([reading, own, *key]))[:12])
            chosen = ", ".join(level_words(k, v) for k, v in own.items())
            aspects.append((reading, words[key], chosen))
        titles = dict(zip(candidates, _titles(aspects), strict=True)) | self.titled
        return {
            "condition": conditions,
            "candidate": candidates,
            "title": [titles[name] for name in candidates],
            "reading": [readings[cell.protocol] for cell in cells],
            "protocol": [cell.protocol for cell in cells],
            "backend": [name for name, *_ in fitted],
            "settings": [settings for *_, settings in fitted],
            "label": [label for _, label, _ in fitted],
            **{key: self._levels(key) for key in self.factors()},
            "case_id": numbered(map(self._identity, cells)),
        }

    def _levels(self, key: str) -> list[Any]:
        """The level of a factor in every cell: numbers where all are, else text."""
        section, _, name = key.partition(".")
        given, protocols = getattr(self.definition, section).get(name), self.protocols
        levels = [c.levels.get(key, protocols[c.protocol].get(key, given)) for c in self.points]
        if all(map(is_real, levels)):
            return [float(level) for level in levels if is_real(level)]
        texts = (level if isinstance(level, str) else canonical_json(level) for level in levels)
        return ["" if level == "null" else level for level in texts]

    def _identity(self, cell: Cell) -> str:
        """A hash of all that determines the numbers of a cell, whatever study asks for it.

        That is the flights, the estimator and its tolerance, but neither the names that a study
        gives to these nor its other cells.
        """
        own = replace(cell.setup, flights=Logs(())) if self._pieces else cell.setup
        file, setup = self.definition, canonical_json(own)
        count = self.count if "linspace" in setup else 0  # a rule that spaces flights
        run = (file.seed, file.run.tolerance, file.run.prediction_flights)
        backend = (cell.backend.name, cell.backend.own_settings)
        return digest(canonical_json([*run, self.on_board, count, setup, *backend]))

    def factors(self) -> dict[str, str]:
        """The swept keys, and those that protocols set."""
        content = [key for overrides in self.protocols.values() for key in overrides]
        every = dict.fromkeys([*self.sweep, *content])
        return {key: "condition" if _of_flight(key) else "candidate" for key in every}

    def version(self, cell: int) -> str:
        return code_version(backends.distribution(self.points[cell].backend.name))

    def truth(self, unit: int, cell: int) -> Mapping[str, Any]:
        """The columns that are known of a case before it is run."""
        rules = self.points[cell].setup.flights
        try:
            return truth_of(rules.draw(unit, self.count, self.definition.seed))
        except InputError:  # an infinite L_w/tau_w, which the reason of the case says
            return {}

    @cached_property
    def _shared(self) -> list[list[int]]:
        """The numbers of the batch, the regression problem and the fit that each cell belongs to.

        A batch has one condition and one desk, so that no flight is simulated twice. A fit is a
        single one, or a path of penalties.
        """
        numbers: dict[object, int] = {}
        shared = []
        for cell in self.points:
            setup, backend = cell.setup, cell.backend
            others = dict(backend.settings) | ({ALPHA: 0.0} if backend.fractions else {})
            fit = (backend.name, backend.fractions, canonical_json(others))
            problem = (setup.flights, setup.derivative, setup.library, setup.online)
            keys = ((setup.flights, self._desk_of(cell)), problem, (problem, fit))
            shared.append([numbers.setdefault(key, len(numbers)) for key in keys])
        return shared

    def desk(self, name: str) -> tuple[Any, tuple[Any, ...]]:
        """The desk of flights, in a process of its own for each back-end of another package."""
        return FlightDesk, (replace(self),)  # without cached columns

    def _desk_of(self, cell: Cell) -> str:
        name = cell.backend.name
        return "flights" if name in backends.BACKENDS else f"back-end {name}"

    def batches(self, wanted: BoolArray) -> Iterator[Batch]:
        for unit, row in enumerate(wanted):
            for cells in self._split(np.flatnonzero(row).tolist(), BATCH):
                yield Batch(unit, tuple(cells))

    def run(self, batches: Iterator[Batch], crew: Crew) -> Iterator[list[Outcome]]:
        return chain.from_iterable(self._flown(batch, crew) for batch in batches)

    def _flown(self, batch: Batch, crew: Crew) -> Iterator[list[Outcome]]:
        """Simulate, build each library, then fit and read; a failed step ends its own cells only.

        Where a path, or a fit of several cells, fails, each cell is tried alone. A step that
        several cells share is tried again after a crash, which may have come from outside.
        """
        steps = deque([("fly", list(batch.cells), 2)])
        for group in self._split(batch.cells, PROBLEM):
            steps.append(("prepare", group, 2))
            steps += [("cases", fit, 1) for fit in self._split(group, FIT)]
        ended: set[int] = set()
        while steps:
            verb, cells, tries = steps.popleft()
            if cells[0] in ended:
                continue
            cell, fits = self.points[cells[0]], 1
            if verb == "cases":
                fits = max(len(cell.backend.fractions), 1) + len(cells) - 1
            limit = self.definition.run.case_timeout * fits
            content = {"unit": batch.unit, "cells": cells}
            try:
                worker = crew.worker(self._desk_of(cell))
                answer = worker.ask(verb, content, limit, work=WORK[verb])
                if verb in ("cases", "alone"):
                    yield self._outcomes(batch.unit, cells, answer)
            except NoAnswerError as failed:
                if failed.status == "crashed" and tries > 1:
                    steps.appendleft((verb, cells, tries - 1))
                elif verb == "cases" and fits > 1:
                    steps.extendleft(("alone", [cell], 1) for cell in reversed(cells))
                else:
                    ended |= set(cells)
                    end, truth = (failed.status, failed.reason), self.truth
                    yield [Outcome(batch.unit, c, *end, truth(batch.unit, c)) for c in cells]

    def _split(self, cells: Iterable[int], level: int) -> list[list[int]]:
        """Cells in groups of equal number, in order of first appearance."""
        groups: dict[int, list[int]] = {}
        for cell in cells:
            groups.setdefault(self._shared[cell][level], []).append(cell)
        return list(groups.values())

    def _outcomes(self, unit: int, cells: list[int], answer: Answer) -> list[Outcome]:
        """The outcomes in an answer, checked against the plan and the kinds of the columns.

        Raises:
            NoAnswerError: they are not valid outcomes of these cells.
        """
        outcomes, kinds = [], kinds_of(self.stored)
        try:
            for cell, row in zip(cells, answer.content["rows"], strict=True):
                own, status, reason, values = row
                if own != cell or status not in STATUSES:
                    raise ValueError("not the cases that were asked for, or no status")
                for name, value in values.items():
                    large = type(value) is int and not -(2**63) <= value < 2**63
                    if large or type(value) not in kinds[name].types:
                        raise ValueError(f"{name} is no {kinds[name].arrow}")
                "".join([reason, *(v for v in values.values() if type(v) is str)]).encode()
                estimate = [values.get(f"est_{name}", math.nan) for name in PARAMETERS]
                if status == "ok" and not np.isfinite(np.array(estimate, float)).all():
                    raise ValueError("ok without an estimate")
                outcomes.append(Outcome(unit, cell, status, reason, values))
        except (ValueError, TypeError, LookupError, AttributeError, RecursionError) as error:
            words = f"the worker process returned no valid outcome: {error}"
            raise NoAnswerError("crashed", words[:200], WORK["cases"]) from None
        return outcomes


def _of_flight(key: str) -> bool:
    return key.startswith("flights.")


def level_words(key: str, level: object) -> str:
    """A level in words: `duration 5`, `measurement_noise 0.2 / 0.05`."""
    return f"{key.partition('.')[2]} {crossing.spelled(level)}"


def _half_words(protocols: Protocols, worlds: Mapping[str, str] | None = None) -> dict[str, str]:
    """Words for what each protocol sets of the flights or, given their words, of the estimator.

    These are the first that are unambiguous: the parts between commas that the names of all
    protocols which agree in this half have in common, first without those that name the flights;
    then the keys and values. Where all protocols agree, there are none.
    """
    alike, levels = dict[str, list[str]](), dict[str, str]()
    for name, own in protocols.items():
        half = {key: level for key, level in own.items() if _of_flight(key) == (worlds is None)}
        identity, words = canonical_json(half), [level_words(*item) for item in half.items()]
        alike.setdefault(identity, []).append(name)
        levels[identity] = ", ".join(words or [UNCHANGED] * (worlds is None))
    chosen, proposed = dict.fromkeys(protocols, ""), list[tuple[str, ...]]()
    for identity, names in alike.items():
        parts, flown = _common(names), _common(worlds[name] for name in names) if worlds else []
        without = ", ".join(part for part in parts if part not in flown)
        proposed.append((without, ", ".join(parts), levels[identity]))
    for names, own_words in zip(alike.values(), proposed, strict=True):
        for word, every in zip(own_words, zip(*proposed, strict=True), strict=True):
            if len(alike) > 1 and word and every.count(word) == 1:
                chosen |= dict.fromkeys(names, word)
                break
    return chosen


def _common(names: Iterable[str]) -> list[str]:
    """The parts between commas that all names share."""
    first, *others = [name.split(", ") for name in names]
    return [part for part in first if all(part in other for other in others)]


def _titles(aspects: Sequence[tuple[str, ...]]) -> Iterator[str]:
    """The shortest unique name of each (reading, back-end, levels)."""
    shortest = telling(aspects)
    named = any(reading for reading, *_ in shortest)
    for (_, backend, _), (reading, name, levels) in zip(aspects, shortest, strict=True):
        if not reading and (named or not (name or levels)):
            name = backend
        names = ": ".join(filter(None, (reading, name)))
        yield " with ".join(filter(None, (names, levels)))


def setting_words(fitted: Iterable[tuple[str, str, str]]) -> dict[tuple[str, str, str], str]:
    """The words of each (back-end, label, settings as JSON): the label, and what varies of it."""
    settings = {key: {"backend": key[0], **json.loads(key[2])} for key in fitted}
    words = {}
    for key, own in settings.items():
        alike = [other for at, other in settings.items() if at[1] == key[1]]
        varied = {name: value for name, value in own.items()
                  if any(other.get(name) != value for other in alike)}  # fmt: skip
        words[key] = crossing.named(key[1], varied)
    return words
