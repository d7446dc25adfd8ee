"""Solvers by name: the referee, those of other packages and of a Python file, and commands.

A solver is a frozen dataclass, whose fields are its settings, with a method

    path(design, target, penalty, alphas, tolerance) -> weights (p, k, n)

for 1/(2m) |Y - Z V|^2 + alpha Omega(V) at descending alphas (p,), in columns Z of unit rms, and
optionally ``takes(penalty)``, the reason for refusing a penalty, empty where it is accepted. Its
class may have ``package``, the module that must be importable, ``extra``, the name for pip,
``stops``, False for a solver without a tolerance, and ``compiles``, True where its first call may
take long. Other packages declare theirs in the entry-point group ``sparsefit.solvers``; classes of
that kind in a file are solvers; a command is a `Command`.
"""

import importlib.util
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, MissingExtra, unknown
from sparsefit.regression.backend import (
    Solution,
    Tolerance,
    checked_class,
    heard,
    imported,
    made,
    plugins,
)
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.commands import Command, LateError
from sparsefit.solvers.conic import Clarabel

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["REFEREE", "LateError", "Recipe", "answers", "solver_names"]
REFEREE = Clarabel.name
DECLARED = {"package": "", "extra": "", "stops": True, "compiles": False}
"""The attributes that the class of a solver may have, and their values without."""


def _plugins() -> "Mapping[str, EntryPoint]":
    return plugins("sparsefit.solvers", (REFEREE,))


def solver_names() -> tuple[str, ...]:
    """Names of the referee and of the solvers of other packages, in order."""
    return (REFEREE, *sorted(_plugins()))


@dataclass(frozen=True)
class Recipe:
    """A solver in plain values: name, settings and origin.

    file: path of the Python file with its class. command: a program and its arguments, run as a
    `Command`, from the folder of ``file``. limit: seconds of a solve; start: seconds of starting,
    reading and writing.
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""
    command: tuple[str, ...] = ()
    limit: float = math.inf
    start: float = math.inf

    @property
    def offered(self) -> tuple[str, ...]:
        """Names of the solvers among which its own is: of its file, or of packages."""
        if self.file and not self.command:
            return tuple(_classes_of(str(Path(self.file).resolve())))
        return solver_names()

    @property
    def owner(self) -> Any:
        """The class of the solver. Raises InputError without one."""
        if self.command:
            return Command
        if self.file:
            classes = _classes_of(str(Path(self.file).resolve()))
            if self.name not in classes:
                raise unknown(f"solver of {Path(self.file).name}", self.name, classes)
            return classes[self.name]
        if self.name == REFEREE:
            return Clarabel
        if self.name not in _plugins():
            raise unknown("solver", self.name, solver_names())
        where = f"solver {self.name!r} (plug-in)"
        return checked_class(where, imported(where, _plugins()[self.name].load), "path", "name")

    def make(self) -> Any:
        """The solver.

        Raises InputError on an unknown name or setting or a value out of range, MissingExtra where
        a package or program that it needs is not installed.
        """
        if self.command:
            folder = Path(self.file).parent
            return Command(self.name, self.command, folder, self.settings, self.limit, self.start)
        package = self.declared("package")
        if package and importlib.util.find_spec(package) is None:
            extra = self.declared("extra") or package
            raise MissingExtra(f"{self.name} is not installed: pip install {extra}")
        return made(f"solver {self.name}", self.owner, self.settings)

    @property
    def missing(self) -> str:
        """The message where a required package is not installed; empty where it is."""
        try:
            self.make()
        except MissingExtra as error:
            return str(error)
        return ""

    def declared(self, attribute: str) -> Any:
        """The value of one of the DECLARED attributes of the solver's class."""
        return getattr(self.owner, attribute, DECLARED[attribute])


def answers(
    solver: Any,
    problem: RegressionProblem,
    penalty: Any,
    alpha_fractions: Sequence[float],
    tolerance: Tolerance = None,
) -> tuple[Solution, ...]:
    """Solutions at descending penalty fractions, in the units of the problem's columns.

    Exceptions and warnings become statuses as in `heard`. Of a `Command` each solution has the time
    that it measured. Raises `LateError` where a command exceeded its limit.
    """
    fractions, count = np.array(alpha_fractions, dtype=float), len(alpha_fractions)
    design, shape = problem.design, (problem.columns, problem.targets)
    alphas = problem.alpha_max(penalty) * fractions
    if not problem.cross.any():
        zero = Solution(np.zeros(shape), solver_status="target is zero", iterations=0)
        return (zero,) * count

    def solved() -> tuple[Array, Any]:
        if hasattr(solver, "takes") and (reason := solver.takes(penalty)):
            raise InputError(reason)
        asked, clock = (design, problem.target, penalty, alphas, tolerance), None
        if isinstance(solver, Command):
            raw, clock = solver.timed(*asked)
        else:
            raw = solver.path(*asked)
        weights = np.array(raw, dtype=float)
        if weights.shape != (count, *shape):
            raise InputError(f"weights of shape {weights.shape}, not {(count, *shape)}")
        return weights / design.rms[:, None], clock

    answer, said = heard(solver.name, solved, LateError)
    if answer is None:
        return (said,) * count
    weights, clock = answer
    return tuple(replace(said, weights=each, clock=clock) for each in weights)


@cache
def _classes_of(file: str) -> Mapping[str, type[Any]]:
    """The solvers that a Python file defines, by name."""
    path = Path(file)
    module_name = f"sparsefit_solvers_of_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise InputError(f"{path}: no such Python file of solvers")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look their module up by its name
    imported(str(path), partial(spec.loader.exec_module, module))
    classes = [
        checked_class(f"solver {cls.name!r}", cls, "path", "name")
        for cls in vars(module).values()
        if isinstance(cls, type) and cls.__module__ == module_name
        if hasattr(cls, "path") and hasattr(cls, "name")
    ]
    if not classes:
        raise InputError(f"{path} has no frozen dataclass with a `name` and a `path` method")
    return {cls.name: cls for cls in classes}
