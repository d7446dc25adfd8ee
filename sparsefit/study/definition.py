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
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from sparsefit.codec import Place, integer, mapping, only, shown, text
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
from sparsefit.study.logged import FILES, read_logs
from sparsefit.study.schema import (
    INSIDE,
    NOT_NEGATIVE,
    POSITIVE,
    SHARE,
    Range,
    distinct,
    items,
    key,
    names_of,
    positive,
    read,
    read_section,
    read_sections,
    record_of,
    required,
    taken,
)
from sparsefit.study.toml_file import Section, canonical_json, read_toml

MOST_CASES = 2_000_000
FLIGHT_KEYS = (
    *("name", "kind", "question", "seed", *SECTION_KEYS, "backends", "protocols", "sweep"),
    *("split", "run", "select", "outputs"),
)
# What a case does not depend on: changing it never makes finished rows those of another study.
PRESENTATION = ("kind", "question", "select", "outputs")
WORLD = "world"  # as a factor: what a protocol changes of the flights
AVERAGE, WORST = "average", "worst"
LEGACY = "-absolute-percentage-error-"  # in a criterion of the form that came before measures
COUNTED = Range(least=0, most=100_000)
Entry: TypeAlias = str | Mapping[str, object]
Three: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class RunRule:
    """The rules by which cases are run: [run]."""

    case_timeout: float = key("Seconds that one case may take.", 60.0, POSITIVE, "s")
    tolerance: float = key("A certificate above it is `inaccurate`.", 1e-8, INSIDE)
    prediction_flights: int = key(
        "Along how many other flights each estimated flow is predicted.", 0
    )
    max_memory: float | None = key(
        "Most that a worker may take; without it, its share of the machine's.",
        None, Range(least=256.0), "MB",
    )  # fmt: skip


@dataclass(frozen=True)
class Reference:
    """Printed numbers that a study is held against; each triple is U0, L_w and tau_w."""

    name: str = key("What the tables call it.")
    flights: int | None = key("How many flights it is of.", None)
    estimate: Three | None = key("U0, L_w, tau_w of one flight [m/s, m, s].", None)
    deviation: Three | None = key("Mean signed errors [m/s, m, s].", None)
    signed_error: Three | None = key("Mean signed errors.", None, unit="%")
    note: str = key("Printed under the table.", "")


@dataclass(frozen=True)
class Outputs:
    """The tables and figures asked for, empty: those that fit the cases: [outputs]."""

    tables: tuple[Entry, ...] = key(
        "Names of shipped tables, or tables of your own (`[[outputs.tables]]`).", ()
    )
    figures: tuple[Entry, ...] = key(
        "Names of shipped figures, or your own (`[[outputs.figures]]`).", ()
    )
    headline: str = key(
        "The measure of the study's one sentence, with or without a summary: "
        '`"median timescale-error"`.', ""
    )  # fmt: skip
    reference: Reference | None = key("Printed numbers that the study is held against.", None)
    script: str = key(
        "A Python file beside the study, whose functions take the frame of cases and return "
        "tables and figures.", ""
    )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Limits:
    """The constraints of a selection, in every regime; None where there is none."""

    max_failure: float | None = key(
        "Most flights without an estimate, as a share, in every regime.", None, SHARE
    )
    max_silent_misses: float | None = key(
        "Most flights called `ok` and off by more than 5 %, or without a flow, as a share.",
        None, SHARE,
    )  # fmt: skip
    max_error: float | None = key(
        "Most that the 95th percentile of the largest error of U0, L_w and tau_w may be.",
        None, POSITIVE, "%",
    )  # fmt: skip
    max_latency_p99: float | None = key(
        "Most that the 99th percentile of the latency may be.", None, POSITIVE, "s"
    )
    max_memory: float | None = key("Most memory of one estimate.", None, POSITIVE, "MB")


@dataclass(frozen=True, kw_only=True)
class SelectionRule:
    """The rule by which a candidate is chosen: [select]."""

    criterion: str = key(
        "A summary and a measure: the least (or most) of it is best.", "mean timescale-error"
    )
    regimes: tuple[str, ...] = key(
        'What nobody chooses: `"world"` (what protocols change of the flights), swept keys of '
        "`[flights]`; empty: all there are.", ()
    )  # fmt: skip
    over: str = key(
        '`"average"` over the regimes, the `"worst"` of them, or the name of one.', AVERAGE
    )
    margin: float = key(
        "How much worse than the best, as a share, a simpler candidate may be.",
        0.05, Range(least=0.0, below=1.0),
    )  # fmt: skip
    simplest: Literal["listed", "fastest"] = key(
        "What simple means: listed first in the file, or fastest at the median.", "listed"
    )
    on_board: bool = key(
        "Whether candidates are scored as they would fly: sample by sample, as exported.", False
    )
    latency_flights: int = key("Flights over which latency and memory are measured.", 100, COUNTED)
    check: int = key(
        "On how many flights of fresh seeds, in every world, the choice is checked.", 0, COUNTED
    )
    seed: int = key("Of what is resampled.", 0, NOT_NEGATIVE)
    limits: Limits = Limits()

    def __post_init__(self) -> None:
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
        own = {name: value for name, value in vars(self).items() if name != "limits"}
        return _rule({**own, **vars(self.limits), **options}, Place("select", "select"))


@dataclass(frozen=True)
class Split:
    """The flights of a choice, and those that score it: [split]."""

    validate: int | float = key("Flights, or share of them, that choose.", range=POSITIVE)
    evaluate: int | float = key(
        "Flights, or share of them, that score the choice once.", range=POSITIVE
    )


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

    hash: of all that its cases depend on; on_board: whether every estimator is flown sample by
    sample, as it would be exported.
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
    on_board: bool = False

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
    place, kinds = Place(path), ("flights", "problems", "solvers")
    kind = document.get("kind", "flights")
    if kind not in kinds:
        near = suggestion(kind, kinds) if isinstance(kind, str) else ""
        raise place.at("kind").error(f"has unknown value {shown(kind)}{near}")
    flown = kind == "flights"
    name = text(required(document, "name", place), place.at("name"))
    if not re.fullmatch(r"[a-z0-9_-]{1,64}", name):
        allowed = "1 to 64 of a-z, 0-9, _ and -: it is the results folder"
        raise place.at("name").error(f"must be {allowed}, not {shown(name)}")
    run, outputs = read(RunRule, document, "run", place), _read_outputs(document, place)
    protocols: tuple[Protocol, ...] = ()
    sweep: tuple[Factor, ...] = ()
    if flown:
        only(document, FLIGHT_KEYS, place)
        required(document, "question", place)
        required(document, "seed", place)
        for entry in (*outputs.tables, *outputs.figures, outputs.headline):
            # All its cases would count as failures.
            if not run.prediction_flights and "prediction-error" in str(entry):
                words = "missing: prediction-error needs other flights to predict along, 2 say"
                raise place.within("run").at("prediction_flights").error(words)
        flights, content = _read_flights(document, place)
        design: object = flights
        protocols, sweep = flights.protocols, flights.sweep
    else:
        from sparsefit.study.contenders import read_problem_design

        design, content = read_problem_design(document, place)
    question = text(document.get("question", "Which solver is fastest?"), place.at("question"))
    return Definition(
        path=path,
        name=name,
        kind="flights" if flown else "problems",
        question=question,
        seed=integer(document.get("seed", 0), place.at("seed"), least=0),
        hash=hashlib.sha256(canonical_json(content).encode()).hexdigest(),
        run=run,
        outputs=outputs,
        selection=_read_selection(document, protocols, sweep, place),
        design=design,
    )


def _read_flights(document: Section, place: Place) -> tuple[FlightDesign, object]:
    """The flights and cells of a study, every combination resolved, and what its hash is of.

    That is not comments, the question, [select], [outputs] or words; of flights that come from
    files, the content of these too.
    """
    content: dict[str, object] = {k: v for k, v in document.items() if k not in PRESENTATION}
    sections = {
        name: dict(read_section(document.get(name, {}), place.at(name))) for name in SECTION_KEYS
    }
    required(document, "flights", place)
    flights, within = sections["flights"], place.within("flights")
    if FILES in flights:
        logs = read_logs(flights, within)
        count = len(logs.pieces)
        content["logs"] = list(dict.fromkeys(piece.digest for piece in logs.pieces))
    else:
        count = integer(required(flights, "count", within), within.at("count"), least=1)
        del flights["count"]
    read_setup(sections, place)
    sweep = read_sweep(document, place)
    backends = read_backends(document, place)
    protocols = read_protocols(document, sweep, place)
    if "protocols" in document:
        entries = read_sections(document["protocols"], place.within("protocols"))
        content["protocols"] = [
            {key: value for key, value in entry.items() if key not in ("world", "reading")}
            for entry in entries
        ]
    settings = sum(len(choice.points) for choice in backends)
    planned = count * len(protocols) * math.prod(len(f.levels) for f in sweep) * settings
    if planned > MOST_CASES:
        shorten = "shorten [sweep], the back-end settings or flights.count"
        raise InputError(f"{place.file}: plans {planned} cases, more than {MOST_CASES}: {shorten}")
    design = FlightDesign(
        count=count,
        given={
            f"{name}.{key}": canonical_json(value)
            for name, entries in sections.items()
            for key, value in entries.items()
        },
        backends=backends,
        protocols=protocols,
        sweep=sweep,
        cells=tuple(cross(sections, protocols, sweep, backends, place)),
        validate_count=_read_split(document, count, place) if "split" in document else None,
    )
    return design, content


def _read_split(document: Section, count: int, place: Place) -> int:
    """The number of flights of the split `validate`."""
    here, section = place.within("split"), read_section(document["split"], place.at("split"))
    only(section, names_of(Split), here)
    parts = [required(section, name, here) for name in names_of(Split)]
    sizes = [positive(p, here.at(n)) for p, n in zip(parts, names_of(Split), strict=True)]
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


def _read_outputs(document: Section, place: Place) -> Outputs:
    """Read [outputs]; which names and measures there are, the files that make them say."""
    section = dict(read_section(document.get("outputs", {}), place.at("outputs")))
    here = place.within("outputs")
    if "answers" in section:
        words = 'went: name one measure, headline = "median timescale-error"'
        raise here.at("answers").error(words)
    lists: dict[str, object] = {}
    for name in ("tables", "figures"):
        if name in section:
            entries = items(section.pop(name), here.at(name))
            for entry in entries:
                mapping(entry, here) if isinstance(entry, dict) else text(entry, here.at(name))
            distinct([str(entry) for entry in entries], here.at(name))
            lists[name] = tuple(entries)
    outputs = record_of(Outputs, section, here)
    if outputs.script and not (Path(place.file).parent / outputs.script).is_file():
        words = f'"{outputs.script}": no such file beside {Path(place.file).name}'
        raise here.at("script").error(words)
    return Outputs(**{**vars(outputs), **lists})


def _read_selection(
    document: Section, protocols: tuple[Protocol, ...], sweep: tuple[Factor, ...], place: Place
) -> SelectionRule:
    """Read [select]; InputError names the first key or factor that does not fit."""
    here = place.within("select")
    rule = _rule(read_section(document.get("select", {}), place.at("select")), here)
    varied = regime_factors(protocols, sweep)
    for name in rule.regimes:
        if name not in varied:
            others = f"; what does: {', '.join(varied)}" if varied else ", and nothing else does"
            raise here.at("regimes").error(f'no "{name}" varies between the flights{others}')
    return rule


def _rule(section: Section, place: Place) -> SelectionRule:
    """The rule of flat keys, of which some are limits."""
    names = (*names_of(SelectionRule), *names_of(Limits))
    only(section, [name for name in names if name != "limits"], place)
    limits, rest = taken(Limits, section, place)
    return record_of(SelectionRule, {**rest, "limits": limits}, place)


def regime_factors(protocols: tuple[Protocol, ...], sweep: tuple[Factor, ...]) -> list[str]:
    """The factors whose levels may be regimes: `world`, and keys of [flights] that vary."""
    keys = dict.fromkeys(key for protocol in protocols for key in protocol.overrides)
    every = dict.fromkeys([*keys, *(factor.key for factor in sweep)])
    varied = [key for key in every if key.startswith("flights.")]
    return ([WORLD] if any(key in keys for key in varied) else []) + varied
