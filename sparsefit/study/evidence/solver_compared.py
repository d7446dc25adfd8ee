"""Two runs of a study of solvers held against each other: who fails now, who became slower.

A case changed where its status did. No time is like another: whether a solver became slower is told
by the geometric mean over problems and tolerances of the ratio of its times, with an interval by
bootstrap over problems.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.compared import SHOWN, paired
from sparsefit.study.evidence.solver_measures import FEWEST, RESAMPLES
from sparsefit.study.evidence.table import SIGNIFICANT, Column, Table, Value

KEYS = (("case_id",), ("problem", "objective", "solver", "tolerance"))


@dataclass(frozen=True, eq=False)
class SolversCompared:
    """The cases that both runs have, row by row, and how many only one has.

    change: (rows,) how much longer the second took, relative to the first; NaN where one has no
    time.
    """

    names: tuple[str, str]
    first: pd.DataFrame
    second: pd.DataFrame
    only: tuple[int, int]

    @property
    def change(self) -> Array:
        """(rows,) the time of the second over that of the first, less 1; NaN without a time."""
        found: Array = (self.second["cpu"] / self.first["cpu"]).to_numpy(dtype=float) - 1.0
        return found

    @property
    def restated(self) -> BoolArray:
        """(rows,) whether the status is another."""
        return np.asarray(self.first["status"].to_numpy() != self.second["status"].to_numpy())

    @property
    def changed(self) -> BoolArray:
        """(rows,) the same: a time that differs is told of solvers, not of cases."""
        return self.restated

    @property
    def sentence(self) -> str:
        """What is the same and what is not."""
        verdicts = [row[-1] for row in solver_effects(self).rows]
        counted = ", ".join(f"{verdicts.count(word)} {word}" for word in ("slower", "faster"))
        only = [
            f"{count} only in {name}"
            for count, name in zip(self.only, self.names, strict=True)
            if count
        ]
        told = f"{int(self.restated.sum())} of {len(self.first)} cases changed in status"
        return "; ".join([told, f"{counted} of {len(verdicts)} solvers", *only]) + "."


def solvers_compared(
    first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str]
) -> SolversCompared:
    """Pair the cases of two runs.

    Raises:
        InputError: if they have no case in common.
    """
    return SolversCompared(names, *paired(first, second, names, KEYS))


def solver_effects(both: SolversCompared) -> Table:
    """Of every solver: cases that changed in status, and the ratio of its times."""
    rows: list[tuple[Value, ...]] = []
    pairs = list(zip(both.first["objective"], both.first["solver"], strict=True))
    for objective, solver in dict.fromkeys(pairs):
        places = np.array([at for at, pair in enumerate(pairs) if pair == (objective, solver)])
        ratio = 1.0 + both.change[places]
        timed = np.isfinite(ratio)
        middle, low, high = _mean(ratio[timed], both.first["problem"].to_numpy()[places][timed])
        restated = int(both.restated[places].sum())
        rows.append(
            (objective, solver, len(places), restated, middle, low, high, _verdict(low, high))
        )
    columns = (
        *(Column(name, align="left") for name in ("objective", "solver")),
        *(Column(name, format="d") for name in ("cases", "in status")),
        *(Column(name, format=SIGNIFICANT) for name in ("second / first", "95 % from", "to")),
        Column("verdict", align="left"),
    )
    note = (
        f"First: {both.names[0]}; second: {both.names[1]}. second / first: geometric mean of the "
        "CPU times of the cases that both have a time of; its 95 % interval by bootstrap over "
        f"problems, of {FEWEST} or more. Where it holds 1, a tie."
    )
    return Table("What changed, solver by solver", columns, tuple(rows), (note,))


def _mean(ratio: Array, problems: Array) -> tuple[float, float, float]:
    """The geometric mean of ratios, and its interval; NaN where there is none."""
    if not len(ratio):
        return np.nan, np.nan, np.nan
    logs = pd.Series(np.log(ratio)).groupby(problems).mean().to_numpy()
    middle = float(np.exp(logs.mean()))
    if len(logs) < FEWEST:
        return middle, np.nan, np.nan
    draw = np.random.default_rng(0).integers(len(logs), size=(RESAMPLES, len(logs)))
    low, high = np.exp(np.quantile(logs[draw].mean(axis=1), [0.025, 0.975]))
    return middle, float(low), float(high)


def _verdict(low: float, high: float) -> str:
    if low > 1.0:
        return "slower"
    if high < 1.0:
        return "faster"
    return "tie" if low == low else "too few problems"


def solver_changes(both: SolversCompared) -> Table:
    """Every case whose status changed."""
    at = np.flatnonzero(both.restated)
    told = ("case_id", "objective", "solver", "problem", "status")
    rows = [
        (*(str(both.first[name].iloc[one]) for name in told), str(both.second["status"].iloc[one]))
        for one in at
    ]
    names = ("case", "objective", "solver", "problem")
    columns = (
        *(Column(name, align="left") for name in names),
        *(Column(name, align="left", group="status") for name in ("first", "second")),
    )
    return Table("Cases that changed", columns, tuple(rows), (), SHOWN)


def solvers_worse(both: SolversCompared, effects: Table) -> bool:
    """Whether a solver became slower, beyond the interval, or a case is not ok any more.

    effects: the table of `solver_effects`.
    """
    lost = (both.first["status"] == "ok") & (both.second["status"] != "ok")
    return bool(lost.any()) or any(row[-1] == "slower" for row in effects.rows)
