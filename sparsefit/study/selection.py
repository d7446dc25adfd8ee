"""A selection: the chosen candidate, every other with its evidence, and the words for them."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.codec import finite_or_none
from sparsefit.study.measures import Measure, factors
from sparsefit.study.statistics import Difference, mean
from sparsefit.study.table import Column, Table, Value, significant

AVERAGE, WORST = "average", "worst"
SPLITS = ("validate", "evaluate")
EVERYWHERE = "everywhere"  # the one regime of a study whose units are all alike
SHARES = ("max_failure", "max_silent_misses")
WORDS = {
    "max_failure": "cases without an answer",
    "max_silent_misses": "silent misses",
    "max_error": "95th percentile of the largest error",
    "max_latency_p99": "99th percentile of the latency",
    "max_memory": "peak memory",
    "on_board": "on board",
}
LATENCY = ("max_latency_p99", "max_memory")
DISTURBED = 0.1  # share of timed flights with other programs on the core, from which it is told


@dataclass(frozen=True)
class Criterion:
    """A measure summarised over the units of each regime, and over the regimes."""

    measure: Measure
    regimes: tuple[str, ...]
    over: str = AVERAGE

    @property
    def words(self) -> str:
        """`mean |error| of τ_w, averaged over the regimes`."""
        where = {AVERAGE: "averaged over the regimes", WORST: "in the worst regime"}
        if len(self.regimes) == 1:
            return self.measure.phrase
        return f"{self.measure.phrase}, {where.get(self.over, f'in {self.over}')}"

    def by_regime(self, grid: Array) -> Array:
        """Return the summary (..., regimes) of a grid (..., units, regimes, cases)."""
        return self.measure.reduce(pooled_regimes(grid))

    def score(self, by_regime: Array) -> Array:
        """Return the one number (...,) of summaries (..., regimes)."""
        if self.over == AVERAGE:
            return mean(by_regime)
        if self.over == WORST:
            worst = np.fmin if self.measure.more else np.fmax  # which pass over NaN
            return np.asarray(worst.reduce(by_regime, axis=-1))
        return np.asarray(by_regime[..., self.regimes.index(self.over)])

    def loss(self, grid: Array) -> Array:
        """Return the score (...,) of a grid, signed so that less is better."""
        score = self.score(self.by_regime(grid))
        return -score if self.measure.more else score

    def say(self, value: float) -> str:
        """Return a value of the criterion with its unit."""
        return f"{significant(value)} {self.measure.unit}".rstrip()


def pooled_regimes(grid: Array) -> Array:
    """Return (..., regimes, all) of (..., units, regimes, cases)."""
    swapped = np.moveaxis(grid, -3, -2)
    return swapped.reshape(*swapped.shape[:-2], -1)


@dataclass(frozen=True)
class Breach:
    """A constraint that a candidate does not keep: the regime, the value there and the limit."""

    constraint: str
    regime: str
    value: float
    limit: float
    reason: str = ""

    @property
    def words(self) -> str:
        """`silent misses 5 % in turbulence 30 %, 1 % is the most`."""
        if self.reason:
            return f"not on board: {self.reason}"
        where = f" in {self.regime}" if self.regime else ""
        value, limit = (_told(self.constraint, each) for each in (self.value, self.limit))
        return f"{WORDS[self.constraint]} {value}{where}, {limit} is the most"


def _told(constraint: str, value: float) -> str:
    """Return a value of a constraint with its unit."""
    if constraint in LATENCY and math.isinf(value):
        return "not measured"
    factor, unit = {"max_latency_p99": (1e3, "ms"), "max_memory": (1.0, "MB")}.get(
        constraint, (100.0 if constraint in SHARES else 1.0, "%")
    )
    return f"{significant(factor * value)} {unit}"


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate with all that speaks for it and against it.

    validate, evaluate: the criterion on either split, `between` its 95 % interval on evaluate,
    by_regime (regimes,) there; breaches: what it does not keep on validate, broken: on evaluate.
    best: the probability over drawn units of validate that it is the best of those that keep
    everything; apart: its loss less that of the chosen on validate, confirmed: on evaluate.
    """

    candidate: str
    title: str
    validate: float
    evaluate: float
    between: tuple[float, float]
    by_regime: Array
    breaches: tuple[Breach, ...]
    broken: tuple[Breach, ...]
    best: float = 0.0
    apart: Difference | None = None
    confirmed: Difference | None = None
    within: bool = False


@dataclass(frozen=True, eq=False)
class Selection:
    """The choice by a rule, and every candidate with its evidence, the best first.

    chosen: None where no candidate keeps the constraints; regret: how much worse the chosen is on
    evaluate than `hindsight`, the best there of those that keep the constraints on validate.
    parts: (candidate, [reading, back-end]) in words; latencies: a row of the latency frame each.
    """

    study: str
    rule: Any
    criterion: Criterion
    ranked: tuple[Scored, ...]
    chosen: Scored | None
    regret: Difference | None
    hindsight: Scored | None
    units: Mapping[str, int]
    parts: Mapping[str, tuple[str, str]]
    latencies: Mapping[str, Mapping[str, float]]
    cases: pd.DataFrame

    @property
    def passing(self) -> list[Scored]:
        """The candidates that keep every constraint, the best first."""
        return [each for each in self.ranked if not each.breaches]

    @property
    def tied(self) -> list[Scored]:
        """Those that keep everything and that the validate units do not tell from the chosen."""
        return [each for each in self.passing if each.apart is not None and each.apart.tie]

    @property
    def contenders(self) -> list[str]:
        """The chosen candidate and what is not ruled out: tied, or within the margin."""
        return [
            each.candidate for each in self.passing
            if each is self.chosen or each.within or (each.apart is not None and each.apart.tie)
        ]  # fmt: skip

    @property
    def headline(self) -> str:
        """The answer in a sentence that can be read aloud, and its number."""
        if self.chosen is None:
            return f"No candidate of {len(self.ranked)} keeps every constraint."
        reading, backend = self.parts[self.chosen.candidate]
        alike = [
            self.parts[each.candidate][1] for each in self.passing
            if (each.within or each is self.chosen)
            and self.parts[each.candidate][0] == reading
        ]  # fmt: skip
        every = {part for own, part in self.parts.values() if own == reading}
        said = f"Use {self.chosen.title}"
        if reading and len(alike) > 1:
            which = f"any of {len(alike)} back-ends" if set(alike) == every else _listed(alike)
            simple = "fastest" if self.rule.simplest == "fastest" else "simplest"
            said = f"Use {reading}; {which} will do, {backend} is the {simple}"
        low, high = self.chosen.between
        kind = "problems" if "objective" in self.cases else "flights"
        fresh = "that had no part in the choice" if len(self.units) > 1 else "it was chosen on"
        return (
            f"{said}. {self.criterion.words[:1].upper()}{self.criterion.words[1:]}: "
            f"{self.criterion.say(self.chosen.evaluate)} ({significant(low)} to "
            f"{significant(high)}) on {self.units[list(self.units)[-1]]} {kind} {fresh}."
        )

    def verdict(self, each: Scored) -> str:
        """Return why a candidate was chosen, or lost."""
        if each is self.chosen:
            return "chosen"
        if each.breaches:
            return "; ".join(breach.words for breach in each.breaches)
        apart = each.apart
        if apart is None or math.isnan(each.validate):
            return "nothing to judge it by"
        if apart.identical:
            return "the same on every flight, less simple"
        by = f"{'worse' if apart.effect > 0 else 'better'} by {significant(abs(apart.effect))}"
        if each.within:
            return f"{'tied' if apart.tie else f'{by}, within the margin'}, less simple"
        return f"tied, but {by}: beyond the margin" if apart.tie else by

    @property
    def table(self) -> Table:
        """Every candidate, the chosen first: verdict, scores and intervals."""
        unit = self.criterion.measure.unit
        least = self.criterion.measure.least
        rows: list[tuple[Value, ...]] = []
        for rank, each in enumerate(self._ordered, 1):
            apart = each.apart
            more = apart.more_units if apart is not None and apart.tie else None
            rows.append((
                rank, each.title, self.verdict(each), each.evaluate, *each.between, each.validate,
                *((None,) * 3 if apart is None else (apart.effect, apart.low, apart.high)),
                None if each.breaches else 100.0 * each.best, more,
            ))  # fmt: skip
        columns = (
            Column("rank", format="d"), Column("candidate"), Column("verdict"),
            Column("criterion", unit, group="evaluate", least=least),
            *(Column(name, unit, group="evaluate", least=least) for name in ("from", "to")),
            Column("criterion", unit, group="validate", least=least),
            *(Column(name, unit, group="validate") for name in ("worse by", "from", "to")),
            Column("best", "%", ".0f", "validate"), Column("more flights", "", ".0f", "validate"),
        )  # fmt: skip
        note = (
            f"Criterion: {self.criterion.words}; {self.criterion.measure.convention}. Worse by: "
            "than the chosen. Intervals (95 %) and the probability to be the best are by bootstrap "
            "over the same flights for all; more flights: how many would end a tie."
        )
        return Table(f"Candidates of the selection ({self.study})", columns, rows, (note,), 60, 3)

    @property
    def regimes(self) -> Table:
        """The criterion on the evaluate units, a row per candidate, a column per regime."""
        unit, least = self.criterion.measure.unit, self.criterion.measure.least
        rows: list[tuple[Value, ...]] = [
            (each.title, self.verdict(each), *map(float, each.by_regime), each.evaluate)
            for each in self._ordered
        ]
        columns = (Column("candidate"), Column("verdict"), *(
            Column(name, unit, least=least) for name in (*self.criterion.regimes, "all")
        ))  # fmt: skip
        return Table(f"Regimes ({self.study})", columns, rows, (), 60, 2)

    @property
    def latency(self) -> Table | None:
        """Time and memory of an estimate of each candidate; None where none was measured."""
        rows: list[tuple[Value, ...]] = []
        for each in self.ranked:
            seen = self.latencies.get(each.candidate)
            if seen is not None:
                rows.append((each.title, 1e3 * seen["median"], 1e3 * seen["p99"], seen["memory"],
                             100.0 * seen["busy"]))  # fmt: skip
        columns = (
            Column("candidate"), Column("median", "ms", varies=True),
            Column("99th percentile", "ms", varies=True),
            Column("peak memory", "MB", ".0f", varies=True),
            Column("disturbed", "%", ".0f", varies=True),
        )  # fmt: skip
        note = (
            "One flight at a time in a process of its own with BLAS on one thread, after a "
            "warm-up. Disturbed: flights during which other programs had the core."
        )
        return Table(f"Latency and memory ({self.study})", columns, rows, (note,)) if rows else None

    @property
    def _ordered(self) -> list[Scored]:
        chosen = [self.chosen] if self.chosen is not None else []
        return [*chosen, *(each for each in self.ranked if each is not self.chosen)]

    def record(self, check: Check | None = None) -> dict[str, Any]:
        """Return the selection as JSON has it."""
        record: dict[str, Any] = {
            "study": self.study, "rule": asdict(self.rule), "criterion": self.criterion.words,
            "summary": self.headline, "said": lines(self, check), "candidates": len(self.ranked),
            "eligible": len(self.passing), "tied": [each.title for each in self.tied],
            "table": self.table.record(), "regimes": self.regimes.record(),
        }  # fmt: skip
        if self.chosen is not None:
            row = self.cases[self.cases["candidate"] == self.chosen.candidate].iloc[0]
            own = [name for name in factors(self.cases) if not name.startswith("flights.")]
            record |= {
                "candidate": self.chosen.candidate, "title": self.chosen.title,
                "protocol": row.get("reading", row.get("protocol", "")), "backend": row["backend"],
                "settings": json.loads(row["settings"]),
                "factors": {name: str(row[name]) for name in own},
                "validate": self.chosen.validate, "evaluate": self.chosen.evaluate,
                "interval": self.chosen.between, "probability_best": self.chosen.best,
                "regret": self.regret.effect if self.regret else None,
                "latency": self.latencies.get(self.chosen.candidate),
                "check": asdict(check) if check else None,
            }  # fmt: skip
        cleaned: dict[str, Any] = finite_or_none(record)
        return cleaned


@dataclass(frozen=True)
class Check:
    """The chosen candidate on units of fresh seeds, and its regret against the best of them there.

    score, between: the criterion and its 95 % interval; broken: what it does not keep there;
    hindsight: the title of the best; candidates: how many were run.
    """

    units: int
    score: float
    between: tuple[float, float]
    regret: Difference
    hindsight: str
    broken: tuple[Breach, ...]
    candidates: int


def lines(selection: Selection, check: Check | None = None) -> list[str]:
    """Return what a review asks: the rule, ties, regret, the worst regime, the clock."""
    criterion, chosen, rule = selection.criterion, selection.chosen, selection.rule
    limits = [
        f"{WORDS[field.name]} at most {_told(field.name, limit)}"
        for field in fields(rule.limits)
        if (limit := getattr(rule.limits, field.name)) is not None
    ]
    keeping = f"; {len(selection.passing)} keep {_listed(limits, 'and')}" if limits else ""
    split, regimes = next(iter(selection.units)), len(criterion.regimes)
    kind = "problems" if "objective" in selection.cases else "flights"
    said = [
        f"{len(selection.ranked)} candidates{f' in {regimes} regimes' if regimes > 1 else ''}, "
        f"chosen on {selection.units[split]} {kind}{keeping}; the simplest within "
        f"{100 * rule.margin:g} % of the best."
    ]
    if chosen is None:
        return [*said, *_binding(selection)]
    if selection.tied:
        needed = [each.apart.more_units for each in selection.tied if each.apart is not None]
        finite = [count for count in needed if math.isfinite(count)]
        more = f"; {min(finite):.0f} more {kind} would end the easiest" if finite else ""
        said.append(f"A tie with {_listed([each.title for each in selection.tied])}{more}.")
    if selection.hindsight is not None and selection.regret is not None:
        if selection.hindsight is chosen:
            said.append("With hindsight nothing that keeps everything is better.")
        else:
            regret = selection.regret
            said.append(
                f"With hindsight {selection.hindsight.title} is best: regret "
                f"{criterion.say(regret.effect)} ({significant(regret.low)} to "
                f"{significant(regret.high)})."
            )
    if len(criterion.regimes) > 1 and np.isfinite(chosen.by_regime).any():
        sizes = -chosen.by_regime if criterion.measure.more else chosen.by_regime
        worst = int(np.nanargmax(sizes))
        value = criterion.say(float(chosen.by_regime[worst]))
        said.append(f"Its worst regime is {criterion.regimes[worst]}: {value}.")
    said += [f"On the evaluate flights it breaks: {breach.words}." for breach in chosen.broken]
    seen = selection.latencies.get(chosen.candidate)
    if seen is not None:
        loud = f" ({100 * seen['busy']:.0f} % of the timed flights disturbed: measure again on a quiet machine)"  # noqa: E501
        said.append(
            f"One estimate takes {significant(1e3 * seen['median'])} ms, at most "
            f"{significant(1e3 * seen['p99'])} ms in 99 of 100, BLAS on one thread"
            f"{loud if seen['busy'] > DISTURBED else ''}."
        )
    if check is not None:
        low, high = check.between
        best = "none of those not ruled out is better there"
        if not check.regret.identical:
            best = f"{check.hindsight} is best there, regret {criterion.say(check.regret.effect)}"
        said.append(f"On {check.units} fresh flights: {criterion.say(check.score)} "
                    f"({significant(low)} to {significant(high)}); {best}.")  # fmt: skip
        said += [f"There it breaks: {breach.words}." for breach in check.broken]
    return said


def _binding(selection: Selection) -> Iterator[str]:
    """Give, for each constraint, how many it refuses and who comes closest."""
    every = [(breach, each) for each in selection.ranked for breach in each.breaches]
    alone = Counter(each.breaches[0].constraint for each in selection.ranked
                    if len(each.breaches) == 1)  # fmt: skip
    for name, count in Counter(breach.constraint for breach, _ in every).most_common():
        breach, nearest = min(
            ((breach, each) for breach, each in every if breach.constraint == name),
            key=lambda pair: pair[0].value,
        )
        binds = f" and alone binds for {alone[name]}" if alone[name] else ""
        yield (
            f"{name} refuses {count} of {len(selection.ranked)}{binds}; the closest is "
            f"{nearest.title}: {breach.words}."
        )


def _listed(names: Sequence[str], word: str = "or") -> str:
    """Return `a`, `a or b`, `a, b or c`, and of more than five how many more."""
    names = list(dict.fromkeys(names))
    if len(names) > 5:
        names = [*names[:4], f"{len(names) - 4} more"]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"


def provenance(study: Any, selection: Selection) -> dict[str, Any]:
    """Return what an estimator comes from: the study, the rule, and the evidence."""
    chosen, regret = selection.chosen, selection.regret
    if chosen is None:
        return {}
    regimes = zip(selection.criterion.regimes, chosen.by_regime.tolist(), strict=True)
    record: dict[str, Any] = finite_or_none({
        "study": study.name, "study_hash": study.hash, "seed": study.seed,
        "rule": asdict(selection.rule), "flights": dict(selection.units),
        "criterion": {
            "words": selection.criterion.words, "unit": selection.criterion.measure.unit,
            "validate": chosen.validate, "evaluate": chosen.evaluate, "interval": chosen.between,
            "by_regime": dict(regimes),
        },
        "probability_best": chosen.best,
        "regret": None if regret is None else [regret.effect, regret.low, regret.high],
        "tied": [each.title for each in selection.tied],
        "latency": selection.latencies.get(chosen.candidate),
    })  # fmt: skip
    return record
