"""Times of solvers to a certified accuracy, and their failures.

A solver solves a problem to an accuracy if, at one of its tolerances, the certified excess of its
answers is within it; its time is the least wall time of those tolerances. An unsolved problem has
an infinite time in performance profiles, and the limit of a solve in means. The unit is a problem.

Source: Dolan and More, Math. Program. 91 (2002) 201-213, for performance profiles.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.study.resampling import ratio
from sparsefit.study.table import Column, Row, Table, Value, significant

if TYPE_CHECKING:
    import pandas as pd

ACCURACIES, LIMIT, SHIFT = (1e-4, 1e-6, 1e-8), 10.0, 1e-3  # LIMIT [s] unless the frame says


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


def is_race(cases: pd.DataFrame) -> bool:
    """Return whether several solvers of one objective ran."""
    ran = cases[cases["status"] != "skipped"]
    return bool((ran.groupby("objective")["solver"].nunique() > 1).any())


def places(cases: pd.DataFrame) -> dict[str, int]:
    """Return the best rank of every solver over the objectives, 0 for the fastest."""
    best: dict[str, int] = {}
    for seconds in times_to(cases, accuracies(cases)[-1]).values():
        for place, name in enumerate(map(str, seconds)):
            best[name] = min(place, best.get(name, place))
    return best


def race(cases: pd.DataFrame, *levels: float) -> pd.DataFrame:
    """Return `seconds` and their `ratio` to the fastest by objective, accuracy, problem and solver.

    Both are infinite if the accuracy is not reached.
    """
    import pandas as pd

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
    columns, rows = [*map(Column, ("objective", "solver", "verdict"))], dict[Row, list[Value]]()
    for level in levels:
        to = f"to {accuracy_text(level)}"
        columns += [
            Column("solved", group=to), Column("mean time", "ms", group=to, varies=True),
            Column("× fastest", group=to, varies=True), Column("95 %", group=to, varies=True),
        ]  # fmt: skip
        for objective, seconds in times_to(cases, level).items():
            charged = seconds.clip(upper=limit)
            for place, name in enumerate(seconds):
                own, solved = charged[name], np.isfinite(seconds[name])
                middle, low, high = ratio(own.to_numpy(), charged.iloc[:, 0].to_numpy())
                is_sure = place > 0 and not math.isnan(low)
                verdict = ("slower" if low > 1.0 else "tie") if is_sure else "too few problems"
                if not place or not solved.any():
                    verdict = "fastest" if solved.any() else "solved none"
                rows.setdefault((objective, str(name)), [verdict]).extend([
                    f"{solved.sum()}/{len(own)}",
                    1e3 * float(np.exp(np.log(own + SHIFT).mean()) - SHIFT),
                    f"{'' if solved.all() else '≥ '}{significant(middle)}",
                    f"{significant(low)} … {significant(high)}" if is_sure else "–",
                ])  # fmt: skip
            absent = cases[(cases["objective"] == objective) & (cases["status"] == "skipped")]
            for name in absent["solver"].unique():
                rows[objective, str(name)] = ["missing", *[None] * (4 * len(levels))]
    note = (
        "solved: problems with a certified excess, relative to the objective at zero, within the "
        f"accuracy. mean time: geometric mean of wall times, shifted by {1e3 * SHIFT:g} ms; an "
        f"unsolved problem counts as the limit, {limit:g} s, and makes × fastest a lower bound (≥)."
        f" 95 %: interval of × fastest over problems. Verdict: to {accuracy_text(levels[0])}."
    )
    every = [(*key, *cells) for key, cells in rows.items()]
    return Table("Solvers: success and time", tuple(columns), every, (note,))


def failures(cases: pd.DataFrame) -> Table:
    """Return the failures by solver, status and reason; numbers in a reason may differ."""
    bad = cases[~cases["status"].isin(["ok", "skipped"])]
    alike = bad["reason"].str.replace(r"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", "#", regex=True)
    rows: list[Row] = []
    keys = [bad["objective"], bad["solver"], bad["status"], alike]
    for key, here in bad.groupby(keys, sort=False):
        names = list(here["problem"].unique())
        words = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        rows.append((*map(str, key[:3]), len(here), words, str(here["reason"].iloc[0])))
    rows.sort(key=lambda row: -int(row[3] or 0))
    heads = ("objective", "solver", "status", "cases", "problems", "reason of the first")
    return Table("Who failed where", tuple(map(Column, heads)), rows)


def headline(cases: pd.DataFrame) -> Iterator[str]:
    """Give a sentence per objective: the fastest solver to the strictest accuracy, and its lead."""
    to, rows = accuracy_text(accuracies(cases)[-1]), summary(cases).rows
    rivals = [row for row in rows if not str(row[1]).endswith(", certified")]  # timed with checks
    for objective, group in itertools.groupby(rivals, key=lambda row: row[0]):
        (_, first, verdict, solved, *_), *others = (tuple(map(str, row)) for row in group)
        if verdict in ("missing", "solved none"):
            yield f"{objective}: no solver solves a problem to a certified {to}."
            continue
        said = f"{objective}: {first} is fastest to a certified {to}"
        said += f" and solves {solved.replace('/', ' of ')} problems"
        for _, second, verdict, _, _, times, ends, *_ in others[:1]:
            if verdict != "missing":
                said += f"; {second} takes {times.replace('≥', 'at least')} times as long"
                said += f" ({ends.replace('…', 'to')})" if ends != "–" else ""
        yield f"{said}."
