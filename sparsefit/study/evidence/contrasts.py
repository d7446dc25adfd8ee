"""Contrasts: what a study declares to compare, paired by flight, with Holm's correction.

A contrast names two of a kind, two protocols, back-ends, settings or levels of a factor. Its
effect is the summary of the first minus that of the second over the same flights; its interval is
by bootstrap over flights, its p-value by exchanging the two within flights (a permutation test of
pairs), and those of one table are adjusted together (Holm, 1979).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError, suggestion
from sparsefit.study.evidence.asked import Asked, refuse
from sparsefit.study.evidence.cases import (
    Group,
    by_setting,
    estimated,
    factors,
    groups_by,
    level_text,
)
from sparsefit.study.evidence.columns import name_columns
from sparsefit.study.evidence.measure import Measure
from sparsefit.study.evidence.resampling import (
    CHUNK,
    RESAMPLES,
    SAME,
    SEED,
    Draws,
    bootstrap,
    by_flight,
    holm,
    pooled,
)
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value, plain
from sparsefit.study.spec.document import canonical_json

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

EXCHANGES = 4999
LEVEL = 0.05
SETTING = "setting"
KINDS = ("protocol", "backend", "label", SETTING)
NOTE = (
    "Paired by flight: effect is the first minus the second on the same flights, its 95 % "
    f"interval by bootstrap over flights ({RESAMPLES} draws, seed {SEED}), p by {EXCHANGES} "
    "exchanges of the two within flights, adjusted for all contrasts of this table by Holm's rule. "
    "A tie is what the interval or the adjusted p (5 %) does not tell apart."
)


@dataclass(frozen=True)
class Contrast:
    """One comparison of two over the same flights.

    ok: cases with an estimate of either; values: their summaries; low, high: the interval of
    their difference; p: before Holm's correction, NaN where none was asked for.
    """

    flights: int
    ok: tuple[int, int]
    planned: tuple[int, int]
    values: tuple[float, float]
    low: float
    high: float
    p: float

    @property
    def effect(self) -> float:
        """The first minus the second."""
        return self.values[0] - self.values[1]


def contrast(
    measure: Measure, first: pd.DataFrame, second: pd.DataFrame, *, test: bool = True
) -> Contrast:
    """Compare two sets of cases on the flights that both have, also by a `test` of exchanges."""
    flights = pd.Index(first["flight"].unique()).intersection(pd.Index(second["flight"].unique()))
    sides = [cases[cases["flight"].isin(flights)] for cases in (first, second)]
    grids = _alike([by_flight(measure.per_case(one), one, flights) for one in sides])
    one, other = grids

    def apart(at: Draws) -> Array:
        return pooled(measure, one[at]) - pooled(measure, other[at])

    low, high = bootstrap(apart, len(flights), one.shape[1])
    told = [float(pooled(measure, grid)) for grid in grids]
    ok = [int(estimated(cases).sum()) for cases in sides]
    return Contrast(
        len(flights), (ok[0], ok[1]), (len(sides[0]), len(sides[1])), (told[0], told[1]),
        low, high, exchanged(measure, one, other) if test else math.nan,
    )  # fmt: skip


def _alike(grids: Sequence[Array]) -> list[Array]:
    """The grids with as many columns each: a flight without a case has none there."""
    width = max(grid.shape[1] for grid in grids)
    fill = [np.full((len(grid), width - grid.shape[1]), np.nan) for grid in grids]
    return [np.hstack(pair) for pair in zip(grids, fill, strict=True)]


def exchanged(measure: Measure, first: Array, second: Array, seed: int = SEED) -> float:
    """The p-value of |difference| under exchange of the two (flights, cases) within flights."""
    seen = abs(float(pooled(measure, first)) - float(pooled(measure, second)))
    if math.isnan(seen) or not first.size:
        return math.nan
    rng, reached = np.random.default_rng(seed), 0
    each = max(1, CHUNK // first.size)
    for start in range(0, EXCHANGES, each):
        swap = rng.random((min(each, EXCHANGES - start), len(first), 1)) < 0.5
        one, other = np.where(swap, second, first), np.where(swap, first, second)
        apart = np.abs(pooled(measure, one) - pooled(measure, other))
        reached += int((apart >= seen * (1.0 - SAME)).sum())
    return (reached + 1) / (EXCHANGES + 1)


def contrasts(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return the declared contrasts of the measures; without any, each setting with the first.

    With `along`, a protocol or a swept factor, each level has contrasts of its own.
    """
    asked.needs(study.name, "measure")
    titled = _titled(cases)
    rows: list[tuple[tuple[Value, ...], Contrast, Measure]] = []
    for level, part in _levels(asked, study, titled):
        for one, other, first, second in _pairs(asked, study, part):
            for measure in asked.measures:
                made = contrast(measure, first, second)
                rows.append(((*level, measure.phrase, one, other), made, measure))
    adjusted = holm([made.p for _, made, _ in rows])
    along = [asked.along] if asked.along else []
    columns = (
        *name_columns(*along, "measure", "first", "second"),
        Column("flights", format="d"),
        *(Column(name, align="right", group="ok / n") for name in ("first", "second")),
        *(Column(name, "", SIGNIFICANT, group="summary") for name in ("first", "second")),
        Column("effect", "", SIGNIFICANT),
        Column("95 % from", "", SIGNIFICANT),
        Column("to", "", SIGNIFICANT),
        Column("p", "", ".4f"),
        Column("p (Holm)", "", ".4f"),
        Column("verdict", align="left"),
    )
    filled = tuple(
        _row(key, made, measure, p) for (key, made, measure), p in zip(rows, adjusted, strict=True)
    )
    title = f"{asked.title or 'Contrasts'} ({study.name})"
    return Table(title, columns, filled, asked.notes or (NOTE,))


def _row(key: tuple[Value, ...], made: Contrast, measure: Measure, p: float) -> tuple[Value, ...]:
    counts = (f"{ok}/{n}" for ok, n in zip(made.ok, made.planned, strict=True))
    told = (*made.values, made.effect, made.low, made.high, made.p, p)
    return (*key, made.flights, *counts, *told, _verdict(key, made, measure, p))


def _verdict(key: tuple[Value, ...], made: Contrast, measure: Measure, p: float) -> str:
    outside = made.low > 0.0 or made.high < 0.0
    if not outside or not p <= LEVEL:
        return "tie"
    return f"{key[-2] if (made.effect > 0) == measure.more else key[-1]} is better"


def _titled(cases: pd.DataFrame) -> pd.DataFrame:
    parts = [group.cases.assign(**{SETTING: group.title}) for group in by_setting(cases)]
    return pd.concat(parts).loc[cases.index]


def _levels(
    asked: Asked, study: Study, cases: pd.DataFrame
) -> Iterator[tuple[tuple[Value, ...], pd.DataFrame]]:
    if not asked.along:
        yield (), cases
        return
    if asked.along not in ("protocol", *factors(cases)):
        raise refuse(study.name, f'does not sweep "{asked.along}"', '"contrasts"')
    for level in groups_by(cases, [asked.along]):
        yield (level_text(level.key[asked.along]),), level.cases


def _pairs(
    asked: Asked, study: Study, cases: pd.DataFrame
) -> Iterator[tuple[str, str, pd.DataFrame, pd.DataFrame]]:
    if not asked.contrasts:
        first, *others = groups_by(cases, ["protocol", SETTING])
        for group in others:
            yield _name(group), _name(first), group.cases, first.cases
        return
    for one, other in asked.contrasts:
        kind = _kind(study, cases, one, other)
        told = [level_text(plain(value)) for value in cases[kind]]
        sides = [cases[[value == name for value in told]] for name in (one, other)]
        yield one, other, sides[0], sides[1]


def check_contrasts(study: Study, asked: Asked) -> None:
    """Refuse, before anything is run, a contrast of what the study does not have.

    Raises:
        InputError: with the nearest name. Settings are known by the back-end they begin with.
    """
    backends = {name for cell in study.cells for name in (cell.backend, cell.label)}
    levels = {
        level_text(level if isinstance(level, str | int | float) else canonical_json(level))
        for factor in study.sweep
        for level in factor.levels
    }
    known = backends | levels | {protocol.name for protocol in study.protocols}
    for name in (name for pair in asked.contrasts for name in pair):
        if name not in known and not name.startswith(tuple(backends)):
            raise InputError(f'contrasts: "{name}" is unknown{suggestion(name, known)}')


def _name(group: Group) -> str:
    return f"{group.key['protocol']}: {group.key[SETTING]}"


def _kind(study: Study, cases: pd.DataFrame, one: str, other: str) -> str:
    """The column in which both are values: protocols, back-ends, labels, settings or levels."""
    known = {
        kind: {level_text(plain(value)) for value in cases[kind].unique()}
        for kind in (*KINDS, *factors(cases))
    }
    for kind, values in known.items():
        if one in values and other in values:
            return kind
    every = sorted(set().union(*known.values()))
    missing = next((name for name in (one, other) if name not in every), None)
    words = f'"{one}" and "{other}" are no two of a kind: name two protocols, back-ends or levels'
    if missing is not None:
        words = f'"{missing}" is unknown{suggestion(missing, every)}'
    raise InputError(f"{study.name}: [outputs] contrasts: {words}")
