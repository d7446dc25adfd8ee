"""The kind of a study: of flights, or of solvers (`kind.py`)."""

from __future__ import annotations

from sparsefit.study.run.flight_kind import FlightKind
from sparsefit.study.run.kind import Kind
from sparsefit.study.run.solver_kind import SolverKind
from sparsefit.study.spec.identity import AnyStudy
from sparsefit.study.spec.solver_study import SolverStudy


def kind_of(study: AnyStudy) -> Kind:
    """A study with what its kind does in its own way."""
    return SolverKind(study) if isinstance(study, SolverStudy) else FlightKind(study)
