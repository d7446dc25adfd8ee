"""Two runs of a study held against each other: which cases changed, and whether for the worse.

Cases are the same where their ids are, else where `flight` and `identity` are. A case changed where
its status did, or a number: of flights U0, L_w and tau_w, of problems the held-out error. No time
is like another: they are not compared. A setting is judged by the mean error of tau_w, or the mean
held-out error, paired by unit.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.errors import InputError
from sparsefit.study.columns import PARAMETERS
from sparsefit.study.entries import grouped, level_text
from sparsefit.study.measures import factors, measure, numbers
from sparsefit.study.resampling import by_unit, interval, pooled
from sparsefit.study.table import Table, significant

TOLERANCE = 1e-6  # of a number: what changed by less is the same


@dataclass(frozen=True, eq=False)
class Comparison:
    """The cases that both runs have, row by row, and how many only one has.

    sides: the cases of either run. cases: `change`, the largest relative change of a number,
    infinite where one run has none; `in status`, whether the status is another; `changed`, whether
    anything is; `lost`, whether an answer is no more.
    """

    names: tuple[str, str]
    sides: list[pd.DataFrame]
    cases: pd.DataFrame
    only: tuple[int, int]

    @property
    def differs(self) -> bool:
        """Whether a case changed, or is in one run alone."""
        return bool(self.cases["changed"].any()) or any(self.only)

    @property
    def worse(self) -> bool:
        """Whether a case lost its answer, or a setting is worse beyond its interval."""
        verdicts = self.effects.frame["verdict"]
        return bool(self.cases["lost"].any()) or "worse" in set(verdicts)

    @property
    def sentence(self) -> str:
        """The numbers of changed cases and the largest change, in a sentence."""
        only = (f"; {count} only in {name}"
                for count, name in zip(self.only, self.names, strict=True) if count)  # fmt: skip
        return (
            f"{self.cases['changed'].sum()} of {len(self.cases)} cases changed, "
            f"{self.cases['in status'].sum()} of them in status; the largest change is "
            f"{significant(_largest(self.cases))} %{''.join(only)}."
        )

    @property
    def tables(self) -> dict[str, Table]:
        """The table of settings, and that of changed cases, the largest first."""
        first, second = self.sides
        label = "solver" if "objective" in first else "label"
        frame = pd.DataFrame({
            "case": first["case_id"], label: first[label],
            f"status in {self.names[0]}": first["status"],
            f"status in {self.names[1]}": second["status"],
            "change [%]": 100.0 * self.cases["change"],
        })[self.cases["changed"]]  # fmt: skip
        frame.attrs["title"] = "Cases that changed"
        changes = frame.sort_values("change [%]", ascending=False, kind="stable")
        return {"effects": self.effects, "changes": Table.of(changes)}

    @cached_property
    def effects(self) -> Table:
        """A row per setting: what changed of it, and whether its measure did."""
        first = self.sides[0]
        of_problems = "objective" in first
        each = measure("mean holdout-error" if of_problems else "mean timescale-error")
        names = ["protocol", "label", *factors(first)]
        names = ["objective", "solver"] if of_problems else names
        values = [each.values(side) for side in self.sides]

        def apart(grid: Array) -> Array:  # of (..., units, cases, 2), the second less the first
            return pooled(each.reduce)(grid[..., 1]) - pooled(each.reduce)(grid[..., 0])

        rows: list[dict[str, object]] = []
        for key, places in grouped(first, ["backend", *names, "settings"]):
            here, units = self.cases.iloc[places], first["flight"].iloc[places]
            grid = np.stack([by_unit(value[places], units) for value in values], axis=-1)
            ends = np.array([apart(grid), *interval(apart, grid)])
            ends[np.abs(ends) < each.least] = 0.0
            rows.append({
                "setting": ", ".join(map(level_text, key[1:-1])), "settings": key[-1],
                "verdict": "worse" if ends[1] > 0 else "better" if ends[2] < 0 else "tie",
                "n": len(places), **here[["changed", "in status"]].sum(),
                "largest change [%]": _largest(here),
                **dict(zip((f"{each.phrase}, second − first [{each.unit}]", "from", "to"), ends,
                           strict=True)),
            })  # fmt: skip
        frame = pd.DataFrame(rows)
        for _, texts in frame.groupby("setting", sort=False)["settings"]:
            every = [json.loads(text) for text in texts]
            differ = [key for key, value in every[0].items()
                      if any(own.get(key) != value for own in every)]  # fmt: skip
            short = [", ".join(f"{key}={own.get(key)}" for key in differ) for own in every]
            frame.loc[texts.index, "settings"] = short
        frame = frame.sort_values("changed", ascending=False, kind="stable", key=lambda n: n > 0)
        note = "First: {}; second: {}. From, to: 95 %, by bootstrap over units.".format(*self.names)
        frame.attrs.update(title="What changed, and whether for the worse", notes=(note,))
        return Table.of(frame)

    def record(self) -> dict[str, Any]:
        """Return the comparison as JSON has it."""
        return {
            "summary": self.sentence, "cases": len(self.cases),
            "changed": int(self.cases["changed"].sum()),
            "restated": int(self.cases["in status"].sum()),
            "only": list(self.only), "worse": self.worse,
            "tables": {name: each.record() for name, each in self.tables.items()},
        }  # fmt: skip


def _largest(cases: pd.DataFrame) -> float:
    """Return the largest finite change, in percent."""
    change = cases["change"].to_numpy()
    return 100.0 * float(change[np.isfinite(change)].max(initial=0.0))


def compare(
    first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str], tolerance: float = TOLERANCE
) -> Comparison:
    """Pair the cases of two runs; a number that moves by more than `tolerance` changed.

    Raises:
        InputError: if they have no case in common.
    """
    for key in (["case_id"], ["flight", "identity"]):
        if not all(set(key) <= set(cases) for cases in (first, second)):
            continue
        index = [pd.MultiIndex.from_frame(cases[key].astype(str)) for cases in (first, second)]
        shared = index[0][index[0].isin(index[1])]
        if len(shared) and all(each.is_unique for each in index):
            break
    else:
        both = f"{names[0]} and {names[1]}"
        raise InputError(f"{both} have no case in common: compare two runs of one study")
    sides = [cases.iloc[each.get_indexer(shared)].reset_index(drop=True)
             for cases, each in zip((first, second), index, strict=True)]  # fmt: skip
    of_problems = "objective" in first
    measured = ["holdout_error"] if of_problems else [f"est_{name}" for name in PARAMETERS]
    pair = np.array([[numbers(side, name) for name in measured] for side in sides])
    moved = np.abs(pair[0] - pair[1]) / np.maximum(np.abs(pair).max(axis=0), 1e-300)
    gone = np.isnan(pair)
    moved[gone.any(axis=0)] = np.inf
    moved[gone.all(axis=0)] = 0.0
    before, after = (side["status"].to_numpy() for side in sides)
    cases = pd.DataFrame({"in status": before != after, "change": moved.max(axis=0)})
    cases["changed"] = cases["in status"] | (cases["change"] > tolerance)
    cases["lost"] = ((before == "ok") & (after != "ok")) | (~gone[0] & gone[1]).any(axis=0)
    only = len(first) - len(shared), len(second) - len(shared)
    return Comparison(names, sides, cases, only)
