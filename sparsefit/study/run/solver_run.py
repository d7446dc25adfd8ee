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
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TypeAlias

from sparsefit.errors import InputError
from sparsefit.regression.problem import RegressionProblem
from sparsefit.study.run import partial
from sparsefit.study.run.again import FAILED
from sparsefit.study.run.lock import locked
from sparsefit.study.run.manifest import (
    MANIFEST,
    git_commit,
    processor,
    read_manifest,
    version_of,
    versions,
)
from sparsefit.study.run.solver_cases import measured
from sparsefit.study.run.solver_crew import Crew
from sparsefit.study.run.solver_rows import (
    CASES,
    Row,
    appending,
    read_cases,
    read_rows,
    rewrite,
    write_cases,
)
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
    retry_failed: bool = False,
    progress: Progress | None = None,
) -> SolverRun:
    """Run ``study`` into ``results_dir/<name>``; interrupted, it goes on from there next time.

    Where the study file changed, what was timed together and still is planned, whole, is kept: on
    the same processor, by the same versions and clock.

    retry_failed: where a case ended as error, timeout or crashed, all that were timed by turns
    with it, those of one problem and one objective, are solved again.

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
        _take_over(study, folder)
        _refuse_foreign(study, folder)
        if retry_failed:
            _let_go(study, folder)
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


def _let_go(study: SolverStudy, folder: Path) -> None:
    """Keep the rows of what was timed together without a failed case among it."""
    rows = _rows(folder)
    kept: list[Row] = []
    for together in _arenas(study):
        mine = [rows[name] for name in map(study.case_id, together) if name in rows]
        if not any(row["status"] in FAILED for row in mine):
            kept += mine
    if len(kept) < len(rows):
        _begin(study, folder)
        rewrite(folder, kept)


def _take_over(study: SolverStudy, folder: Path) -> None:
    """Rows of another study file that are as those of this one would be."""
    header, manifest = partial.read_header(folder), read_manifest(folder)
    made = header or manifest
    if made is None:
        return
    if made.get("study_hash") != study.hash:
        kept = _kept(study, folder) if made.get("timed") == _timed(study) else []
        if not kept:
            return
        _begin(study, folder)
        rewrite(folder, kept)
    if manifest is not None and manifest.get("study_hash") != study.hash:
        (folder / MANIFEST).unlink()  # what it says was taken over


def _kept(study: SolverStudy, folder: Path) -> list[Row]:
    """Of the rows that are there those of problems and objectives that are all there."""
    rows = {name.partition("-")[2]: row for name, row in _rows(folder).items()}
    kept: list[Row] = []
    for together in _arenas(study):
        names = [study.case_id(case).partition("-")[2] for case in together]
        if all(name in rows for name in names):
            pairs = zip(together, names, strict=True)
            kept += [rows[name] | _named(study, case) for case, name in pairs]
    return kept


def _named(study: SolverStudy, case: SolverCase) -> Row:
    """What a study calls a case."""
    source, contender = study.problems[case.problem], study.contenders[case.contender]
    of = {"problem": source.name, "series": source.series, "level": source.level}
    told = {"case_id": study.case_id(case), "study": study.name, "objective": contender.objective}
    return of | told


def _rows(folder: Path) -> dict[str, Row]:
    """The rows of a run, finished or not, by case."""
    if (folder / partial.FOLDER).is_dir():
        told = read_rows(folder)
    elif (folder / CASES).is_file():
        told = [
            {str(key): value for key, value in row.items()}
            for row in read_cases(folder).to_dict("records")
        ]
    else:
        told = []
    return {str(row["case_id"]): row for row in told}


def _timed(study: SolverStudy) -> dict[str, object]:
    """Under what times are those of one comparison."""
    return {"clock": asdict(study.clock), "processor": processor(), "versions": versions()}


def _begin(study: SolverStudy, folder: Path) -> None:
    header = {"study": study.name, "study_hash": study.hash, "planned": study.planned}
    partial.begin(folder, header | {"timed": _timed(study)})


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
        _begin(study, folder)
    rows = read_rows(folder)
    resumed = len(rows)
    known = {row["case_id"] for row in rows}
    crew = Crew(study, problems)
    try:
        with appending(folder) as append:
            for together in _arenas(study):
                left = [case for case in together if study.case_id(case) not in known]
                if left:
                    made = measured(study, crew, problems[left[0].problem], left)
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
        "versions": versions() | {name: version_of(name) for name in PEERS},
        "platform": platform.platform(),
        "machine": platform.machine(),
        "processor": processor(),
        "processors": os.cpu_count(),
        "git_commit": git_commit(),
        "timed": _timed(study),
    }
    write_whole(folder / MANIFEST, json.dumps(content, indent=2) + "\n")
