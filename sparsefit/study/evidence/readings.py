"""Which reading of the paper comes closest to its Table 2, and what the answer hangs on."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence import paper
from sparsefit.study.evidence.summary import (
    PARAMETERS,
    SYMBOLS,
    TEX_SYMBOLS,
    StudyRecord,
    by_setting,
    factors,
    failures,
    grouped,
    hits,
    mean,
    parsed,
    percent_errors,
    quantile,
    varied_settings,
)
from sparsefit.study.evidence.table import SIGNIFICANT, Cell, Column, Table

Statistic: TypeAlias = Callable[[pd.DataFrame], list[float]]
Contexts: TypeAlias = list[list[pd.DataFrame]]
CLOSEST_SHOWN = 15
DISTANCE_NOTE = (
    "Distance: root mean square, over U0, L_w and τ_w, of the difference between the signed mean "
    "percentage error and the printed one (-18.80, -5.91, 33.30), in percentage points (pp). "
    "A small distance is agreement of three numbers, not proof that the paper computed this."
)
RANGE_NOTE = (
    "Range: largest minus smallest value of the statistic of |percentage error| or percentage "
    "error over the levels of the one factor, everything else held fixed, in percentage points "
    "(pp); the median over all such comparisons, and the largest of them. Errors are over the "
    "cases with an estimate; failures is the largest change of their number."
)


def distance(percent: Sequence[float]) -> float:
    """Root mean square difference to Table 2's signed mean percentage errors [pp].

    NaN as soon as one of the three is: a reading without estimates is at no distance.
    """
    return float(np.sqrt(np.mean((np.asarray(percent) - np.asarray(paper.MEAN_PERCENT)) ** 2)))


def readings(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """Every combination of settings and swept factors, closest to the printed Table 2 first."""
    swept = factors(cases)
    rows: list[tuple[Cell, ...]] = []
    for group in by_setting(cases, *swept):
        percent = mean(percent_errors(group.cases))
        key = (group.key["protocol"], group.key["backend"], group.setting)
        counts = (len(group.cases), failures(group.cases), int(hits(group.cases).sum()))
        chosen = (group.key[name] for name in swept)
        rows.append((*key, *chosen, *counts, *percent, distance(percent)))
    columns = (
        *(Column(name, align="left") for name in ("protocol", "backend", "setting", *swept)),
        *(Column(name, format="d") for name in ("n", "failures", "hits")),
        *_three("mean signed % error", "%", "+.2f"),
        Column("distance", "pp", SIGNIFICANT),
    )
    title = f"Readings of the paper, closest to its Table 2 first ({study.name})"
    return Table(title, columns, tuple(sorted(rows, key=_last)), (DISTANCE_NOTE,), CLOSEST_SHOWN)


def _last(row: tuple[Cell, ...]) -> tuple[bool, float]:
    """Sort key: the distance, and what has none at the end."""
    value = float(row[-1] or 0.0)
    return bool(np.isnan(value)), value


def sensitivity(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """For each factor: how far errors move when only this factor changes."""
    rows = [
        row
        for name, levels, contexts in _comparisons(cases, factors(cases))
        for row in _factor_row(name, levels, contexts)
    ]
    columns = (
        Column("factor", align="left"),
        Column("levels", format="d"),
        Column("comparisons", format="d"),
        *_three("range of median |error|", "pp", SIGNIFICANT),
        *_three("the largest such range", "pp", SIGNIFICANT),
        *_three("range of mean signed %", "pp", SIGNIFICANT),
        Column("failures", format="d"),
    )
    title = f"How far the errors depend on each factor ({study.name})"
    # By the time scale, the quantity the paper is after.
    ordered = sorted(rows, key=lambda row: -float(row[5] or 0.0))
    return Table(title, columns, tuple(ordered), (RANGE_NOTE,))


def _factor_row(name: str, levels: int, contexts: Contexts) -> list[tuple[Cell, ...]]:
    if not contexts:
        return []
    medians = np.array([_ranges(one, _median_size) for one in contexts])
    means = np.array([_ranges(one, _signed_mean) for one in contexts])
    failed = max(int(np.ptp([failures(level) for level in one])) for one in contexts)
    typical, largest = quantile(medians, 0.5), quantile(medians, 1.0)
    return [(name, levels, len(contexts), *typical, *largest, *quantile(means, 0.5), failed)]


def _comparisons(cases: pd.DataFrame, swept: list[str]) -> Iterator[tuple[str, int, Contexts]]:
    """(factor, number of its levels, comparisons): what sweeps, protocols and settings vary."""
    rest = ["protocol", "backend", "settings", *swept]
    for name in ("protocol", *swept):
        yield name, *_contexts(cases, [name], [one for one in rest if one != name])
    setting = ["backend", "settings"]
    yield "back-end and setting", *_contexts(cases, setting, ["protocol", *swept])
    for backend in grouped(cases, ["backend"]):
        spread, names = _spread(backend.cases)
        for name in names:
            fixed = ["protocol", *swept, *(one for one in names if one != name)]
            label = name.removeprefix("setting ")
            yield f"{backend.key['backend']} {label}", *_contexts(spread, [name], fixed)


def _spread(cases: pd.DataFrame) -> tuple[pd.DataFrame, list[str]]:
    """The cases of one back-end with a column, `setting NAME`, per setting that varies."""
    ((_, names),) = varied_settings(cases).items()
    settings = [parsed(one) for one in cases["settings"]]
    columns = {f"setting {name}": [str(one.get(name)) for one in settings] for name in names}
    return cases.assign(**columns), list(columns)


def _contexts(cases: pd.DataFrame, varied: list[str], fixed: list[str]) -> tuple[int, Contexts]:
    """Number of levels, and per fixed rest the cases of each level where at least two differ."""
    split = [grouped(group.cases, varied) for group in grouped(cases, fixed)]
    contexts = [[level.cases for level in levels] for levels in split if len(levels) > 1]
    return len(grouped(cases, varied)), contexts


def _median_size(cases: pd.DataFrame) -> list[float]:
    return quantile(np.abs(percent_errors(cases)), 0.5)


def _signed_mean(cases: pd.DataFrame) -> list[float]:
    return mean(percent_errors(cases))


def _ranges(levels: list[pd.DataFrame], statistic: Statistic) -> Array:
    """(3,) largest minus smallest over the levels that have estimates; NaN below two of them."""
    values = np.array([statistic(level) for level in levels])
    values = values[np.isfinite(values).all(axis=1)]
    spread: Array = np.ptp(values, axis=0) if len(values) > 1 else np.full(3, np.nan)
    return spread


def _three(group: str, unit: str, spec: str) -> tuple[Column, ...]:
    return tuple(
        Column(SYMBOLS[one], unit, spec, group=group, tex=TEX_SYMBOLS[one]) for one in PARAMETERS
    )
