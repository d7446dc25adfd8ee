"""Tables of any measure, by comparison: settings and levels, protocols along a factor, limits."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.study.evidence.along import FLIGHTS, axis_of, level_needed, unit_of, words_of
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import (
    by_level,
    by_setting,
    factors,
    failures,
    groups_by,
    level_text,
)
from sparsefit.study.evidence.columns import (
    COUNTS,
    PLANNED,
    Statistic,
    by_levels,
    counted,
    interval_notes,
    name_columns,
    setting_columns,
    setting_values,
    statistic,
    statistics,
    table_of,
)
from sparsefit.study.evidence.reference import printed
from sparsefit.study.evidence.sentence import capital
from sparsefit.study.evidence.table import Column, Table, Value, plain

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study


def settings(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return the measures per setting and level, the numbers of the study's reference first."""
    asked.needs(study.name, "measure")
    swept, conventions = factors(cases), dict.fromkeys(one.convention for one in asked.measures)
    table = table_of(
        asked,
        study,
        setting_columns(swept),
        by_levels(cases, swept),
        (*COUNTS, *statistics(asked)),
        title=asked.name.replace("-", " ") or "Measures",
        notes=(*(f"{capital(text)}." for text in conventions), *interval_notes(asked)),
    )
    known = [printed(study.reference, measure) for measure in asked.measures]
    if study.reference is None or all(value is None for value in known):
        return table
    blank = [None] * (2 + len(swept))
    first = (study.reference.name, *blank, study.reference.flights, None, None, *known)
    return replace(table, rows=(first, *table.rows))


def levels(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return the measures per setting, and per level of each factor with the others pooled."""
    asked.needs(study.name, "measure")
    keys = (*setting_columns(), *name_columns("factor", "level"))
    shown = (PLANNED, *statistics(asked))
    return table_of(asked, study, keys, _pooled(cases), shown, title="Levels", limit=80)


def _pooled(cases: pd.DataFrame) -> Iterator[tuple[tuple[Value, ...], pd.DataFrame]]:
    for group in by_setting(cases):
        key = setting_values(group)
        yield (*key, None, None), group.cases
        for factor in factors(cases):
            for level in groups_by(group.cases, [factor]):
                yield (*key, factor, level.key[factor]), level.cases


def protocols(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return a row for each setting and protocol, a column for each level of a factor."""
    asked.needs(study.name, "measure")
    measure, along = asked.first, axis_of(asked, study, cases)
    others, name = [one for one in factors(cases) if one != along], words_of(along)

    def at(level: Value) -> Statistic:
        def told(group: pd.DataFrame) -> float | None:
            kept = group[[plain(value) == level for value in group[along]]]
            return measure.summarise(kept) if len(kept) else None

        column = replace(
            statistic(measure).column, name=level_text(level), unit=measure.unit, group=name, tex=""
        )
        return Statistic(column, told)

    rows = [
        ((tuple(group.key[one] for one in others), group.title), group)
        for group in by_setting(cases, *others)
    ]
    # The protocols of one setting at one level of the others stand together.
    ranks = [list(dict.fromkeys(values)) for values in zip(*(key for key, _ in rows), strict=True)]
    rows.sort(key=lambda row: [rank.index(one) for rank, one in zip(ranks, row[0], strict=True)])
    lost = Statistic(Column("failures"), lambda group: f"{failures(group)}/{len(group)}")
    return table_of(
        asked,
        study,
        name_columns(*others, "back-end", "protocol"),
        (((*levels, title, group.protocol), group.cases) for (levels, title), group in rows),
        (*(at(level.key[along]) for level in by_level(cases, along)), lost),
        title=f"{capital(measure.phrase)} along {name}",
        notes=(f"{capital(measure.convention)}, and counted.",),
        limit=None,
    )


def until(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return the level from which on the median flight, and 9 in 10, keep each limit."""
    asked.needs(study.name, "measure", "limits")
    along, measure = axis_of(asked, study, cases), asked.first
    others, name = [one for one in factors(cases) if one != along], words_of(along)

    def needed(summary: str, limit: float) -> Statistic:
        def told(group: pd.DataFrame) -> float | None:
            level = level_needed(group, along, replace(measure, summary=summary), limit)
            return level if np.isfinite(level) else None

        words = f"within {limit:g} {measure.unit}"
        return Statistic(Column(words, unit_of(along), "g", group=FLIGHTS[summary]), told)

    note = (
        f"Least {name} tried from which on, at every larger one too, the {measure.words} of the "
        f"median flight, or of 9 in 10 flights, is within the limit; – where none is; "
        f"{measure.convention}."
    )
    return table_of(
        asked,
        study,
        setting_columns(others),
        by_levels(cases, others),
        (
            counted("flights", lambda group: int(group["flight"].nunique())),
            *(needed(summary, limit) for summary in FLIGHTS for limit in asked.limits),
        ),
        title=f"{capital(name)} needed",
        notes=(note,),
        limit=None,
    )
