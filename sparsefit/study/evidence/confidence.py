"""Whether intervals hold the truth as often as they say, and `ok` means what it says."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.keys import key, name_column, setting_columns, titled
from sparsefit.study.evidence.summary import (
    PARAMETERS,
    SYMBOLS,
    StudyRecord,
    by_setting,
    factors,
    in_a_flow,
    three_of,
)
from sparsefit.study.evidence.table import SIGNIFICANT, Cell, Column, Table

NORMAL_95 = 1.959963984540054
OFF = 5.0  # percent: an estimate off by more, in any parameter, should have been flagged
NO_FLOW = "no cellular flow"  # what the reason of a flight without a flow begins with
ROWS_SHOWN = 60
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


@dataclass(frozen=True)
class Share:
    """`part` of `whole` cases, and the interval that holds the true share in 95 % of studies."""

    part: int
    whole: int

    @property
    def percent(self) -> float:
        """The share [%]; NaN of nothing."""
        return 100.0 * self.part / self.whole if self.whole else math.nan

    @property
    def interval(self) -> tuple[float, float]:
        """The Wilson score interval [%] (Wilson, 1927); NaN of nothing."""
        if not self.whole:
            return math.nan, math.nan
        n, p, z2 = self.whole, self.part / self.whole, NORMAL_95**2
        middle = (p + z2 / (2 * n)) / (1 + z2 / n)
        half = NORMAL_95 / (1 + z2 / n) * math.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
        return 100.0 * max(middle - half, 0.0), 100.0 * min(middle + half, 1.0)


def held(cases: pd.DataFrame, name: str) -> tuple[Share, float]:
    """How often the interval of a parameter held the truth, and its median half-width [%].

    Over the cases with status ok, a true value and an interval.
    """
    place = PARAMETERS.index(name)
    true, found, low, high = (
        three_of(cases, prefix)[:, place] for prefix in ("true", "est", "low", "high")
    )
    kept = (cases["status"] == "ok").to_numpy() & ~np.isnan(true + found)
    kept &= ~np.isnan(low) & ~np.isnan(high)
    inside = int(((low <= true) & (true <= high))[kept].sum())
    half: Array = (50.0 * (high - low) / np.abs(found))[kept]
    return Share(inside, int(kept.sum())), float(np.median(half)) if half.size else math.nan


def has_intervals(cases: pd.DataFrame) -> bool:
    """Whether any case has one."""
    return bool((~np.isnan(three_of(cases, "low"))).any())


def coverage(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """Coverage of the 95 % intervals, a row per setting, level and parameter."""
    swept, rows = factors(cases), []
    for group in by_setting(cases[in_a_flow(cases)], *swept):
        ok = int((group.cases["status"] == "ok").sum())
        for name in PARAMETERS:
            share, half = held(group.cases, name)
            measured = (share.percent, *share.interval, half)
            rows.append(
                (*key(group, swept), SYMBOLS[name], len(group.cases), ok, share.whole, *measured)
            )
    columns = (
        *setting_columns(swept),
        name_column("parameter"),
        *(Column(name, format="d") for name in ("n", "ok", "with interval")),
        Column("coverage", "%", ".1f"),
        Column("from", "%", ".1f"),
        Column("to", "%", ".1f"),
        Column("half-width", "%", SIGNIFICANT),
    )
    title = titled(study, "Coverage of the 95 % intervals")
    return Table(title, columns, tuple(rows), (COVERAGE_NOTE,), ROWS_SHOWN)


@dataclass(frozen=True)
class Verdicts:
    """How often a status was right: counts of cases."""

    flights: int
    ok: int
    off: int
    unidentifiable: int
    deserved: int
    empty: int
    false_alarms: int
    called_so: int


def verdicts(cases: pd.DataFrame) -> Verdicts:
    """Count what was called ok and was not, and what was rightly refused."""
    flow, status = in_a_flow(cases), cases["status"]
    ok, refused = (status == "ok").to_numpy(), (status == "unidentifiable").to_numpy()
    alarm = ok | (status == "inaccurate").to_numpy()
    reasons = cases["reason"] if "reason" in cases else pd.Series("", index=cases.index)
    named = reasons.astype(str).str.startswith(NO_FLOW).to_numpy()
    wrong = is_off(cases)
    counted = (
        *(flow, flow & ok, flow & ok & wrong, flow & refused, flow & refused & wrong),
        *(~flow, ~flow & alarm, ~flow & refused & named),
    )
    return Verdicts(*(int(one.sum()) for one in counted))


def is_off(cases: pd.DataFrame) -> BoolArray:
    """(rows,) whether the numbers, flagged or not, miss the truth by > 5 %, or are missing."""
    true, found = three_of(cases, "true"), three_of(cases, "est")
    near = 100.0 * np.abs(found - true) <= OFF * np.abs(true)
    return np.asarray(~near.all(axis=1), dtype=bool)


def identifiability(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """What `ok` and `unidentifiable` were worth, per setting and level, and over all."""
    swept = factors(cases)
    groups = by_setting(cases, *swept)
    rows = [(*key(group, swept), *_cells(verdicts(group.cases))) for group in groups]
    if len(groups) > 1:
        rows.append(("all", None, None, *[None] * len(swept), *_cells(verdicts(cases))))
    columns = (*setting_columns(swept), *_VERDICT_COLUMNS)
    title = titled(study, "What ok and unidentifiable are worth")
    return Table(title, columns, tuple(rows), (IDENTIFIABILITY_NOTE,), ROWS_SHOWN)


def _cells(found: Verdicts) -> Sequence[Cell]:
    flow: Sequence[Cell] = [None] * 9
    empty: Sequence[Cell] = [None] * 3
    if found.flights:
        off, deserved = Share(found.off, found.ok), Share(found.deserved, found.unidentifiable)
        rest = found.flights - found.ok - found.unidentifiable
        ok = (found.ok, Share(found.ok, found.flights).percent, off.part, off.percent)
        refused = (deserved.whole, deserved.part, deserved.percent)
        flow = (found.flights, *ok, *refused, rest)
    if found.empty:
        called = Share(found.called_so, found.empty).percent
        empty = (found.empty, found.false_alarms, called)
    return (*flow, *empty)


_FLOW, _EMPTY = "flow", "no flow"
_VERDICT_COLUMNS = (
    Column("n", format="d", group=_FLOW),
    Column("ok", format="d", group=_FLOW),
    Column("ok", "%", ".1f", group=_FLOW),
    Column("off", format="d", group=_FLOW),
    Column("off", "%", ".2f", group=_FLOW),
    Column("unidentifiable", format="d", group=_FLOW),
    Column("deserved", format="d", group=_FLOW),
    Column("deserved", "%", ".1f", group=_FLOW),
    Column("other", format="d", group=_FLOW),
    Column("n", format="d", group=_EMPTY),
    Column("false alarms", format="d", group=_EMPTY),
    Column("called so", "%", ".1f", group=_EMPTY),
)
