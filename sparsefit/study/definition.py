"""A study file, checked and resolved into frozen records: one schema for both kinds of study.

    definition = read_definition("studies/smoke.toml")

A study of flights asks its question of every flight by every reading and back-end; one of problems
(``kind = "problems"``, or ``"solvers"`` for times to a certificate alone) of every regression
problem by every solver. All that is read here is refused by file, section and key.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeAlias

from sparsefit.codec import Place, integer, mapping, only, text
from sparsefit.errors import InputError
from sparsefit.study.contenders import PROBLEM_SECTIONS, ProblemDesign, read_problem_design
from sparsefit.study.crossing import (
    SECTION_KEYS,
    Cell,
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
    read,
    read_section,
    record_of,
    required,
    taken,
)
from sparsefit.study.toml_file import Section, canonical_json, read_toml

MOST_CASES = 2_000_000
FLIGHT_SECTIONS = (*SECTION_KEYS, "backends", "protocols", "sweep", "split", "run", "select",
                   "outputs")  # fmt: skip
# What a case does not depend on: changing it never makes finished rows those of another study.
PRESENTATION = ("kind", "question", "select", "outputs")
WORLD = "world"  # as a factor: what a protocol changes of the flights
AVERAGE, WORST = "average", "worst"
COUNTED = Range(least=0, most=100_000)
Entry: TypeAlias = str | Mapping[str, object]
Three: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class Heading:
    """The keys at the top of a study file."""

    name: str = key("Of the study and its folder of results: 1 to 64 of `a-z`, `0-9`, `_`, `-`.")
    question: str = key("The one question that the study asks, as its page shows it.")
    kind: Literal["flights", "problems", "solvers"] = key(
        "Flights, regression problems, or times to a certificate alone.", "flights"
    )
    seed: int = key("Whole number that decides everything random.", 0)

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9_-]{1,64}", self.name):
            raise InputError("name must be 1 to 64 of a-z, 0-9, _ and -: it is the results folder")


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

    @property
    def names(self) -> dict[str, list[str]]:
        """The names of tables and figures."""
        lists = {"tables": self.tables, "figures": self.figures}
        return {
            kind: [e if isinstance(e, str) else str(e.get("name", e.get("measure"))) for e in each]
            for kind, each in lists.items()
        }


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

    @classmethod
    def of(cls, section: Section, place: Place) -> SelectionRule:
        """The rule of flat keys, of which some are limits."""
        names = (*names_of(cls), *names_of(Limits))
        only(section, [name for name in names if name != "limits"], place)
        limits, rest = taken(Limits, section, place)
        return record_of(cls, {**rest, "limits": limits}, place)

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
        summary, _, name = self.criterion.rpartition(" ")
        return summary, name

    def changed(self, **options: object) -> SelectionRule:
        """The rule with these options in place of its own; InputError names one that is wrong."""
        own = {name: value for name, value in vars(self).items() if name != "limits"}
        return self.of({**own, **vars(self.limits), **options}, Place("select", "select"))


@dataclass(frozen=True)
class Split:
    """The flights of a choice, and those that score it: [split]."""

    validate: int = key("Flights that choose.", range=POSITIVE)
    evaluate: int = key("Flights that score the choice once: all others.", range=POSITIVE)


@dataclass(frozen=True, eq=False)
class FlightDesign:
    """Flights and the cells that are made of every one of them.

    given: the keys of the sections flights, derivative, library and readout that the file sets,
    dotted, with their values as canonical JSON; sweep: levels by dotted key; validate_count: the
    flights of the split `validate`, None without [split].
    """

    count: int
    given: Mapping[str, str]
    protocols: tuple[Protocol, ...]
    sweep: Mapping[str, tuple[object, ...]]
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

    @property
    def regime_factors(self) -> list[str]:
        """The factors whose levels may be regimes: `world`, and keys of [flights] that vary."""
        keys = dict.fromkeys(key for protocol in self.protocols for key in protocol.overrides)
        varied = [key for key in {**keys, **self.sweep} if key.startswith("flights.")]
        return ([WORLD] if any(key in keys for key in varied) else []) + varied


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
    design: FlightDesign | ProblemDesign
    on_board: bool = False

    @property
    def keeps_weights(self) -> bool:
        """Whether weights per length scale are stored beside the cases: a figure shows them."""
        return "weights" in self.outputs.names["figures"]

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
    flown = document.get("kind", "flights") not in ("problems", "solvers")
    only(document, (*names_of(Heading), *(FLIGHT_SECTIONS if flown else PROBLEM_SECTIONS)), place)
    heading, _ = taken(Heading, document, place)
    run, outputs = read(RunRule, document, "run", place), _read_outputs(document, place)
    for entry in (*outputs.tables, *outputs.figures, outputs.headline):
        # All its cases would count as failures.
        if flown and not run.prediction_flights and "prediction-error" in str(entry):
            words = "missing: prediction-error needs other flights to predict along, 2 say"
            raise place.within("run").at("prediction_flights").error(words)
    selected = read_section(document.get("select", {}), place.at("select"))
    selection = SelectionRule.of(selected, place.within("select"))
    design: FlightDesign | ProblemDesign
    if flown:
        design, content = _read_flights(document, place)
        factors = design.regime_factors
    else:
        holds_out = "holdout" in document or heading.kind == "problems"
        design, content = read_problem_design(document, heading.seed, place, holds_out=holds_out)
        factors = []
    for name in selection.regimes:
        if name not in factors:
            others = f"; what does: {', '.join(factors)}" if factors else ", and nothing else does"
            words = f'no "{name}" varies between the flights{others}'
            raise place.within("select").at("regimes").error(words)
    return Definition(
        path=path,
        name=heading.name,
        kind="flights" if flown else "problems",
        question=heading.question,
        seed=heading.seed,
        hash=hashlib.sha256(canonical_json(content).encode()).hexdigest(),
        run=run,
        outputs=outputs,
        selection=selection,
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
        pieces = read_logs(flights, within).pieces
        count = len(pieces)
        content["logs"] = list(dict.fromkeys(piece.digest for piece in pieces))
    else:
        count = integer(required(flights, "count", within), within.at("count"), least=1)
        del flights["count"]
    read_setup(sections, place)
    sweep = read_sweep(document.get("sweep", {}), place.within("sweep"))
    fitted = read_backends(document, place)
    protocols = read_protocols(document, sweep, place)
    planned = count * len(protocols) * math.prod(map(len, sweep.values())) * len(fitted)
    if planned > MOST_CASES:
        shorten = "shorten [sweep], the back-end settings or flights.count"
        raise InputError(f"{place.file}: plans {planned} cases, more than {MOST_CASES}: {shorten}")
    split = None
    if "split" in document:
        split = read(Split, document, "split", place)
        if (total := split.validate + split.evaluate) != count:
            words = f"counts sum to {total}, not to the {count} of flights.count"
            raise place.within("split").error(words)
    design = FlightDesign(
        count=count,
        given={
            f"{name}.{key}": canonical_json(value)
            for name, entries in sections.items()
            for key, value in entries.items()
        },
        protocols=protocols,
        sweep=sweep,
        cells=tuple(cross(sections, protocols, sweep, fitted, place)),
        validate_count=split.validate if split else None,
    )
    return design, content


def _read_outputs(document: Section, place: Place) -> Outputs:
    """Read [outputs]; which names and measures there are, the files that make them say."""
    section = dict(read_section(document.get("outputs", {}), place.at("outputs")))
    here, lists = place.within("outputs"), dict[str, tuple[object, ...]]()
    for name in ("tables", "figures"):
        if name in section:
            entries = items(section.pop(name), here.at(name))
            for entry in entries:
                mapping(entry, here) if isinstance(entry, dict) else text(entry, here.at(name))
            distinct(entries, here.at(name))
            lists[name] = tuple(entries)
    outputs = record_of(Outputs, section, here)
    if outputs.script and not (Path(place.file).parent / outputs.script).is_file():
        words = f'"{outputs.script}": no such file beside {Path(place.file).name}'
        raise here.at("script").error(words)
    return Outputs(**{**vars(outputs), **lists})
