"""From a candidate to what is deployed: its cells, its estimator, and where that comes from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from sparsefit.codec import finite_or_none, shown
from sparsefit.errors import InputError
from sparsefit.study.evidence.candidates import Candidate, candidates_of
from sparsefit.study.evidence.selection import Selection, select
from sparsefit.study.evidence.worlds import readings_of
from sparsefit.study.run.latency import Latency, read_latency
from sparsefit.study.run.manifest import git_commit, versions
from sparsefit.study.spec.document import canonical_json

if TYPE_CHECKING:
    from sparsefit.estimator.estimator import Estimator
    from sparsefit.study.spec.design import Cell
    from sparsefit.study.spec.selection import SelectionRule
    from sparsefit.study.spec.study import Study


def cells_of(study: Study, candidate: Candidate) -> list[Cell]:
    """The cells of a candidate: one for every world and level of what varies the flights."""
    readings = readings_of(study)
    wanted = tuple(map(candidate.of, ("protocol", "backend", "label", "settings")))
    cells = [
        cell
        for cell in study.cells
        if (readings[cell.protocol], cell.backend, cell.label, cell.canonical_settings) == wanted
        and _has_levels(cell, candidate)
    ]
    if not cells:
        raise InputError(
            f"{study.name} plans nothing like {shown(candidate.title)}, of which its cases tell: "
            "run it with --fresh"
        )
    return cells


def _has_levels(cell: Cell, candidate: Candidate) -> bool:
    # A column of levels that are not all numbers holds them as text.
    return all(
        value in (cell.levels[key], canonical_json(cell.levels[key]))
        for key, value in candidate.factors.items()
    )


def latency_key(study: Study, candidate: Candidate) -> str:
    """By what the stored time of a candidate is known."""
    return cells_of(study, candidate)[0].key


def stored_latencies(study: Study, cases: pd.DataFrame, folder: Path) -> dict[int, Latency]:
    """The times that were measured before, by the place of the candidate in the study."""
    known = read_latency(study, folder)
    if not known:
        return {}
    keys = {one.place: latency_key(study, one) for one in candidates_of(study, cases)}
    return {place: known[key] for place, key in keys.items() if key in known}


def selection_of(
    study: Study, cases: pd.DataFrame, folder: Path, rule: SelectionRule | None = None
) -> Selection:
    """The selection of a finished study with the times that are stored in its folder."""
    return select(study, cases, rule=rule, latencies=stored_latencies(study, cases, folder))


def estimator_of(study: Study, candidate: Candidate) -> Estimator:
    """The estimator that the cases of a candidate used."""
    return study.estimator(cells_of(study, candidate)[0])


def estimator_text(study: Study, selection: Selection) -> str:
    """The chosen estimator as JSON, with its provenance."""
    if selection.chosen is None:
        raise ValueError("nothing was chosen")
    record = json.loads(estimator_of(study, selection.chosen.candidate).to_json())
    record["provenance"] = finite_or_none(provenance(study, selection))
    return json.dumps(record, indent=2, allow_nan=False) + "\n"


def provenance(study: Study, selection: Selection) -> Mapping[str, Any]:
    """What an estimator comes from: the study, the versions, the rule, and the evidence."""
    chosen, regret = selection.chosen, selection.regret
    if chosen is None:
        return {}
    regimes = zip(selection.criterion.regimes, chosen.by_regime.tolist(), strict=True)
    return {
        "study": study.name,
        "study_hash": study.hash,
        "seed": study.seed,
        "versions": versions(),
        "git_commit": git_commit(),
        "rule": asdict(selection.rule),
        "flights": dict(selection.flights),
        "criterion": {
            "words": selection.criterion.words,
            "unit": selection.criterion.measure.unit,
            "validate": chosen.validate,
            "evaluate": chosen.evaluate,
            "interval": chosen.between,
            "by_regime": dict(regimes),
        },
        "probability_best": chosen.best,
        "regret": None if regret is None else [regret.effect, regret.low, regret.high],
        "tied": [one.candidate.title for one in selection.tied],
        "latency": None if chosen.latency is None else asdict(chosen.latency),
    }
