"""From a finished study to one candidate that can be defended, or to the reason why there is none.

Numbers stand as arrays (candidates, units, regimes, cases). A candidate is chosen on the units of
split `validate` and scored once on those of split `evaluate`: of all that keep every constraint in
every regime, the simplest within the margin of the best. What the units do not tell from it is a
tie.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.codec import finite_or_none
from sparsefit.errors import InputError, one_of, suggestion, told_with
from sparsefit.study.measures import (
    MEASURES,
    Measure,
    answered,
    ended,
    factors,
    in_flow,
    in_still_air,
    measure,
    off,
    only,
)
from sparsefit.study.resampling import (
    ROUNDING,
    SUMMARIES,
    Difference,
    best_probabilities,
    ends,
    mean,
    quantile,
    resampled,
)
from sparsefit.study.table import Column, Row, Table, significant

AVERAGE, WORST = "average", "worst"
SPLITS = ("validate", "evaluate")
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


class _Trials:
    """The cases of a split as a grid (candidates, units, regimes, cases), and what it tells.

    loss: (candidates,) of the criterion; drawn: (candidates, resamples) of it over drawn units.
    """

    def __init__(self, cases: pd.DataFrame, candidates: Sequence[str], criterion: Criterion,
                 seed: int) -> None:  # fmt: skip
        """Place the cases of a split.

        Raises:
            InputError: if the candidates were not all tried on the same units and conditions.
        """
        self.cases, self.candidates, self.criterion = cases, candidates, criterion
        candidate = pd.Index(candidates).get_indexer(pd.Index(cases["candidate"]))
        unit, names = pd.factorize(cases["flight"])
        regime = pd.Index(criterion.regimes).get_indexer(pd.Index(cases["regime"]))
        keys = pd.DataFrame({"c": candidate, "u": unit, "r": regime})
        within = keys.groupby(["c", "u", "r"]).cumcount().to_numpy()
        self.at = (candidate, unit, regime, within)
        self.shape = (len(candidates), len(names), len(criterion.regimes),
                      int(within.max(initial=-1)) + 1)  # fmt: skip
        count = np.zeros(self.shape[:3], dtype=np.intp)
        np.add.at(count, self.at[:3], 1)
        unequal = np.flatnonzero((count != count[:1]).any(axis=(1, 2)))
        if unequal.size:
            title = cases.loc[cases["candidate"] == candidates[unequal[0]], "title"].iloc[:1]
            raise InputError(
                f"{', '.join(title) or candidates[unequal[0]]} was not tried on the same flights "
                "as the others: finish the study first (sparsefit study run)"
            )
        self.values = self.grid(criterion.measure.values(cases))
        self.loss = np.array(
            [criterion.sign * float(criterion.score(each)) for each in self.values]
        )
        self.drawn = np.array([criterion.drawn(each, seed) for each in self.values])

    def grid(self, values: Array) -> Array:
        """Return values (rows,) as a grid, NaN where a regime has fewer cases."""
        grid = np.full(self.shape, np.nan)
        grid[self.at] = values
        return grid

    def score(self, at: int) -> tuple[float, tuple[float, float]]:
        """Return the criterion of a candidate and its 95 % interval."""
        low, high = sorted(self.criterion.sign * end for end in ends(self.drawn[at]))
        return self.criterion.sign * float(self.loss[at]), (low, high)

    def against(self, at: int, other: int) -> Difference:
        """Return the loss of a candidate less that of another, paired by unit."""
        pair, least = (self.values[at], self.values[other]), self.criterion.measure.least
        alike = np.allclose(*pair, rtol=ROUNDING, atol=least, equal_nan=True)
        with np.errstate(invalid="ignore"):  # two that fail wholly
            effect, drawn = self.loss[at] - self.loss[other], self.drawn[at] - self.drawn[other]
        return Difference(float(effect), *ends(drawn), len(self.values[at]), bool(alike))

    def breaches(
        self, rule: Any, timed: Mapping[str, Mapping[str, float]], refusals: Mapping[str, str]
    ) -> list[tuple[Breach, ...]]:
        """Return the constraints that each candidate breaks, each in its worst regime."""
        cases, flown, nothing = self.cases, in_flow(self.cases), np.zeros(len(self.cases))
        failed, silent, error = only(flown, ~answered(cases)), nothing, nothing
        if "est_mean_velocity" in cases:
            missed = np.where(flown, off(cases), in_still_air(cases)) & ended(cases, "ok")
            silent, error = missed.astype(float), MEASURES["largest-error"].read(cases)
        largest = quantile(pooled_regimes(self.grid(error)), 0.95)
        there = SUMMARIES["largest"](pooled_regimes(self.grid(flown.astype(float)))) > 0
        values = {
            "max_failure": mean(pooled_regimes(self.grid(failed))),
            "max_silent_misses": mean(pooled_regimes(self.grid(silent))),
            "max_error": np.where(np.isnan(largest) & there, np.inf, largest),
        }
        return [tuple(self._broken(rule, {name: levels[at] for name, levels in values.items()},
                                   timed.get(name), refusals.get(name)))
                for at, name in enumerate(self.candidates)]  # fmt: skip

    def _broken(self, rule: Any, values: Mapping[str, Array], seen: Mapping[str, float] | None,
                refusal: str | None) -> Iterator[Breach]:  # fmt: skip
        """Give what a candidate breaks; one that breaks a constraint of the cases is not timed."""
        if refusal is not None:
            yield Breach("on_board", "", math.inf, 0.0, refusal)
        is_timed = refusal is None
        for name, levels in values.items():
            limit = getattr(rule.limits, name)
            worst = -1 if np.isnan(levels).all() else int(np.nanargmax(levels))
            if limit is not None and worst >= 0 and levels[worst] > limit:
                is_timed = False
                regimes = self.criterion.regimes
                where = regimes[worst] if len(regimes) > 1 else ""
                yield Breach(name, where, float(levels[worst]), limit)
        for name, column in (("max_latency_p99", "p99"), ("max_memory", "memory")):
            limit = getattr(rule.limits, name)
            value = math.inf if seen is None else float(seen[column])
            if limit is not None and value > limit and (seen is not None or is_timed):
                yield Breach(name, "", value, limit)


def select(
    study: Any,
    rule: Any = None,
    *,
    latencies: Mapping[str, Any] | None = None,
    refusals: Mapping[str, str] | None = None,
    **options: Any,
) -> Selection:
    """Choose a candidate by a rule, that of the study unless another is given.

    Args:
        latencies: `median` [s], `p99` [s], `memory` [MB] and `busy` (share) by candidate, as the
            study has stored them unless given; a candidate without keeps no limit of either.
        refusals: why a candidate cannot be on board, where that is asked for.
        options: of [select], in place of those of the rule.

    Raises:
        InputError: if the rule names what does not exist, the study has no split or is
            unfinished, or its candidates were not tried alike.
    """
    rule = rule or study.definition.selection
    rule = rule.changed(**options) if options else rule
    cases = _comparable(study, study.cases, rule)
    criterion = _criterion(rule, cases)
    if not np.isfinite(criterion.measure.read(cases)).any():
        raise InputError(
            f"{study.name} has no case with a number for {criterion.measure.words}: choose by "
            "another criterion (for predictions, set [run] prediction_flights)"
        )
    latencies = study.latencies if latencies is None else latencies
    timed = {name: asdict(seen) for name, seen in latencies.items()}
    if rule.simplest == "fastest" and not timed:
        raise InputError('simplest = "fastest" needs measured latencies: allow them to be measured')
    candidates = [str(name) for name in dict.fromkeys(cases["candidate"])]
    titles = dict(zip(cases["candidate"], cases["title"], strict=True))
    splits = [name for name in SPLITS if (cases["split"] == name).any()] or ["all"]
    every = [_Trials(cases[cases["split"] == name], candidates, criterion, rule.seed + place)
             for place, name in enumerate(splits)]  # fmt: skip
    first, last = every[0], every[-1]
    breaches, broken = (each.breaches(rule, timed, refusals or {}) for each in (first, last))
    order = sorted(range(len(candidates)), key=lambda at: (float(first.loss[at]), at))
    passing = [at for at in order if not breaches[at] and not math.isnan(first.loss[at])]
    best = float(first.loss[passing[0]]) if passing else math.nan
    limit = best + (rule.margin + ROUNDING) * abs(best) + criterion.measure.least
    within = [at for at in passing if first.loss[at] <= limit]
    chosen = min(within, default=None)
    if within and rule.simplest == "fastest":
        chosen = min(within, key=lambda at: timed.get(candidates[at], {}).get("median", math.inf))
    probabilities = best_probabilities(first.drawn[passing]).tolist() if passing else []
    shares = dict(zip(passing, probabilities, strict=True))
    scored = {
        at: Scored(
            candidates[at], str(titles[candidates[at]]), first.score(at)[0], *last.score(at),
            criterion.by_regime(last.values[at]), breaches[at], broken[at], shares.get(at, 0.0),
            None if chosen is None or chosen == at else first.against(at, chosen),
            None if chosen is None or chosen == at else last.against(at, chosen), at in within,
        )
        for at in order
    }  # fmt: skip
    hindsight = min(passing, key=lambda at: (float(last.loss[at]), at != chosen), default=None)
    regret = None
    if chosen is not None and hindsight is not None:
        regret = last.against(chosen, hindsight)
    return Selection(
        study=study.name, rule=rule, criterion=criterion,
        ranked=tuple(scored[at] for at in (*passing, *(at for at in order if at not in passing))),
        chosen=None if chosen is None else scored[chosen], regret=regret,
        hindsight=None if hindsight is None else scored[hindsight],
        units={name: each.shape[1] for name, each in zip(splits, every, strict=True)},
        parts=_parts(cases), latencies=timed, cases=cases,
    )  # fmt: skip


def check_rule(study: Any) -> None:
    """Refuse, before anything is run, a [select] whose measure, regimes or `over` is unknown.

    Raises:
        InputError: with the nearest name that is known.
    """
    rule = study.definition.selection
    if rule != type(rule)():
        _criterion(rule, _comparable(study, study.plan(), rule))


def _criterion(rule: Any, cases: pd.DataFrame) -> Criterion:
    """Return the measure of a rule over the regimes of the cases."""
    regimes = tuple(dict.fromkeys(cases["regime"]))
    one_of("regime in over =", rule.over, (AVERAGE, WORST, *regimes))
    summary, name = rule.measure
    with told_with("criterion ="):
        return Criterion(measure(f"{summary or 'mean'} {name}"), regimes, rule.over)


def _comparable(study: Any, cases: pd.DataFrame, rule: Any) -> pd.DataFrame:
    """Return the cases with their regime, after a check that they can be compared."""
    if len(cases) < len(study.plan()) or cases.empty:
        raise InputError(
            f"{study.name} is unfinished, {len(cases)} of {len(study.plan())} planned cases have a "
            "row: finish it first (sparsefit study run)"
        )
    missing = set(SPLITS) - set(cases["split"])
    if missing and study.kind == "flights":
        raise InputError(
            f"{study.name} has no flights to {' or to '.join(sorted(missing))}: "
            "give the study file a [split] with validate and evaluate"
        )
    named = [name for name in ("world", *factors(cases)) if name in cases]
    varying = [name for name in named if cases[name].nunique() > 1]
    for name in rule.regimes:
        if name not in varying:
            words = f'regimes: no "{name}" varies in {study.name}'
            raise InputError(f"{words}{suggestion(name, varying)}")
    return _with_regimes(cases, rule)


def _with_regimes(cases: pd.DataFrame, rule: Any) -> pd.DataFrame:
    """Return the cases with their regime: the levels of a rule's factors, or their condition."""
    names = [name for name in rule.regimes if name in cases] or ["condition"]
    first, *others = (cases[name].astype(str) for name in names)
    regime = first.str.cat(others, sep=", ")
    return cases.assign(regime=regime.where(regime != "", "everywhere"))


def _parts(cases: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Return the reading with its factors, and the back-end, of each candidate in words."""
    own = [name for name in factors(cases) if not name.startswith(("flights.", "problems."))]
    parts = {}
    for row in cases.drop_duplicates("candidate").to_dict("records"):
        reading = str(row.get("reading", row.get("protocol", "")))
        levels = [str(row[name]) for name in own]
        words = ", ".join(part for part in (reading, *levels) if part and part != "default")
        parts[str(row["candidate"])] = (words, str(row.get("label") or row["backend"]))
    return parts


def check(selection: Selection, cases: pd.DataFrame) -> Check:
    """Return what the cases of fresh units, of the same candidates, say of the choice."""
    if selection.chosen is None:
        raise ValueError("nothing was chosen")
    rule, placed = selection.rule, _with_regimes(cases, selection.rule)
    candidates = [str(name) for name in dict.fromkeys(placed["candidate"])]
    trials = _Trials(placed, candidates, selection.criterion, rule.seed)
    own = candidates.index(selection.chosen.candidate)
    best = min(range(len(candidates)), key=lambda at: (float(trials.loss[at]), at != own))
    title = dict(zip(placed["candidate"], placed["title"], strict=True))[candidates[best]]
    broken = trials.breaches(rule, selection.latencies, {})[own]
    return Check(trials.shape[1], *trials.score(own), trials.against(own, best), str(title),
                 broken, len(candidates))  # fmt: skip
