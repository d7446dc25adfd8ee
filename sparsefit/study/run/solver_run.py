"""Run a study of solvers: one process works at a time, cases of a problem take turns.

Problem by problem and objective by objective, each case is solved once and judged; then all are
timed again in alternating order until each median is known, or the limits of [clock] are reached.
A solver that took longer than the limit at one tolerance is not tried at a tighter one there.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TypeAlias

from sparsefit.errors import InputError
from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.run import partial
from sparsefit.study.run.lock import locked
from sparsefit.study.run.manifest import MANIFEST, git_commit, read_manifest, versions
from sparsefit.study.run.solver_clock import SLOW, Repeats, median_interval
from sparsefit.study.run.solver_rows import (
    CASES,
    Row,
    appending,
    read_cases,
    read_rows,
    write_cases,
)
from sparsefit.study.run.solver_worker import Answer, Ask, Hand, Lost, Worker
from sparsefit.study.spec.document import canonical_json
from sparsefit.study.spec.solver_study import SolverCase, SolverStudy
from sparsefit.whole_file import refusing, write_whole

Progress: TypeAlias = Callable[[int, int, float | None], None]
PEERS = ("scikit-learn", "celer", "skglm", "group-lasso", "spams-bin", "scs", "highspy", "piqp",
         "daqp", "pysindy", "numba")  # fmt: skip


@dataclass(frozen=True)
class SolverRun:
    """What a run did: rows planned and from before, counts by status, seconds, and where."""

    folder: Path
    planned: int
    done: int
    resumed: int
    finished: bool
    statuses: Mapping[str, int]
    seconds: float = 0.0


def run(
    study: SolverStudy,
    results_dir: str | Path,
    *,
    fresh: bool = False,
    progress: Progress | None = None,
) -> SolverRun:
    """Run ``study`` into ``results_dir/<name>``; interrupted, it goes on from there next time.

    Raises:
        InputError: if a problem is none, the folder cannot be written, is in use, or holds rows
            of another study.
    """
    problems = study.build()
    folder = Path(results_dir) / study.name
    with refusing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    with locked(folder):
        if fresh:
            _clear(folder)
        _refuse_foreign(study, folder)
        before = status(study, results_dir)
        if before.finished:
            return SolverRun(folder, study.planned, study.planned, study.planned, True,
                             before.statuses)  # fmt: skip
        return _finish(study, folder, problems, progress)


def status(study: SolverStudy, results_dir: str | Path) -> SolverRun:
    """How far a study is, finished or not; changes nothing."""
    folder = Path(results_dir) / study.name
    _refuse_foreign(study, folder)
    if read_manifest(folder) is not None and not (folder / partial.FOLDER).is_dir():
        counted = Counter(read_cases(folder)["status"])
        return SolverRun(folder, study.planned, study.planned, 0, True, counted)
    rows = read_rows(folder)
    return SolverRun(
        folder, study.planned, len(rows), 0, False, Counter(row["status"] for row in rows)
    )


def _clear(folder: Path) -> None:
    partial.discard(folder)
    for name in (CASES, MANIFEST):
        (folder / name).unlink(missing_ok=True)


def _refuse_foreign(study: SolverStudy, folder: Path) -> None:
    """Times of one study, file or machine are never mixed with those of another."""
    for made in (partial.read_header(folder), read_manifest(folder)):
        if made is not None and made.get("study_hash") != study.hash:
            short = str(made.get("study_hash"))[:12]
            raise InputError(
                f"{folder} was made by a different study (hash {short}): "
                "use --fresh to start over, or rename this study"
            )


def _finish(
    study: SolverStudy,
    folder: Path,
    problems: Sequence[RegressionProblem],
    progress: Progress | None,
) -> SolverRun:
    begun = time.monotonic()
    if not (folder / partial.FOLDER).is_dir():
        header = {"study": study.name, "study_hash": study.hash, "planned": study.planned}
        partial.begin(folder, header)
    rows = read_rows(folder)
    resumed = len(rows)
    known = {row["case_id"] for row in rows}
    crew = _Crew(study, problems)
    try:
        with appending(folder) as append:
            for together in _arenas(study):
                left = [case for case in together if study.case_id(case) not in known]
                if left:
                    made = _measured(study, crew, problems[left[0].problem], left)
                    append(made)
                    rows += made
                if progress:
                    progress(len(rows), study.planned, _left(begun, len(rows), resumed, study))
    finally:
        crew.close()
    statuses = Counter(row["status"] for row in rows)
    write_cases(study, rows, folder)
    seconds = time.monotonic() - begun
    _write_manifest(study, folder, statuses, seconds, resumed)
    partial.discard(folder)
    return SolverRun(folder, study.planned, len(rows), resumed, True, statuses, seconds)


def _left(begun: float, done: int, resumed: int, study: SolverStudy) -> float | None:
    made = done - resumed
    return (time.monotonic() - begun) / made * (study.planned - done) if made else None


def _arenas(study: SolverStudy) -> Iterator[list[SolverCase]]:
    """Cases that are timed by turns: those of one problem and one objective."""
    for problem in range(len(study.problems)):
        for objective in study.objectives:
            yield [
                SolverCase(problem, number, tolerance)
                for number, contender in enumerate(study.contenders)
                for tolerance in contender.tolerances
                if contender.objective == objective
            ]


class _Crew:
    """A process for each family of contenders; one works at a time, the others wait."""

    def __init__(self, study: SolverStudy, problems: Sequence[RegressionProblem]) -> None:
        self._study = study
        self._problems = problems
        self._workers: dict[str, Worker] = {}
        self._met: dict[str, set[int]] = {}
        self._holds: dict[str, int] = {}
        self.first_seconds: dict[int, float] = {}

    def ask(self, ask: Ask) -> Answer | Lost:
        """The answer; before it a first call, and the problem, where the process has not had them.

        The problem is built once, here, and handed over.
        """
        number = ask.case.contender
        name = self._study.contenders[number].family
        worker = self._workers.setdefault(name, Worker(self._study))
        if number not in self._met.setdefault(name, set()):
            answer = worker.ask(Ask("first", ask.case))
            if isinstance(answer, Lost):
                return self._forget(name, Lost(answer.status, f"its first call: {answer.reason}"))
            self._met[name].add(number)
            if answer.timing:
                self.first_seconds.setdefault(number, answer.timing.cpu)
        if self._holds.get(name) != ask.case.problem:
            handed = worker.ask(Hand(self._problems[ask.case.problem]))
            if isinstance(handed, Lost):
                return self._forget(name, handed)
            self._holds[name] = ask.case.problem
        answer = worker.ask(ask)
        return self._forget(name, answer) if isinstance(answer, Lost) else answer

    def _forget(self, name: str, lost: Lost) -> Lost:
        """The process is gone, and with it what it had met and held."""
        self._met[name].clear()
        self._holds.pop(name, None)
        return lost

    def close(self) -> None:
        for worker in self._workers.values():
            worker.close()


def _measured(
    study: SolverStudy, crew: _Crew, problem: RegressionProblem, cases: Sequence[SolverCase]
) -> list[Row]:
    entries = [Repeats(case) for case in cases]
    for entry in entries:
        _judge(study, crew, entry, entries)
    turn = 0
    while not all(entry.done(study.clock) for entry in entries):
        turn += 1
        for entry in entries if turn % 2 == 0 else reversed(entries):
            if not entry.done(study.clock):
                _time(crew, entry)
    return [_row(study, crew, problem, entry) for entry in entries]


def _judge(study: SolverStudy, crew: _Crew, entry: Repeats, entries: Sequence[Repeats]) -> None:
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


def _time(crew: _Crew, entry: Repeats) -> None:
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


def _row(study: SolverStudy, crew: _Crew, problem: RegressionProblem, entry: Repeats) -> Row:
    case = entry.case
    source, contender = study.problems[case.problem], study.contenders[case.contender]
    middle, low, high = median_interval([one.cpu for one in entry.timings])
    wall, _, _ = median_interval([one.wall for one in entry.timings])
    state, reason = _status(study, entry)
    verdict = entry.verdict
    return {
        "case_id": study.case_id(case),
        "study": study.name,
        "problem": source.name,
        "series": source.series,
        "level": source.level,
        "samples": problem.samples,
        "columns": problem.columns,
        "targets": problem.targets,
        "objective": contender.objective,
        "backend": contender.backend,
        "settings": canonical_json(dict(contender.settings)),
        "solver": contender.solver,
        "tolerance": case.tolerance,
        "points": max(len(study.fractions), 1),
        "status": state,
        "reason": reason,
        "word": verdict.words if verdict else "",
        "certificate_kind": verdict.kind if verdict else "",
        "certificate": verdict.gap if verdict else None,
        "excess": verdict.excess if verdict else None,
        "cpu": middle,
        "cpu_low": low,
        "cpu_high": high,
        "wall": wall,
        "repeats": len(entry.timings),
        "known": entry.known(study.clock),
        "first": crew.first_seconds.get(case.contender),
        "memory": entry.memory,
        "load": entry.load,
        "disturbed": entry.disturbed,
    }


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
    wanted = study.accuracies[-1] if wanted != wanted else wanted
    if verdict.excess <= wanted:
        return "ok", ""
    told = f"certified {verdict.excess:.1e}, asked for {wanted:g}"
    return "inaccurate", f"{told}: {verdict.words}" if verdict.words else told


def _write_manifest(
    study: SolverStudy, folder: Path, statuses: Mapping[str, int], seconds: float, resumed: int
) -> None:
    content = {
        "study": study.name,
        "kind": "solvers",
        "study_hash": study.hash,
        "seed": study.seed,
        "cases": study.planned,
        "statuses": dict(sorted(statuses.items())),
        "sha256": {CASES: hashlib.sha256((folder / CASES).read_bytes()).hexdigest()},
        "wall_seconds": round(seconds, 3),
        "resumed_cases": resumed,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": versions() | {name: _version(name) for name in PEERS},
        "platform": platform.platform(),
        "machine": platform.machine(),
        "processor": _processor(),
        "processors": os.cpu_count(),
        "git_commit": git_commit(),
    }
    write_whole(folder / MANIFEST, json.dumps(content, indent=2) + "\n")


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _processor() -> str:
    """The name of the CPU, where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
