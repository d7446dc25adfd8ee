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
from sparsefit.study.evidence.along import FLIGHTS, level_needed, unit_of, words_of
from sparsefit.study.evidence.answers import axis_of
from sparsefit.study.evidence.asked import Asked, read_entry
from sparsefit.study.evidence.cases import (
    STATUSES,
    Group,
    by_level,
    by_setting,
    estimated,
    factors,
    failures,
    groups_by,
    has_status,
    in_a_flow,
    is_condition,
    level_text,
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
from sparsefit.study.evidence.measures import MEASURES, Measure, Share, bounded, three
from sparsefit.study.evidence.reference import SIZES, closest_readings, sensitivity
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value, plain
from sparsefit.study.spec.outputs import Entry

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

TableFunction: TypeAlias = Callable[["Study", pd.DataFrame], Table]
DURATION, MEASUREMENT_NOISE = "flights.duration", "flights.measurement_noise"
FEWEST = 3  # levels that make a curve
FAILURES_NOTE = (
    "n: planned cases. Errors are over the cases with an estimate (status ok or inaccurate); "
    "every other case is a failure, and counts as a miss in the hit rate."
)
SIGNED_NOTE = (
    "Signed means, the paper's convention (its “Absolute Error” and “Percentage Error” are "
    "signed): errors of opposite sign cancel. errors-absolute has the sizes."
)
EFFICIENCY_NOTE = (
    "Bound: the semiparametric Cramér-Rao bound of each flight as flown, under noise on v' alone "
    "(Eq. 7); it assumes nothing of the flow but its length scale. Rms over the flights with "
    "status ok and a bound (their number: with bound); a failure has no error, so read the "
    "number of failures beside it. 1 is the limit of what knows no more than the bound does; "
    "parametric-nls knows Eq. 1 and may fall below it, and so may any back-end where it gives up "
    "the hardest flights."
)
COVERAGE_NOTE = (
    "Share of the flights with status ok whose 95 % interval holds the truth, and the 95 % Wilson "
    "interval of that share: where it leaves 95 % out, the intervals are too narrow or too wide. "
    "Half-width: median, in percent of the estimate. Flights without a flow have no truth and "
    "are left out."
)
IDENTIFIABILITY_NOTE = (
    "Off: called ok, but more than 5 % from the truth in U0, L_w or τ_w, and its share of those "
    "called ok. An unidentifiable flight deserved it if the numbers that it would have given are "
    "off by as much, or there are none. Other: inaccurate, or no answer. In flights without a "
    "flow status ok or inaccurate is a false alarm; called so: unidentifiable because no cellular "
    "flow is detected."
)
SCALES_NOTE = (
    "All found: every flow's length scale within 1 %, over all planned cases. A scale counts as "
    "detected within 5 %; missed and spurious are means per case. Errors: the largest over the "
    "detected scales of a case, median over cases. Unseen: cases that ended as ok without all "
    "scales within 1 %. First row of each setting: all its cases; then "
    "each level of each factor, the others pooled."
)
TIMES_NOTE = (
    "Worst: the largest certificate of the cases with an estimate. "
    "Times depend on the machine; the manifest names it."
)


def titled(study: Study, words: str) -> str:
    """Return the title of a table, with its study."""
    return f"{words} ({study.name})"


def _by_setting_and_level(cases: pd.DataFrame) -> Iterator[tuple[tuple[Value, ...], pd.DataFrame]]:
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
    return table_of(titled(study, title), keys, _by_setting_and_level(cases), shown, notes)


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
    rows = list(_by_setting_and_level(cases))
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
