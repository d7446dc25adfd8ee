"""The answers of a study, by name: each a sentence that its cases, not its author, give."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import pandas as pd

from sparsefit.study.evidence import accuracy_answers, paper_answers, scale_sets, trust_answers
from sparsefit.study.evidence.methods import derivatives_answer, vehicle_answer
from sparsefit.study.evidence.penalty_answer import penalty
from sparsefit.study.evidence.summary import StudyRecord

AnswerFunction: TypeAlias = Callable[[StudyRecord, pd.DataFrame], str]

ANSWERS: dict[str, AnswerFunction] = {
    "derivatives": derivatives_answer,
    "vehicle": vehicle_answer,
    "multiscale": scale_sets.answer,
    "parameters": paper_answers.parameters,
    "least-errors": paper_answers.least_errors,
    "readings": paper_answers.readings,
    "selection": paper_answers.selection,
    "penalty": penalty,
    "completeness": paper_answers.completeness,
    "efficiency": accuracy_answers.efficiency,
    "windows": accuracy_answers.windows,
    "grids": accuracy_answers.grids,
    "coverage": trust_answers.coverage,
    "identifiability": trust_answers.identifiability,
}


def sentences(study: StudyRecord, cases: pd.DataFrame) -> list[str]:
    """What the study's [outputs] asks to be said, computed from its cases."""
    return [ANSWERS[name](study, cases) for name in study.answers]
