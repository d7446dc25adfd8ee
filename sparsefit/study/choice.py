"""From a finished study to one candidate that can be defended, or to the reason why there is none.

Numbers stand as arrays (candidates, units, regimes, cases). A candidate is chosen on the units of
split `validate` and scored once on those of split `evaluate`: of all that keep every constraint in
every regime, the simplest within the margin of the best. What the units do not tell from it is a
tie.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, suggestion, told_with
from sparsefit.study.measures import (
    MEASURES,
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
)
from sparsefit.study.selection import (
    AVERAGE,
    WORST,
    Breach,
    Check,
    Criterion,
    Scored,
    Selection,
    pooled_regimes,
)

SPLITS = ("validate", "evaluate")


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
