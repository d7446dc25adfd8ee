"""From a finished study to one candidate that can be defended, or to the reason why there is none.

Chosen on the flights of split `validate`, scored once on those of split `evaluate`. Of all that
keep every constraint in every regime, the simplest within the margin of the best is chosen. What
the flights do not tell from it is named as a tie.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.evidence.candidates import Candidate, Criterion, candidates_of
from sparsefit.study.evidence.constraints import Breach, breaches
from sparsefit.study.evidence.resampling import (
    SAME,
    Difference,
    best_probabilities,
    interval,
)
from sparsefit.study.evidence.worlds import in_regimes, regime_names
from sparsefit.study.spec.selection import SelectionRule

if TYPE_CHECKING:
    from sparsefit.study.run.latency import Latency
    from sparsefit.study.spec.study import Study


@dataclass(frozen=True, eq=False)
class Scored:
    """A candidate with all that speaks for it and against it.

    validate, evaluate: the criterion on either split, `between` its 95 % interval on evaluate;
    by_regime: (regimes,) on evaluate;
    breaches: what it does not keep on validate; broken: on evaluate; best: the probability, over
    drawn flights of validate, that it is the best of those that keep everything, 0 for others;
    apart: how much worse than the chosen on validate, confirmed: on evaluate; None of the chosen.
    """

    candidate: Candidate
    validate: float
    evaluate: float
    between: tuple[float, float]
    by_regime: Array
    breaches: tuple[Breach, ...]
    broken: tuple[Breach, ...]
    best: float
    apart: Difference | None
    confirmed: Difference | None
    latency: Latency | None

    @property
    def passes(self) -> bool:
        """Whether it keeps every constraint on the flights that it is chosen on."""
        return not self.breaches


@dataclass(frozen=True, eq=False)
class Selection:
    """What was chosen by a rule, and every candidate with its evidence, the best first.

    chosen: none where no candidate keeps the constraints; regret: how much worse the chosen is on
    evaluate than `hindsight`, the best there of those that keep the constraints on validate.
    """

    study: str
    rule: SelectionRule
    criterion: Criterion
    ranked: tuple[Scored, ...]
    chosen: Scored | None
    regret: Difference | None
    hindsight: Scored | None
    flights: Mapping[str, int]

    @property
    def passing(self) -> list[Scored]:
        """The candidates that keep every constraint, the best first."""
        return [one for one in self.ranked if one.passes]

    @property
    def tied(self) -> list[Scored]:
        """Those that keep everything and that the validate flights do not tell from the chosen."""
        return [one for one in self.passing if one.apart is not None and one.apart.tie]

    @property
    def contenders(self) -> list[Scored]:
        """The chosen one and what the validate flights do not rule out: tied, or in the margin."""
        return [
            one for one in self.passing if one.apart is None or one.apart.tie or self.within(one)
        ]

    def within(self, one: Scored) -> bool:
        """Whether a candidate is within the margin of the best that keeps everything."""
        losses = [float(self.criterion.loss(np.asarray(each.validate))) for each in self.passing]
        loss = float(self.criterion.loss(np.asarray(one.validate)))
        return one.passes and _is_within(
            loss, losses, self.rule.margin, self.criterion.measure.least
        )


def select(
    study: Study,
    cases: pd.DataFrame,
    *,
    rule: SelectionRule | None = None,
    latencies: Mapping[int, Latency] | None = None,
) -> Selection:
    """Choose a candidate by a rule, that of the study unless another is given.

    Args:
        latencies: time and memory of the candidates, by their place in the study; a candidate
            without one keeps no limit of either.

    Raises:
        InputError: if the rule names what does not exist, the study has no split or is
            unfinished, or its candidates were not tried alike.
    """
    rule = rule or study.selection
    check_finished(study, cases)
    criterion = Criterion.of(rule, regime_names(in_regimes(study, cases)))
    if not np.isfinite(criterion.measure.read(cases)).any():
        raise InputError(
            f"{study.name} has no case with a number for {criterion.measure.words}: choose by "
            "another criterion (for predictions, set [run] prediction_flights)"
        )
    candidates = candidates_of(study, cases)
    known = latencies or {}
    if rule.simplest == "fastest" and not known:
        raise InputError('simplest = "fastest" needs measured latencies: allow them to be measured')
    return _decide(study, rule, criterion, candidates, known)


def _decide(
    study: Study,
    rule: SelectionRule,
    criterion: Criterion,
    candidates: list[Candidate],
    latencies: Mapping[int, Latency],
) -> Selection:
    found = {
        one.place: breaches(
            rule, one.trials["validate"], criterion.regimes, latencies.get(one.place)
        )
        for one in candidates
    }
    grids = {
        split: [criterion.grid(one.trials[split]) for one in candidates]
        for split in ("validate", "evaluate")
    }
    losses = [float(criterion.loss_of(grid)) for grid in grids["validate"]]
    order = sorted(range(len(candidates)), key=lambda at: (losses[at], at))
    passing = [at for at in order if not found[at] and not math.isnan(losses[at])]
    chosen = _simplest(rule, losses, passing, latencies, criterion.measure.least)
    resampled = {
        split: [criterion.resampled(grid, rule.seed + place) for grid in grids[split]]
        for place, split in enumerate(grids)
    }
    shares = dict.fromkeys(range(len(candidates)), 0.0)
    if passing:
        at_validate = np.array([resampled["validate"][at] for at in passing])
        shares |= zip(passing, best_probabilities(at_validate).tolist(), strict=True)

    def against(split: str, at: int, other: int | None) -> Difference | None:
        if other is None or at == other:
            return None
        first, second = grids[split][at], grids[split][other]
        drawn = resampled[split][at] - resampled[split][other]
        effect = float(criterion.loss_of(first) - criterion.loss_of(second))
        floor = criterion.measure.least
        same = bool(np.allclose(first, second, rtol=SAME, atol=floor, equal_nan=True))
        return Difference.of(effect, drawn, len(first), same=same)

    scored = {
        at: Scored(
            candidate=candidates[at],
            validate=float(criterion.score(criterion.by_regime(grids["validate"][at]))),
            evaluate=float(criterion.score(criterion.by_regime(grids["evaluate"][at]))),
            between=interval(criterion.loss(resampled["evaluate"][at])),
            by_regime=criterion.by_regime(grids["evaluate"][at]),
            breaches=found[at],
            broken=breaches(
                rule, candidates[at].trials["evaluate"], criterion.regimes, latencies.get(at)
            ),
            best=shares[at],
            apart=against("validate", at, chosen),
            confirmed=against("evaluate", at, chosen),
            latency=latencies.get(at),
        )
        for at in order
    }
    later = [float(criterion.loss_of(grid)) for grid in grids["evaluate"]]
    hindsight = min(passing, key=lambda at: (later[at], at != chosen), default=None)
    regret = None
    if chosen is not None and hindsight is not None:
        regret = against("evaluate", chosen, hindsight) or Difference(
            0.0, 0.0, 0.0, len(grids["evaluate"][chosen]), same=True
        )
    return Selection(
        study=study.name,
        rule=rule,
        criterion=criterion,
        ranked=tuple(scored[at] for at in (*passing, *(at for at in order if at not in passing))),
        chosen=None if chosen is None else scored[chosen],
        regret=regret,
        hindsight=None if hindsight is None else scored[hindsight],
        flights={split: len(each[0]) for split, each in grids.items()},
    )


def _simplest(
    rule: SelectionRule,
    losses: list[float],
    passing: list[int],
    latencies: Mapping[int, Latency],
    floor: float,
) -> int | None:
    """The simplest of those within the margin of the best; none of none."""
    least = [losses[at] for at in passing]
    within = [at for at in passing if _is_within(losses[at], least, rule.margin, floor)]
    if rule.simplest == "fastest":
        return min(within, key=lambda at: (latencies[at].median, at), default=None)
    return min(within, default=None)


def _is_within(loss: float, losses: list[float], margin: float, floor: float) -> bool:
    best = min(losses)
    return loss <= best + (margin + SAME) * abs(best) + floor


def check_finished(study: Study, cases: pd.DataFrame) -> None:
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
