"""Columns of tables: what a row stands for, and measures summarised over its cases."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import pandas as pd

from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import Group, by_setting, failures, has_status
from sparsefit.study.evidence.measure import Measure
from sparsefit.study.evidence.resampling import RESAMPLES, SEED, interval_of
from sparsefit.study.evidence.table import Column, Table, Value, cell_text

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

Rows: TypeAlias = Iterable[tuple[tuple[Value, ...], pd.DataFrame]]  # the key of each, its cases
ROWS_SHOWN = 60
FEW = 4  # measures of a table: with more, intervals would hide them
INTERVALS = (
    f"95 %: the interval of the summary by bootstrap over flights ({RESAMPLES} draws of whole "
    f"flights, seed {SEED}). About a quarter of its width is the Monte Carlo standard error: by so "
    "much flights of other seeds would move the summary."
)
PLAIN = ("share", "number")  # summaries that need no word over their column


@dataclass(frozen=True)
class Statistic:
    """One column of a table: its heading, and what it says of the cases of a row."""

    column: Column
    of: Callable[[pd.DataFrame], Value]


def statistic(
    measure: Measure, summary: str = "", *, name: str = "", group: str | None = None
) -> Statistic:
    """Return the column of a measure summarised over cases, by default in its own way.

    Its name is that of the measure in a table, the summary stands over it, `mean |error|`.
    """
    told = summary or measure.summary
    words = f"{told} {measure.column}" if measure.of else told
    column = Column(
        name or (measure.symbol if measure.of else measure.column or measure.words),
        "" if told == "number" else measure.unit,
        "d" if told == "number" else measure.format,
        group=("" if told in PLAIN else words) if group is None else group,
        tex=measure.tex,
        least=measure.least,
        varies=measure.varies,
    )
    return Statistic(column, lambda cases: measure.summarise(cases, told))


def statistics(asked: Asked) -> Iterator[Statistic]:
    """Give the columns of the measures of an entry, with intervals where it has them."""
    for measure in asked.measures:
        yield statistic(measure)
        if has_intervals(asked) and measure.summary != "number":
            yield between(measure)


def has_intervals(asked: Asked) -> bool:
    """Whether the summaries of an entry have intervals beside them: asked for, or few enough."""
    return len(asked.measures) <= FEW if asked.interval is None else asked.interval


def between(measure: Measure) -> Statistic:
    """Return the column of the 95 % interval of a measure's summary, by bootstrap over flights."""
    value = statistic(measure).column
    column = Column("95 %", measure.unit, group=value.group or value.name, varies=measure.varies)

    def told(cases: pd.DataFrame) -> Value:
        low, high = interval_of(measure, cases)
        if math.isnan(low) or math.isnan(high):
            return None
        return f"{cell_text(low, value)} to {cell_text(high, value)}"

    return Statistic(column, told)


def interval_notes(asked: Asked) -> tuple[str, ...]:
    """Return what stands under a table with intervals."""
    return (INTERVALS,) if has_intervals(asked) else ()


def counted(name: str, count: Callable[[pd.DataFrame], int], group: str = "") -> Statistic:
    """Return a column that counts cases."""
    return Statistic(Column(name, format="d", group=group), count)


def with_status(status: str, group: str = "") -> Statistic:
    """Return the column that counts how many cases ended in a status."""
    return counted(status, lambda cases: int(has_status(cases, status).sum()), group)


PLANNED = counted("n", len)
FAILED = counted("failures", failures)
COUNTS = (PLANNED, with_status("ok"), FAILED)


def name_columns(*names: str) -> tuple[Column, ...]:
    """Return columns of words, and of levels: 60.0 is printed as 60."""
    return tuple(Column(name, format="g", align="left") for name in names)


def setting_columns(swept: Sequence[str] = ()) -> tuple[Column, ...]:
    """Return the columns protocol, back-end, setting and swept factors."""
    return name_columns("protocol", "backend", "setting", *swept)


def setting_values(group: Group, swept: Sequence[str] = ()) -> tuple[Value, ...]:
    """Return what a group has in `setting_columns`."""
    fixed = (group.key["protocol"], group.key["backend"], group.setting)
    return (*fixed, *(group.key[name] for name in swept))


def by_levels(
    cases: pd.DataFrame, swept: Sequence[str] = ()
) -> Iterator[tuple[tuple[Value, ...], pd.DataFrame]]:
    """Give the key and the cases of every setting at every level of these factors."""
    for group in by_setting(cases, *swept):
        yield setting_values(group, swept), group.cases


def table_of(
    asked: Asked,
    study: Study,
    keys: tuple[Column, ...],
    rows: Rows,
    shown: Sequence[Statistic],
    *,
    title: str = "",
    notes: tuple[str, ...] = (),
    limit: int | None = ROWS_SHOWN,
) -> Table:
    """Return the table with one row per key and its cases, and one column per statistic.

    The entry's own title and notes stand before those given here.
    """
    columns = (*keys, *(statistic.column for statistic in shown))
    filled = tuple((*key, *(one.of(cases) for one in shown)) for key, cases in rows)
    return Table(f"{asked.title or title} ({study.name})", columns, filled, asked.notes or notes,
                 limit)  # fmt: skip
