"""Solvers by name: those that ship, those of other packages, of a file, and commands.

A solver is a frozen dataclass, whose fields are its settings, with a method

    path(design, target, penalty, alphas, tolerance) -> weights (p, k, n)

for 1/(2m) |Y - Z V|^2 + alpha Omega(V) at descending alphas (p,), in columns Z of unit rms, and
optionally ``takes(penalty)``, the reason why it does not take a penalty, empty where it does. Four
texts of its class are optional: ``package``, what must be importable; ``extra``, what pip installs
for it; ``form``, how the problem is handed over, in words; ``stops``, False where there is no
tolerance to set. Other packages name theirs in the entry-point group ``sparsefit.solvers``; a file
is imported and its classes of that kind are solvers; a command is a `Command`.
"""

import importlib.util
import sys
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from time import perf_counter, process_time
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, MissingExtra, SparsefitError, described, one_line, unknown
from sparsefit.regression.backend import Solution, quiet
from sparsefit.regression.design import RowDesign
from sparsefit.regression.penalties import alpha_max
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.peers import Timed

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = [
    "SOLVERS",
    "Answers",
    "Recipe",
    "Solver",
    "answers",
    "solver",
    "solver_names",
    "solver_type",
]

PEERS, CONIC = "sparsefit.solvers.peers", "sparsefit.solvers.conic"
SOLVERS: Mapping[str, str] = MappingProxyType(
    {
        "clarabel": f"{CONIC}:Clarabel",
        "clarabel-direct": f"{CONIC}:ClarabelDirect",
        "cvxpy": f"{CONIC}:Cvxpy",
        "cvxpy-rows": f"{CONIC}:CvxpyRows",
        "scikit-learn-lars": f"{PEERS}_paths:ScikitLars",
        "spams": f"{PEERS}_paths:Spams",
        "scikit-learn-cd": f"{PEERS}_descent:ScikitDescent",
        "celer": f"{PEERS}_descent:Celer",
        "skglm": f"{PEERS}_skglm:Skglm",
        "glum": f"{PEERS}_descent:Glum",
        "sortedl1": f"{PEERS}_descent:SortedL1",
        "group-lasso-fista": f"{PEERS}_descent:Fista",
        "asgl": f"{PEERS}_descent:Asgl",
        "osqp-direct": f"{PEERS}_quadratic:OsqpDual",
        "piqp-direct": f"{PEERS}_quadratic:PiqpDual",
        "daqp-direct": f"{PEERS}_quadratic:DaqpDual",
    }
)
"""The solvers that ship beside sparsefit's own: name -> class, imported when first asked for."""
BEHIND_CVXPY = ("osqp", "scs", "highs", "piqp", "daqp", "ecos", "proxqp", "qoco", "cvxopt")
"""Names that stand for ``cvxpy`` with this solver; `cvxpy-NAME` and `cvxpy-rows-NAME` for any."""


class Solver(Protocol):
    """A solver of penalised least squares: a frozen dataclass whose fields are its settings."""

    @property
    def name(self) -> str:
        """The name that studies use; a text of the class."""
        ...

    def path(
        self, design: Any, target: Array, penalty: Any, alphas: Array, tolerance: float | None
    ) -> Array | Timed:
        """Weights (p, k, n) of columns of unit rms at descending alphas (p,).

        tolerance: where it stops, in its own measure; None leaves the choice to it.
        """
        ...


@dataclass(frozen=True, eq=False)
class Answers:
    """Solutions of a path, with the seconds of wall and CPU [s] that the solver took."""

    solutions: tuple[Solution, ...]
    wall: float
    cpu: float


@dataclass(frozen=True)
class Recipe:
    """A solver in plain values: its name, settings, and the file or command that it comes from.

    file: path of a Python file with its class; command: a program and its arguments, a `Command`.
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""
    command: tuple[str, ...] = ()

    def make(self) -> Solver:
        """The solver. Raises InputError on an unknown name or setting, MissingExtra as `solver`."""
        if not self.command:
            return _made(self.name, solver_type(self.name, self.file), self.settings)
        from sparsefit.solvers.command import Command

        folder = str(Path(self.file or ".").parent if self.file else Path())
        return Command(self.name, self.command, folder, dict(self.settings))

    @property
    def missing(self) -> str:
        """The remedy where the package that the solver needs is absent; empty where it is there."""
        try:
            self.make()
        except MissingExtra as error:
            return str(error)
        return ""

    @property
    def form(self) -> str:
        """Words for how the problem is handed over."""
        if self.command:
            return f"the command {' '.join(self.command)}"
        cls = solver_type(self.name, self.file)
        return str(getattr(cls, "form", "")) or (cls.__doc__ or "").strip().split("\n")[0]

    @property
    def stops(self) -> bool:
        """Whether a tolerance can be set."""
        return bool(self.command) or getattr(solver_type(self.name, self.file), "stops", True)


@cache
def _plugins() -> "Mapping[str, EntryPoint]":
    from importlib.metadata import entry_points

    found = entry_points(group="sparsefit.solvers")
    return MappingProxyType({e.name: e for e in found if e.name not in SOLVERS})


def solver_names() -> tuple[str, ...]:
    """Names of the solvers that ship, installed or not, then those of other packages."""
    return (*SOLVERS, *sorted(_plugins()))


def solver_type(name: str, file: str | Path = "") -> type[Solver]:
    """The class of a solver, of ``file`` where one is named.

    Raises InputError on an unknown name, and on a plug-in or file that cannot be imported.
    """
    if file:
        classes = _classes_of(str(Path(file).resolve()))
        if name not in classes:
            raise unknown(f"solver of {Path(file).name}", name, classes)
        return classes[name]
    name = _preset(name)[0]
    if name in SOLVERS:
        module, _, attribute = SOLVERS[name].partition(":")
        return cast(type[Solver], getattr(import_module(module), attribute))
    if name not in _plugins():
        raise unknown("solver", name, solver_names())
    return _checked(name, _imported(f"solver {name!r} (plug-in)", _plugins()[name].load))


def solver(name: str, **settings: Any) -> Solver:
    """The solver of that name with these settings.

    Raises InputError on an unknown name or setting or a value out of range, MissingExtra where a
    package that it needs is not installed.
    """
    return _made(name, solver_type(name), settings)


def answers(
    solver: Solver,
    problem: RegressionProblem,
    penalty: Any,
    alpha_fractions: Sequence[float],
    tolerance: float | None = None,
) -> Answers:
    """Solutions at descending penalty fractions, in the units of the problem's columns.

    An exception becomes the status ``error``; a warning ``inaccurate``, with its first words: a
    solver is not trusted to be silent.
    """
    fractions, count = np.array(alpha_fractions, dtype=float), len(alpha_fractions)
    design = RowDesign(problem.theta, problem.samples)
    cross = design.correlate(problem.target)
    shape, alphas = cross.shape, alpha_max(cross, penalty) * fractions
    if not cross.any():
        zero = Solution(np.zeros(shape), solver_status="target is zero", iterations=0)
        return Answers((zero,) * count, 0.0, 0.0)
    wall, cpu = perf_counter(), process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            raw = solver.path(design, problem.target, penalty, alphas, tolerance)
            weights = np.array(raw.weights if isinstance(raw, Timed) else raw, dtype=float)
            if weights.shape != (count, *shape):
                raise InputError(f"weights of shape {weights.shape}, not {(count, *shape)}")
        except Exception as error:  # a public solver may raise anything
            words = f"{solver.name}: {described(error)}"
            failed = Solution(None, "error", words, type(error).__name__)
            return Answers((failed,) * count, perf_counter() - wall, process_time() - cpu)
    wall, cpu = perf_counter() - wall, process_time() - cpu
    if isinstance(raw, Timed):
        wall, cpu = raw.wall, raw.cpu
    doubts = [f"{w.category.__name__}: {w.message}" for w in caught if _matters(w)]
    words = one_line(doubts[0], 120) if doubts else "returned"
    status, reason = ("inaccurate", f"{solver.name}: {words}") if doubts else ("ok", "")
    weights /= design.rms[:, None]
    found = tuple(Solution(each, status, reason, words) for each in weights)  # type: ignore[arg-type]
    return Answers(found, wall, cpu)


def _matters(warning: warnings.WarningMessage) -> bool:
    """Whether a warning is about the solution, and not about a library's future."""
    future = DeprecationWarning | FutureWarning | PendingDeprecationWarning
    return not issubclass(warning.category, future) and "deprecated" not in str(warning.message)


def _preset(name: str) -> tuple[str, dict[str, Any]]:
    """The registered name that a name stands for, and the settings that it implies."""
    if name in BEHIND_CVXPY:
        return "cvxpy", {"solver": name}
    for base in ("cvxpy-rows", "cvxpy"):
        if name.startswith(f"{base}-") and name not in SOLVERS:
            return base, {"solver": name.removeprefix(f"{base}-")}
    return {"clarabel-working-set": "clarabel"}.get(name, name), {}


def _made(name: str, cls: type[Solver], settings: Mapping[str, Any]) -> Solver:
    settings = {**_preset(name)[1], **settings}
    valid = [item.name for item in fields(cast(Any, cls)) if item.init]
    for key in settings:
        if key not in valid:
            raise unknown(f"setting of solver {name}", key, valid)
    package = str(getattr(cls, "package", ""))
    if package and importlib.util.find_spec(package) is None:
        extra = getattr(cls, "extra", "") or package
        raise MissingExtra(f"{name} is not installed: pip install {extra}")
    try:
        with quiet():
            return cast(Solver, cast(Any, cls)(**settings))
    except SparsefitError:
        raise
    except (TypeError, ValueError) as error:
        raise InputError(f"solver {name!r} refuses these settings: {error}") from None


@cache
def _classes_of(file: str) -> Mapping[str, type[Solver]]:
    """The solvers that a Python file defines, by name."""
    path = Path(file)
    module_name = f"sparsefit_solvers_of_{path.stem}"
    spec = importlib.util.spec_from_file_location(module_name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise InputError(f"{path}: no such Python file of solvers")
    module = importlib.util.module_from_spec(spec)
    sys.modules[module_name] = module  # dataclasses look their module up by its name
    _imported(str(path), partial(spec.loader.exec_module, module))
    classes = [cls for cls in vars(module).values() if _is_solver(cls, module)]
    if not classes:
        raise InputError(f"{path} has no frozen dataclass with a `name` and a `path` method")
    return {cls.name: _checked(cls.name, cls) for cls in classes}


def _is_solver(cls: object, module: ModuleType) -> bool:
    mine = isinstance(cls, type) and cls.__module__ == module.__name__
    return mine and callable(getattr(cls, "path", None)) and hasattr(cls, "name")


def _imported(where: str, load: Any) -> Any:
    try:
        with quiet():
            return load()
    except (Exception, SystemExit) as error:  # code of others may raise anything on import
        raise InputError(f"{where} cannot be loaded: {described(error)}") from error


def _checked(name: str, cls: Any) -> type[Solver]:
    frozen = is_dataclass(cls) and cast(Any, cls).__dataclass_params__.frozen
    if not (frozen and callable(getattr(cls, "path", None)) and isinstance(cls.name, str)):
        raise InputError(
            f"solver {name!r} is not a frozen dataclass with a text `name` and a `path` method"
        )
    return cast(type[Solver], cls)
