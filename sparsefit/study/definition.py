"""A study file, checked and resolved into frozen records: one schema for both kinds of study.

    definition = read_definition("studies/smoke.toml")

A study of flights asks its question of every flight by every reading and back-end; one of problems
(``kind = "problems"``, or ``"solvers"`` for times to a certificate alone) of every regression
problem by every solver. All that is read here is refused by file, section and key.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sparsefit.codec import Place, integer, only
from sparsefit.errors import InputError, one_of
from sparsefit.study import crossing, keys, schema
from sparsefit.study.contenders import ProblemDesign, read_problem_design
from sparsefit.study.draw import Logs
from sparsefit.study.quantities import QUANTITIES
from sparsefit.study.toml_file import Section, canonical_json, read_toml

MOST_CASES = 2_000_000


@dataclass(frozen=True, eq=False)
class FlightDesign:
    """Flights and the cells that are made of every one of them.

    given: the keys of the sections flights, derivative, library and readout that the file sets,
    dotted; sweep: levels by dotted key; validate_count: flights of the split `validate`, None
    without [split].
    """

    count: int
    given: Mapping[str, object]
    protocols: crossing.Protocols
    sweep: Mapping[str, tuple[object, ...]]
    cells: tuple[crossing.Cell, ...]
    validate_count: int | None = None

    def split(self, flight: int) -> str:
        """`validate`, `evaluate` or, without [split], `all`.

        The two are interleaved: with a quantity that is equally spaced over the flights, both
        halves cover its range.
        """
        if self.validate_count is None:
            return "all"
        before, after = (n * self.validate_count // self.count for n in (flight, flight + 1))
        return "validate" if after > before else "evaluate"


@dataclass(frozen=True, eq=False)
class Definition:
    """A study file, checked and resolved.

    hash: of all that its cases depend on; on_board: whether every estimator is flown sample by
    sample, as it would be exported.
    """

    path: str
    name: str
    kind: str
    question: str
    seed: int
    hash: str
    rules: keys.RunRule
    outputs: keys.Outputs
    selection: keys.SelectionRule
    design: FlightDesign | ProblemDesign
    on_board: bool = False

    @property
    def flights(self) -> FlightDesign:
        """The design of a study of flights."""
        if not isinstance(self.design, FlightDesign):
            words = "is a study of regression problems, and flies nothing"
            raise InputError(f"{self.path}: {words}: give a study of flights")
        return self.design


def read_definition(path: str | Path) -> Definition:
    """The study that a TOML file describes.

    Raises:
        InputError: with the file, the section and the key (or the line) of the first fault.
    """
    return definition_of(read_toml(path), str(path))


def definition_of(document: Section, path: str) -> Definition:
    """The study of these tables; files that it names lie beside ``path``."""
    place = Place(path)
    heading, _ = schema.taken(keys.Heading, document, place)
    flown = heading.kind == "flights"
    sections = (
        keys.FLIGHT_SECTIONS
        if flown
        else (*schema.names_of(keys.ProblemRules), *keys.PROBLEM_SECTIONS)
    )
    only(document, (*schema.names_of(keys.Heading), *sections), place)
    run = schema.read(keys.RunRule, document, "run", place)
    outputs = schema.read(keys.Outputs, document, "outputs", place)
    default = {"criterion": keys.CRITERIA["flights" if flown else "problems"]}
    rules = {**default, **schema.section_of(document, "select", place)}
    selection = schema.record_of(keys.SelectionRule, rules, place.within("select"))
    if outputs.script and not (Path(path).parent / outputs.script).is_file():
        words = f'"{outputs.script}": no such file beside {Path(path).name}'
        raise place.within("outputs").at("script").error(words)
    words = str((outputs.tables, outputs.figures, outputs.headline))
    if flown and not run.prediction_flights and "prediction-error" in words:
        # All its cases would count as failures.
        words = "missing: prediction-error needs other flights to predict along, 2 say"
        raise place.within("run").at("prediction_flights").error(words)
    design: FlightDesign | ProblemDesign
    if flown:
        design, content = _read_flights(document, place)
    else:
        judged = heading.kind == "problems"
        design, content = read_problem_design(document, heading.seed, place, holds_out=judged)
    return Definition(
        path=path,
        name=heading.name,
        kind="flights" if flown else "problems",
        question=heading.question,
        seed=heading.seed,
        hash=hashlib.sha256(canonical_json(content).encode()).hexdigest(),
        rules=run,
        outputs=outputs,
        selection=selection,
        design=design,
    )


def _read_flights(document: Section, place: Place) -> tuple[FlightDesign, object]:
    """The flights and cells of a study, every combination resolved, and what its hash is of.

    That is not comments, the question, [select], [outputs] or words; of flights that come from
    files, the content of these too.
    """
    shown_only = ("kind", "question", "select", "outputs")
    content: dict[str, object] = {k: v for k, v in document.items() if k not in shown_only}
    sections = {name: dict(schema.section_of(document, name, place)) for name in keys.READING}
    schema.required(document, "flights", place)
    flights, within = sections["flights"], place.within("flights")
    count, parts = 0, dict[str, Any]()
    if "files" not in flights:
        count = integer(schema.required(flights, "count", within), within.at("count"), least=1)
        del flights["count"]
    drawn = crossing.read_setup(sections, place, parts).flights
    if isinstance(drawn, Logs):
        count = len(drawn.pieces)
        content["logs"] = list(dict.fromkeys(piece.digest for piece in drawn.pieces))
    sweep = crossing.read_sweep(schema.section_of(document, "sweep", place), place.within("sweep"))
    fitted = crossing.read_backends(document, place)
    protocols = crossing.read_protocols(document, sweep, place)
    listed = [{"name": name, **overrides} for name, overrides in protocols.items()]
    flat = {"sweep": sweep, "protocols": listed}  # keys bare or in quotes are one content
    content |= {name: flat[name] for name in flat if name in document}
    planned = count * len(protocols) * math.prod(map(len, sweep.values())) * len(fitted)
    if planned > MOST_CASES:
        shorten = "shorten [sweep], the back-end settings or flights.count"
        raise InputError(f"{place.file}: plans {planned} cases, more than {MOST_CASES}: {shorten}")
    validate = None
    if "split" in document:
        split = schema.read(keys.Split, document, "split", place)
        validate, total = split.validate, split.validate + split.evaluate
        if total != count:
            words = f"counts sum to {total}, not to the {count} of flights.count"
            raise place.within("split").error(words)
    given = {f"{name}.{key}": value for name in sections for key, value in sections[name].items()}
    cells = tuple(crossing.cross(sections, protocols, sweep, fitted, place, parts))
    return FlightDesign(count, given, protocols, sweep, cells, validate), content


def keys_of(section: str) -> dict[str, str]:
    """Key of a section of `keys.OWN` -> its sentence, unit, range and default; empty words where
    its record, of the estimator, has none.

    Raises:
        InputError: with the nearest name, if there is no such section.
    """
    one_of("section", section, keys.OWN)
    words = {
        name: text for kind in keys.OWN[section] for name, text in schema.sentences(kind).items()
    }
    every = tuple(dict.fromkeys((*keys.FLIGHT_SECTIONS, *keys.PROBLEM_SECTIONS)))
    more = {**crossing.SECTION_KEYS, "study": every, "solvers": keys.PROBLEM_SECTIONS}
    words = {name: words.get(name, "") for name in (*words, *more.get(section, ()))}
    if section == "flights":
        rows = {
            name: schema.described(q.sentence, q.unit, q.range) for name, q in QUANTITIES.items()
        }
        words |= {"count": "", **rows}
    return words
