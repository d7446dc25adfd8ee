"""Studies: one TOML file, every planned case a row, and results that are written by the program.

What reads stored cases is imported when first used: a worker process needs no data frames.
"""

from typing import TYPE_CHECKING, Any

from sparsefit.study.run.runner import run, status
from sparsefit.study.run.summary import RunStatus, RunSummary
from sparsefit.study.spec.design import Cell
from sparsefit.study.spec.plan import Case, Counts, cells, counts, plan
from sparsefit.study.spec.study import Study

if TYPE_CHECKING:
    from sparsefit.study.run.store import read_cases as read_cases
    from sparsefit.study.run.store import read_weights as read_weights

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


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from sparsefit.study.run import store

    return getattr(store, name)
