"""A study file of either kind."""

from __future__ import annotations

from pathlib import Path

from sparsefit.study.spec.identity import AnyStudy
from sparsefit.study.spec.solver_study import SolverStudy, is_solver_study
from sparsefit.study.spec.study import Study


def load_study(path: str | Path) -> AnyStudy:
    """The study of flights or of solvers that a file describes.

    Raises:
        InputError: with the file, the section and the key (or the line) of the first fault.
    """
    return SolverStudy.load(path) if is_solver_study(path) else Study.load(path)
