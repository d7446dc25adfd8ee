"""Columns of tables: what a row stands for, and measures summarised over its cases."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import pandas as pd

from sparsefit.study.evidence.cases import Group, failures, has_status
from sparsefit.study.evidence.measures import Measure, Share
from sparsefit.study.evidence.table import Column, Table, Value

ROWS_SHOWN = 60


@dataclass(frozen=True)
class Statistic:
    """One column of a table: its heading, and what it says of the cases of a row."""

    column: Column
    of: Callable[[pd.DataFrame], Value]


def statistic(
    measure: Measure,
    summary: str = "",
    *,
    name: str = "",
    group: str = "",
    format: str = "",
) -> Statistic:
    """Return the column of a measure summarised over cases, by default in its own way."""
    column = Column(
        name or measure.symbol, measure.unit, format or measure.format, group=group, tex=measure.tex
    )
    return Statistic(column, lambda cases: measure.summarise(cases, summary))


def statistics(
    measures: Iterable[Measure],
    summary: str = "",
    *,
    group: str,
    format: str = "",
) -> tuple[Statistic, ...]:
    """Return a column of each measure, by symbol, under one heading."""
    return tuple(statistic(one, summary, group=group, format=format) for one in measures)


def counted(name: str, count: Callable[[pd.DataFrame], int], group: str = "") -> Statistic:
    """Return a column that counts cases."""
    return Statistic(Column(name, format="d", group=group), count)


def with_status(status: str, group: str = "") -> Statistic:
    """Return the column that counts how many cases ended in a status."""
    return counted(status, lambda cases: int(has_status(cases, status).sum()), group)


def share_columns(measure: Measure, part: str, group: str, spec: str) -> tuple[Statistic, ...]:
    """Return how many cases a share is, and how many percent."""
    return (
        counted(part, lambda cases: Share.of(measure, cases).part, group),
        Statistic(
            Column(part, "%", spec, group=group), lambda cases: Share.of(measure, cases).percent
        ),
    )


PLANNED = counted("n", len)
COUNTS = (PLANNED, with_status("ok"), counted("failures", failures))


def name_column(name: str) -> Column:
    """Return a column of words."""
    return Column(name, align="left")


def setting_columns(swept: Sequence[str]) -> tuple[Column, ...]:
    """Return the columns protocol, back-end, setting and swept factors."""
    return tuple(map(name_column, ("protocol", "backend", "setting", *swept)))


def setting_values(group: Group, swept: Sequence[str]) -> tuple[Value, ...]:
    """Return what a group has in `setting_columns`."""
    fixed = (group.key["protocol"], group.key["backend"], group.setting)
    return (*fixed, *(group.key[name] for name in swept))


def table_of(
    title: str,
    keys: tuple[Column, ...],
    rows: Iterable[tuple[tuple[Value, ...], pd.DataFrame]],
    shown: Sequence[Statistic],
    notes: tuple[str, ...],
    limit: int | None = ROWS_SHOWN,
) -> Table:
    """Return the table with one row per key and its cases, and one column per statistic."""
    columns = (*keys, *(statistic.column for statistic in shown))
    filled = tuple((*key, *(one.of(cases) for one in shown)) for key, cases in rows)
    return Table(title, columns, filled, notes, limit)
