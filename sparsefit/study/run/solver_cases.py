"""Cases of one problem and one objective: each judged once, then all timed by turns."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence

from sparsefit.study.run.columns import Value
from sparsefit.study.run.outcome import Outcome
from sparsefit.study.run.solver_clock import SLOW, Repeats, median_interval
from sparsefit.study.run.solver_crew import Crew
from sparsefit.study.run.solver_worker import Answer, Ask, Lost
from sparsefit.study.spec.solver_study import SolverStudy


def measured(study: SolverStudy, crew: Crew, problem: int, cells: Sequence[int]) -> list[Outcome]:
    """The rows of cases of one problem and one objective, judged once and timed by turns."""
    entries = [Repeats(study.case(problem, cell)) for cell in cells]
    for entry in entries:
        _judge(study, crew, entry, entries)
    turn = 0
    while not all(entry.done(study.clock) for entry in entries):
        turn += 1
        for entry in entries if turn % 2 == 0 else reversed(entries):
            if not entry.done(study.clock):
                _time(crew, entry)
    return [_row(study, crew, *pair) for pair in zip(cells, entries, strict=True)]


def _judge(study: SolverStudy, crew: Crew, entry: Repeats, entries: Sequence[Repeats]) -> None:
    """The first run: judged, and timed where it was too long to be warmed up for."""
    contender = study.contenders[entry.case.contender]
    if contender.missing:
        entry.lost = "skipped"
        entry.error = contender.missing
        return
    entry.load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    for other in entries:
        same = other.case.contender == entry.case.contender
        if same and other.lost == "timeout" and other.case.tolerance > entry.case.tolerance:
            entry.lost = "timeout"
            entry.error = f"not tried: at tolerance {other.case.tolerance:g} {other.error}"
            return
    answer = crew.ask(Ask("judge", entry.case))
    _note(entry, answer, first=True)


def _time(crew: Crew, entry: Repeats) -> None:
    _note(entry, crew.ask(Ask("time", entry.case)), first=False)


def _note(entry: Repeats, answer: Answer | Lost, *, first: bool) -> None:
    if isinstance(answer, Lost):
        entry.lost, entry.error = answer.status, answer.reason
        return
    entry.error = answer.error
    if answer.timing:
        entry.note(answer.timing, counts=not first or answer.timing.wall > SLOW)
    if first:
        entry.verdict, entry.memory = answer.verdict, answer.memory


def _row(study: SolverStudy, crew: Crew, cell: int, entry: Repeats) -> Outcome:
    case = entry.case
    problem = crew.problems[case.problem]
    middle, low, high = median_interval([one.cpu for one in entry.timings])
    wall, _, _ = median_interval([one.wall for one in entry.timings])
    state, reason = _status(study, entry)
    verdict = entry.verdict
    values: dict[str, Value] = {
        "samples": problem.samples,
        "columns": problem.columns,
        "targets": problem.targets,
        "points": verdict.asked if verdict else max(len(study.fractions), 1),
        "cpu": middle,
        "cpu_low": low,
        "cpu_high": high,
        "wall": wall,
        "repeats": len(entry.timings),
        "known": entry.known(study.clock),
        "memory": entry.memory,
        "load": entry.load,
        "disturbed": entry.disturbed,
    }
    if verdict:
        judged = {"certificate": verdict.gap, "excess": verdict.excess}
        values |= judged | {"word": verdict.words, "certificate_kind": verdict.kind}
    if case.contender in crew.first_seconds:
        values["first"] = crew.first_seconds[case.contender]
    return Outcome(case.problem, cell, state, reason, values)


def _status(study: SolverStudy, entry: Repeats) -> tuple[str, str]:
    """`ok` where the certificate is within what was asked for, or the strictest accuracy."""
    if entry.lost:
        return entry.lost, entry.error
    if entry.error:
        return "error", entry.error
    verdict = entry.verdict
    if verdict is None:
        return "error", "no answer"
    if verdict.answered < verdict.asked:
        return "error", f"{verdict.answered} of {verdict.asked} points answered: {verdict.words}"
    wanted = entry.case.tolerance
    wanted = study.accuracies[-1] if math.isnan(wanted) else wanted
    if verdict.excess <= wanted:
        return "ok", ""
    told = f"certified {verdict.excess:.1e}, asked for {wanted:g}"
    return "inaccurate", f"{told}: {verdict.words}" if verdict.words else told
