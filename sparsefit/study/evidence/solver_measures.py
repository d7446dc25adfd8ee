"""Times to a certified accuracy, and what is summed up of them; failures are in every denominator.

A solver solves a problem to an accuracy if one of its tolerances gives answers whose certified
excess is within it; its time is the least of those. What fails or is killed takes infinitely long
in profiles, and the limit of a solve in means. The unit of every share and interval is a problem.

Sources: Dolan and More, Math. Program. 91 (2002) 201-213, for performance profiles; More and Wild,
SIAM J. Optim. 20 (2009) 172-191, for data profiles, here over seconds of CPU time.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray

RESAMPLES = 4000
FEWEST = 5  # problems below which resampling them says nothing
MISSING = "skipped"


@dataclass(frozen=True, eq=False)
class Times:
    """CPU seconds (problems, solvers) to one accuracy on one objective, infinite where unsolved.

    Solvers that are not installed are not among them.
    """

    objective: str
    accuracy: float
    problems: tuple[str, ...]
    solvers: tuple[str, ...]
    seconds: Array

    @property
    def solved(self) -> BoolArray:
        """Whether each is solved, (problems, solvers)."""
        found: BoolArray = np.isfinite(self.seconds)
        return found

    def ratios(self) -> Array:
        """Times over those of the fastest on each problem; infinite where unsolved."""
        best = np.min(self.seconds, axis=1, initial=np.inf, keepdims=True)
        with np.errstate(invalid="ignore"):
            ratio: Array = np.where(self.solved, self.seconds / best, np.inf)
        return ratio

    def over(self, reference: int, others: Sequence[int], *, limits: Sequence[float]) -> Array:
        """(problems,) times of the best of `others` over those of `reference`, by their places.

        What is unsolved counts at the limit [s] of its solver: where none of the others solves a
        problem, the ratio is a bound.
        """
        charged = np.minimum(self.seconds, np.array(limits))
        found: Array = charged[:, list(others)].min(axis=1) / charged[:, reference]
        return found

    def means(self, *, shift: float, limit: float) -> Array:
        """Shifted geometric mean of each solver [s], what is unsolved counted at the limit [s]."""
        charged = np.minimum(self.seconds, limit)
        found: Array = np.exp(np.log(charged + shift).mean(axis=0)) - shift
        return found

    def against_best(self, *, limit: float) -> Array:
        """(solvers, 3): geometric mean of the times over the fastest solver's, and its interval.

        What is unsolved counts at the limit [s]; the fastest has the least geometric mean. The 95 %
        interval is a percentile bootstrap over problems, paired; none of fewer than `FEWEST`.
        """
        logs = np.log(np.minimum(self.seconds, limit))
        best = int(np.argmin(logs.mean(axis=0)))
        over = logs - logs[:, [best]]
        found = np.full((len(self.solvers), 3), np.nan)
        found[:, 0] = np.exp(over.mean(axis=0))
        if len(over) >= FEWEST:
            draw = np.random.default_rng(0).integers(len(over), size=(RESAMPLES, len(over)))
            means = over[draw].mean(axis=1)
            found[:, 1:] = np.exp(np.quantile(means, [0.025, 0.975], axis=0)).T
        return found


def times_to(cases: pd.DataFrame, objective: str, accuracy: float) -> Times:
    """The times to an accuracy of every solver that ran for an objective."""
    here = cases[cases["objective"] == objective]
    ran = here[here["status"] != MISSING]
    solvers = tuple(dict.fromkeys(ran["solver"]))
    problems = tuple(dict.fromkeys(here["problem"]))
    seconds = np.full((len(problems), len(solvers)), np.inf)
    reached = ran[ran["excess"].le(accuracy) & ran["cpu"].notna()]
    for (problem, solver), rows in reached.groupby(["problem", "solver"]):
        place = problems.index(str(problem)), solvers.index(str(solver))
        seconds[place] = float(rows["cpu"].min())
    return Times(objective, accuracy, problems, solvers, seconds)


def level_text(accuracy: float) -> str:
    """An accuracy as it is written, `1e-8`."""
    return f"{accuracy:.0e}".replace("e-0", "e-")


def steps(values: Array, start: float, end: float) -> tuple[Array, Array]:
    """Corners (x, y) of the share of values that are at most x, from ``start`` to ``end``."""
    inside = np.sort(values[values <= end])
    shares = np.arange(len(inside) + 1) / max(len(values), 1)
    x = np.concatenate([[start], inside, [end]])
    return x, np.concatenate([shares, shares[-1:]])


def objectives(cases: pd.DataFrame) -> tuple[str, ...]:
    """The objectives, in the order of the rows."""
    return tuple(dict.fromkeys(map(str, cases["objective"])))


def missing(cases: pd.DataFrame) -> dict[str, str]:
    """Solvers that did not run, with the reason."""
    absent = cases[cases["status"] == MISSING]
    pairs = zip(absent["solver"], absent["reason"], strict=True)
    return {str(solver): str(reason) for solver, reason in pairs}


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """p of seconds ~ size^p, by least squares of the logarithms; NaN of fewer than two sizes."""
    pairs = [(s, t) for s, t in zip(sizes, seconds, strict=True) if math.isfinite(t) and t > 0]
    if len({size for size, _ in pairs}) < 2:
        return math.nan
    logs = np.log(np.array(pairs))
    return float(np.polyfit(logs[:, 0], logs[:, 1], 1)[0])


def growth(cases: pd.DataFrame, accuracy: float) -> pd.DataFrame:
    """Times to an accuracy along swept problems: series, size ("columns" or "samples"), its value.

    Of each series the one of the two that varies; columns where both do.
    """
    swept = cases[cases["level"] != ""]
    found: list[dict[str, object]] = []
    for (series, objective), rows in swept.groupby(["series", "objective"], sort=False):
        varies = [name for name in ("columns", "samples") if rows[name].nunique() > 1]
        if not varies:
            continue
        times = times_to(rows, str(objective), accuracy)
        sizes = rows.drop_duplicates("problem").set_index("problem")[varies[0]]
        for place, problem in enumerate(times.problems):
            for number, solver in enumerate(times.solvers):
                found.append(
                    {
                        "series": series,
                        "objective": objective,
                        "along": varies[0],
                        "size": int(sizes[problem]),
                        "solver": solver,
                        "seconds": float(times.seconds[place, number]),
                    }
                )
    return pd.DataFrame(
        found, columns=["series", "objective", "along", "size", "solver", "seconds"]
    )
