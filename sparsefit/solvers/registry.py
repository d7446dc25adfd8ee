"""Solvers by name: of this package, of other packages, of a Python file, and commands.

A solver is a frozen dataclass, whose fields are its settings, with a method

    path(design, target, penalty, alphas, tolerance) -> weights (p, k, n)

for 1/(2m) |Y - Z V|^2 + alpha Omega(V) at descending alphas (p,), in columns Z of unit rms, and
optionally ``takes(penalty)``, the reason for refusing a penalty, empty where it is accepted. Its
class may have ``package``, the module that must be importable, ``extra``, the name for pip, and
``stops``, False for a solver without a tolerance. Other packages declare theirs in the entry-point
group ``sparsefit.solvers``; classes of that kind in a file are solvers; a command is a `Command`.
"""

import importlib.util
import json
import math
import os
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from sparsefit.arrays import Array
from sparsefit.errors import InputError, MissingExtra, SparsefitError, one_line, unknown
from sparsefit.regression.backend import (
    Solution,
    Tolerance,
    checked_class,
    heard,
    imported,
    made,
    plugins,
)
from sparsefit.regression.design import Design
from sparsefit.regression.penalties import Penalty
from sparsefit.regression.problem import RegressionProblem
from sparsefit.solvers.conic import BEHIND_CVXPY, Clarabel
from sparsefit.solvers.peers import PEERS, Task, kind_of, solved_in_parts

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

__all__ = ["LateError", "Recipe", "answers", "solver", "solver_names"]
FOREVER = 1e6  # s: the longest wait that the system takes
SHIPPED: Mapping[str, Any] = {**BEHIND_CVXPY, Clarabel.name: Clarabel, **PEERS}


class LateError(SparsefitError):
    """A command exceeded a time limit and was ended; the message continues `the solve`."""


def _plugins() -> "Mapping[str, EntryPoint]":
    return plugins("sparsefit.solvers", tuple(SHIPPED))


def solver_names() -> tuple[str, ...]:
    """Names of the solvers of this package, installed or not, then of other packages."""
    return (*SHIPPED, *sorted(_plugins()))


def solver(name: str, **settings: Any) -> Any:
    """The solver of that name with these settings.

    Raises InputError on an unknown name or setting or a value out of range, MissingExtra where a
    package that it needs is not installed.
    """
    return Recipe(name, settings).make()


@dataclass(frozen=True)
class Recipe:
    """A solver in plain values: name, settings and origin.

    file: path of the Python file with its class. command: a program and its arguments, run as a
    `Command`. limit: seconds of a solve; start: seconds of starting, reading and writing.
    """

    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    file: str = ""
    command: tuple[str, ...] = ()
    limit: float = math.inf
    start: float = math.inf

    @property
    def owner(self) -> Any:
        """The class of the solver, or its row of `SHIPPED`. Raises InputError without one."""
        if self.command:
            return Command
        if self.file:
            classes = _classes_of(str(Path(self.file).resolve()))
            if self.name not in classes:
                raise unknown(f"solver of {Path(self.file).name}", self.name, classes)
            return classes[self.name]
        if self.name in SHIPPED:
            return SHIPPED[self.name]
        if self.name not in _plugins():
            raise unknown("solver", self.name, solver_names())
        where = f"solver {self.name!r} (plug-in)"
        return checked_class(where, imported(where, _plugins()[self.name].load), "path", "name")

    def make(self) -> Any:
        """The solver. Raises InputError on an unknown name or setting, MissingExtra as `solver`."""
        owner, settings, preset = self.owner, dict(self.settings), dict[str, Any]()
        if owner is Command:
            return Command(self)
        if self.package and importlib.util.find_spec(self.package) is None:
            extra = getattr(owner, "extra", "") or self.package
            raise MissingExtra(f"{self.name} is not installed: pip install {extra}")
        if not isinstance(owner, type):  # a row, of which iterations can be set, if anything
            owner, preset = type(owner), vars(owner).copy()
            settings = {k: preset.pop(k) for k in ("iterations",) if k in preset} | settings
        return made(f"solver {self.name}", owner, settings, **preset)

    @property
    def missing(self) -> str:
        """The message where a required package is not installed; empty where it is."""
        try:
            self.make()
        except MissingExtra as error:
            return str(error)
        return ""

    @property
    def stops(self) -> bool:
        """Whether a tolerance can be set."""
        return bool(getattr(self.owner, "stops", True))

    @property
    def package(self) -> str:
        """The package that must be importable; empty where none is needed."""
        return str(getattr(self.owner, "package", ""))


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


@dataclass(frozen=True)
class Command:
    """A solver that is a command: any program that reads and writes files, ``COMMAND... FOLDER``.

    It is started once for a path of each target, or of all where a penalty couples these. FOLDER
    holds the problem in the form of `peers`: ``problem.json`` (kind, fractions f (p,), ridge rho,
    tolerance, settings), ``target.npy`` y (m, b), ``groups.npy`` (k,), from 0, ``lambdas.npy`` (k,)
    where the kind has them (of SLOPE its sequence), and X as ``design.npy`` (m, k) or, where it is
    sparse, ``design.npz`` of scipy. The program reads them, prints a line, reads a line, solves,
    prints a line, and writes ``answer.npy`` (p, b, k). Its time is the one between its two lines:
    neither its start nor files are in it.

    recipe: its command is sought from the folder that its file is in; its limit: seconds [s] of a
    path between these lines; its start: of all beside them: starting, reading and writing.
    """

    recipe: Recipe

    def __post_init__(self) -> None:
        words = self.recipe.command
        if not all(isinstance(word, str) for word in words):
            raise InputError(f"{self.name}: command must be a list of words, a program first")
        path = self._folder / words[0]
        if not (path.is_file() if "/" in words[0] else shutil.which(words[0])):
            raise MissingExtra(f"{self.name}: there is no program {words[0]!r}; install it")

    @property
    def name(self) -> str:
        """The name in tables."""
        return self.recipe.name

    @property
    def _folder(self) -> Path:
        return Path(self.recipe.file).parent

    def takes(self, penalty: Penalty) -> str:
        """The reason for refusing a penalty: problem.json has no name for its kind."""
        return "" if kind_of(penalty) else f"{self.name}: problem.json has no such penalty"

    def path(self, *problem: Any) -> Array:
        """The weights of `timed`, with the same arguments."""
        return self.timed(*problem)[0]

    def timed(
        self, design: Design, target: Array, penalty: Penalty, alphas: Array, tolerance: Tolerance
    ) -> tuple[Array, tuple[float, float]]:
        """Weights (p, k, n) of the program, and its wall and CPU time [s].

        Raises SparsefitError where it fails, `LateError` where it exceeds a limit.
        """
        spent, remaining = [0.0, 0.0], {"solve": self.recipe.limit}

        def solved(task: Task, targets: slice) -> Array:
            with tempfile.TemporaryDirectory(prefix="sparsefit-solver-") as name:
                folder = Path(name)
                if isinstance(task.design, np.ndarray):
                    np.save(folder / "design.npy", task.design)
                else:
                    sparse.save_npz(folder / "design.npz", task.design, compressed=False)
                arrays = {"groups": task.groups, "lambdas": task.lambdas}
                arrays["target"] = np.ascontiguousarray(task.target[:, targets])
                for key, values in arrays.items():
                    if values is not None:
                        np.save(folder / f"{key}.npy", values)
                words: dict[str, Any] = {"fractions": task.fractions.tolist(), "kind": task.kind}
                words |= {"ridge": task.ridge, "tolerance": tolerance}
                words |= {"settings": dict(self.recipe.settings)}
                with (folder / "problem.json").open("w", encoding="utf-8") as file:
                    json.dump(words, file)
                for part, seconds in enumerate(self._run(folder, remaining)):
                    spent[part] += seconds
                try:
                    answer: Array = np.load(folder / "answer.npy", allow_pickle=False)
                except (OSError, ValueError) as error:
                    raise InputError(f"{self.name} wrote no answer.npy ({error})") from None
                return answer

        weights = solved_in_parts(solved, design, target, penalty, alphas)
        return weights, (spent[0], spent[1])

    def _run(self, folder: Path, remaining: dict[str, float]) -> tuple[float, float]:
        """Wall and CPU time [s] between the two lines that the program prints."""
        program, *rest = self.recipe.command
        first = str((self._folder / program).absolute()) if "/" in program else program
        remaining["start"], errors = self.recipe.start, (folder / "errors").open("w+b")
        pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": errors}
        words, where = [first, *rest, str(folder)], self._folder
        started: Any = subprocess.Popen(words, cwd=where, bufsize=0, process_group=0, **pipes)
        with errors, started as run:
            try:
                ready = self._line(run, "start", remaining)
                wall, cpu = perf_counter(), _cpu_seconds(run.pid)
                if ready:
                    with suppress(BrokenPipeError):  # it has ended: the next line says so
                        run.stdin.write(b"go\n")
                done = self._line(run, "solve", remaining) if ready else b""
                wall, cpu = perf_counter() - wall, _cpu_seconds(run.pid) - cpu
                while self._line(run, "start", remaining):
                    pass
                code = run.wait(max(min(remaining["start"], FOREVER), 0.0))
            except subprocess.TimeoutExpired:
                raise self._late("start") from None
            finally:
                with suppress(ProcessLookupError):
                    os.killpg(run.pid, signal.SIGKILL)
            if not done or code:
                errors.seek(max(errors.seek(0, os.SEEK_END) - 1000, 0))
                printed = errors.read().decode(errors="replace").strip().splitlines()
                last = one_line(printed[-1] if printed else "", 200)
                raise SparsefitError(f"{self.name} ended with code {code}: {last}")
        return wall, cpu

    def _line(self, run: Any, part: str, remaining: dict[str, float]) -> bytes:
        """The next line of the program, empty at its end; its time counts towards ``part``."""
        began = perf_counter()
        if not select.select([run.stdout], [], [], max(min(remaining[part], FOREVER), 0.0))[0]:
            raise self._late(part)
        line: bytes = run.stdout.readline()
        remaining[part] -= perf_counter() - began
        return line

    def _late(self, part: str) -> LateError:
        if part == "solve":
            return LateError(f"took longer than {self.recipe.limit:g} s")
        return LateError(f"took longer than {self.recipe.start:g} s to start, to read or to write")


def _cpu_seconds(pid: int) -> float:
    """The CPU time [s] of a process from /proc; NaN on systems without it."""
    try:
        words = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        return float("nan")
    return sum(map(int, words[11:13])) / os.sysconf("SC_CLK_TCK")
