"""The size of a study, for `study plan`: a record, JSON-ready."""

from __future__ import annotations

from typing import Any

from sparsefit.study.contenders import ProblemDesign
from sparsefit.study.flight_experiment import (
    FlightExperiment,
    fit_key,
    flight_key,
    problem_key,
    sharing,
)
from sparsefit.study.plan import Experiment


def counts_of(experiment: Experiment, cases: int) -> dict[str, Any]:
    """Numbers of flights, levels, settings, fits and cases; or of problems and their solvers."""
    definition = experiment.definition
    design: Any = definition.design
    if isinstance(experiment, FlightExperiment):
        keys = {"simulations": flight_key, "problems": problem_key, "fits": fit_key}
        record: dict[str, Any] = {
            "flights": design.count,
            "protocols": [protocol.name for protocol in design.protocols],
            "levels": {factor.key: len(factor.levels) for factor in design.sweep},
            "settings": {choice.label: len(choice.points) for choice in design.backends},
            **{name: design.count * len(sharing(design.cells, key)) for name, key in keys.items()},
        }
    else:
        assert isinstance(design, ProblemDesign)
        sizes = {s.name: experiment.truth(unit, 0) for unit, s in enumerate(design.problems)}
        objectives: dict[str, list[str]] = {}
        for contender in design.contenders:
            objectives.setdefault(contender.objective, []).append(contender.solver)
        record = {
            "problems": {
                name: ", ".join(f"{count} {words}" for words, count in size.items())
                for name, size in sizes.items()
            },
            "objectives": objectives,
            "missing": {c.solver: c.missing for c in design.contenders if c.missing},
            "points": max(len(design.fractions), 1),
            "accuracies": list(design.accuracies),
            "at_most": f"{design.at_most / 60.0:.0f} min, all limits reached",
        }
    outputs = {"tables": definition.outputs.tables, "figures": definition.outputs.figures}
    named = {
        kind: [e if isinstance(e, str) else e.get("name") or e.get("measure") for e in entries]
        for kind, entries in outputs.items()
    }
    return {**record, "cases": cases, **named}
