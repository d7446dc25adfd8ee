"""Sentences that compare along a swept factor: protocols, how far something moves, and limits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.study.evidence.along import (
    FLIGHTS,
    at_level,
    axis_of,
    level_needed,
    unit_of,
    words_of,
)
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
from sparsefit.study.evidence.measure import Failure, Measure, together
from sparsefit.study.evidence.sentence import (
    capital,
    extremes,
    gathered,
    listed,
    shown,
    some,
)
from sparsefit.study.evidence.summary import SUMMARY_WORDS, TINY

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study


def head(measures: Sequence[Measure]) -> str:
    """The measures in words, and how a failure counts where it is a number."""
    told = gathered((SUMMARY_WORDS[one.summary], one) for one in measures)
    words = listed([f"{summary} {together(alike)}" for summary, alike in told.items()])
    first = measures[0]
    counted = first.failure is Failure.MISS and first.miss
    return capital(f"{words}, {first.convention}" if counted else words)


def protocols(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say how protocols compare at each level of a factor, each by its median setting.

    Both ends at every level; or, with show = "every", each protocol over the levels and, in
    brackets, against the first at the last level.
    """
    asked.needs(study.name, "measure")
    along, each = axis_of(asked, study, cases), asked.show == "every"
    levels = ", ".join(level_text(level.key[along]) for level in by_level(cases, along))
    over = f"at {words_of(along)} {levels}; in brackets, against the first at the last"
    where, told = (over, _each) if each else (f"along {words_of(along)}", _ends)
    parts = list(_others(cases, (along, "protocol")))
    return " ".join(
        f"{head([measure])} by protocol {where}. "
        + " ".join(
            f"{told(measure, _by_level(measure, part, along), words)}." for words, part in parts
        )
        for measure in asked.measures
    )


def _others(cases: pd.DataFrame, left: tuple[str, ...]) -> Iterator[tuple[str, pd.DataFrame]]:
    """The cases at each level of the remaining swept factors, and that level in words."""
    names = [name for name in factors(cases) if name not in left]
    for part in groups_by(cases, names) if names else [Group({}, cases)]:
        told = listed([at_level(name, level) for name, level in part.key.items()])
        yield (f"With {told}" if told else ""), part.cases


def _by_level(measure: Measure, cases: pd.DataFrame, along: str) -> dict[str, dict[str, float]]:
    """Per level and protocol, the median over the settings of the summary of the measure."""
    table: dict[str, dict[str, float]] = {}
    for level in by_level(cases, along):
        for group in groups_by(level.cases, ["protocol"]):
            values = [measure.summarise(one.cases) for one in by_setting(group.cases)]
            middle = float(np.quantile(values, 0.5, method="inverted_cdf"))
            table.setdefault(level_text(level.key[along]), {})[group.protocol] = middle
    return table


def _ends(measure: Measure, table: dict[str, dict[str, float]], words: str) -> str:
    said = []
    for level, values in table.items():
        low, high = min(values.values()), max(values.values())
        ends = (high, low) if measure.more else (low, high)
        told = [
            f"{measure.say(end)} ({some([name for name in values if values[name] == end])})"
            for end in ends
        ]
        said.append(f"at {level}: {told[0] if low == high else ' to '.join(told)}")
    return capital(f"{words}{', ' if words else ''}{'; '.join(said)}")


def _each(measure: Measure, table: dict[str, dict[str, float]], words: str) -> str:
    last = list(table.values())[-1]
    first = next(iter(last))
    said = []
    for name in last:
        known = math.isfinite(last[name]) and TINY < last[first] < math.inf and name != first
        ratio = f" (× {shown(last[name] / last[first])})" if known else ""
        values = ", ".join(measure.say(level[name]) for level in table.values() if name in level)
        said.append(f"{name}: {values}{ratio}")
    return f"{words}{': ' if words else ''}{'; '.join(said)}"


def spread(asked: Asked, study: Study, cases: pd.DataFrame) -> str:
    """Say by what factor protocols, or settings, move a measure with everything else fixed."""
    asked.needs(study.name, "measure")
    parts = list(_others(cases, (asked.along,)))
    return " ".join(
        f"{head([measure])}, and how far the {asked.over} alone moves it. "
        + " ".join(
            f"{words}{', ' if words else ''}{_moved(measure, part, asked)}."
            for words, part in parts
        )
        for measure in asked.measures
    )


def _moved(measure: Measure, cases: pd.DataFrame, asked: Asked) -> str:
    values: list[float] = []
    ratios: dict[str, float] = {}
    for level in by_level(cases, asked.along) if asked.along else [Group({}, cases)]:
        told: dict[str, list[float]] = {}
        for group in by_setting(level.cases):
            name = group.title if asked.over == "protocol" else group.protocol
            told.setdefault(name, []).append(measure.summarise(group.cases))
        values += [value for sizes in told.values() for value in sizes]
        for name, sizes in told.items():
            ratios[name] = max(ratios.get(name, 1.0), _ratio(sizes))
    ends = f"{measure.say(min(values))} to {measure.say(max(values))}"
    return f"{ends}, the worst {asked.over}'s {extremes(ratios)} times the best's"


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
    head = (
        f"The {words_of(along)} from which on the {together(asked.measures)} stays within {limits}"
    )
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
