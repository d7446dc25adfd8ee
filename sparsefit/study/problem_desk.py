"""The worker's side of a study of problems: solve what is in hand, and judge it in another process.

A solver's process (`SolverDesk`) meets each problem as a file. For every solve it makes arrays of
its own: read-only copies at other addresses, with the signs of rows and of the target changed,
(D Z, s D y) for signs D and s, which is the same problem with the solution s W in other bytes: an
answer that was kept from an earlier call is none. Weights are written into a file that the parent
has filled with NaN; whatever is not there when the clock stops is no answer.

The judge (`JudgeDesk`) has a process of its own. With V the answer, from the rows of the problem,

    excess = (P(V) - max(D, D_ref)) / (|Y|^2 / 2m),

the worst over the path, with P the objective of the contender's weights, D the dual bound that its
own residual gives and D_ref that of sparsefit's exact path at the same penalty. Any dual bound is a
proof for everyone, by weak duality: a solver is not blamed for a poor dual point.
"""

from __future__ import annotations

import ctypes
import dataclasses
import gc
import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.sparse import csc_array

from sparsefit import RegressionProblem, backends
from sparsefit import path as certified_path
from sparsefit.arrays import Array
from sparsefit.backends import Solution
from sparsefit.errors import one_line
from sparsefit.regression.backend import PathBackend, PenalisedBackend, numeric_fraction
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.fit import certificate_of
from sparsefit.solvers.penalised import PenalisedPath
from sparsefit.solvers.registry import LateError, Recipe, answers
from sparsefit.study.data_sets import Data
from sparsefit.study.schema import canonical_json
from sparsefit.study.worker import resident

FIRST_SECONDS = 120.0  # of a first call that may compile
SPARSE = ("data", "indices", "indptr", "shape")  # of a matrix by columns


@dataclass(frozen=True, eq=False, kw_only=True)
class Contender:
    """A solver of an objective: a back-end with its settings, and who solves it.

    tolerances: where it is asked to stop, loosest first, NaN where it has none to set; missing: why
    it cannot run here, empty where it can; family: what shares a process with it; certified:
    whether checks of the data and certificates are in its time; limit: seconds [s] of a solve;
    foreign: whether it is code that nobody ships; recipe: the solver, None for the back-end's own.
    """

    objective: str
    backend: str
    settings: Mapping[str, float | int | str | bool]
    solver: str
    tolerances: tuple[float, ...]
    missing: str
    family: str
    certified: bool
    limit: float
    foreign: bool
    recipe: Recipe | None

    def killed(self, targets: int, *, first: bool = False) -> float:
        """Seconds [s] after which a solve is killed: a command keeps its limits itself.

        The first call of what ships may compile.
        """
        if self.recipe is not None and self.command:
            return self.limit + targets * self.recipe.start + FIRST_SECONDS
        return max(self.limit, FIRST_SECONDS) if first and not self.foreign else self.limit

    @property
    def command(self) -> bool:
        """Whether it is a program of its own, which keeps its clock and its limits itself."""
        return self.recipe is not None and bool(self.recipe.command)

    @property
    def files(self) -> list[Path]:
        """The solver's own files: that of its class, or what of a command lies beside the study."""
        if self.recipe is None or not self.recipe.file:
            return []
        file = Path(self.recipe.file)
        if not self.recipe.command:
            return [file]
        words = [(file.parent / word).resolve() for word in self.recipe.command]
        home = file.parent.resolve()  # where an interpreter that is linked there does not lie
        return [path for path in words if path.is_file() and path.is_relative_to(home)]

    @property
    def settled(self) -> Any:
        """The back-end with its settings."""
        return backends.get(self.backend, **self.settings)

    @property
    def problem_of(self) -> str:
        """The objective that it minimises, as canonical JSON."""
        return canonical_json([self.backend, dict(self.settings)])

    @property
    def content(self) -> str:
        """All its settings, of the back-end and of the solver, as canonical JSON."""
        own = {"solver": self.recipe.name, **self.recipe.settings} if self.recipe else {}
        return canonical_json({**self.settings, **own})


def write_data(data: Data, file: Path) -> None:
    """The rows of a problem in a file, for `read_rows`."""
    content: dict[str, Any] = {"target": data.target, "samples": data.samples or 0}
    if isinstance(data.theta, np.ndarray):
        content["theta"] = data.theta
    else:
        content |= {name: getattr(data.theta, name) for name in SPARSE}
    if data.groups is not None:
        content["groups"] = np.unique(data.groups, return_inverse=True)[1]
    np.savez(file, **content)


def read_rows(file: str) -> Data:
    """The rows of a problem that the parent wrote."""
    with np.load(file, allow_pickle=False) as arrays:
        theta: Any = arrays.get("theta")
        if theta is None:
            values, indices, starts, shape = (arrays[name] for name in SPARSE)
            theta = csc_array((values, indices, starts), shape=tuple(shape))
        samples = int(arrays["samples"]) or None
        return Data(theta, arrays["target"], arrays.get("groups"), samples=samples)


def problem_of(data: Data, *, partial: bool = False) -> RegressionProblem:
    """The regression problem of these rows; partial: where others of it are left out."""
    arrays = (data.theta, data.target, data.groups)
    problem = RegressionProblem.from_arrays(*arrays, partial=partial)
    if data.samples is None:
        return problem
    return dataclasses.replace(problem, sample_count=data.samples)


def part_of(data: Data, without: tuple[int, int] | None, seed: int) -> Data:
    """A copy of the rows without a range, with signs by a seed, and read-only."""
    every = np.arange(len(data.target))
    chosen = slice(None) if without is None else np.delete(every, np.s_[slice(*without)])
    signs, sign = signs_of(len(data.target[chosen]), seed)
    theta, target = data.theta[chosen], sign * signs[:, None] * data.target[chosen]
    numbers = theta = theta * signs[:, None] if isinstance(theta, np.ndarray) else theta.copy()
    if not isinstance(theta, np.ndarray):
        theta.data *= signs[theta.indices]
        numbers = theta.data
    for array in (numbers, target):
        array.setflags(write=False)
    return Data(theta, target, data.groups, samples=data.samples if without is None else None)


def signs_of(rows: int, seed: int) -> tuple[Array, float]:
    """The signs of the rows (m,) and of the target; seed 0 changes none."""
    if not seed:
        return np.ones(rows), 1.0
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], rows)
    return signs, -1.0 if seed % 2 else 1.0


def solve(
    contender: Contender, problem: RegressionProblem, fractions: Sequence[float], tolerance: float
) -> Sequence[Solution]:
    """The contender's answers, one per penalty; uncertified unless that is in its time."""
    backend = contender.settled
    stop, requested = None if math.isnan(tolerance) else tolerance, tuple(fractions)
    if contender.certified:
        data = (problem.theta, problem.target, problem.groups)
        fits = certified_path(RegressionProblem.from_arrays(*data), backend, requested).fits
        return [Solution(fit.weights, solver_status=fit.status) for fit in fits]
    if not isinstance(backend, PenalisedBackend):
        return [backend.solve(problem)]
    requested = requested or own_fraction(backend)
    if contender.recipe is not None:
        penalty = backend.penalty(problem)
        return answers(contender.recipe.make(), problem, penalty, requested, stop)
    if isinstance(backend, PathBackend):
        return backend.solve_path(problem, requested)
    penalised: Any = backend
    points = [dataclasses.replace(penalised, alpha_fraction=fraction) for fraction in requested]
    return [point.solve(problem) for point in points]


def own_fraction(backend: Any) -> tuple[float, ...]:
    """The penalty fraction of a back-end's own settings; none where it has no penalty."""
    if isinstance(backend, PenalisedBackend):
        return (numeric_fraction(backend.name, backend.alpha_fraction),)
    return ()


def small_problem() -> RegressionProblem:
    """Twelve columns in groups of three, two targets: the problem of a first call."""
    draw = np.random.default_rng(0)
    theta = draw.standard_normal((40, 12))
    target = theta[:, :2] @ draw.standard_normal((2, 2)) + 0.1 * draw.standard_normal((40, 2))
    return RegressionProblem.from_arrays(theta, target, np.arange(12) // 3)


class SolverDesk:
    """Solves for the contenders of one family, one call at a time, a path or a single fit each."""

    def __init__(self, contenders: Sequence[Contender], fractions: Sequence[float]) -> None:
        self._contenders, self._fractions = contenders, fractions
        self._data: tuple[str, Data] | None = None
        self._work: tuple[Any, ...] = ()
        self._into: Any = None
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)

    def nothing(self) -> None:
        """An ask whose time is the clock's own."""

    def ready(
        self,
        contender: int,
        tolerance: float,
        file: str,
        seed: int,
        without: tuple[int, int] | None,
        weights: str,
    ) -> Mapping[str, Any]:
        """Copy the rows of a file, to be solved next; the memory before that."""
        if self._data is None or self._data[0] != file:
            self._data = (file, read_rows(file))
        part = part_of(self._data[1], without, seed)
        problem = problem_of(part, partial=without is not None)
        self._work = (self._contenders[contender], problem, self._fractions, tolerance)
        self._into = np.lib.format.open_memmap(weights, mode="r+")
        memory = _peak_from_here()
        gc.collect()
        gc.disable()
        return {"memory": memory}

    def first(self, contender: int, tolerance: float) -> Mapping[str, Any]:
        """A first call, on a small problem, of which it only counts that a command was late."""
        self._work = (self._contenders[contender], small_problem(), self._fractions, tolerance)
        self._into = ()
        answer = self.solve()
        gc.collect()
        gc.freeze()  # later collections pass over what is loaded now
        return answer

    def solve(self) -> Mapping[str, Any]:
        """Solve, and write what is an answer; all of it counts as time."""
        work, self._work = self._work, ()
        try:
            solutions = solve(*work)
        except LateError as late:
            return {"late": str(late)}
        finally:
            gc.enable()
        for into, solution in zip(self._into, solutions, strict=False):
            if solution.status != "error" and solution.weights is not None:
                into[...] = np.asarray(solution.weights, float)
        rank = {"ok": 0, "inaccurate": 1, "unidentifiable": 2}
        worst = max(solutions, key=lambda each: rank.get(each.status, 3), default=None)
        words = f"{worst.solver_status} {worst.reason}" if worst else "no answer"
        clock = worst.clock if worst else None
        return {"words": one_line(words, 200), "memory": resident(), "clock": clock}


class JudgeDesk:
    """Judges answers from the rows of a problem, in a process that no solver shares."""

    def __init__(self, contenders: Sequence[Contender], fractions: Sequence[float]) -> None:
        self._contenders, self._fractions = contenders, fractions
        self._file = ""
        self._problem: Any = None
        self._bounds: dict[str, Array] = {}

    def verdict(self, file: str, contender: int, weights: str) -> Mapping[str, Any]:
        """The kind of the certificate, its worst value, and the excess, of the weights (p, k, n) of
        a contender on the problem in a file.
        """
        if file != self._file:
            self._file, self._problem, self._bounds = file, problem_of(read_rows(file)), {}
        problem, solved = self._problem, self._contenders[contender]
        answers, backend = np.load(weights, allow_pickle=False), solved.settled
        kind = str(backend.certificate_kind)
        if kind != "duality_gap" or not isinstance(backend, PenalisedBackend):
            certificates = [certificate_of(problem, backend, Solution(each)) for each in answers]
            values = [math.nan if c is None else c.value for c in certificates]
            worst = max(math.inf if math.isnan(value) else value for value in values)
            return {"kind": kind, "gap": worst, "excess": worst}
        fractions = self._fractions or own_fraction(backend)
        penalty = backend.penalty(problem)
        alphas = problem.alpha_max(penalty) * np.array(fractions)
        gaps = duality_gaps(problem.design, problem.target, answers, alphas, penalty)
        if solved.problem_of not in self._bounds:  # D_ref (p,) of the exact path, -inf of none
            exact = isinstance(backend, PenalisedPath)
            fits = certified_path(problem, backend, fractions).fits if exact else ()
            lower = [f.certificate.dual if f.certificate else -math.inf for f in fits]
            self._bounds[solved.problem_of] = np.array(lower or [-math.inf] * len(fractions))
        bounds = np.maximum([c.dual for c in gaps], self._bounds[solved.problem_of])
        excess = np.maximum(np.array([c.primal for c in gaps]) - bounds, 0.0).max()
        null = problem.statistics.null_objective or 1.0
        return {"kind": kind, "gap": max(c.value for c in gaps), "excess": float(excess) / null}


def _peak_from_here() -> float | None:
    """Megabytes resident now [MB], with the highest so far forgotten; None without /proc."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)
    with suppress(OSError):
        with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
            file.write("5")
        return resident("VmRSS")
    return None
