"""Which reading comes closest to a study's reference numbers, and what the answer hangs on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import (
    PARAMETERS,
    Group,
    factors,
    failures,
    groups_by,
    parsed,
    rows_by,
    varied_settings,
)
from sparsefit.study.evidence.columns import (
    FAILED,
    PLANNED,
    Statistic,
    by_levels,
    name_columns,
    setting_columns,
    statistic,
    table_of,
)
from sparsefit.study.evidence.measure import Measure
from sparsefit.study.evidence.measures import MEASURES, three
from sparsefit.study.evidence.readings import percent_errors
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value
from sparsefit.study.spec.outputs import Reference

Contexts: TypeAlias = list[list[int]]  # the places of what differs, the rest being equal
CLOSEST_SHOWN = 15
DISTANCE_NOTE = (
    "Distance: root mean square, over U0, L_w and τ_w, of the difference between the signed mean "
    "percentage error and that of {name} ({numbers}), in percentage points (pp). "
    "A small distance is agreement of three numbers, not proof that {name} was computed so."
)
RANGE_NOTE = (
    "Range: largest minus smallest value of the statistic of |percentage error| or percentage "
    "error over the levels of the one factor, everything else held fixed, in percentage points "
    "(pp); the median over all such comparisons, and the largest of them. Errors are over the "
    "cases with an estimate; failures is the largest change of their number."
)

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study
SIGNED = three("signed-error")
SIZES = three("size")
PRINTED = {"deviation": "deviation", "signed-error": "signed_error"}  # kinds that a reference has


def printed(reference: Reference | None, measure: Measure) -> float | None:
    """Return what a reference has of a measure of one parameter, None where it has nothing."""
    parameter = measure.of.replace("_", "-")
    field = PRINTED.get(measure.name.removeprefix(f"{parameter}-"), "")
    values = getattr(reference, field, None)
    return values[PARAMETERS.index(measure.of)] if values else None


def distance(percent: Sequence[float] | Array, printed: Sequence[float]) -> float:
    """Return the root mean square difference of three percentage errors to three others [pp].

    NaN as soon as one of the three is: a reading without estimates is at no distance.
    """
    return float(np.sqrt(np.mean((np.asarray(percent) - np.asarray(printed)) ** 2)))


def closest_readings(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return every combination of settings and swept factors, closest to the reference first.

    Raises:
        InputError: if the study has no reference with signed errors.
    """
    reference = study.reference
    if reference is None or reference.signed_error is None:
        raise InputError(
            f"{study.name}: nothing to compare readings with: give [outputs.reference] a name "
            "and signed_error = [U0, L_w, tau_w] in percent"
        )
    wanted = reference.signed_error

    def away(group: pd.DataFrame) -> float:
        return distance(SIGNED[0].reduce(percent_errors(group).T), wanted)

    swept, numbers = factors(cases), ", ".join(f"{percent:.2f}" for percent in wanted)
    table = table_of(
        asked,
        study,
        setting_columns(swept),
        by_levels(cases, swept),
        (
            PLANNED,
            FAILED,
            statistic(MEASURES["hits"], "number"),
            *map(statistic, SIGNED),
            Statistic(Column("distance", "pp", SIGNIFICANT), away),
        ),
        title=f"Readings, closest to {reference.name} first",
        notes=(DISTANCE_NOTE.format(name=reference.name, numbers=numbers),),
        limit=CLOSEST_SHOWN,
    )
    return replace(table, rows=tuple(sorted(table.rows, key=_last)))


def _last(row: tuple[Value, ...]) -> tuple[bool, float]:
    """Sort key: the distance, and what has none at the end."""
    value = float(row[-1] or 0.0)
    return bool(np.isnan(value)), value


def sensitivity(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return, for each factor, how far errors move when only this factor changes."""
    columns = (
        *name_columns("factor"),
        Column("levels", format="d"),
        Column("comparisons", format="d"),
        *(
            Column(measure.symbol, "pp", SIGNIFICANT, group=group, tex=measure.tex)
            for group in (
                "range of median |error|", "the largest such range", "range of mean signed %",
            )
            for measure in SIGNED
        ),
        Column("failures", format="d"),
    )  # fmt: skip
    title = f"{asked.title or 'How far the errors depend on each factor'} ({study.name})"
    return Table(title, columns, tuple(sensitivity_rows(cases)), asked.notes or (RANGE_NOTE,))


def sensitivity_rows(cases: pd.DataFrame) -> list[tuple[Value, ...]]:
    """Return the rows of `sensitivity`, what moves tau_w most first."""
    swept = factors(cases)
    # What all of them name together is summarised once, and compared in every way after.
    every = groups_by(cases, ["protocol", "backend", "settings", *swept])
    percent = [percent_errors(group.cases).T for group in every]  # of all three, read once
    told = np.array([[*SIZES[0].reduce(np.abs(one)), *SIGNED[0].reduce(one)] for one in percent])
    failed = np.array([failures(group.cases) for group in every])
    keys = pd.DataFrame([group.key for group in every])
    rows = [
        _factor_row(name, levels, contexts, told, failed)
        for name, levels, contexts in _varied(keys, swept)
        if contexts
    ]
    return sorted(rows, key=lambda row: -float(row[5] or 0.0))


def _factor_row(
    name: str, levels: int, contexts: Contexts, told: Array, failed: NDArray[np.int64]
) -> tuple[Value, ...]:
    ranges = np.array([_ranges(told[one, :3]) for one in contexts])
    means = np.array([_ranges(told[one, 3:]) for one in contexts])
    lost = max(int(np.ptp(failed[one])) for one in contexts)
    moved = [*_over(ranges, 0.5), *_over(ranges, 1.0), *_over(means, 0.5)]
    return (name, levels, len(contexts), *moved, lost)


def _over(values: Array, share: float) -> list[float]:
    """The quantile of each column over its finite entries."""
    finite = [column[np.isfinite(column)] for column in values.T]
    return [float(np.quantile(one, share)) if one.size else np.nan for one in finite]


def _ranges(values: Array) -> Array:
    """(3,) largest minus smallest over the levels that have estimates; NaN below two of them."""
    known = values[np.isfinite(values).all(axis=1)]
    spread: Array = np.ptp(known, axis=0) if len(known) > 1 else np.full(3, np.nan)
    return spread


def _varied(keys: pd.DataFrame, swept: list[str]) -> Iterator[tuple[str, int, Contexts]]:
    """(factor, number of its levels, comparisons): what sweeps, protocols and settings vary."""
    every = ["protocol", "backend", "settings", *swept]
    for name in ("protocol", *swept):
        yield name, *_contexts(keys, [name], [other for other in every if other != name])
    setting = ["backend", "settings"]
    yield "back-end and setting", *_contexts(keys, setting, ["protocol", *swept])
    for backend in groups_by(keys, ["backend"]):
        spread, names = _with_settings(backend)
        for name in names:
            fixed = ["protocol", *swept, *(other for other in names if other != name)]
            label = name.removeprefix("setting ")
            yield f"{backend.key['backend']} {label}", *_contexts(spread, [name], fixed)


def _with_settings(backend: Group) -> tuple[pd.DataFrame, list[str]]:
    """The keys of one back-end with a column, `setting NAME`, per setting that varies."""
    ((_, names),) = varied_settings(backend.cases).items()
    settings = [parsed(text) for text in backend.cases["settings"]]
    columns = {f"setting {name}": [repr(one.get(name)) for one in settings] for name in names}
    return backend.cases.assign(**columns), list(columns)


def _contexts(keys: pd.DataFrame, varied: list[str], fixed: list[str]) -> tuple[int, Contexts]:
    """Number of levels, and per fixed rest the place of each level where at least two differ.

    What varies and what is fixed name one row of the keys together.
    """
    split = [(at, rows_by(keys.iloc[at], varied)) for _, at in rows_by(keys, fixed)]
    contexts = [
        [int(keys.index[at[rows[0]]]) for _, rows in levels]
        for at, levels in split
        if len(levels) > 1
    ]
    return len(rows_by(keys, varied)), contexts
