"""Times of solvers to a certified accuracy, and their failures.

A solver solves a problem to an accuracy if, at one of its tolerances, the certified excess of its
answers is within it; its time is the least wall time of those tolerances. An unsolved problem has
an infinite time in performance profiles, and the limit of a solve in means. The unit is a problem.

Source: Dolan and More, Math. Program. 91 (2002) 201-213, for performance profiles.
"""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.arena import ACCURACIES
from sparsefit.study.measures import interval, mean
from sparsefit.study.table import Column, Table, Value, significant

LIMIT, SHIFT = 10.0, 1e-3  # [s]; LIMIT unless the frame says


def accuracies(cases: pd.DataFrame) -> tuple[float, ...]:
    """Return the accuracies at which success is counted, down to the tolerance of every solver.

    Below the smallest tolerance of a solver, a failure would be one of the study.
    """
    tried = cases.loc[(cases["status"] != "skipped") & cases["tolerance"].notna()]
    strictest = tried.groupby(["objective", "solver"])["tolerance"].min().max()
    fair = tuple(level for level in ACCURACIES if not level < strictest * (1.0 - 1e-9))
    return fair or ACCURACIES[:1]


def accuracy_text(accuracy: float) -> str:
    """Return an accuracy as text, `1e-8`."""
    return f"{accuracy:.0e}".replace("e-0", "e-")


def times_to(cases: pd.DataFrame, accuracy: float) -> dict[str, pd.DataFrame]:
    """Return times [s] to an accuracy by objective, infinite if it is not reached.

    Rows are problems, columns the solvers that ran, ordered by the geometric mean.
    """
    every = {}
    for objective, here in cases.groupby("objective", sort=False):
        ran = here[here["status"] != "skipped"]
        reached = ran[ran["excess"].le(accuracy)]
        best = reached.groupby(["problem", "solver"])["wall"].min().unstack()
        best = best.reindex(index=here["problem"].unique(), columns=ran["solver"].unique())
        best = best.fillna(math.inf)
        order = np.log(best.clip(upper=1e6)).mean().sort_values(kind="stable").index
        every[str(objective)] = best[order]
    return every


def ratio(numerator: Array, denominator: Array) -> tuple[float, float, float]:
    """Return the geometric mean of paired ratios (n,) and its 95 % interval over the pairs.

    Pairs with a value that is not finite are excluded; with fewer than five the interval is NaN.
    """
    logs = np.log(numerator) - np.log(denominator)
    logs = logs[np.isfinite(logs)]
    if not len(logs):
        return math.nan, math.nan, math.nan
    low, high = interval(mean, logs[:, None]) if len(logs) >= 5 else (math.nan, math.nan)
    return math.exp(logs.mean()), math.exp(low), math.exp(high)


def is_race(cases: pd.DataFrame) -> bool:
    """Return whether several solvers of one objective ran."""
    ran = cases[cases["status"] != "skipped"]
    return bool((ran.groupby("objective")["solver"].nunique() > 1).any())


def race(cases: pd.DataFrame, *levels: float) -> pd.DataFrame:
    """Return `seconds` and their `ratio` to the fastest by objective, accuracy, problem and solver.

    Both are infinite if the accuracy is not reached.
    """
    parts = []
    for level in levels or accuracies(cases):
        for objective, seconds in times_to(cases, level).items():
            part = pd.DataFrame({"seconds": seconds.stack()})
            best = part["seconds"].groupby(level=0).transform("min")
            part["ratio"] = (part["seconds"] / best).fillna(math.inf)
            to = f"to {accuracy_text(level)}"
            parts.append(part.reset_index().assign(objective=objective, accuracy=to))
    return pd.concat(parts, ignore_index=True)


def summary(cases: pd.DataFrame) -> Table:
    """Return verdict, success, mean time and ratio to the fastest by objective and solver."""
    levels = accuracies(cases)[::-1]  # the strictest first: it gives order and verdict
    limit = cases.attrs.get("limit", LIMIT)
    every = list[dict[Column, Value]]()
    for objective, here in cases.groupby("objective", sort=False):
        rows = dict[str, dict[Column, Value]]()
        for level in levels:
            to, (seconds,) = f"to {accuracy_text(level)}", times_to(here, level).values()
            charged = seconds.clip(upper=limit).to_numpy().T
            for place, (name, own) in enumerate(zip(seconds, charged, strict=True)):
                solved = np.isfinite(seconds[name])
                middle, low, high = ratio(own, charged[0])
                is_sure = place > 0 and not math.isnan(low)
                verdict = ("slower" if low > 1.0 else "tie") if is_sure else "too few problems"
                if not place or not solved.any():
                    verdict = "fastest" if solved.any() else "solved none"
                mean = 1e3 * float(np.exp(np.log(own + SHIFT).mean()) - SHIFT)
                times = f"{'' if solved.all() else '≥ '}{significant(middle)}"
                ends = f"{significant(low)} … {significant(high)}" if is_sure else "–"
                rows.setdefault(str(name), {Column("verdict"): verdict}).update({
                    Column("solved", group=to): f"{solved.sum()}/{len(own)}",
                    Column("mean time", "ms", group=to, varies=True): mean,
                    Column("× fastest", group=to, varies=True): times,
                    Column("95 %", group=to, varies=True): ends,
                })  # fmt: skip
        for name in here.loc[here["status"] == "skipped", "solver"]:
            rows.setdefault(name, {Column("verdict"): "missing"})
        every += [{Column("objective"): str(objective), Column("solver"): name, **row}
                  for name, row in rows.items()]  # fmt: skip
    note = (
        "solved: problems with a certified excess, relative to the objective at zero, within the "
        f"accuracy. mean time: geometric mean of wall times, shifted by {1e3 * SHIFT:g} ms; an "
        f"unsolved problem counts as the limit, {limit:g} s, and makes × fastest a lower bound (≥)."
        f" 95 %: interval of × fastest over problems. Verdict: to {accuracy_text(levels[0])}."
    )
    return Table.of_cells("Solvers: success and time", every, (note,))


def headline(cases: pd.DataFrame) -> str:
    """Return the fastest solvers to the strictest accuracy, and by how much, in a sentence."""
    strictest, fastest = accuracies(cases)[-1], dict[str, list[str]]()
    limit, leads, least = cases.attrs.get("limit", LIMIT), list[float](), ""
    for objective, seconds in times_to(cases, strictest).items():
        rivals = seconds[[name for name in seconds if not str(name).endswith(", certified")]]
        first, *others = rivals
        if not np.isfinite(rivals[first]).any():
            fastest.setdefault("none", []).append(objective)
            continue
        fastest.setdefault(str(first), []).append(objective)
        for second in others[:1]:
            charged = rivals[[second, first]].clip(upper=limit).to_numpy().T
            leads.append(ratio(*charged)[0])
            least = least if np.isfinite(rivals[second]).all() else "at least "
    words = ", ".join(f"{solver} ({'; '.join(names)})" for solver, names in fastest.items())
    ends = " to ".join(dict.fromkeys(map(significant, (min(leads), max(leads))))) if leads else ""
    slower = f"; the second takes {least}{ends} times as long" if leads else ""
    return f"Fastest to a certified {accuracy_text(strictest)}: {words}{slower}."
