"""Two runs of a study held against each other: which cases changed, and by how much.

Cases are the same where their ids are, else where `flight` and `identity` are. A case changed where
its status did, or a number: of flights U0, L_w and tau_w, of problems the held-out error. No time
is like another: they are not compared.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.errors import InputError
from sparsefit.study.columns import PARAMETERS
from sparsefit.study.entries import grouped
from sparsefit.study.measures import factors, measure, numbers
from sparsefit.study.table import Table, significant

TOLERANCE = 1e-6  # of a number: what changed by less is the same
SIDES = ("first", "second")


@dataclass(frozen=True, eq=False)
class Comparison:
    """The cases that both runs have, row by row, and how many only one has.

    sides: the cases of either run. cases: `change`, the largest relative change of a number [%],
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
        """The settings of which a case changed, and those cases, the largest change first."""
        sides, first = dict(zip(SIDES, self.sides, strict=True)), self.sides[0]
        of_problems, rows, words = "objective" in first, list[dict[str, Any]](), dict[Any, str]()
        each = measure("mean holdout-error" if of_problems else "mean timescale-size")
        names = ["objective", "solver"] if of_problems else ["protocol", "label", *factors(first)]
        for backend, texts in first.groupby("backend")["settings"]:
            every = {text: json.loads(text) for text in texts.unique()}
            varied = [key for key in next(iter(every.values()))
                      if len({str(own.get(key)) for own in every.values()}) > 1]  # fmt: skip
            words |= {(backend, text): ", ".join(f"{key}={own.get(key)}" for key in varied)
                      for text, own in every.items()}  # fmt: skip
        for key, places in grouped(first, [*names, "backend", "settings"]):
            here = self.cases.iloc[places]
            errors = {f"{each.phrase} [%], {name}": each.summary_of(each.read(side)[places])
                      for name, side in sides.items()}  # fmt: skip
            if here["changed"].any():
                rows.append({
                    **dict(zip(names, key, strict=False)), "settings": words[key[-2:]],
                    "n": len(places), **here[["changed", "in status", "lost"]].sum(),
                    "largest change [%]": _largest(here), **errors,
                })  # fmt: skip
        settings = pd.DataFrame(rows).dropna(axis=1, how="all")
        notes = [f"{name}: {run}" for name, run in zip(SIDES, self.names, strict=True)]
        settings.attrs.update(title="Settings of which cases changed", notes=["; ".join(notes)])
        changes = pd.DataFrame({
            "case": first["case_id"], names[1]: first[names[1]],
            **{f"status, {name}": side["status"] for name, side in sides.items()},
            "change [%]": self.cases["change"],
        })[self.cases["changed"]]  # fmt: skip
        changes = changes.sort_values("change [%]", ascending=False, kind="stable")
        changes.attrs["title"] = "Cases that changed"
        return {"settings": Table.of(settings), "changes": Table.of(changes)}

    def record(self) -> dict[str, Any]:
        """Return the comparison as JSON has it."""
        counted = {"changed": "changed", "restated": "in status", "lost": "lost"}
        return {
            "summary": self.sentence, "cases": len(self.cases),
            **{key: int(self.cases[name].sum()) for key, name in counted.items()},
            "only": list(self.only),
            "tables": {name: each.record() for name, each in self.tables.items()},
        }  # fmt: skip


def _largest(cases: pd.DataFrame) -> float:
    """Return the largest finite change [%]."""
    return float(cases["change"][np.isfinite(cases["change"])].max() if len(cases) else 0.0)


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
    cases = pd.DataFrame({"in status": before != after, "change": 100.0 * moved.max(axis=0)})
    cases["changed"] = cases["in status"] | (cases["change"] > 100.0 * tolerance)
    cases["lost"] = ((before == "ok") & (after != "ok")) | (~gone[0] & gone[1]).any(axis=0)
    only = len(first) - len(shared), len(second) - len(shared)
    return Comparison(names, sides, cases, only)
