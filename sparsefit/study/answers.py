"""The answers of a study, by name: each a sentence that its cases, not its author, give."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import pandas as pd

from sparsefit.study import scale_sets
from sparsefit.study.methods import derivatives_answer, vehicle_answer
from sparsefit.study.summary import StudyRecord

AnswerFunction: TypeAlias = Callable[[StudyRecord, pd.DataFrame], str]

ANSWERS: dict[str, AnswerFunction] = {
    "derivatives": derivatives_answer,
    "vehicle": vehicle_answer,
    "multiscale": scale_sets.answer,
}
