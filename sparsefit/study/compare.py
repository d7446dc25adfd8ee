"""Comparison of two runs of a study: which cases changed, and by how much.

Cases are matched by id. A case changed if its status or its estimate did: U0, L_w and tau_w of
flights, the held-out error of problems. Times are not compared.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.errors import InputError
from sparsefit.study.columns import PARAMETERS
from sparsefit.study.measures import numbers
from sparsefit.study.table import Table, significant

TOLERANCE = 1e-6  # relative change below which estimates are equal


@dataclass(frozen=True, eq=False)
class Comparison:
    """The cases that changed, of those that both runs have, and the numbers in one of them only.

    changes: `case_id`, the names of unit and candidate, both statuses, and `change [%]`, the
    largest relative change of an estimate, infinite if one run has none; the largest first.
    """

    names: tuple[str, str]
    compared: int
    changes: pd.DataFrame
    only: tuple[int, int]

    @property
    def differs(self) -> bool:
        """Whether a case changed, or is missing in one run."""
        return len(self.changes) > 0 or any(self.only)

    @property
    def restated(self) -> int:
        """The number of cases whose status changed."""
        return int((self.changes["status"] != self.changes["status, second"]).sum())

    @property
    def sentence(self) -> str:
        """A summary: numbers of changed cases, and the largest change."""
        only = (f"; {count} only in {name}"
                for count, name in zip(self.only, self.names, strict=True) if count)  # fmt: skip
        sizes = self.changes["change [%]"]
        largest = float(sizes[np.isfinite(sizes)].max()) if np.isfinite(sizes).any() else 0.0
        return (
            f"{len(self.changes)} of {self.compared} cases changed, {self.restated} of them in "
            f"status; the largest change is {significant(largest)} %{''.join(only)}."
        )

    def record(self) -> dict[str, Any]:
        """Return the comparison for JSON."""
        counts = {"changed": len(self.changes), "restated": self.restated, "only": list(self.only)}
        return {"summary": self.sentence, "cases": self.compared, **counts,
                "table": Table.of(self.changes).record()}  # fmt: skip


def compare(
    first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str], tolerance: float = TOLERANCE
) -> Comparison:
    """Match the cases of two runs; `tolerance` is the smallest relative change that counts.

    Raises:
        InputError: if they have no case in common.
    """
    both = first.merge(second, on="case_id", suffixes=("", ", second"))
    if both.empty:
        words = f"{names[0]} and {names[1]}"
        raise InputError(f"{words} have no case in common: compare two runs of one study")
    of_problems = "objective" in first
    measured = ["holdout_error"] if of_problems else [f"est_{name}" for name in PARAMETERS]
    old, new = (np.array([numbers(both, f"{name}{end}") for name in measured])
                for end in ("", ", second"))  # fmt: skip
    moved = np.abs(old - new) / np.maximum(np.maximum(np.abs(old), np.abs(new)), 1e-300)
    moved = np.where(np.isnan(old) & np.isnan(new), 0.0, np.where(np.isnan(moved), np.inf, moved))
    both["change [%]"] = 100.0 * moved.max(axis=0)
    changed = (both["status"] != both["status, second"]) | (both["change [%]"] > 100.0 * tolerance)
    unit = ["problem", "objective", "solver"] if of_problems else ["flight", "protocol", "label"]
    shown = ["case_id", *unit, "status", "status, second", "change [%]"]
    changes = both.loc[changed, shown].sort_values("change [%]", ascending=False, kind="stable")
    changes.attrs = {"title": "Cases that changed",
                     "notes": ["first: {}; second: {}".format(*names)]}  # fmt: skip
    only = (len(first) - len(both), len(second) - len(both))
    return Comparison(names, len(both), changes, only)
