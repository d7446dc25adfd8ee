"""A study file, checked and resolved into frozen records: one schema for both kinds of study.

    definition = read_definition("studies/smoke.toml")

A study of flights asks its question of every flight by every reading and back-end; one of problems
(``kind = "problems"``, or ``"solvers"`` as it was first called) of every regression problem by
every solver. All that is read here is refused by file, section and key.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal, TypeAlias

from sparsefit.codec import Place, build, integer, mapping, only, shown, text
from sparsefit.errors import InputError, suggestion
from sparsefit.study.crossing import (
    SECTION_KEYS,
    BackendChoice,
    Cell,
    Factor,
    Protocol,
    cross,
    read_backends,
    read_protocols,
    read_setup,
    read_sweep,
)
from sparsefit.study.logged import FILES, Logs, read_logs
from sparsefit.study.toml_file import (
    Section,
    canonical_json,
    distinct,
    items,
    positive,
    read_section,
    read_toml,
    required,
)

MOST_CASES = 2_000_000
NAME = re.compile(r"[a-z0-9_-]{1,64}")
KINDS = ("flights", "problems", "solvers")
FLIGHT_KEYS = (
    *("name", "kind", "question", "seed", *SECTION_KEYS, "backends", "protocols", "sweep"),
    *("split", "run", "select", "outputs"),
)
# What a case does not depend on: changing it never makes finished rows those of another study.
PRESENTATION = ("kind", "question", "select", "outputs")
SPLITS = ("validate", "evaluate")
WORLD = "world"  # as a factor: what a protocol changes of the flights
AVERAGE, WORST = "average", "worst"
MOST = {"latency_flights": 100_000, "check": 100_000}  # flights
LEGACY = "-absolute-percentage-error-"  # in a criterion of the form that came before measures
Entry: TypeAlias = str | Mapping[str, object]
Three: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class RunRule:
    """How cases are run: [run].

    case_timeout: seconds [s] that one may take; tolerance: of its certificate; prediction_flights:
    how many other flights each estimate predicts the flow along; max_memory: megabytes [MB] that a
    worker may take, None for its share of the machine's.
    """

    case_timeout: float = 60.0
    tolerance: float = 1e-8
    prediction_flights: int = 0
    max_memory: float | None = None

    def __post_init__(self) -> None:
        if self.case_timeout <= 0.0:
            raise InputError(f"case_timeout must be above 0 [s], not {self.case_timeout:g}")
        if not 0.0 < self.tolerance < 1.0:
            raise InputError(f"tolerance must be above 0 and below 1, not {self.tolerance:g}")
        if self.max_memory is not None and self.max_memory < 256.0:
            raise InputError(f"max_memory must be at least 256 [MB], not {self.max_memory:g}")


@dataclass(frozen=True)
class Reference:
    """Printed numbers that a study is held against; each triple is U0, L_w and tau_w.

    estimate: of one flight [m/s, m, s]; deviation: mean signed errors [m/s, m, s];
    signed_error: in percent; flights: their number; note: printed under the table.
    """

    name: str
    flights: int | None = None
    estimate: Three | None = None
    deviation: Three | None = None
    signed_error: Three | None = None
    note: str = ""


@dataclass(frozen=True)
class Outputs:
    """The tables and figures asked for, empty: those that fit the cases: [outputs].

    headline: the measure that the study's one sentence tells; script: a Python file beside the
    study, with functions from the frame of cases to tables and figures.
    """

    tables: tuple[Entry, ...] = ()
    figures: tuple[Entry, ...] = ()
    headline: str = ""
    reference: Reference | None = None
    script: str = ""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The constraints of a selection, in every regime; None where there is none.

    max_failure: share of flights without an estimate; max_silent_misses: share called ok and off
    by more than 5 %, or ok without a flow; max_error: 95th percentile, over the estimates, of the
    largest error of U0, L_w and tau_w [%]; max_latency_p99 [s] and max_memory [MB]: of one
    estimate on one core.
    """

    max_failure: float | None = None
    max_silent_misses: float | None = None
    max_error: float | None = None
    max_latency_p99: float | None = None
    max_memory: float | None = None

    def __post_init__(self) -> None:
        for name in ("max_failure", "max_silent_misses"):
            share = getattr(self, name)
            if share is not None and not 0.0 <= share <= 1.0:
                raise InputError(f"{name} must be a share from 0 to 1; got {share!r}")
        for name in ("max_error", "max_latency_p99", "max_memory"):
            most = getattr(self, name)
            if most is not None and not most > 0.0:
                raise InputError(f"{name} must be above 0; got {most!r}")


@dataclass(frozen=True, kw_only=True)
class SelectionRule:
    """The rule by which a candidate is chosen: [select].

    criterion: a summary and a measure, `mean timescale-error`; regimes: the factors whose levels
    are the regimes, `world` and keys of [flights], empty for all there are; over: `average` of the
    regimes, the `worst` of them, or the name of one; margin: how much worse than the best, as a
    share of it, a simpler candidate may be; simplest: `listed` first in the study file, or
    `fastest` at the median; on_board: whether the estimator as it would be exported is scored;
    latency_flights: how many each candidate is timed on; check: how many flights of fresh seeds,
    in every world, the choice is checked on; seed: of resampling.
    """

    criterion: str = "mean timescale-error"
    regimes: tuple[str, ...] = ()
    over: str = AVERAGE
    margin: float = 0.05
    simplest: Literal["listed", "fastest"] = "listed"
    on_board: bool = False
    latency_flights: int = 100
    check: int = 0
    seed: int = 0
    limits: Limits = field(default_factory=Limits)

    def __post_init__(self) -> None:
        if not 0.0 <= self.margin < 1.0:
            raise InputError(f"margin must be a share, from 0 to below 1; got {self.margin!r}")
        for name, most in MOST.items():
            if not 0 <= getattr(self, name) <= most:
                raise InputError(f"{name} must be from 0 to {most}; got {getattr(self, name)}")
        if not self.latency_flights and self.timed:
            raise InputError(f"latency_flights = 0 measures nothing, and {self.timed} needs it")

    @property
    def timed(self) -> str:
        """The setting that needs a measured latency or memory; empty where none does."""
        if self.simplest == "fastest":
            return 'simplest = "fastest"'
        limits = ("max_latency_p99", "max_memory")
        return next((name for name in limits if getattr(self.limits, name)), "")

    @property
    def measure(self) -> tuple[str, str]:
        """The summary and the measure that the criterion names; an empty summary is the mean."""
        summary, legacy, parameter = self.criterion.partition(LEGACY)
        if legacy:
            return summary, f"{parameter.replace('_', '-')}-error"
        summary, _, name = self.criterion.rpartition(" ")
        return summary, name

    def changed(self, **options: object) -> SelectionRule:
        """The rule with these options in place of its own; InputError names one that is wrong."""
        names = [item.name for item in fields(SelectionRule) if item.name != "limits"]
        own = {name: getattr(self, name) for name in names}
        own |= {item.name: getattr(self.limits, item.name) for item in fields(Limits)}
        return _rule(own | options, Place("select", "select"))


@dataclass(frozen=True, eq=False)
class FlightDesign:
    """Flights and the cells that are made of every one of them.

    given: the keys of the sections flights, derivative, library and readout that the file sets,
    dotted, with their values as canonical JSON; validate_count: the flights of the split
    `validate`, None without [split].
    """

    count: int
    given: Mapping[str, str]
    backends: tuple[BackendChoice, ...]
    protocols: tuple[Protocol, ...]
    sweep: tuple[Factor, ...]
    cells: tuple[Cell, ...]
    validate_count: int | None = None

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


@dataclass(frozen=True, eq=False)
class Definition:
    """A study file, checked and resolved.

    hash: of all that its cases depend on; document: its tables as they were read, for variants.
    """

    path: str
    name: str
    kind: str
    question: str
    seed: int
    hash: str
    run: RunRule
    outputs: Outputs
    selection: SelectionRule
    design: object
    document: Section

    @property
    def keeps_weights(self) -> bool:
        """Whether weights per length scale are stored beside the cases: a figure shows them."""
        figures = self.outputs.figures
        return "weights" in [e if isinstance(e, str) else e.get("name") for e in figures]

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
    kind = document.get("kind", "flights")
    if kind not in KINDS:
        near = suggestion(kind, KINDS) if isinstance(kind, str) else ""
        raise place.at("kind").error(f"has unknown value {shown(kind)}{near}")
    flown = kind == "flights"
    name = text(required(document, "name", place), place.at("name"))
    if not NAME.fullmatch(name):
        allowed = "1 to 64 of a-z, 0-9, _ and -: it is the results folder"
        raise place.at("name").error(f"must be {allowed}, not {shown(name)}")
    fallback = None if flown else "Which solver is fastest?"
    question = text(document.get("question", fallback) or "", place.at("question"))
    seed = document.get("seed", None if flown else 0)
    rules = build(RunRule, read_section(document.get("run", {}), place.at("run")),
                  place.within("run"))  # fmt: skip
    outputs = read_outputs(document.get("outputs", {}), place)
    if flown:
        only(document, FLIGHT_KEYS, place)
        required(document, "question", place)
        required(document, "seed", place)
        _check_predicted(outputs, rules.prediction_flights, place)
        design: object = _read_flights(document, place)
        content = _flight_hash(document, place)
    else:
        from sparsefit.study.contenders import read_problem_design

        design, content = read_problem_design(document, place)
    sweep = design.sweep if isinstance(design, FlightDesign) else ()
    protocols = design.protocols if isinstance(design, FlightDesign) else ()
    return Definition(
        path=path,
        name=name,
        kind="flights" if flown else "problems",
        question=question,
        seed=integer(seed, place.at("seed"), least=0),
        hash=content,
        run=rules,
        outputs=outputs,
        selection=read_selection(document.get("select", {}), protocols, sweep, place),
        design=design,
        document=document,
    )


def _read_flights(document: Section, place: Place) -> FlightDesign:
    """The flights and the cells of a study, every combination resolved."""
    count, sections = _read_sections(document, place)
    read_setup(sections, place)
    sweep = read_sweep(document, place)
    backends = read_backends(required(document, "backends", place), place.within("backends"))
    protocols = read_protocols(document, sweep, place)
    settings = sum(choice.size for choice in backends)
    planned = count * len(protocols) * math.prod(len(f.levels) for f in sweep) * settings
    if planned > MOST_CASES:
        shorten = "shorten [sweep], the back-end settings or flights.count"
        raise InputError(f"{place.file}: plans {planned} cases, more than {MOST_CASES}: {shorten}")
    given = {
        f"{name}.{key}": canonical_json(value)
        for name, entries in sections.items()
        for key, value in entries.items()
    }
    return FlightDesign(
        count=count,
        given=given,
        backends=backends,
        protocols=protocols,
        sweep=sweep,
        cells=tuple(cross(sections, protocols, sweep, backends, place)),
        validate_count=_read_split(document, count, place),
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


def _flight_hash(document: Section, place: Place) -> str:
    """sha256 of what the cases depend on: not of comments, the question, [select], [outputs].

    Of flights that come from files, the content of these counts too.
    """
    content = {key: value for key, value in document.items() if key not in PRESENTATION}
    flights = read_section(document["flights"], place)
    if FILES in flights:
        logs: Logs = read_logs(flights, place.within("flights"))
        content |= {"logs": list(dict.fromkeys(piece.digest for piece in logs.pieces))}
    return hashlib.sha256(canonical_json(content).encode()).hexdigest()


def _read_split(document: Section, count: int, place: Place) -> int | None:
    """The number of flights of the split `validate`; None without [split]."""
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


def read_outputs(value: object, place: Place) -> Outputs:
    """Read [outputs]; `InputError` names the first entry that has not the right form.

    Which names, measures and comparisons there are, the files that make them say.
    """
    section = read_section(value, place.at("outputs"))
    here = place.within("outputs")
    if "answers" in section:
        words = 'went: name one measure, headline = "median timescale-error"'
        raise here.at("answers").error(words)
    only(section, [item.name for item in fields(Outputs)], here)
    lists: dict[str, tuple[Entry, ...]] = {}
    for name in ("tables", "figures"):
        listed = items(section[name], here.at(name)) if name in section else []
        entries = [
            read_section(item, here) if isinstance(item, dict) else text(item, here.at(name))
            for item in listed
        ]
        distinct([str(entry) for entry in entries], here.at(name))
        lists[name] = tuple(entries)
    reference = None
    if "reference" in section:
        printed = mapping(section["reference"], here.at("reference"))
        reference = build(Reference, printed, place.within("outputs.reference"))
    headline = text(section["headline"], here.at("headline")) if "headline" in section else ""
    script = text(section["script"], here.at("script")) if "script" in section else ""
    if script and not (Path(place.file).parent / script).is_file():
        raise here.at("script").error(f'"{script}": no such file beside {Path(place.file).name}')
    return Outputs(lists["tables"], lists["figures"], headline, reference, script)


def _check_predicted(outputs: Outputs, others: int, place: Place) -> None:
    """Refuse to show predictions that no case would have: all would count as failures."""
    for entry in (*outputs.tables, *outputs.figures, outputs.headline):
        if not others and "prediction-error" in str(entry):
            words = "missing: prediction-error needs other flights to predict along, 2 say"
            raise place.within("run").at("prediction_flights").error(words)


def read_selection(
    value: object, protocols: tuple[Protocol, ...], sweep: tuple[Factor, ...], place: Place
) -> SelectionRule:
    """Read [select]; InputError names the first key or factor that does not fit."""
    here = place.within("select")
    rule = _rule(read_section(value, place.at("select")), here)
    registered = regime_factors(protocols, sweep)
    for name in rule.regimes:
        if name not in registered:
            others = (
                f"; what does: {', '.join(registered)}" if registered else ", and nothing else does"
            )
            words = f'no "{name}" varies between the flights{others}'
            raise here.at("regimes").error(words)
    return rule


def _rule(section: Section, place: Place) -> SelectionRule:
    """The rule of flat keys, of which some are limits."""
    limits = [item.name for item in fields(Limits)]
    names = [item.name for item in fields(SelectionRule) if item.name != "limits"]
    only(section, [*names, *limits], place)
    bounds = build(Limits, {key: v for key, v in section.items() if key in limits}, place)
    rest = {key: value for key, value in section.items() if key in names}
    return build(SelectionRule, {**rest, "limits": bounds}, place)


def regime_factors(protocols: tuple[Protocol, ...], sweep: tuple[Factor, ...]) -> list[str]:
    """The factors whose levels may be regimes: `world`, and keys of [flights] that vary."""
    keys = dict.fromkeys(key for protocol in protocols for key in protocol.overrides)
    every = dict.fromkeys([*keys, *(factor.key for factor in sweep)])
    varied = [key for key in every if key.startswith("flights.")]
    return ([WORLD] if any(key in keys for key in varied) else []) + varied
