"""How many times faster the exact paths of sparsefit are than others, problem by problem.

At least the best of all others on each problem, chosen there in hindsight: no one solver that a
user could have picked beforehand does as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from sparsefit.arrays import Array, BoolArray
from sparsefit.study.evidence.solver_measures import Times, level_text, times_to
from sparsefit.study.evidence.table import Column, Table, Value, significant
from sparsefit.study.spec.contenders import EXACT
from sparsefit.study.spec.solver_study import SolverStudy

BEST = "best of the others"


class Against(NamedTuple):
    """Times of another over those of an exact path (problems,); bound: the other did not solve."""

    exact: str
    other: str
    ratio: Array
    bound: BoolArray

    @property
    def mean(self) -> float:
        """The geometric mean over the problems."""
        return float(np.exp(np.log(self.ratio).mean()))


def compared(study: SolverStudy, at: Times) -> Iterator[Against]:
    """Every exact path that solves all against the best other, and against each that solves any."""
    exact = {one.solver for one in study.contenders if one.form.startswith(EXACT)}
    others = [place for place, name in enumerate(at.solvers) if name not in exact]
    own = {one.solver: one.limit for one in study.contenders if one.objective == at.objective}
    limits = [own.get(name) or study.clock.limit for name in at.solvers]
    for place, name in enumerate(at.solvers):
        if name not in exact or not others or not at.solved[:, place].all():
            continue
        any_solved = [one for one in others if at.solved[:, one].any()]
        for label, group in ((BEST, others), *((at.solvers[one], [one]) for one in any_solved)):
            solved = np.asarray(at.solved[:, group].any(axis=1))
            yield Against(name, label, at.over(place, group, limits=limits), ~solved)


def ratios(study: SolverStudy, cases: pd.DataFrame, objective: str) -> Table:
    """Times of the others over those of sparsefit's exact paths, problem by problem."""
    accuracy = study.accuracies[-1]
    at = times_to(cases, objective, accuracy)
    columns = (
        *(Column(name, align="left") for name in ("exact path", "against")),
        *(Column(name) for name in at.problems),
        Column("geometric mean"),
    )
    rows: list[tuple[Value, ...]] = []
    for one in compared(study, at):
        cells = [_ratio(*pair) for pair in zip(one.ratio.tolist(), one.bound.tolist(), strict=True)]
        rows.append((one.exact, one.other, *cells, _ratio(one.mean, bool(one.bound.any()))))
    note = (
        "How many times longer the other takes. best of the others: whichever is fastest on each "
        "problem. ≥: it does not solve the problem within its limit, which counts as its time. "
        '"certified": the checks of the data and the certificates of all points are in '
        "the time of the exact path, and nothing of the kind in that of the others."
    )
    title = f"{objective}: times the exact path, to a certified {level_text(accuracy)}"
    return Table(title, columns, tuple(rows), (note,))


def _ratio(value: float, bound: bool) -> str:
    return f"{'≥ ' if bound else ''}{significant(value)}"


def against_others(study: SolverStudy, cases: pd.DataFrame, objective: str) -> Iterator[str]:
    """A sentence for each exact path: against the best other of each problem."""
    accuracy = study.accuracies[-1]
    for one in compared(study, times_to(cases, objective, accuracy)):
        if one.other == BEST:
            bound = bool(one.bound.any())
            ends = f"{significant(float(one.ratio.min()))} … {significant(float(one.ratio.max()))}"
            yield (
                f"{objective}, {one.exact}: the best other solver of each problem takes "
                f"{_ratio(one.mean, bound)} times as long (geometric mean; {ends} by problem)."
            )
