"""Error profiles: the share of flights with an error of at most x, for every x.

A failure is a miss: it never gets there, so nobody's profile rises by giving no answer. Where one
profile lies above another, it is better at every level of error that anyone may ask for.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence.asked import Asked
from sparsefit.study.evidence.cases import factors, in_a_flow
from sparsefit.study.evidence.columns import (
    COUNTS,
    Statistic,
    by_levels,
    setting_columns,
    table_of,
)
from sparsefit.study.evidence.measure import Failure, Measure
from sparsefit.study.evidence.resampling import interval_of
from sparsefit.study.evidence.sentence import shown
from sparsefit.study.evidence.table import Column, Table, Value

if TYPE_CHECKING:
    from sparsefit.study.spec.study import Study

STEPS = (0.1, 1.0, 5.0, 20.0)  # of an error in percent, unless the study names its own
NOTE = (
    "Share of planned cases with an error of at most so much, failures as misses; in brackets the "
    "95 % interval by bootstrap over flights."
)


def reached(measure: Measure, most: float, cases: pd.DataFrame) -> Array:
    """(rows,) 1 where the number of a case is at most `most`; 0 where more, or where it failed."""
    read = np.abs(measure.read(cases))
    return np.where(in_a_flow(cases), (read <= most).astype(float), np.nan)


def profile_of(measure: Measure, cases: pd.DataFrame) -> tuple[Array, Array]:
    """The errors that occur, ascending, and the share [%] of cases with at most that."""
    kept = cases[in_a_flow(cases)]
    read = np.abs(measure.read(kept))
    known = np.sort(read[np.isfinite(read)])
    return known, 100.0 * np.arange(1, known.size + 1) / max(len(kept), 1)


def profiles(asked: Asked, study: Study, cases: pd.DataFrame) -> Table:
    """Return, for every setting and level, the share of flights within each of the limits."""
    asked.needs(study.name, "measure")
    swept = factors(cases)
    shown_ = [
        _within(measure, most, many=len(asked.measures) > 1)
        for measure in asked.measures
        for most in (asked.limits or STEPS)
    ]
    title = f"Error profiles: {', '.join(measure.words for measure in asked.measures)}"
    return table_of(
        asked,
        study,
        setting_columns(swept),
        by_levels(cases, swept),
        (*COUNTS, *shown_),
        title=title,
        notes=(NOTE,),
    )


def _within(measure: Measure, most: float, *, many: bool) -> Statistic:
    def told(cases: pd.DataFrame) -> Value:
        within = replace(measure, read=partial(reached, measure, most), summary="share",
                         failure=Failure.LEFT_OUT)  # fmt: skip
        share = within.summarise(cases)
        if np.isnan(share):
            return None
        low, high = interval_of(within, cases)
        ends = "" if np.isnan(low) else f" ({shown(low)} to {shown(high)})"
        return f"{shown(share)}{ends}"

    group = measure.words if many else "share [%]"
    return Statistic(Column(f"≤ {most:g} {measure.unit}".strip(), group=group), told)
