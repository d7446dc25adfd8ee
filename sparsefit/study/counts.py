"""How large a study is, for `study plan`: numbers for programs, and lines for people."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from sparsefit.study.contenders import ProblemDesign
from sparsefit.study.definition import Entry
from sparsefit.study.flight_experiment import (
    FlightExperiment,
    fit_key,
    flight_key,
    problem_key,
    sharing,
)
from sparsefit.study.plan import Experiment


def counts_of(experiment: Experiment, cases: int) -> dict[str, Any]:
    """The size of a study, JSON-ready; "rows": (label, words) lines for people."""
    if isinstance(experiment, FlightExperiment):
        return _flights(experiment, cases)
    design = experiment.definition.design
    assert isinstance(design, ProblemDesign)
    return _problems(experiment, design, cases)


def _flights(experiment: FlightExperiment, cases: int) -> dict[str, Any]:
    design, outputs = experiment.design, experiment.definition.outputs
    settings = {choice.label: choice.size for choice in design.backends}
    work = {
        name: design.count * len(sharing(design.cells, key))
        for name, key in (
            ("simulations", flight_key),
            ("problems", problem_key),
            ("fits", fit_key),
        )
    }
    each = cases // max(sum(settings.values()), 1)
    steps = f"{work['problems']} regression problems, {work['fits']} fits"
    rows = [
        ("flights", str(design.count)),
        ("protocols", ", ".join(protocol.name for protocol in design.protocols)),
        *((f"sweep {f.key}", f"{len(f.levels)} levels") for f in design.sweep),
        *(
            (f"back-end {label}", f"{size} settings, {size * each} cases")
            for label, size in settings.items()
        ),
        ("cases", str(cases)),
        ("work", f"{work['simulations']} simulations, {steps}"),
        ("tables", ", ".join(map(name_of, outputs.tables)) or "those that fit the cases"),
        ("figures", ", ".join(map(name_of, outputs.figures)) or "those that fit the cases"),
    ]
    return {
        "flights": design.count,
        "protocols": len(design.protocols),
        "levels": {factor.key: len(factor.levels) for factor in design.sweep},
        "settings": settings,
        **work,
        "cases": cases,
        "tables": list(outputs.tables),
        "figures": list(outputs.figures),
        "rows": rows,
    }


def _problems(experiment: Experiment, design: ProblemDesign, cases: int) -> dict[str, Any]:
    sizes: dict[str, Mapping[str, Any]] = {
        source.name: experiment.truth(unit, 0) for unit, source in enumerate(design.problems)
    }
    solvers: dict[str, list[str]] = {}
    for contender in design.contenders:
        solvers.setdefault(contender.objective, []).append(contender.solver)
    missing = {c.solver: c.missing for c in design.contenders if c.missing}
    work = f"paths of {len(design.fractions)} points" if design.fractions else "single fits"
    rows = [
        *(("problem", f"{name}: {_sized(size)}") for name, size in sizes.items()),
        *(("objective", f"{name}: {', '.join(names)}") for name, names in solvers.items()),
        *(("missing", f"{solver}: {why}") for solver, why in missing.items()),
        ("work", work),
        ("accuracies", ", ".join(f"{level:g}" for level in design.accuracies)),
        ("cases", str(cases)),
        ("at most", f"{design.at_most / 60.0:.0f} min, all limits reached"),
    ]
    return {
        "problems": {name: dict(size) for name, size in sizes.items()},
        "objectives": solvers,
        "missing": missing,
        "points": max(len(design.fractions), 1),
        "cases": cases,
        "rows": rows,
    }


def _sized(size: Mapping[str, Any]) -> str:
    targets = size["targets"]
    words = f"{size['samples']} samples, {size['columns']} columns"
    return f"{words}, {targets} target{'s' if targets != 1 else ''}"


def name_of(entry: Entry) -> str:
    """The name of an entry of [outputs], or the measure that it shows."""
    if isinstance(entry, str):
        return entry
    return str(entry.get("name") or entry.get("measure", ""))
