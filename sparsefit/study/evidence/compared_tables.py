"""Tables of any measure, by comparison: settings, protocols along a factor, and limits."""

from __future__ import annotations

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
    failures,
    groups_by,
    level_text,
)
from sparsefit.study.evidence.columns import (
    COUNTS,
    Statistic,
    counted,
    name_column,
    setting_columns,
    setting_values,
    statistic,
    table_of,
)
from sparsefit.study.evidence.measures import Measure
from sparsefit.study.evidence.table import Column, Table, Value, plain

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study


def titled(study: Study, words: str) -> str:
    """Return the title of a table, with its study."""
    return f"{words} ({study.name})"


def by_setting_and_level(cases: pd.DataFrame) -> Iterator[tuple[tuple[Value, ...], pd.DataFrame]]:
    """Give the key and the cases of every setting at every level of the swept factors."""
    swept = factors(cases)
    for group in by_setting(cases, *swept):
        yield setting_values(group, swept), group.cases


def per_setting(
    study: Study,
    cases: pd.DataFrame,
    *,
    title: str,
    shown: tuple[Statistic, ...],
    notes: tuple[str, ...] = (),
) -> Table:
    """Return a row for each setting and level of the swept factors."""
    keys = setting_columns(factors(cases))
    return table_of(titled(study, title), keys, by_setting_and_level(cases), shown, notes)


def across(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return a row for each protocol and setting, a column for each level of a factor."""
    asked.needs(study.name, "measure")
    measure, along = asked.measure, axis_of(asked, study, cases)
    others = [name for name in factors(cases) if name != along]
    name = words_of(along)

    def at(level: Value) -> Statistic:
        column = Column(level_text(level), measure.unit, measure.format, group=name)
        return Statistic(column, lambda group: _summary_at(measure, group, along, level))

    lost = Statistic(Column("failures"), lambda group: f"{failures(group)}/{len(group)}")
    groups = by_setting(cases, *others)
    places = {
        key: place
        for place, key in enumerate(
            (*level.key.values(), title)
            for level in (groups_by(cases, others) if others else [Group({}, cases)])
            for title in dict.fromkeys(group.title for group in groups)
        )
    }
    rows = sorted(
        (
            ((*(group.key[one] for one in others), group.title, group.protocol), group.cases)
            for group in groups
        ),
        key=lambda row: places[row[0][:-1]],
    )
    return table_of(
        titled(study, f"{measure.phrase[0].upper()}{measure.phrase[1:]} along {name}"),
        tuple(map(name_column, (*others, "back-end", "protocol"))),
        rows,
        (*(at(level.key[along]) for level in by_level(cases, along)), lost),
        (f"{measure.convention[0].upper()}{measure.convention[1:]}, and counted.",),
        None,
    )


def _summary_at(measure: Measure, cases: pd.DataFrame, along: str, level: Value) -> float | None:
    kept = cases[[plain(value) == level for value in cases[along]]]
    return measure.summarise(kept) if len(kept) else None


def until(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return the level from which on the median flight, and 9 in 10, keep each limit."""
    for key in ("measure", "limits"):
        asked.needs(study.name, key)
    along, measure = axis_of(asked, study, cases), asked.measure
    others = [name for name in factors(cases) if name != along]
    name = words_of(along)

    def needed(summary: str, limit: float) -> Statistic:
        told = replace(measure, summary=summary)
        words = f"within {limit:g} {measure.unit}"
        column = Column(words, unit_of(along), "g", group=FLIGHTS[summary])

        def of(group: pd.DataFrame) -> float | None:
            level = level_needed(group, along, told, limit)
            return level if np.isfinite(level) else None

        return Statistic(column, of)

    note = (
        f"Least {name} tried from which on, at every larger one too, the {measure.words} of the "
        f"median flight, or of 9 in 10 flights, is within the limit; – where none is; "
        f"{measure.convention}."
    )
    return table_of(
        titled(study, f"{name[0].upper()}{name[1:]} needed"),
        setting_columns(others),
        ((setting_values(group, others), group.cases) for group in by_setting(cases, *others)),
        (
            counted("flights", lambda group: int(group["flight"].nunique())),
            *(needed(summary, limit) for summary in FLIGHTS for limit in asked.limits),
        ),
        (note,),
        None,
    )


def settings(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return the measures, summarised in their own ways, per setting and level."""
    asked.needs(study.name, "measure")
    shown = tuple(statistic(one, name=one.symbol, group=one.summary) for one in asked.measures)
    conventions = dict.fromkeys(one.convention for one in asked.measures)
    notes = tuple(f"{text[0].upper()}{text[1:]}." for text in conventions)
    title = asked.name.replace("-", " ") or "Measures"
    return per_setting(study, cases, title=title, shown=(*COUNTS, *shown), notes=notes)
