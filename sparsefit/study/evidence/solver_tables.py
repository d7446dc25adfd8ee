"""The tables of a study of solvers."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

import numpy as np
import pandas as pd

from sparsefit.arrays import Array
from sparsefit.study.evidence.sentence import numberless
from sparsefit.study.evidence.solver_measures import (
    FEWEST,
    MISSING,
    Times,
    exponent,
    growth,
    level_text,
    missing,
    objectives,
    times_to,
)
from sparsefit.study.evidence.solver_ratios import ratios
from sparsefit.study.evidence.table import Column, Table, Value, significant
from sparsefit.study.spec.solver_study import SolverStudy

FAILURES_SHOWN = 40
NAMES = ("summary", "ratios", "times", "failures", "growth", "clock", "contenders", "problems")


def tables_of(study: SolverStudy, cases: pd.DataFrame) -> dict[str, Table]:
    """The tables that have rows, by the name of their file, the ones to read first in front.

    Where there are several objectives, each has a summary and times of its own: `summary-lasso`.
    """
    parts = objectives(cases)
    named = {objective: f"-{_slug(objective)}" if len(parts) > 1 else "" for objective in parts}
    every = {
        **{f"summary{named[one]}": summary(study, cases, one) for one in parts},
        **{f"ratios{named[one]}": ratios(study, cases, one) for one in parts},
        **{f"times{named[one]}": times(study, cases, one) for one in parts},
        "failures": failures(cases),
        "growth": grown(study, cases),
        "clock": clock(study, cases),
        "contenders": contenders(study, cases),
        "problems": problems(cases),
    }
    return {name: table for name, table in every.items() if table.rows}


def _slug(objective: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", objective.lower()).strip("-")[:60]


def summary(study: SolverStudy, cases: pd.DataFrame, objective: str) -> Table:
    """Each solver of an objective: success at every accuracy, mean times, and against the best."""
    levels = study.accuracies
    at = [times_to(cases, objective, level) for level in levels]
    shift, limit = study.clock.shift, study.clock.limit
    means = [1e3 * one.means(shift=shift, limit=limit) for one in at]
    ratio = at[-1].against_best(limit=limit)
    columns = (
        Column("solver", align="left"),
        *(Column(level_text(level), group="solved to") for level in levels),
        *(Column(level_text(level), "ms", "significant", group="mean time to") for level in levels),
        Column(f"times the fastest, to {level_text(levels[-1])}", format="significant"),
        Column("95 % interval"),
        Column("verdict", align="left"),
    )
    rows: list[tuple[Value, ...]] = []
    order = np.argsort(ratio[:, 0], kind="stable").tolist()
    for place in order:
        rows.append(
            (
                at[0].solvers[place],
                *(solved_text(one, place) for one in at),
                *(float(mean[place]) for mean in means),
                float(ratio[place, 0]),
                interval_text(ratio[place]),
                _verdict(ratio[place], at[-1], place, first=place == order[0]),
            )
        )
    absent = missing(cases[cases["objective"] == objective])
    nothing = (*("–" for _ in levels), *(None for _ in range(len(levels) + 2)))
    rows += [(name, *nothing, "missing") for name in absent]
    notes = (*_summary_notes(study), *_cautions(study, cases, objective))
    return Table(f"{objective}: success and time", columns, tuple(rows), notes)


def solved_text(one: Times, place: int) -> str:
    """How many problems a solver solves, `11 of 12`."""
    return f"{int(one.solved[:, place].sum())} of {len(one.problems)}"


def interval_text(ratio: Array) -> str:
    """The interval of a ratio and its two ends; a dash where there is none."""
    low, high = float(ratio[1]), float(ratio[2])
    return "–" if math.isnan(low) else f"{significant(low)} … {significant(high)}"


def _verdict(ratio: Array, one: Times, place: int, *, first: bool) -> str:
    if not one.solved[:, place].any():
        return "solved none"
    if first:
        return "fastest"
    if math.isnan(ratio[1]):
        return "too few problems for an interval"
    return "tie with the fastest" if ratio[1] <= 1.0 else "slower"


def _summary_notes(study: SolverStudy) -> tuple[str, ...]:
    shift, limit = 1e3 * study.clock.shift, study.clock.limit
    return (
        "solved: problems whose answers, at one of the tolerances asked for, are certified to lie "
        "within that share of the objective at zero above its minimum, of all problems planned.",
        f"mean time: geometric, shifted by {shift:g} ms, of the CPU time; what is not solved "
        f"counts as the limit of {limit:g} s.",
        "times the fastest: geometric mean over problems of the time over that of the solver "
        "whose geometric mean is least. 95 % interval: paired bootstrap over problems, of "
        f"{FEWEST} or more; where it holds 1, a tie. The fastest is chosen by the same times, "
        "which flatters its lead.",
    )


def _cautions(study: SolverStudy, cases: pd.DataFrame, objective: str) -> Iterator[str]:
    """What to know of an objective: tolerances that stop short, a certificate of another kind."""
    here = cases[cases["objective"] == objective]
    strict, asked = study.accuracies[-1], here["tolerance"].dropna()
    least = asked.groupby(here["solver"]).min()
    short = [str(name) for name in least.index[least > strict]]
    if short:
        told = f"{', '.join(short)}: never asked for {level_text(strict)} or less"
        yield f"{told}; smaller tolerances in the study file would tell."
    hasty = [one for one in study.contenders if one.objective == objective and one.limit]
    for limit in sorted({one.limit for one in hasty if one.limit}):
        named = ", ".join(one.solver for one in hasty if one.limit == limit)
        yield f"{named}: killed after {limit:g} s already, by the study file."
    if (here["certificate_kind"] == "fixed_point").any():
        yield (
            "Certified here is a fixed point, the share of the support that the method's own rule "
            "would change: it claims no optimum."
        )


def times(study: SolverStudy, cases: pd.DataFrame, objective: str) -> Table:
    """Problem by problem: milliseconds to the strictest accuracy, or how a solver failed."""
    accuracy = study.accuracies[-1]
    at = times_to(cases, objective, accuracy)
    here = cases[cases["objective"] == objective]
    columns = (Column("solver", align="left"), *(Column(name) for name in at.problems))
    rows: list[tuple[Value, ...]] = []
    for place, solver in enumerate(at.solvers):
        mine = here[here["solver"] == solver]
        cells = [
            significant(1e3 * float(seconds))
            if math.isfinite(seconds)
            else _failure(mine[mine["problem"] == problem])
            for problem, seconds in zip(at.problems, at.seconds[:, place], strict=True)
        ]
        rows.append((solver, *cells))
    rows += [(name, "missing", *("" for _ in at.problems[1:])) for name in missing(here)]
    note = (
        "A number is milliseconds of CPU time, what the solver forms of Z'Z or a QR in it. *x: the "
        "least certified excess at any tolerance; else how its last case ended."
    )
    title = f"{objective}: CPU time to a certified {level_text(accuracy)} [ms]"
    return Table(title, columns, tuple(rows), (note,))


def _failure(rows: pd.DataFrame) -> str:
    best = rows["excess"].min()
    if best == best and math.isfinite(best):
        return f"*{best:.0e}"
    return str(rows["status"].iloc[-1]) if len(rows) else "not run"


def failures(cases: pd.DataFrame) -> Table:
    """Who failed where, by status and reason; numbers in a reason may differ."""
    bad = cases[(cases["status"] != "ok") & (cases["status"] != MISSING)]
    groups: dict[tuple[str, str, str, str], list[tuple[str, float, str]]] = {}
    names = ("objective", "solver", "status", "reason", "problem", "tolerance")
    listed = (bad[name].tolist() for name in names)
    for objective, solver, state, reason, problem, tolerance in zip(*listed, strict=True):
        key = (objective, solver, state, numberless(reason))
        groups.setdefault(key, []).append((problem, tolerance, reason))
    columns = (
        *(Column(name, align="left") for name in ("objective", "solver", "status")),
        Column("cases"),
        Column("tolerances"),
        Column("problems", align="left"),
        Column("reason of the first", align="left"),
    )
    ordered = sorted(groups.items(), key=lambda item: -len(item[1]))
    rows: list[tuple[Value, ...]] = []
    for (objective, solver, state, _), found in ordered:
        told = dict.fromkeys(level_text(t) for _, t, _ in found if not math.isnan(t))
        tolerances = " ".join(told) or "–"
        where = list(dict.fromkeys(name for name, _, _ in found))
        words = ", ".join(where[:3]) + (f" and {len(where) - 3} more" if len(where) > 3 else "")
        rows.append((objective, solver, state, len(found), tolerances, words, found[0][2]))
    note = "inaccurate: the certificate is above the tolerance that the solver was asked for."
    return Table("Who failed where", columns, tuple(rows), (note,), shown=FAILURES_SHOWN)


def grown(study: SolverStudy, cases: pd.DataFrame) -> Table:
    """How the time to the strictest accuracy that most reach grows along swept problems."""
    accuracy = study.accuracies[len(study.accuracies) // 2]
    columns = (
        *(Column(name, align="left") for name in ("problems", "objective", "solver")),
        Column("from"),
        Column("to"),
        Column("time ~", align="left"),
        Column("unsolved"),
    )
    rows: list[tuple[Value, ...]] = []
    keys = ["series", "objective", "along", "solver"]
    for (series, objective, along, solver), here in growth(cases, accuracy).groupby(
        keys, sort=False
    ):
        power = exponent(here["size"].tolist(), here["seconds"].tolist())
        letter = "k" if along == "columns" else "m"
        words = "–" if math.isnan(power) else f"{letter}^{power:.2f}"
        ends = (f"{letter} = {here['size'].min()}", f"{letter} = {here['size'].max()}")
        bad = int((~np.isfinite(here["seconds"])).sum())
        rows.append((str(series), str(objective), str(solver), *ends, words, bad))
    note = "Least squares of the logarithms over the problems that were solved."
    return Table(f"Growth of the time to {level_text(accuracy)}", columns, tuple(rows), (note,))


def clock(study: SolverStudy, cases: pd.DataFrame) -> Table:
    """What the clock saw of each solver: first call, memory, repeats, disturbance, threads."""
    columns = (
        Column("solver", align="left"),
        Column("first call", "s", "significant"),
        Column("peak memory", "MB", ".0f"),
        Column("cases timed"),
        Column("repeats, median", format=".0f"),
        Column(f"median known to {100 * study.clock.precision:g} %"),
        Column("disturbed"),
        Column("CPU / wall", format=".2f"),
    )
    timed = cases[cases["repeats"] > 0]
    rows: list[tuple[Value, ...]] = []
    for solver, here in timed.groupby("solver", sort=False):
        rows.append(
            (
                str(solver),
                float(here["first"].max()),
                float(here["memory"].max()),
                len(here),
                float(here["repeats"].median()),
                f"{int(here['known'].sum())} of {len(here)}",
                int(here["disturbed"].sum()),
                float((here["cpu"] / here["wall"]).median()),
            )
        )
    notes = (
        "first call: imports and compilation, on a small problem, in no other time; what several "
        "need is in the first one's. peak memory: the most that one solve added. disturbed: the "
        "wall clock ran 1.2 times ahead of the CPU's. CPU / wall above 1 means threads of its "
        "own.",
        *_disturbed(timed),
    )
    return Table("The clock", columns, tuple(rows), notes)


def _disturbed(timed: pd.DataFrame) -> Iterator[str]:
    if len(timed):
        share, load = int(timed["disturbed"].sum()), timed["load"]
        yield (
            f"{share} of {len(timed)} cases were disturbed; the machine's load was "
            f"{load.min():.1f} … {load.max():.1f}, this comparison's own process included."
        )


def contenders(study: SolverStudy, cases: pd.DataFrame) -> Table:
    """Who took part, in what form, and who is missing and why."""
    absent = missing(cases)
    columns = tuple(Column(name, align="left") for name in ("solver", "form", "stops at", "runs"))
    found: dict[str, tuple[Value, ...]] = {}
    for one in study.contenders:
        told = [level_text(tolerance) for tolerance in one.tolerances if not math.isnan(tolerance)]
        runs = f"missing: {absent[one.solver]}" if one.solver in absent else "yes"
        row = (one.solver, one.form, " ".join(told) or "nothing to set", runs)
        found.setdefault(one.solver, row)
    return Table("Contenders", columns, tuple(found.values()))


def problems(cases: pd.DataFrame) -> Table:
    """The problems and their sizes."""
    columns = (
        Column("problem", align="left"),
        *(Column(name) for name in ("samples", "columns", "targets")),
    )
    once = cases.drop_duplicates("problem")
    listed = (once[name].tolist() for name in ("problem", "samples", "columns", "targets"))
    rows = tuple(zip(*listed, strict=True))
    return Table("Problems", columns, rows)
