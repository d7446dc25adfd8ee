"""A choice checked where nothing was tuned: the same worlds, flights of fresh seeds.

What the validate flights do not rule out is run on them, and the chosen one is held against the
best with hindsight. The flights had no part in the study, nor in the choice.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import pandas as pd

from sparsefit.study.evidence.candidates import Candidate, candidates_of
from sparsefit.study.evidence.constraints import Breach, breaches
from sparsefit.study.evidence.deploy import cells_of
from sparsefit.study.evidence.resampling import Difference, interval
from sparsefit.study.evidence.selection import Selection

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

FRESH = "fresh"  # the results folder of the fresh flights, within that of the study


@dataclass(frozen=True, eq=False)
class Check:
    """The chosen candidate on fresh flights, and its regret against the best of them there.

    score, between: the criterion and its 95 % interval; broken: what it does not keep there;
    hindsight: the best in words; candidates: how many were run.
    """

    flights: int
    score: float
    between: tuple[float, float]
    regret: Difference
    hindsight: str
    broken: tuple[Breach, ...]
    candidates: int


def fresh_study(study: Study, selection: Selection, count: int) -> Study:
    """The study of what was not ruled out, on `count` flights of other seeds."""
    cells = [cell for one in selection.contenders for cell in cells_of(study, one.candidate)]
    kept = tuple(
        replace(cell, index=index)
        for index, cell in enumerate(sorted(cells, key=lambda cell: cell.index))
    )
    told = f"{study.hash} {FRESH} {count} {' '.join(cell.key for cell in kept)}"
    return replace(
        study,
        name=FRESH,
        seed=fresh_seed(study),
        count=count,
        cells=kept,
        validate_count=None,
        tables=(),
        figures=(),
        answers=(),
        hash=hashlib.sha256(told.encode()).hexdigest(),
    )


def fresh_seed(study: Study) -> int:
    """A seed of which the study's own says nothing."""
    return int(hashlib.sha256(f"{FRESH} {study.seed}".encode()).hexdigest()[:8], 16)


def check_of(study: Study, selection: Selection, cases: pd.DataFrame) -> Check:
    """What the cases of the fresh study say of the chosen candidate."""
    if selection.chosen is None:
        raise ValueError("nothing was chosen")
    tried = candidates_of(study, cases.assign(split="evaluate"))
    criterion = selection.criterion
    # Fewer levels may be left than the study sweeps, so that titles do not tell who is who.
    keys = {cell.key for cell in cells_of(study, selection.chosen.candidate)}
    own = next(place for place, one in enumerate(tried) if _keys(one) <= keys)
    grids = [criterion.grid(one.trials["evaluate"]) for one in tried]
    losses = [float(criterion.loss_of(grid)) for grid in grids]
    best = min(range(len(tried)), key=lambda at: (losses[at], at != own))
    seed = selection.rule.seed
    resampled = {at: criterion.resampled(grids[at], seed) for at in (own, best)}
    apart = resampled[own] - resampled[best]
    trial = tried[own].trials["evaluate"]
    return Check(
        flights=len(grids[own]),
        score=float(criterion.score(criterion.by_regime(grids[own]))),
        between=interval(criterion.loss(resampled[own])),
        regret=Difference.of(losses[own] - losses[best], apart, len(grids[own]), same=own == best),
        hindsight=_titled(study, selection, tried[best]),
        broken=breaches(selection.rule, trial, criterion.regimes, selection.chosen.latency),
        candidates=len(tried),
    )


def _titled(study: Study, selection: Selection, candidate: Candidate) -> str:
    """What the selection calls a candidate."""
    keys = _keys(candidate)
    named = (one.candidate for one in selection.contenders)
    return next(one.title for one in named if keys <= {cell.key for cell in cells_of(study, one)})


def _keys(candidate: Candidate) -> set[str]:
    """The keys of the cells of a candidate, which its case ids end in."""
    return {str(case).partition("-")[2] for case in candidate.group.cases["case_id"]}
