"""Comparison of two runs of a study: which cases changed, and by how much.

Cases are matched by id or, without common ids, by the names of unit and candidate. A case changed
if its status or its estimate did: U0, L_w and tau_w of flights, the held-out error of problems.
Times are not compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.errors import InputError
from sparsefit.study.columns import PARAMETERS
from sparsefit.study.measures import factors, numbers
from sparsefit.study.table import Table, significant
from sparsefit.study.tables import factor_words, level_text

TOLERANCE = 1e-6  # relative change below which estimates are equal
NAMES = (  # of unit and candidate, beside the levels of factors
    *("flight", "log", "true_mean_velocity", "true_length_scale", "protocol", "label", "settings"),
    *("problem", "samples", "columns", "objective", "solver", "tolerance"),
)
COUNTS = ("changed", "in status", "lost")


@dataclass(frozen=True, eq=False)
class Comparison:
    """The cases of both runs, and the numbers of cases in one of them only.

    cases: those of the first run, with the columns `status, second`; `change`, the largest relative
    change of an estimate [%], infinite if one run has none; `in status`, whether the status
    differs; `changed`, whether status or estimate do; `lost`, whether the second has no answer.
    """

    names: tuple[str, str]
    cases: pd.DataFrame
    only: tuple[int, int]

    @property
    def differs(self) -> bool:
        """Whether a case changed, or is missing in one run."""
        return bool(self.cases["changed"].any()) or any(self.only)

    @property
    def sentence(self) -> str:
        """A summary: numbers of changed cases, and the largest change."""
        only = (f"; {count} only in {name}"
                for count, name in zip(self.only, self.names, strict=True) if count)  # fmt: skip
        return (
            f"{self.cases['changed'].sum()} of {len(self.cases)} cases changed, "
            f"{self.cases['in status'].sum()} of them in status; the largest change is "
            f"{significant(_largest(self.cases['change']))} %{''.join(only)}."
        )

    @property
    def tables(self) -> dict[str, Table]:
        """Changes by setting, and the changed cases, the largest change first."""
        swept = {name: self.cases[name].map(level_text, "ignore") for name in factors(self.cases)}
        cases = self.cases.assign(**swept)
        names = ["objective", "solver"] if "objective" in cases else ["protocol", "label"]
        for name in (*swept, "settings"):  # unless implied by the others
            if cases.groupby(names, dropna=False)[name].nunique(dropna=False).max() > 1:
                names.append(name)
        groups = cases.groupby(names, sort=False, dropna=False)
        settings = groups.size().to_frame("n").join(groups[[*COUNTS]].sum())
        settings["largest change [%]"] = groups["change"].agg(_largest)
        settings = settings[settings["changed"] > 0].rename_axis(index=factor_words)
        settings.attrs = {"title": "Settings of which cases changed",
                          "notes": ["first: {}; second: {}".format(*self.names)]}  # fmt: skip
        shown = ["case_id", names[1], "status", "status, second", "change"]
        changes = cases.loc[cases["changed"], shown].rename(columns={"change": "change [%]"})
        changes = changes.sort_values("change [%]", ascending=False, kind="stable")
        changes.attrs["title"] = "Cases that changed"
        return {"settings": Table.of(settings), "changes": Table.of(changes)}

    def record(self) -> dict[str, Any]:
        """Return the comparison for JSON."""
        counts = self.cases[[*COUNTS]].sum().tolist()
        return {
            "summary": self.sentence, "cases": len(self.cases),
            **dict(zip(("changed", "restated", "lost"), counts, strict=True)),
            "only": list(self.only),
            "tables": {name: each.record() for name, each in self.tables.items()},
        }  # fmt: skip


def _largest(change: pd.Series) -> float:
    """Return the largest finite change [%], or 0."""
    return float(change[np.isfinite(change)].max()) if np.isfinite(change).any() else 0.0


def compare(
    first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str], tolerance: float = TOLERANCE
) -> Comparison:
    """Match the cases of two runs; `tolerance` is the smallest relative change that counts.

    Raises:
        InputError: if they have no case in common.
    """
    both = first.columns.intersection(second.columns)
    for key in (["case_id"], [name for name in both if name in NAMES or "." in name]):
        index = [pd.MultiIndex.from_frame(cases[key].astype(str)) for cases in (first, second)]
        shared = index[0][index[0].isin(index[1])]
        if len(shared) and all(each.is_unique for each in index):
            break
    else:
        words = f"{names[0]} and {names[1]}"
        raise InputError(f"{words} have no case in common: compare two runs of one study")
    sides = [cases.iloc[each.get_indexer(shared)].reset_index(drop=True)
             for cases, each in zip((first, second), index, strict=True)]  # fmt: skip
    of_problems = "objective" in first
    measured = ["holdout_error"] if of_problems else [f"est_{name}" for name in PARAMETERS]
    pair = np.array([[numbers(side, name) for name in measured] for side in sides])
    moved = np.abs(pair[0] - pair[1]) / np.maximum(np.abs(pair).max(axis=0), 1e-300)
    gone = np.isnan(pair)
    moved[gone.any(axis=0)] = np.inf
    moved[gone.all(axis=0)] = 0.0
    before, after = (side["status"] for side in sides)
    change, restated = 100.0 * moved.max(axis=0), before != after
    cases = sides[0].assign(**{
        "status, second": after, "change": change, "in status": restated,
        "changed": restated | (change > 100.0 * tolerance),
        "lost": ((before == "ok") & (after != "ok")) | (~gone[0] & gone[1]).any(axis=0),
    })  # fmt: skip
    return Comparison(names, cases, (len(first) - len(shared), len(second) - len(shared)))
