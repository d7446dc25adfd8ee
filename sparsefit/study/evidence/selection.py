"""From a finished study to one chosen estimator, with the evidence.

Chosen on the flights of split `validate`, scored once on those of split `evaluate`. A case
without an estimate counts as an error of 100 %: giving no answer is never better than an answer
that is less than 100 % off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import pandas as pd

from sparsefit.errors import InputError, one_of
from sparsefit.study.evidence.candidates import (
    CRITERIA,
    RESAMPLES,
    Candidate,
    Limits,
    candidates_of,
    measure_of,
    paired_interval,
)
from sparsefit.study.evidence.columns import setting_columns, setting_values
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

__all__ = ["CRITERIA", "Limits", "Selection", "select"]

RUNNERS_UP_SHOWN = 10


@dataclass(frozen=True, eq=False)
class Selection:
    """The winner of a study by a criterion, and the table that shows why.

    candidates: how many there are; eligible: how many of them keep the limits.
    """

    study: str
    criterion: str
    winner: Candidate
    candidates: int
    eligible: int
    table: Table


def select(
    study: Study,
    cases: pd.DataFrame,
    *,
    criterion: str = CRITERIA[0],
    max_failure_rate: float | None = None,
    max_seconds: float | None = None,
    seed: int = 0,
) -> Selection:
    """Choose the candidate with the smallest criterion on `validate`, within the limits.

    A candidate is a protocol, back-end, setting and level of every swept factor that belongs to
    the estimator; factors of the flights are conditions, and all of them count. Of equals (to
    six digits) the faster wins, then the first listed. The table gives, on `evaluate`, every
    runner-up's criterion minus the winner's, with its paired bootstrap 95 % interval over
    flights.

    Args:
        criterion: one of `CRITERIA`.
        max_failure_rate: largest share of `validate` cases without an estimate.
        max_seconds: largest median time of a `validate` case [s].
        seed: of the bootstrap.

    Raises:
        InputError: if the criterion is unknown, the study has no split or is unfinished, or no
            candidate keeps the limits (the closest is named).
    """
    one_of("criterion", criterion, CRITERIA)
    limits = Limits(max_failure_rate, max_seconds)
    _check_finished(study, cases)
    candidates = candidates_of(cases, measure_of(criterion))
    eligible = [one for one in candidates if one.excess(limits) == 0.0]
    if not eligible:
        raise _none_within(candidates, limits)
    # Rounding must not decide between equals: to six digits the same, the faster wins.
    ranked = sorted(eligible, key=lambda one: (float(f"{one.validate:.6g}"), one.seconds))
    table = _evidence(study, ranked, len(candidates), criterion, seed)
    return Selection(study.name, criterion, ranked[0], len(candidates), len(eligible), table)


def _check_finished(study: Study, cases: pd.DataFrame) -> None:
    """Refuse what would compare candidates on unequal evidence."""
    if len(cases) < study.planned or cases.empty:
        raise InputError(
            f"{study.name} is unfinished, {len(cases)} of {study.planned} planned cases have a "
            "row: finish it first (sparsefit study run)"
        )
    if cases["case_id"].duplicated().any():
        raise InputError(f"{study.name} has a case twice: run it afresh (--fresh)")
    if cases["status"].isna().any() or (cases["status"] == "").any():
        raise InputError(f"{study.name} has cases without a status: run it afresh (--fresh)")
    missing = {"validate", "evaluate"} - set(cases["split"])
    if missing:
        raise InputError(
            f"{study.name} has no flights to {' or to '.join(sorted(missing))}: "
            "give the study file a [split] with validate and evaluate"
        )
    both = cases.groupby("flight")["split"].nunique()
    if (both > 1).any():
        raise InputError(
            f"{study.name} has flight {both.idxmax()} in both splits: it cannot judge a choice "
            "that it helped to make"
        )


def _none_within(candidates: list[Candidate], limits: Limits) -> InputError:
    closest = min(candidates, key=lambda one: (one.excess(limits), one.validate))
    return InputError(
        f"none of the {len(candidates)} candidates keeps the limits; the closest is "
        f"{closest.title}, with a failure rate of {closest.failure_rate:.3g} and a median of "
        f"{closest.seconds:.3g} s: raise max_failure_rate or max_seconds"
    )


def _evidence(
    study: Study, ranked: list[Candidate], candidates: int, criterion: str, seed: int
) -> Table:
    winner = ranked[0]
    names = list(winner.factors)
    rows = tuple(_row(place, one, winner, criterion, seed) for place, one in enumerate(ranked))
    columns = (
        Column("rank", format="d"),
        *setting_columns(names),
        Column("criterion", "%", SIGNIFICANT, group="validate"),
        Column("failures", "%", ".1f", group="validate"),
        Column("median", "s", SIGNIFICANT, group="validate"),
        Column("criterion", "%", SIGNIFICANT, group="evaluate"),
        Column("minus winner", "pp", SIGNIFICANT, group="evaluate"),
        Column("95 % from", "pp", SIGNIFICANT, group="evaluate"),
        Column("to", "pp", SIGNIFICANT, group="evaluate"),
    )
    notes = (
        f"Criterion: {criterion}; {measure_of(criterion).convention}. "
        f"Chosen on validate, scored once on evaluate ({len(winner.losses)} flights). Of equals, "
        "to six digits, the faster ranks first.",
        f"{len(ranked)} of {candidates} candidates keep the limits. Minus winner: positive is "
        f"worse than the winner; 95 % interval by paired bootstrap over flights, {RESAMPLES} "
        f"resamples, seed {seed}. An interval that holds 0 does not tell the two apart.",
    )
    title = f"Selected estimator and its runners-up ({study.name})"
    return Table(title, columns, rows, notes, 1 + RUNNERS_UP_SHOWN)


def _row(
    place: int, one: Candidate, winner: Candidate, criterion: str, seed: int
) -> tuple[Value, ...]:
    against: tuple[Value, ...] = (None, None, None)
    if one is not winner:
        interval = paired_interval(one.losses, winner.losses, criterion.partition("-")[0], seed)
        against = (one.evaluate - winner.evaluate, *interval)
    named = (*setting_values(one.group), *one.factors.values())
    scores = (one.validate, 100.0 * one.failure_rate, one.seconds, one.evaluate)
    return (place + 1, *named, *scores, *against)
