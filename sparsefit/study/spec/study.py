"""A study: one question, asked of every flight by every back-end, from one TOML file."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from sparsefit.codec import Place, build, integer, only, shown, text
from sparsefit.errors import InputError
from sparsefit.estimator.estimator import Estimator
from sparsefit.study.spec.choices import BackendChoice, make_backend, read_backends
from sparsefit.study.spec.design import Cell, Factor, Protocol, cross, read_protocols, read_sweep
from sparsefit.study.spec.document import (
    Section,
    canonical_json,
    positive,
    read_section,
    read_toml,
    required,
)
from sparsefit.study.spec.draw import Draw
from sparsefit.study.spec.flights import FlightRules
from sparsefit.study.spec.logs import FILES, Logged, Logs, read_logs
from sparsefit.study.spec.outputs import Entry, Outputs, Reference, name_of, read_outputs
from sparsefit.study.spec.selection import SelectionRule, read_selection
from sparsefit.study.spec.setup import SECTION_KEYS, read_setup

MAX_CASES = 2_000_000
NAME = re.compile(r"[a-z0-9_-]{1,64}")
KEYS = (
    "name",
    "kind",
    "question",
    "seed",
    *SECTION_KEYS,
    "backends",
    "protocols",
    "sweep",
    "split",
    "run",
    "select",
    "outputs",
)
# What a case does not depend on: changing it never makes finished rows those of another study.
PRESENTATION = ("kind", "question", "select", "outputs")
SPLITS = ("validate", "evaluate")


@dataclass(frozen=True)
class Run:
    """How cases are run: seconds that one may take, and the tolerance of its certificate.

    prediction_flights: how many other flights each estimate predicts the flow along.
    """

    case_timeout: float = 60.0
    tolerance: float = 1e-8
    prediction_flights: int = 0

    def __post_init__(self) -> None:
        if self.case_timeout <= 0.0:
            raise InputError(f"case_timeout must be above 0 [s], not {self.case_timeout:g}")
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(f"tolerance must be above 0 and below 1, not {self.tolerance:g}")


@dataclass(frozen=True, eq=False)
class Study:
    """A study file, checked and resolved; made by `Study.load` only.

    `count` is the number of flights, `cells` what is done to every one of them; `given` the keys
    of the sections flights, derivative, library and readout that the file sets, dotted, with
    their values as canonical JSON; `case_timeout` is in seconds; `selection` says by what one
    candidate is chosen;
    `prediction_flights` is the number of other flights along which a flow found is predicted.
    """

    path: str
    name: str
    question: str
    seed: int
    count: int
    given: Mapping[str, str]
    backends: tuple[BackendChoice, ...]
    protocols: tuple[Protocol, ...]
    sweep: tuple[Factor, ...]
    cells: tuple[Cell, ...]
    validate_count: int | None
    case_timeout: float
    tolerance: float
    prediction_flights: int
    tables: tuple[Entry, ...]
    figures: tuple[Entry, ...]
    answers: tuple[Entry, ...]
    reference: Reference | None
    selection: SelectionRule
    hash: str

    @classmethod
    def load(cls, path: str | Path) -> Study:
        """Read and check a study file.

        Raises:
            InputError: with the file, the section and the key (or the line) of the first fault.
        """
        document = read_toml(path)
        place = Place(str(path))
        if document.get("kind", "flights") != "flights":
            raise place.at("kind").error("is not flights: only sparsefit study reads such a file")
        only(document, KEYS, place)
        return _read(document, place)

    @property
    def planned(self) -> int:
        """How many cases there are."""
        return self.count * len(self.cells)

    @property
    def store_weights(self) -> bool:
        """Whether weights per length scale are kept beside the cases."""
        return "weights" in map(name_of, self.figures)

    def split(self, flight: int) -> str:
        """`validate`, `evaluate` or, without [split], `all`.

        The two are interleaved: with a quantity that is equally spaced over the flights, both
        halves cover its range.
        """
        if self.validate_count is None:
            return "all"
        before = flight * self.validate_count // self.count
        after = (flight + 1) * self.validate_count // self.count
        return "validate" if after > before else "evaluate"

    def draw(self, flight: int, cell: Cell) -> Draw | Logged:
        """What flight number `flight` of a cell flies: its flow, vehicle and noise, or its log."""
        return cell.setup.flights.draw(flight, self.count, self.seed)

    def estimator(self, cell: Cell) -> Estimator:
        """The estimator of a cell: what it derives, fits and reads, to the study's tolerance."""
        return Estimator(
            derivative=cell.setup.derivative,
            library=cell.setup.library,
            backend=make_backend(cell.backend, cell.settings),
            readout=cell.setup.readout,
            tolerance=self.tolerance,
        )


def _read(document: Section, place: Place) -> Study:
    count, sections = _read_sections(document, place)
    setup = read_setup(sections, place)
    sweep = read_sweep(document, place)
    run = build(Run, read_section(document.get("run", {}), place.at("run")), place.within("run"))
    output = read_outputs(document.get("outputs", {}), place)
    _check_predicted(output, run.prediction_flights, place)
    name = _name(required(document, "name", place), place.at("name"))
    question = text(required(document, "question", place), place.at("question"))
    seed = integer(required(document, "seed", place), place.at("seed"), least=0)
    backends = read_backends(required(document, "backends", place), place.within("backends"))
    protocols = read_protocols(document, sweep, place)
    validate_count = _read_split(document, count, place)
    _check_size(count, backends, protocols, sweep, place)
    return Study(
        path=place.file,
        name=name,
        question=question,
        seed=seed,
        count=count,
        given=_given(sections),
        backends=backends,
        protocols=protocols,
        sweep=sweep,
        cells=tuple(cross(sections, protocols, sweep, backends, place)),
        validate_count=validate_count,
        case_timeout=run.case_timeout,
        tolerance=run.tolerance,
        prediction_flights=run.prediction_flights,
        tables=output.tables,
        figures=output.figures,
        answers=output.answers,
        reference=output.reference,
        selection=read_selection(document.get("select", {}), protocols, sweep, place),
        hash=study_hash(document, setup.flights),
    )


def _read_sections(document: Section, place: Place) -> tuple[int, dict[str, Section]]:
    """The number of flights, and the sections that protocols and [sweep] may override."""
    flights = dict(read_section(required(document, "flights", place), place.at("flights")))
    within = place.within("flights")
    if FILES in flights:
        count = len(read_logs(flights, within).pieces)
    else:
        count = integer(required(flights, "count", within), within.at("count"), least=1)
        del flights["count"]
    others = {
        name: read_section(document.get(name, {}), place.at(name))
        for name in SECTION_KEYS
        if name != "flights"
    }
    return count, {"flights": flights, **others}


def _given(sections: Mapping[str, Section]) -> dict[str, str]:
    return {
        f"{name}.{key}": canonical_json(value)
        for name, entries in sections.items()
        for key, value in entries.items()
    }


def study_hash(document: Section, flights: FlightRules | Logs) -> str:
    """sha256 of what the cases depend on: not of comments, the question, [select], [outputs].

    Of flights that come from files, what these hold counts too.
    """
    content = {key: value for key, value in document.items() if key not in PRESENTATION}
    if isinstance(flights, Logs):
        content |= {"logs": list(dict.fromkeys(piece.digest for piece in flights.pieces))}
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()


def _name(value: object, place: Place) -> str:
    name = text(value, place)
    if not NAME.fullmatch(name):
        allowed = "1 to 64 of a-z, 0-9, _ and -: it is the results folder"
        raise place.error(f"must be {allowed}, not {shown(name)}")
    return name


def _read_split(document: Section, count: int, place: Place) -> int | None:
    if "split" not in document:
        return None
    here = place.within("split")
    entries = read_section(document["split"], place.at("split"))
    only(entries, SPLITS, here)
    parts = [required(entries, key, here) for key in SPLITS]
    sizes = [positive(part, here.at(key)) for part, key in zip(parts, SPLITS, strict=True)]
    if all(isinstance(part, int) for part in parts):
        if sum(sizes) != count:
            raise here.error(f"counts sum to {sum(sizes):g}, not to the {count} of flights.count")
        return int(sizes[0])
    if not math.isclose(sum(sizes), 1.0, abs_tol=1e-9):
        raise here.error(f"fractions sum to {sum(sizes):g}, not to 1 (for counts, write integers)")
    validate = round(sizes[0] * count)
    if not 0 < validate < count:
        raise here.error(f"leaves one part of {count} flights empty: use more flights")
    return validate


def _check_predicted(output: Outputs, others: int, place: Place) -> None:
    """Refuse to show predictions that no case would have: all would count as failures."""
    for entry in (*output.tables, *output.figures, *output.answers):
        if not others and "prediction-error" in str(entry):
            words = "missing: prediction-error needs other flights to predict along, 2 say"
            raise place.within("run").at("prediction_flights").error(words)


def _check_size(
    count: int,
    backends: tuple[BackendChoice, ...],
    protocols: tuple[Protocol, ...],
    sweep: tuple[Factor, ...],
    place: Place,
) -> None:
    """Refuse more cases than can be run, before any is resolved."""
    settings = sum(choice.size for choice in backends)
    planned = count * len(protocols) * math.prod(len(one.levels) for one in sweep) * settings
    if planned > MAX_CASES:
        raise InputError(
            f"{place.file}: plans {planned} cases, more than {MAX_CASES}: "
            "shorten [sweep], the back-end settings or flights.count"
        )
