"""Times of solvers to a certified accuracy: who solves what, how fast, and who fails.

A solver solves a problem to an accuracy if one of its tolerances gives answers whose certified
excess is within it; its time is the least of those, on the wall. What is not solved takes
infinitely long in profiles, and the limit of a solve in means. The unit is a problem.

Sources: Dolan and More, Math. Program. 91 (2002) 201-213, for performance profiles.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array
from sparsefit.study.resampling import ratio
from sparsefit.study.table import Column, Row, Table, Value, significant

if TYPE_CHECKING:
    import pandas as pd

ACCURACIES, LIMIT, SHIFT = (1e-4, 1e-6, 1e-8), 10.0, 1e-3  # [s], unless the frame says
CHARGED = ", certified"  # ends the name of a solver that is timed with its certificates too


def accuracies(cases: pd.DataFrame) -> tuple[float, ...]:
    """Return the accuracies at which success is counted, down to what every solver was asked for.

    An accuracy below the least tolerance of a solver would tell of the study and not of the solver.
    """
    every = tuple(cases.attrs.get("accuracies", ACCURACIES))
    tried = cases.loc[(cases["status"] != "skipped") & cases["tolerance"].notna()]
    strictest = tried.groupby(["objective", "solver"])["tolerance"].min().max()
    fair = tuple(level for level in every if not level < strictest * (1.0 - 1e-9))
    return fair or every[:1]


def accuracy_text(accuracy: float) -> str:
    """Return an accuracy as it is written, `1e-8`."""
    return f"{accuracy:.0e}".replace("e-0", "e-")


def times_to(cases: pd.DataFrame, accuracy: float) -> Iterator[tuple[str, pd.DataFrame]]:
    """Give every objective with the seconds to an accuracy, infinite where it is not reached.

    A row is a problem, a column a solver that ran, the fastest by the geometric mean first.
    """
    for objective, here in cases.groupby("objective", sort=False):
        ran = here[here["status"] != "skipped"]
        reached = ran[ran["excess"].le(accuracy)]
        best = reached.groupby(["problem", "solver"])["wall"].min().unstack()
        best = best.reindex(index=here["problem"].unique(), columns=ran["solver"].unique())
        best = best.fillna(math.inf)
        order = np.log(best.clip(upper=1e6)).mean().sort_values(kind="stable").index
        yield str(objective), best[order]


def places(cases: pd.DataFrame) -> dict[str, int]:
    """Return the best place of every solver in any objective, 0 for the fastest."""
    best: dict[str, int] = {}
    for _, seconds in times_to(cases, accuracies(cases)[-1]):
        for place, name in enumerate(map(str, seconds.columns)):
            best[name] = min(place, best.get(name, place))
    return best


def rivals(seconds: pd.DataFrame) -> pd.DataFrame:
    """Return the times of the solvers, without those that stand there twice."""
    return seconds[[name for name in seconds if not str(name).endswith(CHARGED)]]


def race(cases: pd.DataFrame, *levels: float) -> pd.DataFrame:
    """Return a row per objective, accuracy, problem and solver: `seconds`, `ratio` to the fastest.

    Both are infinite where the accuracy is not reached.
    """
    import pandas as pd

    parts = []
    for level in levels or accuracies(cases):
        for objective, seconds in times_to(cases, level):
            part = pd.DataFrame({"seconds": seconds.stack()})
            best = part["seconds"].groupby(level=0).transform("min")
            part["ratio"] = (part["seconds"] / best).fillna(math.inf)
            to = f"to {accuracy_text(level)}"
            parts.append(part.reset_index().assign(objective=objective, accuracy=to))
    return pd.concat(parts, ignore_index=True)


def _charged(seconds: pd.Series, limit: float) -> Array:
    """Return seconds (problems,), the limit where a problem is not solved."""
    return np.asarray(seconds.clip(upper=limit), dtype=float)


def summary(cases: pd.DataFrame) -> Table:
    """Return each solver of each objective: verdict, success, mean time, times the fastest."""
    levels = accuracies(cases)[::-1]  # the strictest first: it gives order and verdict
    limit, shift = cases.attrs.get("limit", LIMIT), cases.attrs.get("shift", SHIFT)
    every = [dict(times_to(cases, level)) for level in levels]
    rows: list[Row] = []
    for objective, strict in every[0].items():
        for name in strict:
            cells, verdicts = list[Value](), list[str]()
            for seconds in (level[objective] for level in every):
                own, charged = seconds[name], _charged(seconds[name], limit)
                solved, is_first = np.isfinite(own), name == seconds.columns[0]
                middle, low, high = ratio(charged, _charged(seconds.iloc[:, 0], limit))
                is_sure = not math.isnan(low)
                between = f"{significant(low)} … {significant(high)}"
                cells += [
                    f"{solved.sum()}/{len(own)}",
                    1e3 * float(np.exp(np.log(charged + shift).mean()) - shift),
                    f"{'' if solved.all() else '≥ '}{significant(middle)}",
                    between if is_sure and not is_first else "–",
                ]
                rank = ("slower" if low > 1.0 else "tie") if is_sure else "too few problems"
                verdicts.append("fastest" if is_first else rank)
                if not solved.any():
                    verdicts[-1] = "solved none"
            rows.append((objective, str(name), verdicts[0], *cells))
        absent = cases[(cases["objective"] == objective) & (cases["status"] == "skipped")]
        blank = [None] * (4 * len(levels))
        rows += [(objective, str(name), "missing", *blank) for name in absent["solver"].unique()]
    columns = [*map(Column, ("objective", "solver", "verdict"))]
    for level in levels:
        to = f"to {accuracy_text(level)}"
        columns += [
            Column("solved", group=to), Column("mean time", "ms", group=to, varies=True),
            Column("× fastest", group=to, varies=True), Column("95 %", group=to, varies=True),
        ]  # fmt: skip
    note = (
        "solved: problems whose answers are certified to lie within that share of the objective "
        f"at zero above its minimum. mean time: geometric, shifted by {1e3 * shift:g} ms, on the "
        f"wall; what is not solved counts as the limit, {limit:g} s, and makes × fastest a bound "
        f"(≥). × fastest: with its interval over problems. Verdict: to {accuracy_text(levels[0])}."
    )
    return Table("Solvers: success and time", tuple(columns), rows, (note,))


def winners(cases: pd.DataFrame) -> Table:
    """Return the fastest solver of every problem by its shape, and the next one behind it."""
    once = cases.drop_duplicates("problem")
    sizes = zip(once["samples"], once["columns"], strict=True)
    shapes = dict(zip(once["problem"], (f"{m} × {k}" for m, k in sizes), strict=True))
    strict, limit = accuracies(cases)[-1], cases.attrs.get("limit", LIMIT)
    rows: list[Row] = []
    for objective, seconds in times_to(cases, strict):
        for problem, own in rivals(seconds).iterrows():
            (first, least), *others = own.sort_values(kind="stable").items()
            row: Row = ("nobody", None, None, None)
            if math.isfinite(least):
                second, behind = others[0] if others else (None, math.inf)
                bound = "≥ " if math.isinf(behind) else ""
                ahead = f"{bound}{significant(min(behind, limit) / least)}" if others else None
                row = (str(first), 1e3 * least, str(second) if others else None, ahead)
            rows.append((objective, str(problem), shapes[str(problem)], *row))
    heads = (
        *map(Column, ("objective", "problem", "samples × columns", "fastest")),
        Column("time", "ms", varies=True), Column("next", varies=True),
        Column("next / fastest", varies=True),
    )  # fmt: skip
    return Table(f"The fastest by shape, to {accuracy_text(strict)}", heads, rows)


def failures(cases: pd.DataFrame) -> Table:
    """Return who failed where, by status and reason; the numbers in a reason may differ."""
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
    """Give a sentence per objective: who is fastest to the strictest accuracy, and by how much."""
    strict, limit = accuracies(cases)[-1], cases.attrs.get("limit", LIMIT)
    for objective, seconds in times_to(cases, strict):
        solved = np.isfinite(rivals(seconds))
        if not solved.any(axis=None):
            yield f"{objective}: no solver solves a problem to a certified {accuracy_text(strict)}."
            continue
        first, *others = solved
        said = f"{objective}: {first} is fastest to a certified {accuracy_text(strict)}"
        said += f" and solves {solved[first].sum()} of {len(solved)} problems"
        for second in others[:1]:
            middle, low, high = ratio(*(_charged(seconds[name], limit) for name in (second, first)))
            bound = "" if solved[second].all() else "at least "
            said += f"; {second} takes {bound}{significant(middle)} times as long"
            if not math.isnan(low):
                said += f" ({significant(low)} to {significant(high)})"
        yield f"{said}."
