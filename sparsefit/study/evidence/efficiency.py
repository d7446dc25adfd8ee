"""How close errors come to the Cramer-Rao bound: efficiency, the rms of error / bound."""

from __future__ import annotations

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence.keys import counts, key, key_columns, three, titled
from sparsefit.study.evidence.summary import (
    StudyRecord,
    by_setting,
    factors,
    signed_errors,
    three_of,
)
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table

EFFICIENCY_NOTE = (
    "Bound: the semiparametric Cramér-Rao bound of each flight as flown, under noise on v' alone "
    "(Eq. 7); it assumes nothing of the flow but its length scale. Rms over the flights with "
    "status ok and a bound (their number: with bound); a failure has no error, so read the "
    "number of failures beside it. 1 is the limit of what knows no more than the bound does; "
    "parametric-nls knows Eq. 1 and may fall below it, and so may any back-end where it gives up "
    "the hardest flights."
)


def bounded(cases: pd.DataFrame) -> pd.DataFrame:
    """The cases with status ok whose flight has a finite bound."""
    bounds = three_of(cases, "bound")
    known = np.isfinite(bounds).all(axis=1) & (bounds > 0).all(axis=1)
    return cases[known & (cases["status"] == "ok").to_numpy()]


def ratios(cases: pd.DataFrame) -> Array:
    """(rows, 3) signed error / bound of U0, L_w and tau_w over the `bounded` cases."""
    kept = bounded(cases)
    found: Array = signed_errors(kept) / three_of(kept, "bound")
    return found


def percent_of_truth(cases: pd.DataFrame, prefix: str) -> Array:
    """(rows, 3) a column in percent of the truth."""
    share: Array = 100.0 * three_of(cases, prefix) / three_of(cases, "true")
    return share


def rms(values: Array) -> list[float]:
    """Root mean square of each column; NaN of none."""
    if not len(values):
        return [np.nan] * values.shape[1]
    return [float(one) for one in np.sqrt(np.mean(values**2, axis=0))]


def efficiency(study: StudyRecord, cases: pd.DataFrame) -> Table:
    """Rms error, rms bound and rms of error / bound, per setting and level."""
    swept = factors(cases)
    rows = []
    for group in by_setting(cases, *swept):
        kept = bounded(group.cases)
        errors = 100.0 * signed_errors(kept) / three_of(kept, "true")
        measured = (*rms(errors), *rms(percent_of_truth(kept, "bound")), *rms(ratios(kept)))
        rows.append((*key(group, swept), *counts(group.cases), len(kept), *measured))
    columns = (
        *key_columns(swept),
        Column("with bound", format="d"),
        *three("rms error", SIGNIFICANT, unit="%"),
        *three("rms bound", SIGNIFICANT, unit="%"),
        *three("rms of error/bound", SIGNIFICANT, unit=""),
    )
    title = titled(study, "Errors against the Cramér-Rao bound")
    return Table(title, columns, tuple(rows), (EFFICIENCY_NOTE,), 60)
