"""From a finished study to one candidate that can be defended, or to the reason why there is none.

Numbers stand as arrays (candidates, units, regimes, cases). A candidate is chosen on the units of
split `validate` and scored once on those of split `evaluate`: of all that keep every constraint in
every regime, the simplest within the margin of the best. What the units do not tell from it is a
tie.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, suggestion, told_with
from sparsefit.study.measures import (
    answered,
    ended,
    factors,
    in_flow,
    in_still_air,
    measure,
    off,
    only,
)
from sparsefit.study.selection import (
    AVERAGE,
    EVERYWHERE,
    LATENCY,
    SPLITS,
    WORST,
    Breach,
    Check,
    Criterion,
    Scored,
    Selection,
    pooled_regimes,
)
from sparsefit.study.statistics import (
    ROUNDING,
    SUMMARIES,
    Difference,
    best_probabilities,
    ends,
    mean,
    quantile,
    resampled,
)


@dataclass(frozen=True, eq=False)
class _Trials:
    """The cases of a split, each with its place in (candidates, units, regimes, cases)."""

    cases: pd.DataFrame
    at: tuple[Any, ...]
    shape: tuple[int, ...]

    @classmethod
    def of(cls, cases: pd.DataFrame, candidates: Sequence[str], regimes: Sequence[str]) -> _Trials:
        """Place the cases of a split.

        Raises:
            InputError: if the candidates were not all tried on the same units and conditions.
        """
        candidate = pd.Index(candidates).get_indexer(pd.Index(cases["candidate"]))
        unit, names = pd.factorize(cases["flight"])
        regime = pd.Index(regimes).get_indexer(pd.Index(cases["regime"]))
        keys = pd.DataFrame({"c": candidate, "u": unit, "r": regime})
        within = keys.groupby(["c", "u", "r"]).cumcount().to_numpy()
        shape = (len(candidates), len(names), len(regimes), int(within.max(initial=-1)) + 1)
        count = np.zeros(shape[:3], dtype=np.intp)
        np.add.at(count, (candidate, unit, regime), 1)
        unequal = np.flatnonzero((count != count[:1]).any(axis=(1, 2)))
        if unequal.size:
            title = cases.loc[cases["candidate"] == candidates[unequal[0]], "title"].iloc[:1]
            raise InputError(
                f"{', '.join(title) or candidates[unequal[0]]} was not tried on the same flights "
                "as the others: finish the study first (sparsefit study run)"
            )
        return cls(cases, (candidate, unit, regime, within), shape)

    def grid(self, values: Array) -> Array:
        """Return values (rows,) as a grid, NaN where a regime has fewer cases."""
        grid = np.full(self.shape, np.nan)
        grid[self.at] = values
        return grid

    def constraints(self) -> dict[str, Array]:
        """Return what each constraint of the cases is held against, (candidates, regimes)."""
        cases, flown = self.cases, in_flow(self.cases)
        silent = np.where(flown, off(cases), in_still_air(cases)) & ended(cases, "ok")
        if "est_mean_velocity" not in cases:
            silent = np.zeros(len(cases), dtype=bool)
        failed = only(flown, ~answered(cases))
        shares = {
            "max_failure": mean(pooled_regimes(self.grid(failed))),
            "max_silent_misses": mean(pooled_regimes(self.grid(silent.astype(float)))),
        }
        error = measure("largest-error").read(cases) if "est_mean_velocity" in cases else failed
        largest = quantile(pooled_regimes(self.grid(error)), 0.95)
        there = SUMMARIES["largest"](pooled_regimes(self.grid(flown.astype(float)))) > 0
        shares["max_error"] = np.where(np.isnan(largest) & there, np.inf, largest)
        return shares


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
    placed = _with_regimes(study, study.cases, rule)
    criterion = _criterion(rule, placed)
    if not np.isfinite(criterion.measure.read(placed)).any():
        raise InputError(
            f"{study.name} has no case with a number for {criterion.measure.words}: choose by "
            "another criterion (for predictions, set [run] prediction_flights)"
        )
    latencies = study.latencies if latencies is None else latencies
    timed = {name: asdict(seen) for name, seen in latencies.items()}
    if rule.simplest == "fastest" and not timed:
        raise InputError('simplest = "fastest" needs measured latencies: allow them to be measured')
    return _decided(study, rule, criterion, placed, timed, refusals or {})


def check_rule(study: Any) -> None:
    """Refuse, before anything is run, a [select] whose measure, regimes or `over` is unknown.

    Raises:
        InputError: with the nearest name that is known.
    """
    rule = study.definition.selection
    if rule != type(rule)():
        _criterion(rule, _with_regimes(study, study.plan(), rule))


def _criterion(rule: Any, placed: pd.DataFrame) -> Criterion:
    """The measure of a rule over the regimes of the cases."""
    regimes = tuple(dict.fromkeys(placed["regime"]))
    one_of("regime in over =", rule.over, (AVERAGE, WORST, *regimes))
    summary, name = rule.measure
    with told_with("criterion ="):
        return Criterion(measure(f"{summary or 'mean'} {name}"), regimes, rule.over)


def _with_regimes(study: Any, cases: pd.DataFrame, rule: Any) -> pd.DataFrame:
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
    names = list(rule.regimes)
    for name in names:
        if name not in varying:
            words = f'regimes: no "{name}" varies in {study.name}'
            raise InputError(f"{words}{suggestion(name, varying)}")
    if names:
        parts = [cases[name].astype(str) for name in names]
        regime = parts[0].str.cat(parts[1:], sep=", ")
    else:
        regime = cases["condition"].astype(str)
    return cases.assign(regime=regime.where(regime != "", EVERYWHERE))


def _decided(
    study: Any,
    rule: Any,
    criterion: Criterion,
    cases: pd.DataFrame,
    timed: Mapping[str, Mapping[str, float]],
    refusals: Mapping[str, str],
) -> Selection:
    candidates = [str(name) for name in dict.fromkeys(cases["candidate"])]
    titles = dict(zip(cases["candidate"], cases["title"], strict=True))
    splits = [name for name in SPLITS if (cases["split"] == name).any()] or ["all"]
    trials = [_Trials.of(cases[cases["split"] == name], candidates, criterion.regimes)
              for name in splits]  # fmt: skip
    grids = [each.grid(criterion.measure.values(each.cases)) for each in (trials[0], trials[-1])]
    first, last = ([criterion.loss(part) for part in grid] for grid in grids)
    drawn = [
        np.array([
            _drawn(criterion, part, rule.seed + place)
            for part in grid
        ])
        for place, grid in enumerate(grids)
    ]  # fmt: skip
    breaches, broken = (
        [
            tuple(_breaches(rule, values, at, name, criterion.regimes, timed, refusals))
            for at, name in enumerate(candidates)
        ]
        for values in (trials[0].constraints(), trials[-1].constraints())
    )
    order = sorted(range(len(candidates)), key=lambda at: (float(first[at]), at))
    passing = [at for at in order if not breaches[at] and not math.isnan(first[at])]
    least = criterion.measure.least
    limit = math.inf
    if passing:
        best = float(first[passing[0]])
        limit = best + (rule.margin + ROUNDING) * abs(best) + least
    within = [at for at in passing if first[at] <= limit]
    chosen = None
    if within and rule.simplest == "fastest":
        chosen = min(within, key=lambda at: timed.get(candidates[at], {}).get("median", math.inf))
    elif within:
        chosen = min(within)
    shares = dict.fromkeys(range(len(candidates)), 0.0)
    if passing:
        shares |= zip(passing, best_probabilities(drawn[0][passing]).tolist(), strict=True)

    def against(place: int, at: int, other: int | None) -> Difference | None:
        if other is None or at == other:
            return None
        pair = grids[place][at], grids[place][other]
        same = np.allclose(*pair, rtol=ROUNDING, atol=least, equal_nan=True)
        effect = (first, last)[place][at] - (first, last)[place][other]
        with np.errstate(invalid="ignore"):  # two that fail wholly
            apart = ends(drawn[place][at] - drawn[place][other])
        return Difference(float(effect), *apart, len(pair[0]), bool(same))

    sign = -1.0 if criterion.measure.more else 1.0
    scored = {
        at: Scored(
            candidates[at], str(titles[candidates[at]]), sign * float(first[at]),
            sign * float(last[at]), _signed(ends(drawn[1][at]), sign),
            criterion.by_regime(grids[1][at]), breaches[at], broken[at], shares[at],
            against(0, at, chosen), against(1, at, chosen), at in within,
        )
        for at in order
    }  # fmt: skip
    hindsight = min(passing, key=lambda at: (float(last[at]), at != chosen), default=None)
    regret = None
    if chosen is not None and hindsight is not None:
        none = Difference(0.0, 0.0, 0.0, len(grids[1][chosen]), True)
        regret = against(1, chosen, hindsight) or none
    return Selection(
        study=study.name, rule=rule, criterion=criterion,
        ranked=tuple(scored[at] for at in (*passing, *(at for at in order if at not in passing))),
        chosen=None if chosen is None else scored[chosen], regret=regret,
        hindsight=None if hindsight is None else scored[hindsight],
        units={name: each.shape[1] for name, each in zip(splits, trials, strict=True)},
        parts=_parts(cases), latencies=timed, cases=cases,
    )  # fmt: skip


def _drawn(criterion: Criterion, grid: Array, seed: int) -> Array:
    """Return the loss (resamples,) over drawn units; one seed draws the same for all."""
    return resampled(lambda at: criterion.loss(grid[at]), len(grid), grid[0].size, seed)


def _signed(pair: tuple[float, float], sign: float) -> tuple[float, float]:
    low, high = sorted((sign * pair[0], sign * pair[1]))
    return low, high


def _parts(cases: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Return the reading with its factors, and the back-end, of each candidate in words."""
    own = [name for name in factors(cases) if not name.startswith(("flights.", "problems."))]
    once = cases.drop_duplicates("candidate")
    parts_ = {}
    for row in once.to_dict("records"):
        reading = str(row.get("reading", row.get("protocol", "")))
        levels = [str(row[name]) for name in own]
        words = ", ".join(part for part in (reading, *levels) if part and part != "default")
        parts_[str(row["candidate"])] = (words, str(row.get("label") or row["backend"]))
    return parts_


def _breaches(
    rule: Any, values: Mapping[str, Array], at: int, name: str, regimes: Sequence[str],
    timed: Mapping[str, Mapping[str, float]], refusals: Mapping[str, str],
) -> Iterator[Breach]:  # fmt: skip
    """Give the constraints that a candidate breaks, each in its worst regime.

    A candidate that breaks one of the cases was not timed: it is not told to break a latency too.
    """
    if name in refusals:
        yield Breach("on_board", "", math.inf, 0.0, refusals[name])
    timeable = name not in refusals
    for constraint, levels in values.items():
        limit = getattr(rule.limits, constraint)
        if limit is None or np.isnan(levels[at]).all():
            continue
        worst = int(np.nanargmax(levels[at]))
        if levels[at][worst] > limit:
            timeable = False
            where = regimes[worst] if len(regimes) > 1 else ""
            yield Breach(constraint, where, float(levels[at][worst]), limit)
    seen = timed.get(name)
    for constraint, column in zip(LATENCY, ("p99", "memory"), strict=True):
        limit = getattr(rule.limits, constraint)
        value = math.inf if seen is None else float(seen[column])
        if limit is not None and value > limit and (seen is not None or timeable):
            yield Breach(constraint, "", value, limit)


def check(selection: Selection, cases: pd.DataFrame) -> Check:
    """Return what the cases of fresh units, of the same candidates, say of the choice."""
    if selection.chosen is None:
        raise ValueError("nothing was chosen")
    rule = replace(selection.rule, simplest="listed")
    regime = cases["condition"].astype(str)
    named = [name for name in rule.regimes if name in cases]
    if named:
        parts = [cases[name].astype(str) for name in named]
        regime = parts[0].str.cat(parts[1:], sep=", ")
    placed = cases.assign(regime=regime.where(regime != "", EVERYWHERE))
    candidates = [str(name) for name in dict.fromkeys(placed["candidate"])]
    trials = _Trials.of(placed, candidates, selection.criterion.regimes)
    criterion = selection.criterion
    grids = trials.grid(criterion.measure.values(placed))
    own = candidates.index(selection.chosen.candidate)
    losses = [float(criterion.loss(grid)) for grid in grids]
    best = min(range(len(candidates)), key=lambda at: (losses[at], at != own))
    mine, other = (
        _drawn(criterion, grids[place], rule.seed)
        for place in (own, best)
    )  # fmt: skip
    sign = -1.0 if criterion.measure.more else 1.0
    apart = Difference(losses[own] - losses[best], *ends(mine - other), len(grids[own]),
                       own == best)  # fmt: skip
    broken = _breaches(rule, trials.constraints(), own, candidates[own], criterion.regimes,
                       selection.latencies, {})  # fmt: skip
    title = dict(zip(placed["candidate"], placed["title"], strict=True))[candidates[best]]
    return Check(len(grids[own]), sign * losses[own], _signed(ends(mine), sign), apart,
                 str(title), tuple(broken), len(candidates))  # fmt: skip
