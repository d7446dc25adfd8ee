"""The tables of a study: measures of groups of cases.

A table groups the cases by columns of the frame, a row per group, and summarises measures, a column
each. An entry of [outputs] is the name of a table of outputs.toml or of a function of the study's
script, or a mapping of the fields of `Entry`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray, IntArray
from sparsefit.study import entries, measures, solver_times
from sparsefit.study.columns import STATUSES
from sparsefit.study.entries import Entry, Options, level_text
from sparsefit.study.measures import MEASURES, SYMBOLS, Measure
from sparsefit.study.table import Column, Table, Value, listed
from sparsefit.study.trials import unit_of

Cells: TypeAlias = dict[Column, Value]
FAILURES = "In a quantile, a failure counts as worse than any number; in a mean, as 100 %."


class Part(NamedTuple):
    """A column of a table: the values (rows,) of all cases, and the measure that summarises them.

    each: the measure, or None for the number of cases with a true value.
    interval: whether columns with the ends of a 95 % interval over units follow.
    """

    column: Column
    values: Array
    each: Measure | None = None
    interval: bool = False

    def cells(self, cases: pd.DataFrame, places: IntArray) -> Cells:
        """Return the summary of a group of cases, and the ends of its interval."""
        here, each, column = self.values[places], self.each, self.column
        if each is None or not self.interval:
            return {column: int(here.sum()) if each is None else each.summary_of(here)}
        unit, units = cases["flight"].iloc[places].factorize()
        grid = measures.gridded(here, [unit], [len(units)])
        if each.summary == "share" and grid.shape[1] == 1:
            ends = measures.wilson(np.nansum(here), (~np.isnan(here)).sum())
        else:
            ends = measures.interval(each.reduce, grid)
        before = f"{column.name} " if column.group else ""
        below = replace(column, group=column.group or column.name)
        columns = (column, *(replace(below, name=f"{before}{end}") for end in ("from", "to")))
        return dict(zip(columns, (each.summary_of(here), *ends), strict=True))


def column_of(each: Measure) -> Column:
    """Return the column of a measure, with the summary before its heading or above it."""
    words, _, symbol = each.heading.rpartition(" ")
    if symbol not in SYMBOLS.values():
        words, symbol = each.heading, ""
    words = each.head + words
    name, group = (symbol, words) if symbol else (words, "")
    return Column(name, each.unit, each.format, group, each.least, each.varies)


def name_columns(entry: Entry, cases: pd.DataFrame) -> list[str]:
    """Return the columns that define the rows: those with several values, a status, or the last.

    By default they are condition and title, along a factor protocol and title. What the title
    implies is left out.

    Raises:
        InputError: for a column that the cases do not have.
    """
    rows = entry.rows or ("condition", "title")
    if entry.along and not entry.rows:
        rows = ("protocol", "title") if "protocol" in cases else ("title",)
    entries.check_columns(cases, [*rows, *filter(None, [entry.along])], "the table")
    names = [name for name in rows if name == "status" or cases[name].nunique(dropna=False) > 1]
    if "title" in names:
        several = cases.groupby("title")[names].nunique(dropna=False).max() > 1
        names = [name for name in names if name in ("title", "status") or several[name]]
    return names or list(rows[-1:])


def summarised(
    entry: Entry, cases: pd.DataFrame, names: Sequence[str], parts: Sequence[Part], *notes: str
) -> Table:
    """Return a row per group of cases by `names`, and a column per part with any number."""
    parts, rows = [part for part in parts if not np.isnan(part.values).all()], list[Cells]()
    for key, places in entries.grouped(cases, names):
        rows.append(dict(zip(map(Column, names), map(level_text, key), strict=True)))
        for part in parts:
            rows[-1] |= part.cells(cases, places)
    title = entry.title or entry.name.replace("-", " ").capitalize() or "Measures"
    made = Table.of_cells(title, rows, (*entry.notes, *notes))
    measured = any(part.each for part in parts) or not entry.measures
    return made if measured else replace(made, rows=())


def _count(name: str, mask: BoolArray, group: str = "") -> Part:
    """Return the column with the number of cases where the mask holds."""
    return Part(Column(name, format="d", group=group), mask.astype(float))


def settings(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return counts and measures by group, with intervals if the entry has them.

    With `along`, each measure has a column per level of that factor. Single cases have a status in
    place of counts.
    """
    names, parts = name_columns(entry, cases), list[Part]()
    if "status" not in names:
        parts += [
            _count("n", np.ones(len(cases), dtype=bool)),
            _count("ok", measures.ended(cases, "ok")),
            _count("failures", ~measures.answered(cases)),
        ]
    for each in entry.measures:
        column, values = column_of(each), each.values(cases)
        if not entry.along:
            parts.append(Part(column, values, each, entry.interval))
            continue
        words, levels = entries.factor_words(entry.along), entries.levels_of(cases, entry.along)
        group = f"{column.group} {column.name}, {words}".strip()
        for level in levels.cat.categories:
            here = measures.only((levels == level).to_numpy(), values)
            of_level = replace(column, name=level, group=group)
            parts.append(Part(of_level, here, each, entry.interval))
    notes = [FAILURES] if any(each.miss is not None for each in entry.measures) else []
    if entry.interval:
        drawn = f"From, to: 95 %, by {measures.RESAMPLES} draws of whole {unit_of(cases)}s"
        notes.append(f"{drawn}; a share of single cases: Wilson's.")
    return summarised(entry, cases, names, parts, *notes)


def status(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return numbers of cases by status and error: within 5 %, off, no flow, or unknown truth."""
    near, truth = f"≤ {measures.OFF:g} %", np.full(len(cases), "all", object)
    if "est_mean_velocity" in cases:
        flown = measures.in_flow(cases)
        truth[flown] = np.where(measures.off(cases), "off", near)[flown]
        truth[measures.in_still_air(cases)] = "no flow"
        truth[~measures.ended(cases, *STATUSES[:4])] = "all"
    else:
        entry = replace(entry, notes=())  # of errors
    parts = [_count("n", np.ones(len(cases), dtype=bool))]
    for name in STATUSES:
        for fact in (near, "off", "no flow", "all"):
            both = measures.ended(cases, name) & (truth == fact)
            parts += [_count(fact, both, name)] if both.any() else []
    return summarised(entry, cases, name_columns(entry, cases), parts)


def coverage(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return the share of 95 % intervals that contain the truth, a row per group and parameter."""
    shares = measures.of_parameters(cases)
    covered, halves = shares["coverage"].ravel(), shares["half-width"].ravel()
    each = cases.iloc[np.repeat(np.arange(len(cases)), 3)]
    each = each.assign(parameter=np.tile(list(SYMBOLS.values()), len(cases)))
    names = [*name_columns(entry, cases), "parameter"]
    parts = [
        _count("n", np.ones(len(each), dtype=bool)),
        _count("ok", measures.ended(each, "ok")),
        _count("with interval", np.isfinite(covered)),
        Part(Column("coverage", "%", ".1f"), covered, MEASURES["hits"], interval=True),
        Part(Column("half-width", "%"), halves, MEASURES["length-scale-half-width"]),
    ]
    made = summarised(entry, each, names, parts)
    return replace(made, rows=[row for row in made.rows if row[len(names) + 2]])


def failures(cases: pd.DataFrame) -> pd.DataFrame:
    """Return the cases that are not ok by candidate, status and reason but for its numbers."""
    bad = cases[cases["status"] != "ok"]
    alike = bad["reason"].str.replace(r"[-+]?\d[\d.,e+-]*", "#", regex=True)
    groups = bad.groupby(["title", "status", alike], sort=False, dropna=False)
    names = "problem" if "problem" in bad else "unit"
    summaries = {
        "cases": (names, "size"),
        "where": (names, lambda units: listed(units, "and")),
        "first case": ("case_id", "first"),
        "reason of it": ("reason", "first"),
    }
    frame = groups.agg(**summaries)
    frame = frame.droplevel(2).sort_values("cases", ascending=False, kind="stable")
    frame.attrs["title"] = "Who failed where"
    return frame


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Table]] = {
    "settings": settings,
    "protocols": settings,
    "status": status,
    "coverage": coverage,
    "solvers": lambda entry, cases: solver_times.summary(cases),
    "failed": lambda entry, cases: Table.of(failures(cases[cases["status"] != "skipped"])),
}


def tables(
    study: Any, cases: pd.DataFrame, names: Sequence[str | Options] = ()
) -> dict[str, Table]:
    """Return tables by file name: those named, else those of [outputs], else what fits."""
    outputs, every = study.definition.outputs, dict[str, Table]()
    wanted = names or outputs.tables or entries.defaults(study, cases, "tables")
    for name, entry in entries.asked(study, "table", LAYOUTS, wanted):
        if not isinstance(entry, Entry):
            made = entry(cases, pd.DataFrame, Table)
            made = made if isinstance(made, Table) else Table.of(made)
            title = made.title or name.replace("_", " ").capitalize()
            every[name] = replace(made, title=title)
            continue
        made = LAYOUTS[entry.compare or "settings"](entry, cases)
        stated = measures.stated(outputs.reference)
        printed = {column_of(own).full: stated.get(own.name) for own in entry.measures}
        if any(value is not None for value in printed.values()):
            printed |= {"n": outputs.reference.flights, made.heads[0]: outputs.reference.name}
            made = replace(made, rows=[tuple(map(printed.get, made.heads)), *made.rows])
        every[name] = made
    return {name: made for name, made in every.items() if made.rows or names}
