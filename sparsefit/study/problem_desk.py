"""A study of problems, worker side: solvers, and in another process the certificates.

A `SolverDesk` holds the rows of a problem. For every solve it makes new arrays: read-only copies at
other addresses, the rows in another order P, and signs of rows and of the target changed,
(P D Z, s P D y). That is the same problem with the solution s W in other bytes, so that a cached
answer is wrong. Where a penalty takes V and -V for different, s = 1. Weights are written into a
file that the parent has filled with NaN; those that are missing when the clock stops count as
unanswered.

A `JudgeDesk` certifies an answer V from the rows of the problem by

    excess = (P(V) - max(D, D_ref)) / (|Y|^2 / 2m),

the largest over the path, with P the primal objective, D the dual bound of the answer's residual
and D_ref that of sparsefit's exact path at the same penalty. By weak duality either bound holds for
every answer, so that a solver is not rated by its dual point.
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

from sparsefit import backends
from sparsefit.arrays import Array
from sparsefit.backends import Solution
from sparsefit.errors import one_line
from sparsefit.regression import RegressionProblem
from sparsefit.regression.backend import PenalisedBackend, numeric_fraction
from sparsefit.regression.fit import certificates_of, points_of, solutions_of
from sparsefit.solvers.penalised import PenalisedPath
from sparsefit.solvers.registry import LateError, Recipe, answers
from sparsefit.study.data_sets import Data
from sparsefit.study.schema import canonical_json
from sparsefit.study.worker import peak_memory

FIRST_SECONDS = 120.0  # of a first call that may compile


@dataclass(frozen=True, eq=False)
class Contender:
    """A solver of an objective, which is a back-end with its settings, at a tolerance.

    tolerance: NaN where it has none; missing: why it cannot run here, empty where it can; family:
    the name that solvers share which run in one process; certified: whether checks of the data and
    certificates are in its time; limit: of a solve [s]; compiles: whether a first call may take
    longer; recipe: the solver, None for the back-end's own; even: whether -V costs what V does.
    """

    objective: str
    backend: str
    settings: Mapping[str, float | int | str | bool]
    solver: str
    recipe: Recipe | None
    certified: bool
    limit: float
    tolerance: float = math.nan
    family: str = ""
    compiles: bool = False
    missing: str = ""
    even: bool = True

    def killed(self, targets: int, *, first: bool = False) -> float:
        """The time [s] after which a solve is killed, longer than a command's own limits.

        A first call may compile.
        """
        if self.recipe is not None and self.command:
            return self.limit + targets * self.recipe.start + FIRST_SECONDS
        return max(self.limit, FIRST_SECONDS) if first and self.compiles else self.limit

    @property
    def command(self) -> bool:
        """Whether it is a program, with a clock and limits of its own."""
        return self.recipe is not None and bool(self.recipe.command)

    @property
    def files(self) -> list[Path]:
        """The solver's own files: that of its class, or those that the words of a command name.

        The first word counts where it lies beside the study: elsewhere it is an interpreter.
        """
        if self.recipe is None or not self.recipe.file:
            return []
        file = Path(self.recipe.file)
        program, *files = [file.parent / word for word in self.recipe.command] or [file]
        if program.resolve().is_relative_to(file.parent.resolve()):
            files.insert(0, program)
        return [path for path in files if os.path.isfile(path)]  # False of any odd word

    @property
    def settled(self) -> Any:
        """The back-end with its settings."""
        return backends.get(self.backend, **self.settings)

    @property
    def names(self) -> tuple[str, str]:
        """The objective and the solver, which its other tolerances share."""
        return self.objective, self.solver

    @property
    def content(self) -> str:
        """All its settings, of the back-end and of the solver, as canonical JSON."""
        own = {"solver": self.recipe.name, **self.recipe.settings} if self.recipe else {}
        return canonical_json({**self.settings, **own})


def problem_of(data: Data, *, partial: bool = False) -> RegressionProblem:
    """The regression problem of these rows; partial: whether they are some of a problem's."""
    arrays = (data.theta, data.target, data.groups)
    problem = RegressionProblem.from_arrays(*arrays, partial=partial)
    if data.samples is None:
        return problem
    return dataclasses.replace(problem, sample_count=data.samples)


def part_of(data: Data, without: tuple[int, int] | None, seed: int) -> Data:
    """A read-only copy of the rows without a range, in an order and with signs drawn by a seed.

    Seed 0: in their order, without signs; an odd seed: with the other sign of the target, too.
    """
    order, sign = np.delete(np.arange(len(data.target)), np.s_[slice(*without or (0, 0))]), 1.0
    signs = np.ones(len(order))
    if seed:
        draw, sign = np.random.default_rng(seed), -1.0 if seed % 2 else 1.0
        order, signs = draw.permutation(order), draw.choice([-1.0, 1.0], len(order))
    across = data.theta.T  # by which a copy of columns stays one of columns
    theta, target = across[:, order].T, sign * signs[:, None] * data.target[order]
    if isinstance(theta, np.ndarray):
        theta *= signs[:, None]
    else:
        theta.sort_indices()
        theta.data *= signs[theta.indices]
    for array in (theta if isinstance(theta, np.ndarray) else theta.data, target):
        array.setflags(write=False)
    return Data(theta, target, data.groups, samples=data.samples if without is None else None)


def solve(
    contender: Contender, problem: RegressionProblem, fractions: Sequence[float]
) -> Sequence[Solution]:
    """The contender's answers, one per penalty; certified only where that is in its time."""
    backend = contender.settled
    stop = None if math.isnan(contender.tolerance) else contender.tolerance
    if contender.certified:
        data = (problem.theta, problem.target, problem.groups)
        fits = backends.path(RegressionProblem.from_arrays(*data), backend, fractions).fits
        return [Solution(fit.weights, solver_status=fit.status) for fit in fits]
    requested = fractions_of(backend, fractions)
    if contender.recipe is not None and isinstance(backend, PenalisedBackend):
        penalty = backend.penalty(problem)
        return answers(contender.recipe.make(), problem, penalty, requested, stop)
    return solutions_of(problem, backend, requested)


def fractions_of(backend: Any, requested: Sequence[float]) -> tuple[float, ...]:
    """The penalty fractions requested of a back-end, or its own; none where it has no penalty."""
    if not isinstance(backend, PenalisedBackend):
        return ()
    return tuple(requested) or (numeric_fraction(backend.name, backend.alpha_fraction),)


def small_problem(*, sparse: bool = False) -> RegressionProblem:
    """The problem of a first call: twelve columns in groups of three, two targets."""
    draw = np.random.default_rng(0)
    theta: Any = draw.standard_normal((40, 12))
    target = theta[:, :2] @ draw.standard_normal((2, 2)) + 0.1 * draw.standard_normal((40, 2))
    theta = csc_array(theta) if sparse else theta
    return RegressionProblem.from_arrays(theta, target, np.arange(12) // 3)


class SolverDesk:
    """Runs the contenders of one family, a path or a single fit at a time."""

    def __init__(self, contenders: Sequence[Contender], fractions: Sequence[float]) -> None:
        self._contenders, self._fractions = contenders, fractions
        self._data: Any = None
        self._work: tuple[Any, ...] = ()
        self._into: Any = None
        self._met: set[tuple[str, str, bool]] = set()
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)

    def nothing(self) -> None:
        """An empty request, whose time is the overhead of one."""

    def hold(self, data: Data) -> None:
        """Take the rows of a problem, in place of another's."""
        self._data = data

    def ready(
        self,
        contender: int,
        seed: int,
        without: tuple[int, int] | None,
        weights: str,
        shape: tuple[int, int, int],
    ) -> Mapping[str, Any]:
        """Copy the rows for the next solve; returns the resident memory before it."""
        part = part_of(self._data, without, seed)
        problem = problem_of(part, partial=without is not None)
        self._work = (self._contenders[contender], problem, self._fractions)
        self._into = np.memmap(weights, float, "r+", shape=shape)
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)
        memory = None
        with suppress(OSError):
            # The kernel counts the peak from here on.
            with open("/proc/self/clear_refs", "w", encoding="ascii") as peaks:
                peaks.write("5")
            memory = peak_memory()
        gc.collect()
        gc.disable()
        return {"memory": memory}

    def first(self, contender: int, sparse: bool) -> Mapping[str, Any]:
        """A first call, on a small problem of dense or sparse columns; its answer is not used."""
        solver = self._contenders[contender]
        if (*solver.names, sparse) in self._met:
            return {}
        self._met.add((*solver.names, sparse))
        self._work = (solver, small_problem(sparse=sparse), self._fractions)
        self._into = ()
        answer = self.solve()
        gc.collect()
        gc.freeze()  # later collections pass over what is loaded now
        return answer

    def solve(self) -> Mapping[str, Any]:
        """Solve and write the weights; the whole call is timed."""
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
        words = (worst.reason or worst.solver_status) if worst else "no answer"
        clock = worst.clock if worst else None
        return {"words": one_line(words, 200), "memory": peak_memory(), "clock": clock}


class JudgeDesk:
    """Certifies answers from the rows of a problem, in a process that no solver shares."""

    def __init__(self, contenders: Sequence[Contender], fractions: Sequence[float]) -> None:
        self._contenders, self._fractions = contenders, fractions
        self._problem: Any = None
        self._bounds: dict[str, Array] = {}

    def hold(self, data: Data) -> None:
        """Take the rows of a problem, in place of another's."""
        self._problem, self._bounds = problem_of(data), {}

    def verdict(self, contender: int, weights: Array) -> Mapping[str, Any]:
        """The kind of certificate, its largest value and the excess of weights (p, k, n), the
        answer of a contender.
        """
        problem, solved = self._problem, self._contenders[contender]
        backend = solved.settled
        kind, fractions = str(backend.certificate_kind), fractions_of(backend, self._fractions)
        proofs = certificates_of(problem, points_of(backend, fractions), weights)
        worst = max(c.value if c and c.value == c.value else math.inf for c in proofs)
        if kind != "duality_gap" or None in proofs:
            return {"kind": kind, "gap": worst, "excess": worst}
        objective = canonical_json([solved.backend, dict(solved.settings)])
        if objective not in self._bounds:  # D_ref (p,) of the exact path, -inf of none
            exact = isinstance(backend, PenalisedPath)
            fits = backends.path(problem, backend, fractions).fits if exact else ()
            lower = [f.certificate.dual if f.certificate else -math.inf for f in fits]
            self._bounds[objective] = np.array(lower or [-math.inf] * len(fractions))
        primal, dual = np.array([(c.primal, c.dual) for c in proofs if c]).T
        excess = np.maximum(primal - np.maximum(dual, self._bounds[objective]), 0.0).max()
        null = problem.null_objective or 1.0
        return {"kind": kind, "gap": worst, "excess": float(excess) / null}
