"""The candidates of a selection: what each one scores, and how two are compared."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.evidence.cases import (
    Group,
    by_setting,
    estimated,
    factors,
    groups_by,
    is_condition,
    numbers,
)
from sparsefit.study.evidence.measure import Failure, Measure
from sparsefit.study.evidence.measures import MEASURES
from sparsefit.study.evidence.table import Value

CRITERIA = tuple(
    f"{statistic}-absolute-percentage-error-{parameter}"
    for statistic in ("mean", "median")
    for parameter in ("timescale", "length_scale", "mean_velocity")
)
RESAMPLES = 2000


def measure_of(criterion: str) -> Measure:
    """Return the measure that a criterion names: an error that counts a failure as a miss."""
    summary, _, parameter = criterion.partition("-absolute-percentage-error-")
    measure = MEASURES[f"{parameter.replace('_', '-')}-error"]
    return replace(measure, failure=Failure.MISS, summary=summary)


@dataclass(frozen=True)
class Limits:
    """What a candidate must keep on the validate flights: failures as a share, median seconds."""

    max_failure_rate: float | None = None
    max_seconds: float | None = None

    def __post_init__(self) -> None:
        rate, seconds = self.max_failure_rate, self.max_seconds
        if rate is not None and not 0.0 <= rate <= 1.0:
            raise InputError(f"max_failure_rate must be a share from 0 to 1; got {rate!r}")
        if seconds is not None and not seconds > 0.0:
            raise InputError(f"max_seconds must be above 0 [s]; got {seconds!r}")


@dataclass(frozen=True, eq=False)
class Candidate:
    """One protocol, back-end and setting (`group`) at one level of the estimator's factors.

    factors: those levels by dotted name, as they stand in its rows. validate, evaluate: the
    criterion [%] on the flights of either split; failure_rate: the share of validate cases
    without an estimate; seconds: their median time [s]; losses: (flights, cases) [%] of evaluate.
    """

    group: Group
    factors: Mapping[str, Value]
    validate: float
    evaluate: float
    failure_rate: float
    seconds: float
    losses: Array

    @property
    def title(self) -> str:
        """One line that tells this candidate from the others."""
        chosen = [f"{name}={value}" for name, value in self.factors.items()]
        return ", ".join([f"{self.group.protocol}: {self.group.title}", *chosen])

    def of(self, column: str) -> str:
        """What its rows have in a column that they share: protocol, backend, label, settings."""
        return str(self.group.key[column])

    def excess(self, limits: Limits) -> float:
        """How far beyond the limits, as a sum of shares: 0 within them."""
        rate, seconds = limits.max_failure_rate, limits.max_seconds
        too_many = 0.0 if rate is None else max(0.0, self.failure_rate - rate)
        if seconds is None:
            return too_many
        late = self.seconds / seconds - 1.0
        return too_many + (max(0.0, late) if np.isfinite(late) else np.inf)


def candidates_of(cases: pd.DataFrame, criterion: Measure) -> list[Candidate]:
    """Return every candidate, scored, in the order in which the study lists them.

    Raises:
        InputError: if they were not all tried on the same flights and conditions.
    """
    own = [name for name in factors(cases) if not is_condition(name)]
    conditions = [name for name in factors(cases) if is_condition(name)]
    groups = by_setting(cases, *own)
    expected = _evidence_of(groups[0], conditions)
    for group in groups:
        if _evidence_of(group, conditions) != expected:
            raise InputError(
                f"{group.title} was not tried on the same flights as {groups[0].title}: "
                "finish the study first (sparsefit study run)"
            )
    return [_candidate(group, own, criterion) for group in groups]


def _evidence_of(group: Group, conditions: list[str]) -> list[tuple[str, ...]]:
    names = ["flight", "split", *conditions]
    return sorted(tuple(map(str, row)) for row in group.cases[names].itertuples(index=False))


def _candidate(group: Group, own: list[str], criterion: Measure) -> Candidate:
    validate = group.cases[group.cases["split"] == "validate"]
    evaluate = group.cases[group.cases["split"] == "evaluate"].sort_values("flight", kind="stable")
    seconds = numbers(validate, "seconds")
    timed = seconds[np.isfinite(seconds)]
    per_flight = [criterion.values(flight.cases) for flight in groups_by(evaluate, ["flight"])]
    return Candidate(
        group=group,
        factors={name: group.key[name] for name in own},
        validate=criterion.summarise(validate),
        evaluate=criterion.summarise(evaluate),
        failure_rate=float(1.0 - np.mean(estimated(validate))),
        seconds=float(np.median(timed)) if timed.size else np.nan,
        losses=np.array(per_flight),
    )


def paired_interval(first: Array, second: Array, summary: str, seed: int) -> tuple[float, float]:
    """95 % percentile interval of a summary, mean or median, of first minus that of second.

    Both are (flights, cases). The same flights are drawn for both (paired), whole flights with
    all their conditions.
    """
    draws = np.random.default_rng(seed).integers(len(first), size=(RESAMPLES, len(first)))
    over = np.mean if summary == "mean" else np.median
    one, other = (over(values[draws].reshape(RESAMPLES, -1), axis=1) for values in (first, second))
    low, high = np.quantile(one - other, [0.025, 0.975])
    return float(low), float(high)
