"""The tables of a study: measures of groups of cases.

A table groups the cases by columns of the frame, a row per group, and summarises measures, a column
each. Layouts differ in the measures: one per level of a factor (`protocols`), per status and error
(`status`), per parameter (`coverage`). An entry of [outputs] is the name of a table of outputs.toml
or of a function of the study's script, or a mapping of the fields of `Entry`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sparsefit.arrays import Array
from sparsefit.study import entries, measures, resampling, solver_times
from sparsefit.study.columns import PARAMETERS, STATUSES
from sparsefit.study.entries import Entry, Options, level_text
from sparsefit.study.measures import MEASURES, SYMBOLS, UNITS, Measure, in_words
from sparsefit.study.table import Column, Row, Table, Value, sentence
from sparsefit.study.trials import unit_of

if TYPE_CHECKING:
    import pandas as pd

ROWS = ("condition", "title")


class Part(NamedTuple):
    """A column of a table: the values (rows,) of all cases, and the measure that summarises them.

    each: the measure, or None for the number of cases with a true value.
    interval: whether columns with the ends of a 95 % interval over flights follow.
    """

    column: Column
    values: Array
    each: Measure | None = None
    interval: bool = False


def column_of(each: Measure) -> Column:
    """Return the column of a measure, with the summary before its heading or above it."""
    head, _, symbol = each.heading.rpartition(" ")
    if symbol not in SYMBOLS.values():
        head, symbol = each.heading, ""
    words = head if each.summary == "share" else f"{each.summary} {head}"
    name, group = (symbol, words) if symbol else (words, "")
    return Column(name, each.unit, each.format, group, each.least, each.varies)


def name_columns(cases: pd.DataFrame, rows: Sequence[str]) -> list[str]:
    """Return those of the columns that have several values, or the last one.

    Raises:
        InputError: for a column that the cases do not have.
    """
    entries.check_columns(cases, rows, "rows")
    several = [name for name in rows if cases[name].nunique(dropna=False) > 1]
    return several or list(rows[-1:])


def _counts(cases: pd.DataFrame) -> list[Part]:
    """Return the columns with the numbers of planned, ok and unanswered cases."""
    counted = {"n": np.ones(len(cases), dtype=bool), "ok": measures.ended(cases, "ok"),
               "failures": ~measures.answered(cases)}  # fmt: skip
    return [Part(Column(name, format="d"), mask.astype(float)) for name, mask in counted.items()]


def summarised(entry: Entry, cases: pd.DataFrame, parts: Sequence[Part], names: Sequence[str] = (),
               notes: Sequence[str] = ()) -> Table:  # fmt: skip
    """Return a row per group of cases and a column per part that has a number of any case.

    Args:
        names: the columns that define the groups; by default those of the entry that vary.
    """
    parts = [part for part in parts if not part.each or not np.isnan(part.values).all()]
    names = names or name_columns(cases, entry.rows or ROWS)
    columns = [*map(Column, names)]
    for part in parts:
        group = f"{part.column.group} {part.column.name}".strip()
        ends = ("from", "to") if part.interval else ()
        columns += [part.column, *(replace(part.column, name=end, group=group) for end in ends)]
    rows: list[Row] = []
    for key, places in entries.grouped(cases, names):
        cells: list[Value] = []
        for part in parts:
            here, each = part.values[places], part.each
            cells.append(each.summary_of(here) if each else int(here.sum()))
            if each and part.interval:
                grid = resampling.by_unit(here, cases["flight"].iloc[places])
                if each.summary == "share" and grid.shape[1] == 1:
                    cells += resampling.wilson(np.nansum(here), (~np.isnan(here)).sum())
                else:
                    cells += resampling.interval(resampling.pooled(each.reduce), grid)
        rows.append((*map(level_text, key), *cells))
    title = entry.title or entry.name.replace("-", " ").capitalize() or "Measures"
    return Table(title, tuple(columns), rows, (*entry.notes, *filter(None, notes)))


def settings(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return counts and measures by group, with intervals if the entry has them.

    With `along`, each measure has a column per level of that factor.
    """
    every, title, names = entry.measures, entry.title, list(entry.rows or ROWS)
    parts = [Part(column_of(each), each.values(cases), each, entry.interval) for each in every]
    explained = [each for each in every if each.miss is not None or entry.along]
    if entry.along:
        words, levels = entries.factor_words(entry.along), entries.levels_of(cases, entry.along)
        several = len(every) > 1
        parts = [
            part._replace(
                column=replace(part.column, name=level,
                               group=f"{part.column.name}, {words}" if several else words),
                values=measures.only((levels == level).to_numpy(), part.values))
            for part in parts for level in levels.cat.categories
        ]  # fmt: skip
        what = "Measures" if several else sentence(every[0].phrase)[:-1]
        title = title or f"{what} along {words}"
        if not entry.rows:  # a title may have several protocols
            names = [name for name in ("protocol", *ROWS[1:]) if name in cases]
            is_unique = not cases[names].drop_duplicates()["title"].duplicated().any()
            names = names[-1:] if is_unique else names
    notes = [sentence(in_words(explained))]
    if entry.interval:
        drawn = f"From, to: 95 %, by {resampling.RESAMPLES} draws of whole {unit_of(cases)}s"
        notes.append(f"{drawn}; a share of single cases: Wilson's.")
    parts = [*_counts(cases), *parts]
    return summarised(replace(entry, title=title), cases, parts, name_columns(cases, names), notes)


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
    parts = [_counts(cases)[0]]
    for name in STATUSES:
        for fact in (near, "off", "no flow", "all"):
            both = measures.ended(cases, name) & (truth == fact)
            parts += [Part(Column(fact, "", "d", name), both.astype(float))] if both.any() else []
    return summarised(entry, cases, parts)


def coverage(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return the share of 95 % intervals that contain the truth, a row per group and parameter."""
    shares = measures.of_parameters(cases)
    covered, halves = shares["coverage"].ravel(), shares["half-width"].ravel()
    names = [*name_columns(cases, entry.rows or ROWS), "parameter"]
    each = cases.iloc[np.repeat(np.arange(len(cases)), 3)]
    each = each.assign(parameter=np.tile(list(SYMBOLS.values()), len(cases)))
    with_interval = np.isfinite(covered).astype(float)
    parts = [
        *_counts(each)[:2], Part(Column("with interval", format="d"), with_interval),
        Part(Column("coverage", "%", ".1f"), covered, MEASURES["hits"], interval=True),
        Part(Column("half-width", "%"), halves, MEASURES["length-scale-half-width"]),
    ]  # fmt: skip
    made = summarised(entry, each, parts, names)
    return replace(made, rows=[row for row in made.rows if row[len(names) + 2]])


def single(entry: Entry, cases: pd.DataFrame) -> Table:
    """Return status, truth, estimate and percentage error of every case."""
    errors = measures.of_parameters(cases)["signed-error"]
    values = {"true": measures.parameters(cases, "true"), "error": errors,
              "estimated": measures.parameters(cases, "est")}  # fmt: skip
    parts = [
        Part(Column(SYMBOLS[name], "%" if group == "error" else UNITS[name], format, group),
             values[group][:, place], MEASURES["seconds"])
        for group, format in (("true", ".4g"), ("estimated", ".4g"), ("error", "+.2f"))
        for place, name in enumerate(PARAMETERS)
    ]  # fmt: skip
    names = [*name_columns(cases, entry.rows or ("flight", *ROWS)), "status"]
    return summarised(entry, cases, parts, names)


LAYOUTS: Mapping[str, Callable[[Entry, pd.DataFrame], Table]] = {
    "settings": settings,
    "protocols": settings,
    "status": status,
    "coverage": coverage,
    "parameters": single,
    "solvers": lambda entry, cases: solver_times.summary(cases),
    "failed": lambda entry, cases: solver_times.failures(cases),
}


def table(study: Any, entry: str | Options) -> Table:
    """Return the table that an entry asks for, of the cases of a study.

    Raises:
        InputError: for an unknown name, or one of the other kind of study.
    """
    (made,) = tables(study, study.cases, [entry]).values()
    return made


def tables(
    study: Any, cases: pd.DataFrame, names: Sequence[str | Options] = ()
) -> dict[str, Table]:
    """Return tables by file name: those named, else those of [outputs], else all that apply."""
    import pandas as pd

    outputs, every = study.definition.outputs, dict[str, Table]()
    for name, entry in entries.asked(study, "table", LAYOUTS, names, cases):
        if not isinstance(entry, Entry):
            made = entry(cases, pd.DataFrame, Table)
            made = made if isinstance(made, Table) else Table.of(made)
            title = made.title or name.replace("_", " ").capitalize()
            every[name] = replace(made, title=title)
            continue
        made = LAYOUTS[entry.compare or "settings"](entry, cases)
        printed: dict[str, Value] = {column_of(each).full: printed_value(outputs.reference, each)
                                     for each in entry.measures}  # fmt: skip
        if any(value is not None for value in printed.values()):
            printed |= {"n": outputs.reference.flights, made.heads[0]: outputs.reference.name}
            made = replace(made, rows=[tuple(map(printed.get, made.heads)), *made.rows])
        every[name] = made
    return {name: made for name, made in every.items() if made.rows or names}


def printed_value(reference: Any, each: Measure) -> float | None:
    """Return the value of a measure that a reference states, or None."""
    for kind in ("deviation", "signed-error"):
        values = getattr(reference, kind.replace("-", "_"), ())
        names = measures.three(kind)
        if values and each.name in names:
            return float(values[names.index(each.name)])
    return None
