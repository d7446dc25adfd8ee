"""The tables of a study, by name: rows are a comparison, columns are measures summarised.

A table of a study's own names its measures and one of `TABLE_COMPARISONS`; `TABLES` are those
that need no options.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pandas as pd

from sparsefit.errors import unknown
from sparsefit.study.evidence.asked import Asked, read_entry
from sparsefit.study.evidence.cases import (
    STATUSES,
    Group,
    by_setting,
    estimated,
    factors,
    groups_by,
    has_status,
    in_a_flow,
    is_condition,
    three_of,
)
from sparsefit.study.evidence.columns import (
    COUNTS,
    PLANNED,
    ROWS_SHOWN,
    Statistic,
    counted,
    name_column,
    setting_columns,
    setting_values,
    share_columns,
    statistic,
    statistics,
    table_of,
    with_status,
)
from sparsefit.study.evidence.measures import MEASURES, Measure, Share, three
from sparsefit.study.evidence.readings import bounded
from sparsefit.study.evidence.reference import SIZES, closest_readings, sensitivity
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value, plain
from sparsefit.study.spec.outputs import Entry

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

from sparsefit.study.evidence.compared_tables import (
    across,
    by_setting_and_level,
    per_setting,
    settings,
    titled,
    until,
)
from sparsefit.study.evidence.notes import (
    COVERAGE_NOTE,
    EFFICIENCY_NOTE,
    FAILURES_NOTE,
    IDENTIFIABILITY_NOTE,
    SCALES_NOTE,
    SIGNED_NOTE,
    TIMES_NOTE,
)

TableFunction: TypeAlias = Callable[["Study", pd.DataFrame], Table]
DURATION, MEASUREMENT_NOISE = "flights.duration", "flights.measurement_noise"
FEWEST = 3  # levels that make a curve


def parameters(study: Study, cases: pd.DataFrame) -> Table:
    """Return truth, estimate and percentage error of every case, the reference beside it."""
    swept = factors(cases)
    names = ("flight", "protocol", "backend", "setting", *swept)
    columns = (
        *map(name_column, names),
        *(_symbol(one, one.unit, ".4g", "value") for one in three("deviation")),
        *(_symbol(one, one.unit, "+.2f", "error") for one in three("signed-error")),
        name_column("status"),
    )
    rows: list[tuple[Value, ...]] = []
    for flight in groups_by(cases, ["flight"]):
        rows += _flight_rows(study, flight, swept)
    notes = (study.reference.note,) if study.reference and study.reference.note else ()
    return Table("True and estimated flow parameters", columns, tuple(rows), notes, ROWS_SHOWN)


def _symbol(measure: Measure, unit: str, spec: str, group: str) -> Column:
    return Column(measure.symbol, unit, spec, group=group, tex=measure.tex)


def _flight_rows(study: Study, flight: Group, swept: list[str]) -> list[tuple[Value, ...]]:
    name, blank = flight.key["flight"], [None] * (2 + len(swept))
    truth = three_of(flight.cases.iloc[:1], "true")[0]
    rows: list[tuple[Value, ...]] = [(name, "true value", *blank, *map(plain, truth), *[None] * 4)]
    reference = study.reference
    if reference and reference.estimate and reference.signed_error:
        printed = (*reference.estimate, *reference.signed_error, None)
        rows.append((name, reference.name, *blank, *printed))
    for group in by_setting(flight.cases, *swept):
        estimates = three_of(group.cases, "est").tolist()
        percent = np.column_stack([one.read(group.cases) for one in three("signed-error")]).tolist()
        for place, status in enumerate(group.cases["status"]):
            told = (*estimates[place], *percent[place], plain(status))
            rows.append((name, *setting_values(group, swept), *told))
    return rows


def errors(study: Study, cases: pd.DataFrame) -> Table:
    """Return signed mean errors per setting, the study's reference first."""
    shown = (
        *COUNTS,
        *statistics(three("deviation"), group="mean signed error"),
        *statistics(three("signed-error"), group="mean signed % error"),
        statistic(MEASURES["hits"], name="hits"),
    )
    notes = (FAILURES_NOTE, SIGNED_NOTE)
    table = per_setting(study, cases, title="Signed mean errors", shown=shown, notes=notes)
    printed = study.reference
    if printed is None or not (printed.deviation and printed.signed_error):
        return table
    blank = [None] * (2 + len(factors(cases)))
    first = (printed.name, *blank, printed.flights, None, None)
    return replace(
        table, rows=((*first, *printed.deviation, *printed.signed_error, None), *table.rows)
    )


def times(study: Study, cases: pd.DataFrame) -> Table:
    """Return seconds per fit, the worst certificate, and how many cases ended in each status."""
    seconds = MEASURES["seconds"]
    ended = [status for status in STATUSES if has_status(cases, status).any()]
    shown = (
        PLANNED,
        statistic(seconds, name="median", group="time"),
        statistic(seconds, "95th percentile", name="95 %", group="time"),
        Statistic(Column("certificate", align="left"), _kinds),
        Statistic(Column("worst", format=".1e"), _worst),
        *(with_status(status, "cases that ended as") for status in ended),
    )
    rows = ((setting_values(group, ()), group.cases) for group in by_setting(cases))
    title = titled(study, "Times, certificates and statuses")
    return table_of(title, setting_columns(()), rows, shown, (TIMES_NOTE,), None)


def _kinds(cases: pd.DataFrame) -> str | None:
    kinds = {str(kind) for kind in map(plain, cases["certificate_kind"][estimated(cases)]) if kind}
    return ", ".join(sorted(kinds)) or None


def _worst(cases: pd.DataFrame) -> float | None:
    worst = MEASURES["certificate"].summarise(cases)
    return None if np.isnan(worst) else worst


def coverage(study: Study, cases: pd.DataFrame) -> Table:
    """Return the coverage of the 95 % intervals, a row per setting, level and parameter."""
    swept, kept = factors(cases), cases[in_a_flow(cases)]
    rows = []
    for group in by_setting(kept, *swept):
        ok = int(has_status(group.cases, "ok").sum())
        for measure, half in zip(three("coverage"), three("half-width"), strict=True):
            share = Share.of(measure, group.cases)
            told = (share.percent, *share.interval, half.summarise(group.cases))
            counts = (len(group.cases), ok, share.whole)
            rows.append((*setting_values(group, swept), measure.symbol, *counts, *told))
    columns = (
        *setting_columns(swept),
        name_column("parameter"),
        *(Column(name, format="d") for name in ("n", "ok", "with interval")),
        *(Column(name, "%", ".1f") for name in ("coverage", "from", "to")),
        Column("half-width", "%", SIGNIFICANT),
    )
    title = titled(study, "Coverage of the 95 % intervals")
    return Table(title, columns, tuple(rows), (COVERAGE_NOTE,), ROWS_SHOWN)


def identifiability(study: Study, cases: pd.DataFrame) -> Table:
    """Return what `ok` and `unidentifiable` were worth, per setting and level, and over all."""
    swept = factors(cases)
    rows = list(by_setting_and_level(cases))
    if len(rows) > 1:
        rows.append((("all", None, None, *[None] * len(swept)), cases))
    title = titled(study, "What ok and unidentifiable are worth")
    shown = (*map(_in_flow, _flow_columns()), *map(_without_flow, _empty_columns()))
    return table_of(title, setting_columns(swept), rows, shown, (IDENTIFIABILITY_NOTE,))


def _flow_columns() -> tuple[Statistic, ...]:
    def called(status: str) -> Callable[[pd.DataFrame], int]:
        return lambda cases: int(has_status(cases, status).sum())

    ok, refused = called("ok"), called("unidentifiable")
    return (
        PLANNED,
        counted("ok", ok),
        Statistic(Column("ok", "%", ".1f"), lambda cases: 100.0 * ok(cases) / len(cases)),
        *share_columns(MEASURES["off"], "off", "", ".2f"),
        counted("unidentifiable", refused),
        *share_columns(MEASURES["deserved"], "deserved", "", ".1f"),
        counted("other", lambda cases: len(cases) - ok(cases) - refused(cases)),
    )


def _empty_columns() -> tuple[Statistic, ...]:
    alarms, so = (share_columns(MEASURES[name], name.replace("-", " "), "", ".1f")
                  for name in ("false-alarms", "called-so"))  # fmt: skip
    return (PLANNED, alarms[0], so[1])


def _of_part(one: Statistic, group: str, *, flow: bool) -> Statistic:
    """The statistic over the cases with, or without, a flow; nothing where there are none."""

    def told(cases: pd.DataFrame) -> Value:
        part = cases[in_a_flow(cases) == flow]
        return one.of(part) if len(part) else None

    return Statistic(replace(one.column, group=group), told)


_in_flow = partial(_of_part, group="flow", flow=True)
_without_flow = partial(_of_part, group="no flow", flow=False)


def per_level(study: Study, cases: pd.DataFrame) -> Table:
    """Return scales found, missed and spurious, per setting and level of every factor."""
    found = MEASURES["scales-found"]

    def unseen(group: pd.DataFrame) -> int:
        return int(((found.values(group) == 0) & has_status(group, "ok")).sum())

    means = (MEASURES["scales-missed"], MEASURES["scales-spurious"])
    medians = (MEASURES["scales-length-scale-error"], MEASURES["scales-mean-velocity-error"])
    shown = (
        PLANNED,
        statistic(found, name="all found"),
        *(statistic(one, name=one.name.removeprefix("scales-"), group="mean") for one in means),
        *(statistic(one, group="median error") for one in medians),
        counted("unseen", unseen),
    )
    keys = (*setting_columns(()), name_column("factor"), name_column("level"))
    title = titled(study, "Several scales at once")
    return table_of(title, keys, _pooled_levels(cases), shown, (SCALES_NOTE,), 80)


def _pooled_levels(cases: pd.DataFrame) -> Iterator[tuple[tuple[Value, ...], pd.DataFrame]]:
    for group in by_setting(cases):
        key = setting_values(group, ())
        yield (*key, None, None), group.cases
        for factor in factors(cases):
            for level in groups_by(group.cases, [factor]):
                yield (*key, factor, level.key[factor]), level.cases


AskedTable: TypeAlias = Callable[[Asked, "Study", pd.DataFrame], Table]
TABLE_COMPARISONS: dict[str, AskedTable] = {
    "settings": settings,
    "protocols": across,
    "until": until,
    "reference": lambda _, study, cases: closest_readings(study, cases),
    "one-at-a-time": lambda _, study, cases: sensitivity(study, cases),
}
ABSOLUTE = (
    *COUNTS,
    *statistics(SIZES, "mean", group="mean |error|"),
    *statistics(SIZES, "median", group="median |error|"),
    *statistics(SIZES, "95th percentile", group="95th percentile |error|"),
    statistic(MEASURES["hits"], name="hits"),
)
AGAINST_BOUND = (
    *COUNTS,
    counted("with bound", lambda cases: int(bounded(cases).sum())),
    *statistics(three("bounded-error"), group="rms error"),
    *statistics(three("bound"), group="rms bound"),
    *statistics(three("efficiency"), group="rms of error/bound"),
)
# What the name alone asks for; an entry of [outputs] that is a mapping changes it.
PRESETS = {
    "methods": Asked(
        name="methods",
        compare="protocols",
        measures=(MEASURES["timescale-error"],),
        along=MEASUREMENT_NOISE,
    ),
    "windows": Asked(
        name="windows",
        compare="until",
        measures=(MEASURES["largest-error"],),
        along=DURATION,
        limits=(5.0, 1.0),
    ),
}
# In the order of the pages.
TABLES: dict[str, TableFunction] = {
    "parameters": parameters,
    "errors": errors,
    "errors-absolute": partial(
        per_setting, title="Sizes of the percentage errors", shown=ABSOLUTE, notes=(FAILURES_NOTE,)
    ),
    "readings": closest_readings,
    "sensitivity": sensitivity,
    "scales": per_level,
    "times": times,
    "methods": partial(across, PRESETS["methods"]),
    "efficiency": partial(
        per_setting,
        title="Errors against the Cramér-Rao bound",
        shown=AGAINST_BOUND,
        notes=(EFFICIENCY_NOTE,),
    ),
    "coverage": coverage,
    "identifiability": identifiability,
    "windows": partial(until, PRESETS["windows"]),
}


def read_table(entry: Entry) -> tuple[str, TableFunction]:
    """Return the file name of a table that [outputs] asks for, and what makes it.

    Raises:
        InputError: for a name, measure or comparison that is not known.
    """
    if isinstance(entry, str):
        if entry not in TABLES:
            raise unknown("table", entry, TABLES)
        return entry, TABLES[entry]
    asked = read_entry(entry, PRESETS, TABLE_COMPARISONS)
    return asked.file_name, partial(TABLE_COMPARISONS[asked.compare], asked)


def tables_of(study: Study, cases: pd.DataFrame) -> dict[str, Table]:
    """Return the tables that the study asks for, or else all that apply, by file name."""
    entries: Sequence[Entry] = study.tables or tables_for(cases, study.reference is not None)
    return {name: make(study, cases) for name, make in map(read_table, entries)}


def tables_for(cases: pd.DataFrame, reference: bool = False) -> list[str]:
    """Return the names of the tables that have something to say about these cases."""
    swept = factors(cases)
    single = cases["flight"].nunique() == 1
    said = {
        "parameters": single,
        "errors": not single,
        "errors-absolute": not single,
        "readings": not single and reference and any(not is_condition(name) for name in swept),
        "sensitivity": not single and bool(swept),
        "scales": has_any(cases, "scales-found"),
        "times": True,
        "methods": not single and MEASUREMENT_NOISE in swept,
        "efficiency": bool(bounded(cases).any()),
        "coverage": bool((~np.isnan(three_of(cases, "low"))).any()),
        "identifiability": not in_a_flow(cases).all(),
        "windows": not single and many_levels(cases, DURATION),
    }
    return [name for name in TABLES if said[name]]


def has_any(cases: pd.DataFrame, measure: str) -> bool:
    """Return whether any case has a number for a measure."""
    return bool(np.isfinite(MEASURES[measure].read(cases)).any())


def many_levels(cases: pd.DataFrame, factor: str) -> bool:
    """Return whether a factor has enough levels to tell from which on a limit is kept."""
    return factor in cases and cases[factor].nunique() >= FEWEST
