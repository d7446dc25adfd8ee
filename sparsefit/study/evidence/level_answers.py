"""Sentences that compare along a swept factor: protocols, how far something moves, and limits."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.study.evidence.along import FLIGHTS, axis_of, level_needed, unit_of, words_of
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import (
    Group,
    by_level,
    by_setting,
    factors,
    first_settings,
    groups_by,
    level_text,
)
from sparsefit.study.evidence.measure import SUMMARY_WORDS, TINY, Failure, Measure, together
from sparsefit.study.evidence.sentence import capital, extremes, gathered, shown, some

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study


def head(asked: Asked) -> str:
    """The measures in words, and how a failure counts where it is a number."""
    words = f"{SUMMARY_WORDS[asked.first.summary]} {together(asked.measures)}"
    if asked.first.failure is Failure.MISS and asked.first.miss:
        words = f"{words}, {asked.first.convention}"
    return capital(words)


def protocols(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say how protocols compare at each level of a factor, each by its median setting.

    Both ends at every level; or, with show = "every", each protocol over the levels and, in
    brackets, against the first at the last level.
    """
    asked.needs(study.name, "measure")
    along = axis_of(asked, study, cases)
    told = _each if asked.show == "every" else _ends
    said = [
        f"{words}{told(asked.first, _by_level(asked.first, part, along))}"
        for words, part in _others(cases, (along, "protocol"))
    ]
    levels = ", ".join(level_text(level.key[along]) for level in by_level(cases, along))
    note = "; in brackets, against the first at the last" if asked.show == "every" else ""
    name = words_of(along)
    return f"{head(asked)} by protocol at {name} {levels}{note}. {'. '.join(said)}."


def _others(cases: pd.DataFrame, left: tuple[str, ...]) -> Iterator[tuple[str, pd.DataFrame]]:
    """The cases at each level of the remaining swept factors, and that level in words."""
    names = [name for name in factors(cases) if name not in left]
    for part in groups_by(cases, names) if names else [Group({}, cases)]:
        told = [
            f"{name.rpartition('.')[2]} = {level_text(level)}" for name, level in part.key.items()
        ]
        yield (f"With {', '.join(told)}: " if told else ""), part.cases


def _by_level(measure: Measure, cases: pd.DataFrame, along: str) -> dict[str, dict[str, float]]:
    """Per level and protocol, the median over the settings of the summary of the measure."""
    table: dict[str, dict[str, float]] = {}
    for level in by_level(cases, along):
        for group in groups_by(level.cases, ["protocol"]):
            values = [measure.summarise(one.cases) for one in by_setting(group.cases)]
            middle = float(np.quantile(values, 0.5, method="inverted_cdf"))
            table.setdefault(level_text(level.key[along]), {})[group.protocol] = middle
    return table


def _ends(measure: Measure, table: dict[str, dict[str, float]]) -> str:
    said = []
    for level, values in table.items():
        low, high = min(values.values()), max(values.values())
        ends = (high, low) if measure.more else (low, high)
        told = [
            f"{measure.say(end)} ({some([name for name in values if values[name] == end])})"
            for end in ends
        ]
        said.append(f"at {level} {told[0] if low == high else ' to '.join(told)}")
    return ", ".join(said)


def _each(measure: Measure, table: dict[str, dict[str, float]]) -> str:
    last = list(table.values())[-1]
    first = next(iter(last))
    said = []
    for name in last:
        known = math.isfinite(last[name]) and TINY < last[first] < math.inf and name != first
        ratio = f" (× {shown(last[name] / last[first])})" if known else ""
        values = ", ".join(measure.say(level[name]) for level in table.values() if name in level)
        said.append(f"{name} {values}{ratio}")
    return "; ".join(said)


def spread(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say by what factor protocols, or settings, move a measure with everything else fixed."""
    asked.needs(study.name, "measure")
    over = asked.over
    said = []
    for words, part in _others(cases, (asked.along,)):
        values: list[float] = []
        ratios: dict[str, float] = {}
        levels = by_level(part, asked.along) if asked.along else [Group({}, part)]
        for level in levels:
            told: dict[str, list[float]] = {}
            for group in by_setting(level.cases):
                name = group.title if over == "protocol" else group.protocol
                told.setdefault(name, []).append(asked.first.summarise(group.cases))
            values += [value for sizes in told.values() for value in sizes]
            for name, sizes in told.items():
                ratios[name] = max(ratios.get(name, 1.0), _ratio(sizes))
        said.append(
            f"{words}{asked.first.say(min(values))} to {asked.first.say(max(values))}, "
            f"the worst {over}'s {extremes(ratios)} times the best's"
        )
    return f"{head(asked)}, and how far the {over} alone moves it. {'. '.join(said)}."


def _ratio(values: list[float]) -> float:
    """Largest over least; 1 where nobody answers, infinite from an answer to none."""
    low, high = max(min(values), TINY), max(*values, TINY)
    return high / low if math.isfinite(low) else 1.0


def until(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say from which level of a factor on the typical case, and 9 in 10, keep the limits."""
    asked.needs(study.name, "measure", "limits")
    along, said = axis_of(asked, study, cases), []
    for name, compared in gathered((one.protocol, one) for one in first_settings(cases)).items():
        titles = gathered((_reached(asked, group.cases, along), group.title) for group in compared)
        words = [
            f"{'every back-end' if len(titles) == 1 else some(who)} {reached}"
            for reached, who in titles.items()
        ]
        said.append(f"{name}: {', '.join(words)}")
    limits = " / ".join(f"{limit:g} {asked.first.unit}" for limit in asked.limits)
    head = f"The {words_of(along)} from which on the {asked.first.words} stays within {limits}"
    return f"{head} (median flight and 9 of 10 flights). {'; '.join(said)}."


def _reached(asked: Asked, cases: pd.DataFrame, along: str) -> str:
    """`2 / 3 s and 3 / never s`: the level of each limit, by summary; or `never` of all."""
    levels = [
        [level_needed(cases, along, replace(one, summary=share), limit) for limit in asked.limits]
        for one in asked.measures
        for share in FLIGHTS
    ]
    if not np.isfinite(levels).any():
        return "never"
    told = [" / ".join("never" if math.isinf(one) else f"{one:g}" for one in row) for row in levels]
    return " and ".join(f"{words} {unit_of(along)}".strip() for words in told)
