"""A selection: the chosen candidate, every other with its evidence, and the tables of both."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.codec import finite_or_none
from sparsefit.study.measures import Measure, factors
from sparsefit.study.resampling import Difference, mean, resampled
from sparsefit.study.table import Column, Row, Table, significant

AVERAGE, WORST = "average", "worst"
LIMITS = {  # what a constraint is of, the factor to its unit, and the unit
    "max_failure": ("cases without an answer", 100.0, "%"),
    "max_silent_misses": ("silent misses", 100.0, "%"),
    "max_error": ("95th percentile of the largest error", 1.0, "%"),
    "max_latency_p99": ("99th percentile of the latency", 1e3, "ms"),
    "max_memory": ("peak memory", 1.0, "MB"),
}


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

    def score(self, grid: Array) -> Array:
        """Return the one number (...,) of a grid (..., units, regimes, cases)."""
        by_regime = self.by_regime(grid)
        if self.over == AVERAGE:
            return mean(by_regime)
        if self.over == WORST:
            worst = np.fmin if self.measure.more else np.fmax  # which pass over NaN
            return np.asarray(worst.reduce(by_regime, axis=-1))
        return np.asarray(by_regime[..., self.regimes.index(self.over)])

    @property
    def sign(self) -> float:
        """The factor by which a score becomes a loss, of which less is better."""
        return -1.0 if self.measure.more else 1.0

    def drawn(self, grid: Array, seed: int) -> Array:
        """Return the loss (resamples,) of a grid over drawn units; one seed draws alike for all."""
        return resampled(lambda at: self.sign * self.score(grid[at]), len(grid), grid[0].size, seed)

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
        value, limit = (limit_text(self.constraint, each) for each in (self.value, self.limit))
        return f"{LIMITS[self.constraint][0]} {value}{where}, {limit} is the most"


def limit_text(constraint: str, value: float) -> str:
    """Return a value of a constraint with its unit."""
    _, factor, unit = LIMITS[constraint]
    if math.isinf(value) and unit != "%":
        return "not measured"
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

    @property
    def tied(self) -> bool:
        """Whether the validate units do not tell it from the chosen."""
        return self.apart is not None and self.apart.tie


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
    cases: pd.DataFrame = field(repr=False)

    @property
    def passing(self) -> list[Scored]:
        """The candidates that keep every constraint, the best first."""
        return [each for each in self.ranked if not each.breaches]

    @property
    def tied(self) -> list[Scored]:
        """Those that keep everything and that the validate units do not tell from the chosen."""
        return [each for each in self.passing if each.tied]

    @property
    def contenders(self) -> list[str]:
        """The chosen candidate and what is not ruled out: tied, or within the margin."""
        return [each.candidate for each in self.passing
                if each is self.chosen or each.within or each.tied]  # fmt: skip

    @property
    def kind(self) -> str:
        """The noun of a unit, `flights` or `problems`."""
        return "problems" if "objective" in self.cases else "flights"

    @property
    def headline(self) -> str:
        """The answer in a sentence that can be read aloud."""
        if self.chosen is None:
            return f"No candidate of {len(self.ranked)} keeps every constraint."
        reading, backend = self.parts[self.chosen.candidate]
        alike = [
            self.parts[each.candidate][1] for each in self.passing
            if each.within and self.parts[each.candidate][0] == reading
        ]  # fmt: skip
        every = {part for own, part in self.parts.values() if own == reading}
        said = f"Use {self.chosen.title}"
        if reading and len(alike) > 1:
            which = f"any of {len(alike)} back-ends" if set(alike) == every else listed(alike)
            simple = "fastest" if self.rule.simplest == "fastest" else "simplest"
            said = f"Use {reading}; {which} will do, {backend} is the {simple}"
        elif reading and backend:
            said = f"Use {reading} with {backend}"
        return f"{said}."

    @property
    def score_line(self) -> str:
        """The criterion of the chosen with its interval, and of what it was measured."""
        if self.chosen is None:
            return ""
        low, high = map(significant, self.chosen.between)
        words = self.criterion.words
        fresh = "that had no part in the choice" if len(self.units) > 1 else "it was chosen on"
        return (
            f"{words[:1].upper()}{words[1:]}: {self.criterion.say(self.chosen.evaluate)} ({low} to "
            f"{high}) on {self.units[list(self.units)[-1]]} {self.kind} {fresh}."
        )

    def verdict(self, each: Scored) -> str:
        """Return why a candidate was chosen, or lost."""
        apart = each.apart
        if each is self.chosen:
            return "chosen"
        if each.breaches:
            return "; ".join(breach.words for breach in each.breaches)
        if apart is None or math.isnan(each.validate):
            return "nothing to judge it by"
        if apart.identical:
            return "the same on every flight, less simple"
        by = f"{'worse' if apart.effect > 0 else 'better'} by {significant(abs(apart.effect))}"
        if each.within:
            return f"{'tied' if apart.tie else f'{by}, within the margin'}, less simple"
        return f"tied, but {by}: beyond the margin" if apart.tie else by

    @property
    def tables(self) -> dict[str, Table]:
        """The tables of candidates, of regimes, and where it was measured of latency."""
        unit, least = self.criterion.measure.unit, self.criterion.measure.least
        candidates, regimes, times = list[Row](), list[Row](), list[Row]()
        chosen = [self.chosen] if self.chosen is not None else []
        others = (each for each in self.ranked if each is not self.chosen)
        for rank, each in enumerate([*chosen, *others], 1):
            apart, verdict = each.apart, self.verdict(each)
            candidates.append((
                str(rank), each.title, verdict, each.evaluate, *each.between, each.validate,
                *((None,) * 3 if apart is None else (apart.effect, apart.low, apart.high)),
                None if each.breaches else 100.0 * each.best,
                apart.more_units if apart is not None and apart.tie else None,
            ))  # fmt: skip
            regimes.append((each.title, verdict, *each.by_regime.tolist(), each.evaluate))
            if seen := self.latencies.get(each.candidate):
                times.append((each.title, 1e3 * seen["median"], 1e3 * seen["p99"], seen["memory"],
                              100.0 * seen["busy"]))  # fmt: skip
        names = (*self.criterion.regimes, "all")
        score = [Column(name, unit, group="evaluate", least=least)
                 for name in ("criterion", "from", "to")]  # fmt: skip
        apart_ = [Column(name, unit, group="validate") for name in ("worse by", "from", "to")]
        timed = (("median", "ms", ""), ("99th percentile", "ms", ""), ("peak memory", "MB", ".0f"),
                 ("disturbed", "%", ".0f"))  # fmt: skip
        made = {
            "selection": Table(
                f"Candidates of the selection ({self.study})",
                (*map(Column, ("rank", "candidate", "verdict")), *score,
                 Column("criterion", unit, group="validate", least=least), *apart_,
                 Column("best", "%", ".0f", "validate"),
                 Column("more flights", "", ".0f", "validate")),
                candidates,
                (f"Criterion: {self.criterion.words}; {self.criterion.measure.convention}. Worse "
                 "by: than the chosen. Intervals (95 %) and the probability to be the best are by "
                 "bootstrap over the same flights for all; more flights: how many would end a tie.",
                 ),
            ),
            "regimes": Table(
                f"Regimes ({self.study})",
                (*map(Column, ("candidate", "verdict")),
                 *(Column(name, unit, least=least) for name in names)),
                regimes,
            ),
            "latency": Table(
                f"Latency and memory ({self.study})",
                (Column("candidate"), *(Column(*each, varies=True) for each in timed)), times,
                ("One flight at a time in a process of its own with BLAS on one thread, after a "
                 "warm-up. Disturbed: flights during which other programs had the core.",),
            ),
        }  # fmt: skip
        return {name: each for name, each in made.items() if each.rows}

    def record(self, check: Check | None = None) -> dict[str, Any]:
        """Return the selection as JSON has it."""
        tables, chosen = self.tables, self.chosen
        record: dict[str, Any] = {
            "study": self.study, "rule": asdict(self.rule), "criterion": self.criterion.words,
            "unit": self.criterion.measure.unit, "units": dict(self.units),
            "summary": self.headline, "candidates": len(self.ranked),
            "eligible": len(self.passing), "tied": [each.title for each in self.tied],
            "table": tables["selection"].record(), "regimes": tables["regimes"].record(),
        }  # fmt: skip
        if chosen is not None:
            row = self.cases[self.cases["candidate"] == chosen.candidate].iloc[0]
            own = [name for name in factors(self.cases) if not name.startswith("flights.")]
            regimes = zip(self.criterion.regimes, chosen.by_regime.tolist(), strict=True)
            record |= {
                "candidate": chosen.candidate, "title": chosen.title,
                "protocol": row.get("reading", row.get("protocol", "")), "backend": row["backend"],
                "settings": json.loads(row["settings"]),
                "factors": {name: str(row[name]) for name in own},
                "validate": chosen.validate, "evaluate": chosen.evaluate,
                "interval": chosen.between, "by_regime": dict(regimes),
                "probability_best": chosen.best,
                "regret": self.regret.effect if self.regret else None,
                "latency": self.latencies.get(chosen.candidate),
                "check": asdict(check) if check else None,
            }  # fmt: skip
        cleaned: dict[str, Any] = finite_or_none(record)
        return cleaned


def listed(names: Sequence[str], word: str = "or") -> str:
    """Return `a`, `a or b`, `a, b or c`, and of more than five how many more."""
    names = list(dict.fromkeys(names))
    if len(names) > 5:
        names = [*names[:4], f"{len(names) - 4} more"]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"


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
