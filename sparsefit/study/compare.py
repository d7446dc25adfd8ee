"""Two runs of a study held against each other: which cases changed, and whether for the worse.

Cases are the same where their ids are, else where `flight` and `identity` are. Of flights a case
changed where its status or a number of U0, L_w or tau_w did; of problems where its status did, and
whether a solver became slower is told by the ratio of its times over all problems.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.errors import InputError
from sparsefit.study import page, solver_times
from sparsefit.study.entries import grouped, level_text
from sparsefit.study.measures import PARAMETERS, factors, measure, numbers
from sparsefit.study.statistics import by_unit, difference, pooled, ratio
from sparsefit.study.table import Column, Table, Value, significant
from sparsefit.whole_file import write_files

KEYS = (("case_id",), ("flight", "identity"))
SHOWN = 30


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
        if self.of_problems:
            return self.restated
        moved: BoolArray = self.restated | (self.change > self.tolerance)
        return moved

    @property
    def differs(self) -> bool:
        """Whether anything changed, or a case is in one run alone."""
        return bool(self.changed.any()) or any(self.only)

    @property
    def sentence(self) -> str:
        """What changed, in a sentence."""
        said = f"{int(self.changed.sum())} of {len(self.first)} cases changed, "
        said += f"{int(self.restated.sum())} of them in status"
        if not self.of_problems:
            most = float(self.change[np.isfinite(self.change)].max(initial=0.0))
            said += f"; the largest change of a number is {significant(100.0 * most)} %"
        pairs = zip(self.only, self.names, strict=True)
        only = [f"{count} only in {name}" for count, name in pairs if count]
        return f"{'; '.join([said, *only])}."

    @property
    def tables(self) -> dict[str, Table]:
        """The table of settings, or solvers, and that of the cases that changed."""
        effects = self._solvers() if self.of_problems else self._settings()
        return {"effects": effects, "changes": self._changes()}

    @property
    def worse(self) -> bool:
        """Whether a case lost its answer, or a setting or solver is worse beyond its interval."""
        lost = (self.first["status"] == "ok") & ~self.second["status"].isin(["ok"])
        if not self.of_problems:
            answered = [np.isfinite(numbers(side, "est_timescale")) for side in
                     (self.first, self.second)]  # fmt: skip
            lost = pd.Series(answered[0] & ~answered[1])
        verdicts = (row[2] for row in self.tables["effects"].rows)
        return bool(lost.any()) or any(verdict in ("worse", "slower") for verdict in verdicts)

    def _settings(self) -> Table:
        """Return what changed in every setting, and whether its error did, paired by flight."""
        each = replace(measure("timescale-error"), summary="mean")
        names = ["protocol", "backend", "label", "settings", *factors(self.first)]
        before, after = each.values(self.first), each.values(self.second)
        rows: list[tuple[Value, ...]] = []
        for key, places in grouped(self.first, names):
            flights = self.first["flight"].iloc[places]
            order = pd.Index(flights.unique())
            grids = [by_unit(values[places], flights, order) for values in (after, before)]
            apart = difference(pooled(each.reduce), *grids)
            change = self.change[places]
            verdict = "tie"
            if apart.low > each.least:
                verdict = "worse"
            elif apart.high < -each.least:
                verdict = "better"
            labels = dict(zip(names, map(level_text, key), strict=True))
            levels = [labels[name] for name in factors(self.first)]
            title = ", ".join([labels["protocol"], labels["label"], *levels])
            rows.append((
                title, labels["settings"], verdict, len(places), int(self.changed[places].sum()),
                int(self.restated[places].sum()),
                100.0 * float(change[np.isfinite(change)].max(initial=0.0)),
                apart.effect, apart.low, apart.high,
            ))  # fmt: skip
        rows.sort(key=lambda row: not row[4])
        columns = (
            *map(Column, ("setting", "settings", "verdict")),
            *(Column(name, format="d") for name in ("n", "changed", "in status")),
            Column("largest change", "%", least=each.least),
            *(Column(name, "%", group="mean |error| of τ_w, second − first", least=each.least)
              for name in ("effect", "from", "to")),
        )  # fmt: skip
        note = f"First: {self.names[0]}; second: {self.names[1]}. 95 %: bootstrap over flights."
        return Table("What changed, setting by setting", columns, rows, (note,), SHOWN, 2)

    def _solvers(self) -> Table:
        """Return the ratio of the times of every solver, over problems, with its interval."""
        time, rows = solver_times.TIME, list[tuple[Value, ...]]()
        logs = np.log((self.second[time] / self.first[time]).to_numpy(float))
        for (objective, solver), places in grouped(self.first, ["objective", "solver"]):
            problem = self.first["problem"].iloc[places].to_numpy()
            means = pd.Series(logs[places]).groupby(problem).mean().dropna().to_numpy()
            middle, low, high = ratio(np.exp(means), np.ones(len(means)))
            verdict = "slower" if low > 1.0 else "faster" if high < 1.0 else "tie"
            verdict = verdict if low == low else "too few problems"
            rows.append((str(objective), str(solver), verdict, len(places),
                         int(self.restated[places].sum()), middle, low, high))  # fmt: skip
        columns = (
            *map(Column, ("objective", "solver", "verdict")), Column("cases", format="d"),
            Column("in status", format="d"),
            *(Column(name, group="time, second / first") for name in ("mean", "from", "to")),
        )  # fmt: skip
        note = f"First: {self.names[0]}; second: {self.names[1]}. Geometric mean over problems."
        return Table("What changed, solver by solver", columns, rows, (note,), 90, 2)

    def _changes(self) -> Table:
        """Return every case that changed, the largest change first."""
        places = np.flatnonzero(self.changed)
        places = places[np.argsort(-np.nan_to_num(self.change[places]), kind="stable")]
        label = "solver" if self.of_problems else "label"
        rows: list[tuple[Value, ...]] = [
            (str(self.first["case_id"].iloc[at]), str(self.first[label].iloc[at]),
             str(self.first["status"].iloc[at]), str(self.second["status"].iloc[at]),
             100.0 * float(self.change[at]))
            for at in places
        ]  # fmt: skip
        columns = (*map(Column, ("case", label)), Column("first", group="status"),
                   Column("second", group="status"), Column("change", "%"))  # fmt: skip
        return Table("Cases that changed", columns, rows, (), SHOWN, 2)

    def record(self) -> dict[str, Any]:
        """Return the comparison as JSON has it."""
        return {
            "summary": self.sentence, "cases": len(self.first), "changed": int(self.changed.sum()),
            "restated": int(self.restated.sum()), "only": list(self.only), "worse": self.worse,
            "tables": {name: each.record() for name, each in self.tables.items()},
        }  # fmt: skip


def compare(
    first: pd.DataFrame, second: pd.DataFrame, names: tuple[str, str], tolerance: float = 1e-9
) -> Comparison:
    """Pair the cases of two runs.

    Raises:
        InputError: if they are of two kinds, of other paths, or have no case in common.
    """
    kinds = ["objective" in cases for cases in (first, second)]
    if kinds[0] != kinds[1]:
        raise InputError(f"{names[0]} and {names[1]}: one holds flights, one problems: compare "
                         "two runs of one study")  # fmt: skip
    before, after, alone = _paired(first, second, names)
    if kinds[0]:
        for name in ("points", "settings", "tolerance"):
            if name in before and name in after and not _same(before[name], after[name]):
                raise InputError(f"{names[0]} and {names[1]} differ in {name}: their times are not "
                                 "of the same work; compare two runs of one study")  # fmt: skip
        time = solver_times.TIME
        change = np.abs((after[time] / before[time]).to_numpy(float) - 1.0)
    else:
        change = np.zeros(len(before))
        for name in PARAMETERS:
            pair = np.array([numbers(cases, f"est_{name}") for cases in (before, after)])
            size = np.maximum(np.abs(pair).max(axis=0), 1e-300)
            moved = np.abs(pair[0] - pair[1]) / size
            gone = np.isnan(pair)
            moved[gone.any(axis=0)] = np.inf
            moved[gone.all(axis=0)] = 0.0
            change = np.maximum(change, moved)
    return Comparison(names, before, after, alone, change, tolerance)


def _same(first: pd.Series, second: pd.Series) -> bool:
    return bool(((first == second) | (first.isna() & second.isna())).all())


def _paired(
    first: pd.DataFrame, second: pd.DataFrame, names: Sequence[str]
) -> tuple[pd.DataFrame, pd.DataFrame, tuple[int, int]]:
    """Return the cases that both runs have, row by row, and how many only one has."""
    for key in KEYS:
        if set(key) <= set(first.columns) & set(second.columns):
            places = [
                pd.MultiIndex.from_frame(cases[list(key)].astype(str)) for cases in (first, second)
            ]
            if not all(index.is_unique for index in places):
                continue
            shared = places[0][places[0].isin(places[1])]
            if len(shared):
                before, after = (
                    cases.iloc[index.get_indexer(shared)].reset_index(drop=True)
                    for cases, index in zip((first, second), places, strict=True)
                )
                return before, after, (len(first) - len(shared), len(second) - len(shared))
    raise InputError(
        f"{names[0]} and {names[1]} have no case in common: compare two runs of one study"
    )


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
    files["comparison.md"] = ("\n\n".join(part.strip() for part in parts) + "\n").encode()
    folder.mkdir(parents=True, exist_ok=True)
    return write_files(folder, files)
