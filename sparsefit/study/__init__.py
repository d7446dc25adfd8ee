"""Studies: one TOML file, every planned case a row, and results that are written by the program."""

from sparsefit.study.design import Case, Cell, Counts, cells, counts, plan
from sparsefit.study.runner import RunStatus, RunSummary, run, status
from sparsefit.study.spec import Study
from sparsefit.study.store import read_cases, read_weights

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
