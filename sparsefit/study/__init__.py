"""Studies: one TOML file, every planned case a row, and results that are written by the program."""

from sparsefit.study.run.runner import RunStatus, RunSummary, run, status
from sparsefit.study.run.store import read_cases, read_weights
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.plan import Case, Counts, cells, counts, plan
from sparsefit.study.spec.study import Study

__all__ = [
    "Case",
    "Cell",
    "Counts",
    "RunStatus",
    "RunSummary",
    "Study",
    "cells",
    "counts",
    "plan",
    "read_cases",
    "read_weights",
    "run",
    "status",
]
