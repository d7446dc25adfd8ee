"""What a study of solvers answers, in sentences, and what it cannot tell."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from sparsefit.study.evidence.solver_measures import level_text, missing, objectives, times_to
from sparsefit.study.evidence.solver_ratios import against_others
from sparsefit.study.evidence.solver_tables import interval_text, solved_text
from sparsefit.study.evidence.table import significant
from sparsefit.study.spec.contenders import CERTIFIED
from sparsefit.study.spec.solver_study import SolverStudy


def sentences(study: SolverStudy, cases: pd.DataFrame) -> list[str]:
    """A sentence for each objective, one for who is missing, one where the run was disturbed."""
    told = [
        sentence
        for objective in objectives(cases)
        for sentence in (
            _sentence(study, cases, objective),
            *against_others(study, cases, objective),
        )
    ]
    absent = missing(cases)
    if absent:
        told.append("Missing: " + "; ".join(absent.values()) + ".")
    disturbed = int(cases["disturbed"].sum())
    if disturbed:
        total = int((cases["repeats"] > 0).sum())
        told.append(f"The machine was busy: {disturbed} of {total} timed cases were disturbed.")
    return told


def _sentence(study: SolverStudy, cases: pd.DataFrame, objective: str) -> str:
    accuracy, shift, limit = study.accuracies[-1], study.clock.shift, study.clock.limit
    at = times_to(cases, objective, accuracy)
    start = f"{objective}, certified to {level_text(accuracy)}: "
    if not at.solvers or not at.solved.any():
        return start + "no solver solves any problem."
    ratio = at.against_best(limit=limit)
    order = np.argsort(ratio[:, 0], kind="stable").tolist()
    mean = 1e3 * at.means(shift=shift, limit=limit)[order[0]]
    first = (
        f"{at.solvers[order[0]]} is fastest, {significant(float(mean))} ms on average, and solves"
    )
    words = f"{start}{first} {solved_text(at, order[0])}"
    charged = at.solvers[order[0]] + CERTIFIED  # the same, and no competitor
    order = [place for place in order if at.solvers[place] != charged]
    if len(order) < 2:
        return words + "."
    second = order[1]
    if not at.solved[:, order[1:]].any():
        return f"{words}; no other solver solves any."
    times_ = significant(float(ratio[second, 0]))
    interval = "" if math.isnan(ratio[second, 1]) else f" (95 % {interval_text(ratio[second])})"
    tie = " Their times cannot be told apart." if ratio[second, 1] <= 1.0 else ""
    return (
        f"{words}; next is {at.solvers[second]} with {times_} times that{interval}, which solves "
        f"{solved_text(at, second)}.{tie}"
    )


def limits(study: SolverStudy, cases: pd.DataFrame) -> str:
    """What this comparison cannot tell, in a paragraph made of what it was."""
    count, kind = cases["problem"].nunique(), "paths" if study.fractions else "single fits"
    flights = sum(source.kind == "flights" for source in study.problems)
    return (
        f"It is about {count} problems, {flights} of them flights, and {kind} at these penalties: "
        "another choice of problems can turn the order, and the intervals only say how much "
        "another draw from the same kind of problems would. Times are of one machine, one process "
        "and one thread: what a solver gains from threads, a GPU, sparse data, warm starts over "
        "many right-hand sides or generated code is not seen. Tolerances are tried at the values "
        "listed; a solver may have a faster setting. Who wrote the adapters knows sparsefit's own "
        "solvers best. An excess is certified against the best lower bound at hand: an answer may "
        "be more accurate than is proven, never less. What is missing is not judged at all."
    )
