"""The tables of a study: those of one purpose, and what stands behind each name.

The others are comparisons of any measures (`layouts.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.study.evidence import layouts, notes
from sparsefit.study.evidence.asked import DURATION, MEASUREMENT_NOISE, Asked, Kind
from sparsefit.study.evidence.cases import (
    STATUSES,
    Group,
    by_setting,
    estimated,
    factors,
    groups_by,
    has_status,
    in_a_flow,
    in_still_air,
    is_condition,
    three_of,
)
from sparsefit.study.evidence.columns import (
    PLANNED,
    ROWS_SHOWN,
    Statistic,
    by_levels,
    counted,
    name_columns,
    setting_columns,
    setting_values,
    statistic,
    table_of,
    with_status,
)
from sparsefit.study.evidence.contrasts import contrasts
from sparsefit.study.evidence.measure import Measure, Share
from sparsefit.study.evidence.measures import MEASURES, names, three
from sparsefit.study.evidence.profiles import profiles
from sparsefit.study.evidence.readings import bounded
from sparsefit.study.evidence.reference import closest_readings, sensitivity
from sparsefit.study.evidence.summary import TINY
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value, plain
from sparsefit.study.spec.outputs import Entry

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

FEWEST = 3  # levels that make a curve


def parameters(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return truth, estimate and percentage error of every case, the reference beside it."""
    swept = factors(cases)
    columns = (
        *name_columns("flight", "protocol", "backend", "setting", *swept),
        *(replace(_of(one, "value"), format=".4g") for one in three("deviation")),
        *(_of(one, "error") for one in three("signed-error")),
        *name_columns("status"),
    )
    rows = [row for one in groups_by(cases, ["flight"]) for row in _flight_rows(study, one, swept)]
    said = (study.reference.note,) if study.reference and study.reference.note else ()
    title = "True and estimated flow parameters"
    return Table(asked.title or title, columns, tuple(rows), asked.notes or said, ROWS_SHOWN)


def _of(measure: Measure, group: str) -> Column:
    return statistic(measure, group=group).column


def _flight_rows(study: Study, flight: Group, swept: Sequence[str]) -> Iterator[tuple[Value, ...]]:
    name, blank, printed = flight.key["flight"], [None] * (2 + len(swept)), study.reference
    truth = three_of(flight.cases.iloc[:1], "true")[0]
    yield name, "true value", *blank, *map(plain, truth), *[None] * 4
    if printed and printed.estimate and printed.signed_error:
        yield name, printed.name, *blank, *printed.estimate, *printed.signed_error, None
    for group in by_setting(flight.cases, *swept):
        estimates = three_of(group.cases, "est").tolist()
        percent = np.column_stack([one.read(group.cases) for one in three("signed-error")]).tolist()
        for values, sizes, status in zip(estimates, percent, group.cases["status"], strict=True):
            yield name, *setting_values(group, swept), *values, *sizes, plain(status)


def times(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return seconds per fit, the worst certificate, and how many cases ended in each status."""
    seconds = MEASURES["seconds"]
    ended = [status for status in STATUSES if has_status(cases, status).any()]
    shown = (
        PLANNED,
        statistic(seconds, name="median", group="time"),
        statistic(seconds, "95th percentile", name="95 %", group="time"),
        Statistic(Column("certificate", align="left"), _kinds),
        statistic(MEASURES["certificate"], name="worst", group=""),
        *(with_status(status, "cases that ended as") for status in ended),
    )
    return table_of(asked, study, setting_columns(), by_levels(cases), shown, limit=None)


def statuses(study: Study, cases: pd.DataFrame) -> Table:
    """Return how many cases of each setting ended in each status that occurs."""
    ended = [status for status in STATUSES if has_status(cases, status).any()]
    shown = (PLANNED, *(with_status(status) for status in ended))
    asked = Asked(title="How cases ended")
    return table_of(asked, study, setting_columns(), by_levels(cases), shown)


def _kinds(cases: pd.DataFrame) -> str | None:
    kinds = {str(kind) for kind in map(plain, cases["certificate_kind"][estimated(cases)]) if kind}
    return ", ".join(sorted(kinds)) or None


def coverage(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return the coverage of the 95 % intervals, a row per setting, level and parameter."""
    swept, rows = factors(cases), []
    for key, part in by_levels(cases[in_a_flow(cases)], swept):
        ok = int(has_status(part, "ok").sum())
        for measure, half in zip(three("coverage"), three("half-width"), strict=True):
            share = Share.of(measure, part)
            told = (share.percent, *share.interval, half.summarise(part))
            rows.append((*key, measure.symbol, len(part), ok, share.whole, *told))
    columns = (
        *setting_columns(swept),
        *name_columns("parameter"),
        *(Column(name, format="d") for name in ("n", "ok", "with interval")),
        *(Column(name, "%", ".1f") for name in ("coverage", "from", "to")),
        Column("half-width", "%", SIGNIFICANT, least=TINY),
    )
    title = f"{asked.title} ({study.name})"
    return Table(title, columns, tuple(rows), asked.notes, ROWS_SHOWN)


def identifiability(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return what `ok` and `unidentifiable` were worth, per setting and level, and over all."""
    swept = factors(cases)
    rows = list(by_levels(cases, swept))
    if len(rows) > 1:
        rows.append((("all", None, None, *[None] * len(swept)), cases))
    off, deserved, so, alarms = (
        (statistic(MEASURES[name], "number"), statistic(MEASURES[name]))
        for name in ("off", "deserved", "called-so", "false-alarms")
    )
    ok, misfit, refused = map(with_status, ("ok", "misfit", "unidentifiable"))
    misfits = (misfit,) if _int(misfit, cases) else ()
    told = (ok, misfit, refused)
    share = Statistic(Column("ok", "%", ".1f"), lambda part: 100 * _int(ok, part) / len(part))
    other = counted("other", lambda part: len(part) - sum(_int(one, part) for one in told))
    shown = (
        *(_of_part(one, "flow", flow=True)
          for one in (PLANNED, ok, share, *off, *misfits, refused, *deserved, other)),
        *(_of_part(one, "no flow", flow=False) for one in (PLANNED, alarms[0], so[1])),
    )  # fmt: skip
    return table_of(asked, study, setting_columns(swept), rows, shown)


def _int(count: Statistic, cases: pd.DataFrame) -> int:
    return int(count.of(cases) or 0)


def _of_part(one: Statistic, group: str, *, flow: bool) -> Statistic:
    """The statistic over the cases with, or without, a flow; nothing where there are none."""

    def told(cases: pd.DataFrame) -> Value:
        part = cases[in_a_flow(cases) if flow else in_still_air(cases)]
        return one.of(part) if len(part) else None

    return Statistic(replace(one.column, group=group), told)


TABLES: Kind[Table] = Kind(
    "table",
    {
        "settings": layouts.settings,
        "levels": layouts.levels,
        "protocols": layouts.protocols,
        "until": layouts.until,
        "reference": closest_readings,
        "one-at-a-time": sensitivity,
        "parameters": parameters,
        "times": times,
        "coverage": coverage,
        "identifiability": identifiability,
        "contrasts": contrasts,
        "profiles": profiles,
    },
    {  # in the order of the pages
        "parameters": {"compare": "parameters"},
        "errors": {
            "title": "Signed mean errors",
            "measure": (*names("deviation"), *names("signed-error"), "hits"),
            "notes": (notes.FAILURES, notes.SIGNED),
        },
        "errors-absolute": {
            "title": "Sizes of the percentage errors",
            "measure": (
                *(f"{summary} {name}"
                  for summary in ("mean", "median", "95th percentile") for name in names("size")),
                "hits",
            ),
            "notes": notes.FAILURES,
        },
        "readings": {"compare": "reference"},
        "sensitivity": {"compare": "one-at-a-time"},
        "scales": {
            "title": "Several scales at once",
            "compare": "levels",
            "measure": ("scales-found", "scales-missed", "scales-spurious",
                        "scales-length-scale-error", "scales-mean-velocity-error", "unseen"),
            "notes": notes.SCALES,
        },
        "times": {
            "title": "Times, certificates and statuses",
            "compare": "times",
            "notes": notes.TIMES,
        },
        "methods": {
            "compare": "protocols", "measure": "timescale-error", "along": MEASUREMENT_NOISE,
        },
        "efficiency": {
            "title": "Errors against the Cramér-Rao bound",
            "measure": ("bounded", *names("bounded-error"), *names("bound"), *names("efficiency")),
            "notes": notes.EFFICIENCY,
        },
        "coverage": {
            "title": "Coverage of the 95 % intervals",
            "compare": "coverage",
            "notes": notes.COVERAGE,
        },
        "identifiability": {
            "title": "What ok and unidentifiable are worth",
            "compare": "identifiability",
            "notes": notes.IDENTIFIABILITY,
        },
        "contrasts": {"compare": "contrasts", "measure": "mean timescale-error",
                      "failures": "miss"},
        "profiles": {"compare": "profiles", "measure": "timescale-error"},
        "windows": {
            "compare": "until", "measure": "largest-error", "along": DURATION, "limits": (5.0, 1.0),
        },
    },
)  # fmt: skip


def tables_of(study: Study, cases: pd.DataFrame) -> dict[str, Table]:
    """Return the tables that the study asks for, or else all that apply, by file name."""
    entries: Sequence[Entry] = study.tables or tables_for(cases, study.reference is not None)
    return {one.file_name: TABLES.make(one, study, cases) for one in map(TABLES.read, entries)}


def tables_for(cases: pd.DataFrame, reference: bool = False) -> list[str]:
    """Return the names of the tables that have something to say about these cases."""
    swept = factors(cases)
    several = cases["flight"].nunique() > 1
    said = {
        "parameters": not several,
        "errors": several,
        "errors-absolute": several,
        "readings": several and reference and not all(map(is_condition, swept)),
        "sensitivity": several and bool(swept),
        "scales": has_any(cases, "scales-found"),
        "times": True,
        "methods": several and MEASUREMENT_NOISE in swept,
        "efficiency": bool(bounded(cases).any()),
        "coverage": bool((~np.isnan(three_of(cases, "low"))).any()),
        "identifiability": bool(in_still_air(cases).any()),
        "windows": several and many_levels(cases, DURATION),
    }
    return [name for name in TABLES.named if said.get(name)]


def has_any(cases: pd.DataFrame, measure: str) -> bool:
    """Return whether any case has a number for a measure."""
    return bool(np.isfinite(MEASURES[measure].read(cases)).any())


def many_levels(cases: pd.DataFrame, factor: str) -> bool:
    """Return whether a factor has enough levels to tell from which on a limit is kept."""
    return factor in cases and cases[factor].nunique() >= FEWEST
