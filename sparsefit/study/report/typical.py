"""Which case a point stands for that summarises many: the one to look at first."""

from __future__ import annotations

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence.measure import Measure
from sparsefit.study.evidence.summary import TINY

HAIR = 1e-9  # of the summary: two machines agree to that


def typical(measure: Measure, cases: pd.DataFrame) -> pd.DataFrame:
    """Return one case, as a row: the largest value that is not above the summary.

    Of a share, whose values are 1 or 0, the first case that speaks against it. Where no case has
    a number, the first.
    """
    values = measure.read(cases)
    if measure.summary in ("share", "number"):
        return _first(cases, values == (0.0 if measure.more else 1.0))
    values = np.maximum(np.nan_to_num(values, nan=np.inf), TINY)
    below = values <= max(measure.summarise(cases), TINY) * (1.0 + HAIR)
    if not below.any():
        return cases.iloc[:1]
    highest = values[below].max() * (1.0 - HAIR)
    return _first(cases, below & (values >= highest))


def _first(cases: pd.DataFrame, wanted: Array) -> pd.DataFrame:
    place = int(np.argmax(wanted))
    return cases.iloc[place : place + 1]
