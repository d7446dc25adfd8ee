"""Times of solvers to a certified accuracy: who solves what, how fast, and who fails.

A solver solves a problem to an accuracy if one of its tolerances gives answers whose certified
excess is within it; its time is the least of those, on the wall. What is not solved takes
infinitely long in profiles, and the limit of a solve in means. The unit is a problem.

Sources: Dolan and More, Math. Program. 91 (2002) 201-213, for performance profiles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.statistics import ratio, shifted_mean
from sparsefit.study.table import Column, Table, Value, significant

MISSING = "skipped"
CLOCK = {"accuracies": (1e-4, 1e-6, 1e-8), "limit": 10.0, "shift": 1e-3}  # unless the frame says
TIME = "wall"
CHARGED = ", certified"  # ends the name of a solver that is timed with its certificates too


@dataclass(frozen=True, eq=False)
class Times:
    """Seconds (problems, solvers) to one accuracy of one objective, infinite where unsolved."""

    objective: str
    accuracy: float
    problems: tuple[str, ...]
    solvers: tuple[str, ...]
    seconds: Array

    @property
    def solved(self) -> BoolArray:
        """Whether each solver solves each problem, (problems, solvers)."""
        return np.isfinite(self.seconds)

    @property
    def ratios(self) -> Array:
        """Times over those of the fastest solver of each problem; infinite where unsolved."""
        best = np.min(self.seconds, axis=1, initial=np.inf, keepdims=True)
        with np.errstate(invalid="ignore"):
            return np.where(self.solved, self.seconds / best, np.inf)

    @property
    def rivals(self) -> list[int]:
        """The places of the solvers in `order`, without those that stand there twice."""
        return [at for at in self.order if not self.solvers[at].endswith(CHARGED)]

    @property
    def order(self) -> list[int]:
        """The places of the solvers by the geometric mean of their times, the fastest first."""
        logs = np.log(np.minimum(self.seconds, 1e6)).mean(axis=0)
        order: list[int] = np.argsort(logs, kind="stable").tolist()
        return order


def clock_of(cases: pd.DataFrame, name: str) -> float:
    """Return the limit or the shift [s] of the clock, as the frame carries it."""
    return float(cases.attrs.get(name, CLOCK[name]))


def accuracies(cases: pd.DataFrame) -> tuple[float, ...]:
    """Return the accuracies at which success is counted, down to what every solver was asked for.

    An accuracy below the least tolerance of a solver would tell of the study and not of the solver.
    """
    every = tuple(cases.attrs.get("accuracies", CLOCK["accuracies"]))
    tried = cases.loc[(cases["status"] != MISSING) & cases["tolerance"].notna()]
    strictest = tried.groupby(["objective", "solver"])["tolerance"].min().max()
    fair = tuple(level for level in every if not level < strictest * (1.0 - 1e-9))
    return fair or every[:1]


def level_text(accuracy: float) -> str:
    """Return an accuracy as it is written, `1e-8`."""
    return f"{accuracy:.0e}".replace("e-0", "e-")


def objectives(cases: pd.DataFrame) -> list[str]:
    """Return the objectives, in the order of the cases."""
    return list(dict.fromkeys(map(str, cases["objective"])))


def times_to(cases: pd.DataFrame, objective: str, accuracy: float) -> Times:
    """Return the times to an accuracy of every solver that ran for an objective."""
    here = cases[cases["objective"] == objective]
    ran = here[here["status"] != MISSING]
    reached = ran[ran["excess"].le(accuracy) & ran[TIME].notna()]
    problems, solvers = here["problem"].unique().tolist(), ran["solver"].unique().tolist()
    best = reached.groupby(["problem", "solver"])[TIME].min().unstack()
    seconds = best.reindex(index=problems, columns=solvers).to_numpy(float)
    return Times(objective, accuracy, tuple(problems), tuple(solvers),
                 np.where(np.isnan(seconds), np.inf, seconds))  # fmt: skip


def summary(cases: pd.DataFrame) -> Table:
    """Return each solver of each objective: verdict, success, mean time, times the fastest."""
    levels, limit, shift = accuracies(cases), clock_of(cases, "limit"), clock_of(cases, "shift")
    rows: list[tuple[Value, ...]] = []
    for objective in objectives(cases):
        at = [times_to(cases, objective, level) for level in levels]
        last = at[-1]
        means = [1e3 * shifted_mean(each.seconds, shift, limit) for each in at]
        charged = np.minimum(last.seconds, limit)
        for rank, place in enumerate(last.order):
            middle, low, high = ratio(charged[:, place], charged[:, last.order[0]])
            ends = "–" if math.isnan(low) else f"{significant(low)} … {significant(high)}"
            bound = "" if last.solved[:, place].all() else "≥ "
            rows.append((
                objective, last.solvers[place], _verdict(last, place, rank, low),
                *(f"{int(each.solved[:, place].sum())}/{len(each.problems)}" for each in at),
                *(float(mean[place]) for mean in means), f"{bound}{significant(middle)}",
                ends if rank else "–",
            ))  # fmt: skip
        nothing: list[Value] = [None] * (2 * len(levels) + 2)
        rows += [(objective, name, "missing", *nothing) for name in _missing(cases, objective)]
    columns = (
        *map(Column, ("objective", "solver", "verdict")),
        *(Column(level_text(level), group="solved to") for level in levels),
        *(Column(level_text(level), "ms", group="mean time to", varies=True) for level in levels),
        Column("× fastest", varies=True),
        Column("95 %", varies=True),
    )
    notes = (
        "solved: problems whose answers are certified to lie within that share of the objective "
        f"at zero above its minimum. mean time: geometric, shifted by {1e3 * shift:g} ms, on the "
        f"wall; what is not solved counts as the limit, {limit:g} s, and makes × fastest a bound "
        f"(≥). × fastest: to {level_text(levels[-1])}, with its interval over problems.",
    )
    return Table("Solvers: success and time", columns, rows, notes, 90, 2)


def _verdict(times: Times, place: int, rank: int, low: float) -> str:
    if not times.solved[:, place].any():
        return "solved none"
    if rank == 0:
        return "fastest"
    if math.isnan(low):
        return "too few problems"
    return "tie" if low <= 1.0 else "slower"


def _missing(cases: pd.DataFrame, objective: str) -> list[str]:
    absent = cases[(cases["objective"] == objective) & (cases["status"] == MISSING)]
    return list(dict.fromkeys(map(str, absent["solver"])))


def winners(cases: pd.DataFrame) -> Table:
    """Return the fastest solver of every problem by its shape, and the next one behind it."""
    shapes = cases.drop_duplicates("problem").set_index("problem")
    strict = accuracies(cases)[-1]
    rows: list[tuple[Value, ...]] = []
    for objective in objectives(cases):
        times = times_to(cases, objective, strict)
        for problem, seconds in zip(times.problems, times.seconds, strict=True):
            samples, columns = (int(shapes[name][problem]) for name in ("samples", "columns"))
            shape = f"{samples} × {columns}"
            rivals = sorted(times.rivals, key=lambda at: float(seconds[at]))
            first, *others = rivals or [0]
            if not rivals or math.isinf(seconds[first]):
                rows.append((objective, problem, shape, "nobody", None, None, None))
                continue
            second = others[0] if others else None
            ahead = None
            if second is not None:
                limit = clock_of(cases, "limit")
                behind = significant(min(seconds[second], limit) / seconds[first])
                ahead = behind if np.isfinite(seconds[second]) else f"≥ {behind}"
            rows.append((objective, problem, shape, times.solvers[first], 1e3 * seconds[first],
                         None if second is None else times.solvers[second], ahead))  # fmt: skip
    heads = (
        *map(Column, ("objective", "problem", "samples × columns", "fastest")),
        Column("time", "ms", varies=True), Column("next", varies=True),
        Column("next / fastest", varies=True),
    )  # fmt: skip
    return Table(f"The fastest by shape, to {level_text(strict)}", heads, rows, (), 90, 4)


def failures(cases: pd.DataFrame) -> Table:
    """Return who failed where, by status and reason; the numbers in a reason may differ."""
    bad = cases[~cases["status"].isin(["ok", MISSING])]
    alike = bad["reason"].str.replace(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", regex=True)
    rows: list[tuple[Value, ...]] = []
    keys = [bad["objective"], bad["solver"], bad["status"], alike]
    for (objective, solver, status, _), here in bad.groupby(keys, sort=False):
        names = list(dict.fromkeys(map(str, here["problem"])))
        words = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        labels = (str(objective), str(solver), str(status))
        rows.append((*labels, len(here), words, str(here["reason"].iloc[0])))
    rows.sort(key=lambda row: -int(row[3] or 0))
    heads = ("objective", "solver", "status", "cases", "problems", "reason of the first")
    return Table("Who failed where", tuple(map(Column, heads)), rows, (), 40, 3)


def clock(cases: pd.DataFrame) -> Table:
    """Return what the clock saw of each solver: first call, memory, repeats, disturbance."""
    timed = cases[cases["repeats"] > 0]
    rows: list[tuple[Value, ...]] = [
        (
            str(solver), float(here["first"].max()), float(here["memory"].max()), len(here),
            float(here["repeats"].median()), f"{int(here['known'].sum())}/{len(here)}",
            int(here["disturbed"].sum()), float((here["cpu"] / here["wall"]).median()),
        )
        for (solver,), here in timed.groupby(["solver"], sort=False)
    ]  # fmt: skip
    columns = (
        Column("solver"), Column("first call", "s", varies=True),
        Column("peak memory", "MB", ".0f", varies=True), Column("cases", format="d"),
        Column("repeats", format=".0f", varies=True), Column("median known", varies=True),
        Column("disturbed", format="d", varies=True), Column("CPU / wall", format=".2f",
                                                             varies=True),
    )  # fmt: skip
    note = "first call: imports and compilation, in no other time. CPU / wall above 1: threads."
    return Table("The clock", columns, rows, (note,))


def headline(cases: pd.DataFrame) -> Iterator[str]:
    """Give a sentence per objective: who is fastest to the strictest accuracy, and by how much."""
    strict, limit = accuracies(cases)[-1], clock_of(cases, "limit")
    for objective in objectives(cases):
        times = times_to(cases, objective, strict)
        if not times.solved.any():
            yield f"{objective}: no solver solves any problem to a certified {level_text(strict)}."
            continue
        first, *others = times.rivals
        count = f"{int(times.solved[:, first].sum())} of {len(times.problems)}"
        said = f"{objective}: {times.solvers[first]} is fastest to a certified {level_text(strict)}"
        said += f" and solves {count} problems"
        if others:
            charged = np.minimum(times.seconds, limit)
            middle, low, high = ratio(charged[:, others[0]], charged[:, first])
            bound = "" if times.solved[:, others[0]].all() else "at least "
            said += f"; {times.solvers[others[0]]} takes {bound}{significant(middle)} times as long"
            if not math.isnan(low):
                said += f" ({significant(low)} to {significant(high)})"
        yield f"{said}."
