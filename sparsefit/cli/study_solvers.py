"""`sparsefit study` on a file of ``kind = "solvers"``: the same actions, for a comparison."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sparsefit.cli.output import duration, print_json, table_record, terminal_width
from sparsefit.cli.parser import Run
from sparsefit.cli.progress import Bar, Lines
from sparsefit.cli.study_run import STOPPED_FRESH, STOPPED_WRITING, by_status

if TYPE_CHECKING:
    import pandas as pd

    from sparsefit.study.run.solver_run import SolverRun
    from sparsefit.study.spec.solver_study import SolverStudy


FLIGHTS_ONLY = ("stale", "only", "scheduler")


def action(name: str) -> Run:
    """What an action of `sparsefit study` does with a study of solvers.

    Raises:
        InputError: where it is for studies of flights only.
    """
    from sparsefit.errors import InputError

    if name not in RUNS:
        raise InputError(f"study {name} is for studies of flights; this is a study of solvers")
    return RUNS[name]


def check(args: argparse.Namespace) -> int:
    """Exit 0 if the file is valid and every problem is one; missing contenders are named."""
    study = _load(args)
    study.build()
    if args.json:
        record = {"study": study.name, "cases": study.planned, "hash": study.hash}
        print_json({**record, "missing": _missing(study)})
        return 0
    print(f"{args.study}: ok, study {study.name} of solvers plans {study.planned} cases")
    for solver, reason in _missing(study).items():
        print(f"  missing: {solver}: {reason}")
    return 0


def _missing(study: SolverStudy) -> dict[str, str]:
    """Why each solver that cannot run here is missing."""
    return {one.solver: one.missing for one in study.contenders if one.missing}


def plan(args: argparse.Namespace) -> int:
    """What will be solved, by whom, to which tolerances."""
    study = _load(args)
    problems = study.build()
    sizes = {
        source.name: (problem.samples, problem.columns, problem.targets)
        for source, problem in zip(study.problems, problems, strict=True)
    }
    if args.json:
        print_json(_plan_record(study, sizes))
        return 0
    rows = [
        ("study", study.name),
        ("question", study.question),
        *(("problem", f"{name}: {m} samples, {k} columns, {n} targets")
          for name, (m, k, n) in sizes.items()),
        *(("objective", f"{name}: {', '.join(_solvers(study, name))}")
          for name in study.objectives),
        *(("missing", f"{solver}: {why}") for solver, why in _missing(study).items()),
        ("work", f"paths of {len(study.fractions)} points" if study.fractions else "single fits"),
        ("accuracies", ", ".join(f"{level:g}" for level in study.accuracies)),
        ("cases", str(study.planned)),
        ("at most", f"{duration(_most(study))}, all limits reached"),
    ]  # fmt: skip
    width = max(len(label) for label, _ in rows)
    print("\n".join(f"{label:<{width}}  {value}" for label, value in rows))
    return 0


def _plan_record(study: SolverStudy, sizes: dict[str, tuple[int, int, int]]) -> dict[str, Any]:
    return {
        "study": study.name,
        "problems": {
            name: {"samples": m, "columns": k, "targets": n} for name, (m, k, n) in sizes.items()
        },
        "objectives": {name: _solvers(study, name) for name in study.objectives},
        "missing": _missing(study),
        "points": max(len(study.fractions), 1),
        "cases": study.planned,
    }


def _solvers(study: SolverStudy, objective: str) -> list[str]:
    return [one.solver for one in study.contenders if one.objective == objective]


def _most(study: SolverStudy) -> float:
    """Seconds if every solve took its limit and every repeat its share."""
    return study.planned * (study.clock.limit + study.clock.seconds)


def run(args: argparse.Namespace) -> int:
    """Run to the end, write the pages, and print what came out."""
    from sparsefit.errors import InputError
    from sparsefit.study.run import solver_run

    if args.processes not in (None, 1):
        raise InputError("a study of solvers runs one process at a time: leave --processes away")
    if args.executor != "processes":
        raise InputError("a study of solvers runs on this machine: leave --executor away")
    for option in FLIGHTS_ONLY:
        if getattr(args, option, None):
            flag = f"--{option.replace('_', '-')}"
            raise InputError(f"{flag} is for studies of flights: a comparison is timed as one")
    study = _load(args)
    if args.fresh:
        args.stopped = STOPPED_FRESH
    progress = Bar() if sys.stderr.isatty() else Lines()
    try:
        done = solver_run.run(
            study,
            args.results,
            fresh=args.fresh,
            retry_failed=args.retry_failed,
            progress=progress,
        )
    finally:
        progress.close()
    args.stopped = STOPPED_WRITING
    return _finish(args, study, done)


def _finish(args: argparse.Namespace, study: SolverStudy, done: SolverRun) -> int:
    from sparsefit.study.evidence.solver_answers import sentences
    from sparsefit.study.report.solver_pages import shown, write_report
    from sparsefit.study.run.solver_rows import read_cases

    cases = read_cases(done.folder)
    written = write_report(study, done.folder, cases)
    answers = sentences(study, cases)
    if args.json:
        record = {"study": study.name, "folder": str(done.folder), "cases": done.planned}
        counted = {"resumed": done.resumed, "statuses": dict(done.statuses)}
        said = {"answers": answers, "written": [str(path) for path in written]}
        print_json({**record, **counted, "seconds": done.seconds, **said})
        return 0
    print("".join(f"{sentence}\n\n" for sentence in answers), end="")
    print(shown(study, cases, width=terminal_width(), names=("summary",)))
    told = f"{done.planned} cases ({by_status(done.statuses)})"
    if done.resumed == done.planned:
        print(f"nothing to run: all {told} were there")
    else:
        before = f", {done.resumed} of them from before" if done.resumed else ""
        print(f"{told}{before} in {duration(done.seconds)}, one process")
    print(f"written to {done.folder}; start with {written[-1]}")
    return 0


def status(args: argparse.Namespace) -> int:
    """Planned, done, and by status."""
    from sparsefit.study.run import solver_run

    study = _load(args)
    found = solver_run.status(study, args.results)
    if args.json:
        record = {"folder": str(found.folder), "planned": found.planned, "done": found.done}
        counted = {"finished": found.finished, "statuses": dict(found.statuses)}
        print_json({"study": study.name, **record, **counted})
        return 0
    state = "finished" if found.finished else "not finished" if found.done else "not begun"
    print(
        f"{study.name}: {state}, {found.done} of {found.planned} cases "
        f"({by_status(found.statuses)}) in {found.folder}"
    )
    return 0


def errors(args: argparse.Namespace) -> int:
    """Who failed where, grouped by reason."""
    return _print_tables(args, ("failures",))


def show(args: argparse.Namespace) -> int:
    """The tables of the study, or those asked for; also of one that is not finished.

    Raises:
        InputError: where one case is asked for: there is no flight to draw.
    """
    from sparsefit.errors import InputError

    if args.case is not None:
        raise InputError("--case draws a flight; of a study of solvers show its tables: --table")
    return _print_tables(args, tuple(args.table or ()))


def _print_tables(args: argparse.Namespace, names: tuple[str, ...]) -> int:
    from sparsefit.study.report.solver_pages import chosen, shown

    study = _load(args)
    cases, note = _stored(args, study)
    if args.json:
        tables = chosen(study, cases, names)
        print_json({name: table_record(table) for name, table in tables.items()})
        return 0
    told = shown(study, cases, width=terminal_width(), names=names)
    print((told or f"{study.name}: nothing to show\n") + note, end="")
    return 0


def _stored(args: argparse.Namespace, study: SolverStudy) -> tuple[pd.DataFrame, str]:
    """The rows that are there, and a note where they are not all."""
    from sparsefit.errors import InputError
    from sparsefit.study.run import solver_rows, solver_run

    found = solver_run.status(study, args.results)
    if found.finished:
        return solver_rows.read_cases(found.folder), ""
    rows = solver_rows.read_rows(found.folder)
    if not rows:
        raise InputError(
            f"{found.folder}: no cases are there; run them first: sparsefit study run {args.study}"
        )
    note = f"(not finished: {found.done} of {found.planned} cases so far)\n"
    return solver_rows.frame(study, rows), note


def report(args: argparse.Namespace) -> int:
    """Tables, pictures and README anew; the cases stay as they are."""
    from sparsefit.errors import InputError
    from sparsefit.study.evidence.solver_answers import sentences
    from sparsefit.study.report.solver_pages import write_report
    from sparsefit.study.run import solver_run
    from sparsefit.study.run.solver_rows import read_cases

    study = _load(args)
    found = solver_run.status(study, args.results)
    if not found.finished:
        raise InputError(
            f"{found.folder}: {found.done} of {found.planned} cases are there; "
            f"run them first: sparsefit study run {args.study}"
        )
    cases = read_cases(found.folder)
    written = write_report(study, Path(found.folder), cases)
    print("\n".join([*sentences(study, cases), *map(str, written)]))
    return 0


RUNS: dict[str, Run] = {
    "check": check,
    "plan": plan,
    "run": run,
    "status": status,
    "errors": errors,
    "show": show,
    "report": report,
}


def _load(args: argparse.Namespace) -> SolverStudy:
    from sparsefit.study.spec.solver_study import SolverStudy

    return SolverStudy.load(args.study)
