"""Selection of a candidate of a finished study, or the reason why none is selected.

The choice is made on the units of split `validate` and scored once on those of `evaluate`: of the
candidates that keep every constraint in every regime, the first listed within the margin of the
best. A candidate whose difference from the chosen one is not significant is tied.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.errors import InputError, one_of, told_with
from sparsefit.study import measures, trials
from sparsefit.study.flight_experiment import setting_words
from sparsefit.study.measures import ROUNDING, factors
from sparsefit.study.table import listed, significant
from sparsefit.study.tables import factor_words, level_text
from sparsefit.study.trials import Criterion, Difference, Trials, regimes_of, unit_of


@dataclass(frozen=True, eq=False)
class Selection:
    """The selected candidate, and the evidence of all candidates.

    ranked: a row per candidate, best first: `candidate`, `title`, `reading`, `backend`, `label`;
    `validate`, `evaluate`, the criterion on each split; `between`, its 95 % interval on evaluate;
    `by_regime` (regimes,) there; `breaches`, `broken`, the constraints violated on validate and on
    evaluate; `apart`, the difference of its loss on validate from that of the chosen; `within`,
    whether it is within the margin. chosen: a row, or None if no candidate satisfies the
    constraints. regret: excess loss of the chosen on evaluate over `hindsight`, the best there of
    those that satisfy the constraints on validate. latencies: a row of the latency frame by
    candidate; refused: reasons of candidates without an on-board form.
    """

    study: str
    rule: Any
    criterion: Criterion
    ranked: tuple[Any, ...]
    chosen: Any
    regret: Difference | None
    hindsight: Any
    units: Mapping[str, int]
    latencies: Mapping[str, Mapping[str, float]]
    refused: Mapping[str, str]
    cases: pd.DataFrame = field(repr=False)

    @property
    def passing(self) -> list[Any]:
        """The candidates that satisfy every constraint, the best first."""
        return [each for each in self.ranked if not each.breaches]

    @property
    def tied(self) -> list[Any]:
        """The candidates that satisfy every constraint and do not differ significantly."""
        return [each for each in self.passing if each.apart is not None and each.apart.tie]

    @property
    def contenders(self) -> list[str]:
        """The chosen candidate and those that are tied with it or within the margin."""
        return [each.candidate for each in self.passing if each.within or each in self.tied]

    @property
    def unit(self) -> str:
        """The word for a unit."""
        return unit_of(self.cases)

    def counted(self, count: int) -> str:
        """Return a number with the word for units, `1 problem`."""
        return f"{count} {self.unit}{'s' * (count != 1)}"

    def __str__(self) -> str:
        return "\n".join([headline(self), *(f"- {line}" for line in lines(self))])


def select(
    study: Any,
    rule: Any = None,
    *,
    latencies: Mapping[str, Any] | None = None,
    refusals: Mapping[str, str] | None = None,
    candidate: str = "",
    **options: Any,
) -> Selection:
    """Select a candidate by a rule, by default that of the study.

    Args:
        latencies: `median` [s], `p99` [s], `memory` [MB] and `busy` (share) by candidate, as the
            study has stored them unless given; a candidate without keeps no limit of either.
        refusals: by title why a candidate cannot be on board, where that is asked for.
        candidate: one that was chosen before and is checked here, on all units.
        options: of [select], in place of those of the rule.

    Raises:
        InputError: if the rule has unknown names, the study has no split or is unfinished, or
            its candidates have different units.
    """
    rule = rule or study.definition.select
    rule = rule.changed(**options) if options else rule
    cases, refused = study.cases, dict(refusals or {})
    _check_split(study, cases, is_split=not candidate)
    cases = cases[~cases["title"].isin(refused)]
    criterion = _criterion(rule, cases)
    if not candidate and not np.isfinite(criterion.measure.read(cases)).any():
        flown = " (for predictions, set [run] prediction_flights)" * (study.kind == "flights")
        raise InputError(
            f"{study.name} has no case with a number for {criterion.measure.words}: choose by "
            f"another criterion{flown}"
        )
    latencies = study.latencies if latencies is None else latencies
    timed = {name: asdict(seen) for name, seen in latencies.items()}
    splits = [name for name in ("validate", "evaluate") if (cases["split"] == name).any()]
    splits = splits or ["all"]
    frame = _in_words(cases)
    every = [Trials(cases[cases["split"] == name], list(frame["candidate"]), criterion, place)
             for place, name in enumerate(splits)]  # fmt: skip
    first, last = every[0], every[-1]
    breaches, broken = (each.breaches(rule, timed) for each in (first, last))
    order = np.argsort(first.loss, kind="stable").tolist()
    passing = [at for at in order if not breaches[at] and not math.isnan(first.loss[at])]
    best = float(first.loss[passing[0]]) if passing else math.nan
    limit = best + (rule.margin + ROUNDING) * abs(best) + criterion.measure.least
    within = [at for at in passing if first.loss[at] <= limit]
    # The first listed is the simplest; an infinite loss recommends nobody.
    chosen = min(within) if math.isfinite(best) else None
    chosen = first.candidates.index(candidate) if candidate else chosen
    places = range(len(order))
    values: dict[str, Any] = {
        "validate": criterion.sign * first.loss, "evaluate": criterion.sign * last.loss,
        "between": list(map(last.between, places)),
        "by_regime": list(criterion.by_regime(last.values)),
        "breaches": breaches, "broken": broken,
        "within": [at in within for at in places],
        "apart": [None if chosen in (None, at) else first.against(at, chosen) for at in places],
    }  # fmt: skip
    rows = list(frame.assign(**values).itertuples(name="Candidate"))
    hindsight = min(passing, default=None, key=lambda at: (float(last.loss[at]), at != chosen))
    return Selection(
        study=study.name, rule=rule, criterion=criterion,
        ranked=tuple(rows[at] for at in (*passing, *(at for at in order if at not in passing))),
        chosen=None if chosen is None else rows[chosen],
        regret=None if chosen is None or hindsight is None else last.against(chosen, hindsight),
        hindsight=None if hindsight is None else rows[hindsight],
        units={name: each.shape[1] for name, each in zip(splits, every, strict=True)},
        latencies=timed, refused=refused, cases=cases,
    )  # fmt: skip


def _in_words(cases: pd.DataFrame) -> pd.DataFrame:
    """Return `candidate`, `title`, `reading` with its factors, `backend` and `label`.

    Factors that a reading sets are part of its name, settings that vary part of a label.
    """
    frame = cases.drop_duplicates("candidate").reset_index(drop=True)
    named = frame["reading" if "reading" in frame else "protocol"] if "protocol" in frame else ""
    fitted = list(zip(*(frame[name] for name in ("backend", "label", "settings")), strict=True))
    words = setting_words(fitted)
    frame = frame.assign(reading=named, label=[words[each] for each in fitted])
    own = [
        name for name in factors(frame) if not name.startswith("flights.")
        and frame.groupby("reading")[name].nunique(dropna=False).max() > 1
    ]  # fmt: skip
    if (frame["reading"] == "default").all():
        frame["reading"] = ""
    for name in own:
        frame["reading"] += [f", {factor_words(name)} {level_text(level)}" for level in frame[name]]
    frame["reading"] = frame["reading"].str.removeprefix(", ")
    return frame[["candidate", "title", "backend", "reading", "label"]]


def check_rule(study: Any) -> None:
    """Refuse a [select] with an unknown measure or `over` before anything is run.

    Raises:
        InputError: with the nearest name that is known.
    """
    rule = study.definition.select
    if rule != type(rule)():
        cases = study.plan()
        _check_split(study, cases)
        _criterion(rule, cases)


def _criterion(rule: Any, cases: pd.DataFrame) -> Criterion:
    """Return the measure of a rule over the regimes of the cases."""
    regimes = tuple(regimes_of(cases).unique())
    kind = "problems" if "objective" in cases else "flights"
    default = {"flights": "mean timescale-error", "problems": "mean holdout-error"}[kind]
    summary, _, name = (rule.criterion or default).rpartition(" ")
    with told_with("[select] over"):
        one_of("regime", rule.over, ("average", "worst", *regimes))
    for limit in ("on_board", "check", *trials.LIMITS):
        if kind == "problems" and limit != "max_failure" and getattr(rule, limit):
            raise InputError(
                f"[select] {limit} is for flights: a study of problems has no such rule"
            )
    with told_with("[select] criterion"):
        measure = measures.measure(f"{summary or 'mean'} {name}")
        if measure.kind not in ("", kind):
            raise InputError(f'"{name}" is a measure of {measure.kind}, not of {kind}')
        return Criterion(measure, regimes, rule.over)


def _check_split(study: Any, cases: pd.DataFrame, *, is_split: bool = True) -> None:
    """Refuse an unfinished study, and flights without a split."""
    planned = len(study.plan())
    if len(cases) < planned or cases.empty:
        raise InputError(
            f"{study.name} is unfinished, {len(cases)} of {planned} planned cases have a row: "
            "finish it first (sparsefit study run)"
        )
    missing = {"validate", "evaluate"} - set(cases["split"])
    if missing and study.kind == "flights" and is_split:
        raise InputError(
            f"{study.name} has no flights to {' or to '.join(sorted(missing))}: "
            "give the study file a [split] with validate and evaluate"
        )


def headline(selection: Selection) -> str:
    """Return the selection in a sentence."""
    chosen = selection.chosen
    if chosen is None and selection.passing:
        words = "has a finite score: choose by a mean, in which a failure counts as a finite error"
        return f"No candidate of {len(selection.ranked)} {words}."
    if chosen is None:
        return f"No candidate of {len(selection.ranked)} keeps every constraint."
    reading, backend = chosen.reading, chosen.label
    mine = [each for each in selection.ranked if each.reading == reading]
    alike = [each.label for each in mine if each.within]
    if reading and len(alike) > 1:
        backends = {each.backend for each in mine}
        kind = "back-ends" if len(backends) == len(mine) else "candidates"
        which = f"any of {len(alike)} {kind}" if len(alike) == len(mine) else listed(alike)
        return f"Use {reading}; {which} will do, {backend} is the simplest."
    return f"Use {f'{reading} with {backend}' if reading else chosen.title}."


def lines(selection: Selection, check: Selection | None = None) -> Iterator[str]:
    """Give the score, the rule, ties, the regret, the worst regime and the latency in lines.

    check: the same candidates on flights of fresh seeds.
    """
    criterion, chosen, rule = selection.criterion, selection.chosen, selection.rule
    regimes, units = criterion.regimes, [*map(selection.counted, selection.units.values())]

    def scored(value: float, between: Sequence[float]) -> str:
        ends = " to ".join(map(significant, between))
        return criterion.say(value) + ("" if math.isnan(between[0]) else f" ({ends})")

    if chosen is not None:
        fresh = " that had no part in the choice" if len(units) > 1 else ""
        yield f"Score: {scored(chosen.evaluate, chosen.between)} on {units[-1]}{fresh}."
    yield f"Rule: {criterion.words}; the simplest within {100 * rule.margin:g} % of the best."
    limits = [
        f"{trials.LIMITS[name][0]} at most {trials.limit_text(name, limit)}"
        for name in trials.LIMITS if (limit := getattr(rule, name)) is not None
    ]  # fmt: skip
    keeping = f"; {len(selection.passing)} keep: {listed(limits, 'and')}" if limits else ""
    where = f" in {len(regimes)} regimes" if len(regimes) > 1 else ""
    yield f"Candidates: {len(selection.ranked)}{where}, chosen on {units[0]}{keeping}."
    if selection.refused:
        yield f"Not on board: {len(selection.refused)} more, see the table."
    if chosen is None:  # by constraint, the number refused and the nearest candidate
        every = [(breach, each.title) for each in selection.ranked for breach in each.breaches]
        for name, refused in Counter(breach.constraint for breach, _ in every).most_common():
            breach, nearest = min((pair for pair in every if pair[0].constraint == name),
                                  key=lambda pair: pair[0].value)  # fmt: skip
            yield f"{name}: refuses {refused}; the closest is {nearest}, {breach.words}."
        return
    if min(selection.units.values()) < 2:
        yield f"Ties: not tested, {units[0]} shows no spread."
    elif selection.tied:
        yield f"Tied: {'; '.join(each.title for each in selection.tied)}."
    gap, best = selection.regret, selection.hindsight
    if gap is not None:
        against = f"{scored(gap.effect, (gap.low, gap.high))} against {best.title}"
        yield f"Regret: {'none' if best is chosen else against}."
    if len(regimes) > 1 and np.isfinite(chosen.by_regime).any():
        worst = int(np.nanargmax(criterion.sign * chosen.by_regime))
        value = criterion.say(float(chosen.by_regime[worst]))
        yield f"Worst regime: {value} in {regimes[worst]}."
    if chosen.broken:
        yield f"Broken on evaluate: {'; '.join(each.words for each in chosen.broken)}."
    if seen := selection.latencies.get(chosen.candidate):
        loud = f"; {100 * seen['busy']:.0f} % of the timed flights disturbed: measure again on a "
        loud = f"{loud}quiet machine" if seen["busy"] > 0.1 else ""
        median, slowest = significant(1e3 * seen["median"]), significant(1e3 * seen["p99"])
        yield (f"Latency: median {median} ms, 99th percentile {slowest} ms, BLAS on one thread"
               f"{loud}.")  # fmt: skip
    if check is not None:
        here, gap, regret = check.chosen, check.regret, "none"
        if gap is not None and not gap.identical:
            regret = f"{criterion.say(gap.effect)} against {check.hindsight.title}"
        broken = "".join(f"; broken: {each.words}" for each in here.broken)
        value = f"{scored(here.evaluate, here.between)} on {check.counted(*check.units.values())}"
        yield f"Fresh seeds: {value}, regret {regret}{broken}."


def verdict(selection: Selection, each: Any) -> str:
    """Return the reason why a candidate was chosen or not."""
    apart = each.apart
    if each is selection.chosen:
        return "chosen"
    if each.breaches:
        return "; ".join(breach.words for breach in each.breaches)
    if apart is None or math.isnan(each.validate):
        return "nothing to judge it by"
    if apart.identical:
        return f"the same on every {selection.unit}, less simple"
    by = f"{'worse' if apart.effect > 0 else 'better'} by {significant(abs(apart.effect))}"
    if each.within:
        return f"{'tied' if apart.tie else f'{by}, within the margin'}, less simple"
    return f"tied, but {by}: beyond the margin" if apart.tie else by
