"""Two runs of a study held against each other: which cases changed, and whether for the worse.

Cases are the same where their ids are, else where `flight` and `identity` are. Of flights a case
changed where its status or a number of U0, L_w or tau_w did; of problems where its status did. A
setting is judged by the mean error of tau_w, a solver by the mean logarithm of its time, each
paired by unit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError
from sparsefit.study import page
from sparsefit.study.entries import grouped, level_text
from sparsefit.study.measures import PARAMETERS, factors, measure, numbers
from sparsefit.study.resampling import by_unit, difference, pooled
from sparsefit.study.table import Column, Row, Table, significant
from sparsefit.whole_file import write_files

SHOWN = 30  # rows of a table of a page


@dataclass(frozen=True, eq=False)
class Comparison:
    """The cases that both runs have, row by row, and how many only one has.

    change: (rows,) the largest relative change of U0, L_w and tau_w, infinite where one run has no
    number; of problems that of the time on the wall. tolerance: what counts as a change.
    """

    names: tuple[str, str]
    first: pd.DataFrame
    second: pd.DataFrame
    only: tuple[int, int]
    change: Array
    tolerance: float

    @property
    def of_problems(self) -> bool:
        """Whether the runs are of regression problems."""
        return "objective" in self.first

    @property
    def restated(self) -> BoolArray:
        """Whether the status of each case is another, (rows,)."""
        return np.asarray(self.first["status"].to_numpy() != self.second["status"].to_numpy())

    @property
    def changed(self) -> BoolArray:
        """Whether each case changed, (rows,); no time of a solver is like another."""
        moved = np.zeros_like(self.restated) if self.of_problems else self.change > self.tolerance
        return np.asarray(self.restated | moved)

    @property
    def differs(self) -> bool:
        """Whether a case changed, or is in one run alone."""
        return bool(self.changed.any()) or any(self.only)

    @property
    def sentence(self) -> str:
        """The numbers of changed cases and the largest change, in a sentence."""
        said = f"{int(self.changed.sum())} of {len(self.first)} cases changed, "
        said += f"{int(self.restated.sum())} of them in status"
        if not self.of_problems:
            said += f"; the largest change of a number is {significant(_largest(self.change))} %"
        pairs = zip(self.only, self.names, strict=True)
        only = [f"{count} only in {name}" for count, name in pairs if count]
        return f"{'; '.join([said, *only])}."

    @property
    def tables(self) -> dict[str, Table]:
        """The table of settings, or solvers, and that of the cases that changed."""
        return {"effects": self._effects(), "changes": self._changes()}

    @property
    def worse(self) -> bool:
        """Whether a case lost its answer, or a setting or solver is worse beyond its interval."""
        lost = (self.first["status"] == "ok") & (self.second["status"] != "ok")
        has = [np.isfinite(numbers(side, "est_timescale")) for side in (self.first, self.second)]
        rows = self._effects().rows
        return bool(lost.any() or (has[0] & ~has[1]).any()) or any(
            row[2] == "worse" for row in rows
        )

    def _effects(self) -> Table:
        """Return what changed in every setting, or solver, and whether its measure did."""
        if self.of_problems:
            each, names = measure("mean wall"), ["objective", "solver"]
            sides = [np.log(numbers(side, "wall")) for side in (self.second, self.first)]
            words, unit, least = "time, second / first", "", 0.0
        else:
            each = measure("mean timescale-error")
            names = ["protocol", "label", *factors(self.first), "backend", "settings"]
            sides = [each.values(side) for side in (self.second, self.first)]
            words, unit, least = "mean |error| of τ_w, second − first", each.unit, each.least
        rows: list[Row] = []
        for key, places in grouped(self.first, names):
            flights = self.first["flight"].iloc[places]
            order = pd.Index(flights.unique())
            grids = [by_unit(values[places], flights, order) for values in sides]
            apart = difference(pooled(each.reduce), *grids)
            verdict = "worse" if apart.low > least else "better" if apart.high < -least else "tie"
            head = [", ".join(map(level_text, key[:-2])), level_text(key[-1])]
            if self.of_problems:
                head = list(map(level_text, key))
            rows.append((
                *head, verdict, len(places), int(self.changed[places].sum()),
                int(self.restated[places].sum()), _largest(self.change[places]),
                *(math.exp(value) if self.of_problems else value
                  for value in (apart.effect, apart.low, apart.high)),
            ))  # fmt: skip
        rows.sort(key=lambda row: not row[4])
        columns = (
            *map(Column, names if self.of_problems else ("setting", "settings")),
            Column("verdict"),
            *(Column(name, format="d") for name in ("n", "changed", "in status")),
            Column("largest change", "%", least=least),
            *(Column(name, unit, group=words, least=least) for name in ("effect", "from", "to")),
        )  # fmt: skip
        note = f"First: {self.names[0]}; second: {self.names[1]}. 95 %: bootstrap over units."
        return Table(
            f"What changed, {columns[1].name} by {columns[1].name}", columns, rows, (note,)
        )

    def _changes(self) -> Table:
        """Return every case that changed, the largest change first."""
        places = np.flatnonzero(self.changed)
        places = places[np.argsort(-np.nan_to_num(self.change[places]), kind="stable")]
        label = "solver" if self.of_problems else "label"
        kept = [self.first["case_id"], self.first[label], self.first["status"],
                self.second["status"]]  # fmt: skip
        rows: list[Row] = [
            (*(str(column.iloc[at]) for column in kept), 100.0 * float(self.change[at]))
            for at in places
        ]
        columns = (*map(Column, ("case", label)), Column("first", group="status"),
                   Column("second", group="status"), Column("change", "%"))  # fmt: skip
        return Table("Cases that changed", columns, rows)

    def record(self) -> dict[str, Any]:
        """Return the comparison as JSON has it."""
        return {
            "summary": self.sentence, "cases": len(self.first), "changed": int(self.changed.sum()),
            "restated": int(self.restated.sum()), "only": list(self.only), "worse": self.worse,
            "tables": {name: each.record() for name, each in self.tables.items()},
        }  # fmt: skip


def _largest(change: Array) -> float:
    """Return the largest finite change of (n,), in percent."""
    return 100.0 * float(change[np.isfinite(change)].max(initial=0.0))


def compare(
    first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str], tolerance: float = 1e-9
) -> Comparison:
    """Pair the cases of two runs.

    Raises:
        InputError: if they are of two kinds, of other paths, or have no case in common.
    """
    runs, both = (first, second), f"{names[0]} and {names[1]}"
    of_problems = ["objective" in cases for cases in runs]
    if of_problems[0] != of_problems[1]:
        raise InputError(f"{both}: one holds flights, one problems: compare two runs of one study")
    for key in (["case_id"], ["flight", "identity"]):
        if not all(set(key) <= set(cases) for cases in runs):
            continue
        index = [pd.MultiIndex.from_frame(cases[key].astype(str)) for cases in runs]
        shared = index[0][index[0].isin(index[1])]
        if len(shared) and all(each.is_unique for each in index):
            break
    else:
        raise InputError(f"{both} have no case in common: compare two runs of one study")
    before, after = (
        cases.iloc[each.get_indexer(shared)].reset_index(drop=True)
        for cases, each in zip(runs, index, strict=True)
    )
    for name in ("points", "settings", "tolerance") if of_problems[0] else ():
        if name in before and name in after and not before[name].equals(after[name]):
            raise InputError(f"{both} differ in {name}: their times are not of the same work; "
                             "compare two runs of one study")  # fmt: skip
    measured = ["wall"] if of_problems[0] else [f"est_{name}" for name in PARAMETERS]
    pair = np.array([[numbers(cases, name) for name in measured] for cases in (before, after)])
    size = pair[0] if of_problems[0] else np.maximum(np.abs(pair).max(axis=0), 1e-300)
    moved, gone = np.abs(pair[0] - pair[1]) / size, np.isnan(pair)
    moved[gone.any(axis=0)] = np.inf
    moved[gone.all(axis=0)] = 0.0
    only = len(first) - len(shared), len(second) - len(shared)
    return Comparison(names, before, after, only, moved.max(axis=0), tolerance)


def write_comparison(comparison: Comparison, folder: Path) -> list[Path]:
    """Write the tables as CSV, comparison.html and comparison.md, the last."""
    made = comparison.tables
    files = {f"{name}.csv": each.to_csv().encode() for name, each in made.items()}
    title = f"{comparison.names[0]} and {comparison.names[1]}"
    sections = [page.Section("Tables", list(made.values()))]
    files["comparison.html"] = page.to_html(title, title, [comparison.sentence], sections).encode()
    parts = [
        f"# {title}",
        comparison.sentence,
        *(each.to_markdown(SHOWN) for each in made.values()),
    ]
    files["comparison.md"] = page.joined(parts)
    folder.mkdir(parents=True, exist_ok=True)
    return write_files(folder, files)
