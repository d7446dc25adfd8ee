"""The candidates of a selection, and what each scores on the flights of a split.

A candidate is what an engineer could deploy: a reading (the half of a protocol that is not its
world), a back-end, a setting, and a level of every swept factor that belongs to the estimator.
All are tried on the same flights, so their numbers stand side by side as (flights, regimes, cases).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, unknown
from sparsefit.study.evidence.along import at_level
from sparsefit.study.evidence.cases import DEFAULT, Group, by_setting, factors
from sparsefit.study.evidence.measure import Failure, Measure
from sparsefit.study.evidence.measures import LISTED, MEASURES
from sparsefit.study.evidence.resampling import resampled
from sparsefit.study.evidence.sentence import listed
from sparsefit.study.evidence.summary import SUMMARY_WORDS, reduce
from sparsefit.study.evidence.table import Value
from sparsefit.study.evidence.worlds import REGIME, conditions_of, in_regimes, regime_names
from sparsefit.study.spec.selection import AVERAGE, WORST, SelectionRule

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

SPLITS = ("validate", "evaluate")


@dataclass(frozen=True, eq=False)
class Trial:
    """The cases of one candidate on the flights of a split, in the order all candidates share.

    at: (3, rows) the flight, regime and place within both of each row; shape: of their grid.
    """

    cases: pd.DataFrame
    at: np.ndarray[tuple[int, ...], np.dtype[np.int64]]
    shape: tuple[int, int, int]

    def grid(self, values: Array) -> Array:
        """(flights, regimes, cases) numbers of the rows, NaN where a regime has fewer cases."""
        grid = np.full(self.shape, np.nan)
        grid[tuple(self.at)] = values
        return grid


def over_flights(grid: Array) -> Array:
    """(..., regimes, all) of (..., flights, regimes, cases): what is summarised together."""
    swapped = np.moveaxis(grid, -3, -2)
    return swapped.reshape(*swapped.shape[:-2], -1)


@dataclass(frozen=True, eq=False)
class Candidate:
    """One reading, back-end and setting (`group`) at one level of the estimator's factors.

    place: where the study lists it, from 0; factors: those levels by dotted name, as they stand
    in its rows; trials: its cases by split.
    """

    place: int
    group: Group
    factors: Mapping[str, Value]
    trials: Mapping[str, Trial]

    @property
    def title(self) -> str:
        """One line that tells this candidate from the others."""
        chosen = listed([at_level(name, value) for name, value in self.factors.items()])
        of = "" if self.group.protocol == DEFAULT else f"{self.group.protocol}: "
        return f"{of}{self.group.title}{' with ' if chosen else ''}{chosen}"

    def of(self, column: str) -> str:
        """What its rows have in a column that they share: protocol, backend, label, settings."""
        return str(self.group.key[column])


@dataclass(frozen=True)
class Criterion:
    """A measure summarised over the flights of each regime, and over the regimes."""

    measure: Measure
    regimes: tuple[str, ...]
    over: str = AVERAGE

    @classmethod
    def of(cls, rule: SelectionRule, regimes: list[str]) -> Criterion:
        """The criterion that a rule names.

        Raises:
            InputError: with the nearest, if there is no such measure, summary or regime.
        """
        if rule.over not in (AVERAGE, WORST, *regimes):
            raise unknown("regime in over =", rule.over, (AVERAGE, WORST, *regimes))
        return cls(measure_of(rule), tuple(regimes), rule.over)

    @property
    def words(self) -> str:
        """`mean |error| of τ_w, averaged over the regimes`."""
        where = {AVERAGE: "averaged over the regimes", WORST: "in the worst regime"}
        if len(self.regimes) == 1:
            return self.measure.phrase
        return f"{self.measure.phrase}, {where.get(self.over, f'in {self.over}')}"

    def grid(self, trial: Trial) -> Array:
        """(flights, regimes, cases) the measure; a failure in a flow counts as the measure says."""
        return trial.grid(self.measure.per_case(trial.cases))

    def by_regime(self, grid: Array) -> Array:
        """(..., regimes) the summary of (..., flights, regimes, cases) in each regime."""
        return self.measure.reduce(over_flights(grid))

    def score(self, by_regime: Array) -> Array:
        """(...,) the one number of (..., regimes)."""
        if self.over == AVERAGE:
            return reduce("mean", by_regime)
        if self.over == WORST:
            return np.asarray(self._worst.reduce(by_regime, axis=-1))
        return np.asarray(by_regime[..., self.regimes.index(self.over)])

    def worst(self, by_regime: Array) -> str:
        """The regime in which it is worst."""
        sizes = -by_regime if self.measure.more else by_regime
        return self.regimes[int(np.nanargmax(sizes))] if not np.isnan(sizes).all() else ""

    @property
    def _worst(self) -> np.ufunc:
        return np.fmin if self.measure.more else np.fmax  # which pass over NaN

    def loss(self, score: Array) -> Array:
        """The score so that less is better."""
        return -score if self.measure.more else score

    def loss_of(self, grid: Array) -> Array:
        """(...,) the one number of (..., flights, regimes, cases), so that less is better."""
        return self.loss(self.score(self.by_regime(grid)))

    def resampled(self, grid: Array, seed: int) -> Array:
        """(resamples,) the loss over flights drawn anew, the same ones for the same seed."""
        return resampled(
            lambda at: self.loss_of(grid[at]), len(grid), width=grid[0].size, seed=seed
        )


def measure_of(rule: SelectionRule) -> Measure:
    """The measure of a rule's criterion, a failure never better than any answer.

    Raises:
        InputError: with the nearest, if there is no such measure or summary.
    """
    summary, name = rule.measure
    one_of("measure in criterion =", name, MEASURES, LISTED)
    if summary:
        one_of("summary in criterion =", summary, SUMMARY_WORDS)
    measure = MEASURES[name]
    failure = Failure.MISS if measure.failure is Failure.INFINITE else measure.failure
    return replace(measure, summary=summary or measure.summary, failure=failure)


def candidates_of(study: Study, cases: pd.DataFrame) -> list[Candidate]:
    """Return every candidate in the order in which the study lists them.

    Raises:
        InputError: if they were not all tried on the same flights and conditions.
    """
    placed = in_regimes(study, cases)
    conditions = conditions_of(study, placed)
    own = [name for name in factors(cases) if name not in conditions]
    groups = by_setting(placed, *own)
    expected = _evidence_of(groups[0], conditions)
    for group in groups:
        if _evidence_of(group, conditions) != expected:
            raise InputError(
                f"{group.title} was not tried on the same flights as {groups[0].title}: "
                "finish the study first (sparsefit study run)"
            )
    regimes = regime_names(placed)
    return [
        Candidate(place, group, {name: group.key[name] for name in own}, {
            split: _trial(group.cases[group.cases["split"] == split], regimes, conditions)
            for split in SPLITS
        })
        for place, group in enumerate(groups)
    ]  # fmt: skip


def _evidence_of(group: Group, conditions: list[str]) -> list[tuple[str, ...]]:
    names = ["flight", "split", *conditions]
    return sorted(tuple(map(str, row)) for row in group.cases[names].itertuples(index=False))


def _trial(cases: pd.DataFrame, regimes: list[str], conditions: list[str]) -> Trial:
    ordered = cases.sort_values(["flight", *conditions], kind="stable", key=_sortable)
    flight, _ = pd.factorize(ordered["flight"])
    regime = ordered[REGIME].map({name: place for place, name in enumerate(regimes)})
    within = ordered.groupby(["flight", REGIME], sort=False).cumcount()
    at = np.array([flight, regime, within], dtype=np.int64)
    sizes = at.max(axis=1) + 1 if len(ordered) else np.zeros(3, np.int64)
    return Trial(ordered, at, (int(sizes[0]), len(regimes), int(sizes[2])))


def _sortable(column: Any) -> Any:
    return column if pd.api.types.is_numeric_dtype(column) else column.astype(str)
