"""Two runs held against each other, case by case: which changed, by how much, for better or worse.

Cases are the same where their ids are: one flight, one back-end, one setting of one study, by two
versions of the code or on two machines. Where no ids agree, as after protocols were renamed, what
determines their numbers tells which belong together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError
from sparsefit.study.evidence.cases import PARAMETERS, by_setting, factors, numbers
from sparsefit.study.evidence.columns import setting_columns, setting_values
from sparsefit.study.evidence.contrasts import contrast
from sparsefit.study.evidence.measure import Failure
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.sentence import shown
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value, plain

NEEDED = ("flight", "protocol", "backend", "label", "settings", "status")
KEYS = (("case_id",), ("flight", "identity"))
JUDGED = replace(MEASURES["timescale-error"], failure=Failure.MISS, summary="mean")
LARGEST = MEASURES["largest-error"]
SHOWN = 30


@dataclass(frozen=True, eq=False)
class Compared:
    """The cases that both runs have, row by row, and how many only one has.

    change: (rows,) the largest relative change of U0, L_w and tau_w, infinite where only one run
    has an estimate; names: of the runs, as they were given; tolerance: what counts as a change.
    """

    names: tuple[str, str]
    first: pd.DataFrame
    second: pd.DataFrame
    only: tuple[int, int]
    change: Array
    tolerance: float

    @property
    def restated(self) -> BoolArray:
        """(rows,) whether the status is another."""
        return np.asarray(self.first["status"].to_numpy() != self.second["status"].to_numpy())

    @property
    def changed(self) -> BoolArray:
        """(rows,) whether a case changed: its status, or a number by more than the tolerance."""
        both: BoolArray = self.restated | (self.change > self.tolerance)
        return both

    @property
    def sizes(self) -> tuple[Array, Array]:
        """(rows,) the largest |error| of U0, L_w and tau_w [%] of either run."""
        return LARGEST.read(self.first), LARGEST.read(self.second)

    @property
    def sentence(self) -> str:
        """What is the same and what is not."""
        known, many = len(self.change), int(self.changed.sum())
        restated, largest = int(self.restated.sum()), self.change[np.isfinite(self.change)]
        only = [
            f"{count} only in {name}"
            for count, name in zip(self.only, self.names, strict=True)
            if count
        ]
        most = shown(100.0 * float(largest.max(initial=0.0)))
        said = f"{many} of {known} cases changed, {restated} of them in status"
        said += f"; the largest change of a number is {most} %"
        return "; ".join([said, *only]) + "."


def compared(
    first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str], tolerance: float
) -> Compared:
    """Pair the cases of two runs.

    Raises:
        InputError: if they have no case in common.
    """
    for name, cases in zip(names, (first, second), strict=True):
        if missing := [column for column in NEEDED if column not in cases]:
            raise InputError(f"{name}: holds no cases of flights, without a column {missing[0]}")
    one, other, only = paired(first, second, names, KEYS)
    return Compared(names, one, other, only, _change(one, other), tolerance)


def paired(
    first: pd.DataFrame,
    second: pd.DataFrame,
    names: tuple[str, str],
    keys: Sequence[Sequence[str]],
) -> tuple[pd.DataFrame, pd.DataFrame, tuple[int, int]]:
    """The cases that both runs have, row by row, and how many only one has.

    keys: columns by which cases are known; the first by which any are the same counts.

    Raises:
        InputError: if they have no case in common.
    """
    for key in keys:
        if not set(key) <= set(first.columns) & set(second.columns):
            continue
        places = [_places(cases, key) for cases in (first, second)]
        shared = [name for name in places[0] if name in places[1]]
        if shared:
            one, other = (
                cases.iloc[[at[name] for name in shared]].reset_index(drop=True)
                for cases, at in zip((first, second), places, strict=True)
            )
            return one, other, (len(first) - len(shared), len(second) - len(shared))
    raise InputError(
        f"{names[0]} and {names[1]} have no case in common: compare two runs of one study"
    )


def _places(cases: pd.DataFrame, key: Sequence[str]) -> dict[tuple[Value, ...], int]:
    columns = [[plain(value) for value in cases[name]] for name in key]
    return {name: place for place, name in enumerate(zip(*columns, strict=True))}


def _change(first: pd.DataFrame, second: pd.DataFrame) -> Array:
    largest = np.zeros(len(first))
    for name in PARAMETERS:
        one, other = (numbers(cases, f"est_{name}") for cases in (first, second))
        size = np.maximum(np.abs(one), np.abs(other))
        change = np.abs(one - other) / np.where(size > 0, size, 1.0)
        change[np.isnan(one) & np.isnan(other)] = 0.0
        change[np.isnan(one) != np.isnan(other)] = np.inf
        largest = np.maximum(largest, change)
    return largest


def effects_table(both: Compared) -> Table:
    """What changed in every setting and level, and whether its error did, paired by flight.

    Settings without a change come last, and only its CSV file has them.
    """
    swept = factors(both.first)
    rows: list[tuple[Value, ...]] = []
    for group in by_setting(both.first, *swept):
        at = group.cases.index.to_numpy()
        change = both.change[at]
        finite = change[np.isfinite(change)]
        made = contrast(JUDGED, both.second.loc[at], both.first.loc[at], test=False)
        rows.append(
            (
                *setting_values(group, swept), len(at), int(both.changed[at].sum()),
                int(both.restated[at].sum()), 100.0 * float(finite.max(initial=0.0)),
                made.values[1], made.values[0], made.effect, made.low, made.high,
                _verdict(made.low, made.high),
            )
        )  # fmt: skip
    unit, least = JUDGED.unit, JUDGED.least
    columns = (
        *setting_columns(swept),
        *(Column(name, format="d") for name in ("n", "changed", "in status")),
        Column("largest change", "%", SIGNIFICANT, least=least),
        *(Column(name, unit, SIGNIFICANT, group=JUDGED.phrase, least=least)
          for name in ("first", "second", "effect", "95 % from", "to")),
        Column("verdict", align="left"),
    )  # fmt: skip
    notes = (
        f"First: {both.names[0]}; second: {both.names[1]}. Changed: another status, or a number "
        f"of U0, L_w or τ_w that differs by more than {both.tolerance:g} of itself. Effect: second "
        f"minus first, on the same flights, {JUDGED.convention}; its 95 % interval by bootstrap "
        "over flights. A tie is what the interval does not tell apart.",
    )
    place = len(swept) + 4
    ordered = sorted(rows, key=lambda row: not row[place])
    moved = sum(bool(row[place]) for row in rows)
    return Table("What changed, setting by setting", columns, tuple(ordered), notes, moved)


def _verdict(low: float, high: float) -> str | None:
    if np.isnan(low):
        return None
    if low > JUDGED.least:
        return "worse"
    return "better" if high < -JUDGED.least else "tie"


def changes_table(both: Compared) -> Table:
    """Every case that changed, the largest change first."""
    places = np.flatnonzero(both.changed)
    order = places[np.argsort(-both.change[places], kind="stable")]
    one, other = both.sizes
    titles = {
        place: f"{group.protocol}: {group.title}"
        for group in by_setting(both.first)
        for place in group.cases.index
    }
    rows = tuple(
        (
            plain(both.first["case_id"][at]), titles[at], plain(both.first["status"][at]),
            plain(both.second["status"][at]), 100.0 * float(both.change[at]),
            float(one[at]), float(other[at]),
        )
        for at in order
    )  # fmt: skip
    columns = (
        Column("case", align="left"),
        Column("setting", align="left"),
        *(Column(name, align="left", group="status") for name in ("first", "second")),
        Column("change", "%", SIGNIFICANT),
        *(Column(name, "%", SIGNIFICANT, group="largest |error|", least=LARGEST.least)
          for name in ("first", "second")),
    )  # fmt: skip
    return Table("Cases that changed", columns, rows, (), SHOWN)


def worse(both: Compared, effects: Table) -> bool:
    """Whether a setting became worse: its error, beyond the interval, or a case lost its answer.

    effects: the table of `effects_table`.
    """
    lost = np.isnan(both.sizes[1]) & ~np.isnan(both.sizes[0])
    return bool(lost.any()) or any(row[-1] == "worse" for row in effects.rows)
