"""How many seconds of flight each back-end needs before its answers are good enough."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.evidence.keys import key, setting_columns, titled
from sparsefit.study.evidence.summary import (
    Group,
    StudyRecord,
    by_setting,
    estimated,
    factors,
    grouped,
    percent_errors,
)
from sparsefit.study.evidence.table import Column, Table

DURATION = "flights.duration"
LIMITS = (5.0, 1.0)  # percent
FEWEST = 3  # durations that make a curve
SHARES = {"median flight": 0.5, "9 of 10 flights": 0.9}
WINDOWS_NOTE = (
    "Shortest of the durations flown from which on, at every longer one too, the error of the "
    "median flight, or of 9 in 10 flights, is within 5 % or 1 %; – where none is. The error of a "
    "flight is the largest of those of U0, L_w and τ_w; a flight without an estimate counts as "
    "infinitely wrong."
)


def worst_errors(cases: pd.DataFrame) -> Array:
    """(rows,) the largest |% error| of the three parameters; infinite without an estimate."""
    largest = np.abs(percent_errors(cases)).max(axis=1)
    return np.where(estimated(cases) & ~np.isnan(largest), largest, np.inf)


def by_duration(cases: pd.DataFrame, share: float) -> tuple[Array, Array]:
    """Durations [s], ascending, and at each the error [%] that `share` of the flights keep."""
    levels = sorted(grouped(cases, [DURATION]), key=lambda one: float(one.key[DURATION] or 0))
    seconds = np.array([float(level.key[DURATION] or 0.0) for level in levels])
    kept = [np.quantile(worst_errors(one.cases), share, method="inverted_cdf") for one in levels]
    return seconds, np.array(kept)


def seconds_to(cases: pd.DataFrame, limit: float, share: float) -> float:
    """The duration [s] from which on `share` of the flights are within `limit` [%]; or inf."""
    seconds, kept = by_duration(cases, share)
    late = np.flatnonzero(~(kept <= limit))
    first = int(late[-1]) + 1 if late.size else 0
    return float(seconds[first]) if first < len(seconds) else math.inf


def many_durations(cases: pd.DataFrame) -> bool:
    """Whether enough durations were flown to tell when an error falls below a limit."""
    return DURATION in cases and cases[DURATION].nunique() >= FEWEST


def duration_groups(study: StudyRecord, cases: pd.DataFrame) -> tuple[list[str], list[Group]]:
    """The other swept factors, and the groups of settings over all durations.

    Raises:
        InputError: if the study does not sweep the duration.
    """
    swept = factors(cases)
    if DURATION not in swept:
        raise InputError(
            f'{study.name} does not sweep "{DURATION}": drop "windows" from its [outputs]'
        )
    others = [name for name in swept if name != DURATION]
    return others, by_setting(cases, *others)


def windows(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """Seconds until within 5 % and 1 %, for the median flight and for 9 in 10."""
    others, groups = duration_groups(study, cases)
    wanted = [(share, limit) for share in SHARES.values() for limit in LIMITS]
    rows = []
    for group in groups:
        reached = [seconds_to(group.cases, limit, share) for share, limit in wanted]
        cells = [one if math.isfinite(one) else None for one in reached]
        rows.append((*key(group, others), int(group.cases["flight"].nunique()), *cells))
    columns = (
        *setting_columns(others),
        Column("flights", format="d"),
        *(
            Column(f"within {limit:g} %", "s", "g", group=name)
            for name in SHARES
            for limit in LIMITS
        ),
    )
    return Table(titled(study, "Seconds of flight needed"), columns, tuple(rows), (WINDOWS_NOTE,))
