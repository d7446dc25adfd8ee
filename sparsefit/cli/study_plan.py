"""`sparsefit study check, plan`: what a study file asks for, before anything is computed."""

from __future__ import annotations

import argparse
import dataclasses
from typing import TYPE_CHECKING, Any

from sparsefit.cli.output import duration, print_json
from sparsefit.cli.parser import Run

if TYPE_CHECKING:
    from sparsefit.study.spec.solver_study import SolverStudy
    from sparsefit.study.spec.study import Study


def check(args: argparse.Namespace) -> int:
    """Exit 0 if the study file is valid; solvers that are missing here are named."""
    from sparsefit.study.report.kind_pages import pages_of
    from sparsefit.study.spec.load import load_study
    from sparsefit.study.spec.solver_study import SolverStudy

    study = load_study(args.study)
    pages_of(study).check()
    record: dict[str, Any] = {"study": study.name, "cases": study.planned, "hash": study.hash}
    if isinstance(study, SolverStudy):
        study.build()
        record["missing"] = study.missing
    if args.json:
        print_json(record)
        return 0
    kind = " of solvers" if "missing" in record else ""
    print(f"{args.study}: ok, study {study.name}{kind} plans {study.planned} cases")
    for solver, reason in record.get("missing", {}).items():
        print(f"  missing: {solver}: {reason}")
    return 0


def plan(args: argparse.Namespace) -> int:
    """What will be computed, and of flights written."""
    from sparsefit.study.spec.load import load_study
    from sparsefit.study.spec.solver_study import SolverStudy

    study = load_study(args.study)
    told = _solvers_planned(study) if isinstance(study, SolverStudy) else _flights_planned(study)
    record, rows = told
    if args.json:
        print_json({"study": study.name, **record})
        return 0
    lines = [("study", study.name), ("question", study.question), *rows]
    width = max(len(label) for label, _ in lines)
    print("\n".join(f"{label:<{width}}  {value}" for label, value in lines))
    return 0


RUNS: dict[str, Run] = {"check": check, "plan": plan}
Planned = tuple[dict[str, Any], list[tuple[str, str]]]  # as JSON, and as lines


def _flights_planned(study: Study) -> Planned:
    from sparsefit.study.spec.outputs import name_of
    from sparsefit.study.spec.plan import counts

    counted = counts(study)
    written = {
        "tables": list(study.tables),
        "figures": list(study.figures),
        "answers": list(study.answers),
    }
    each = counted.cases // sum(counted.settings.values())
    rows = [
        ("flights", str(counted.flights)),
        ("protocols", ", ".join(one.name for one in study.protocols)),
        *((f"sweep {key}", f"{levels} levels") for key, levels in counted.levels.items()),
        *(
            (f"back-end {label}", f"{size} settings, {size * each} cases")
            for label, size in counted.settings.items()
        ),
        ("cases", str(counted.cases)),
        (
            "work",
            f"{counted.simulations} simulations, {counted.problems} regression problems, "
            f"{counted.fits} fits",
        ),
        ("tables", ", ".join(map(name_of, study.tables)) or "those that fit the cases"),
        ("figures", ", ".join(map(name_of, study.figures)) or "those that fit the cases"),
        ("answers", ", ".join(map(name_of, study.answers)) or "none"),
    ]
    return {**dataclasses.asdict(counted), **written}, rows


def _solvers_planned(study: SolverStudy) -> Planned:
    sizes = {
        source.name: (problem.samples, problem.columns, problem.targets)
        for source, problem in zip(study.problems, study.build(), strict=True)
    }
    solvers = {
        name: [one.solver for one in study.contenders if one.objective == name]
        for name in study.objectives
    }
    record = {
        "problems": {
            name: {"samples": m, "columns": k, "targets": n} for name, (m, k, n) in sizes.items()
        },
        "objectives": solvers,
        "missing": study.missing,
        "points": max(len(study.fractions), 1),
        "cases": study.planned,
    }
    work = f"paths of {len(study.fractions)} points" if study.fractions else "single fits"
    rows = [
        *(
            ("problem", f"{name}: {m} samples, {k} columns, {n} targets")
            for name, (m, k, n) in sizes.items()
        ),
        *(("objective", f"{name}: {', '.join(found)}") for name, found in solvers.items()),
        *(("missing", f"{solver}: {why}") for solver, why in study.missing.items()),
        ("work", work),
        ("accuracies", ", ".join(f"{level:g}" for level in study.accuracies)),
        ("cases", str(study.planned)),
        ("at most", f"{duration(study.at_most)}, all limits reached"),
    ]
    return record, rows
