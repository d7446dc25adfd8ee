"""One timed solve of a contender, and what the referee says of it.

The solver works on a copy of the problem that has nothing cached: what it needs of Z'Z or a QR is
in its time. The certificate is the caller's, from the rows of the problem, outside the clock:

    excess = (P(V) - max(D, D_ref)) / (|Y|^2 / 2m),

the worst over the path, with P the objective of the contender's weights, D the dual bound that its
own residual gives and D_ref the one that sparsefit's exact path gives at the same penalty. Any
dual bound is a proof for everyone, by weak duality: a solver is not blamed for a poor dual point.
"""

from __future__ import annotations

import copy
import ctypes
import dataclasses
import gc
import math
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends import Backend, Solution
from sparsefit.backends.penalised import PenalisedPath
from sparsefit.errors import one_line
from sparsefit.regression.backend import PathBackend, PenalisedBackend, numeric_fraction
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.fit import path as certified_path
from sparsefit.regression.judgement import certificate_of
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.problem import RegressionProblem

CACHED = ("statistics", "spectrum", "compressed")


@dataclass(frozen=True, eq=False)
class Task:
    """A contender's work: its back-end, the penalties (none: one fit) and where it stops (NaN).

    certified: whether the data are checked and every answer certified within the work.
    """

    backend: Backend
    fractions: tuple[float, ...]
    tolerance: float
    certified: bool = False


@dataclass(frozen=True)
class Timing:
    """Seconds of the process's CPU and of the clock on the wall."""

    cpu: float
    wall: float


@dataclass(frozen=True)
class Verdict:
    """What the referee says of the answers of a task.

    gap: its own duality gap (or the certificate of another kind), worst over the path; excess: as
    in the head of this file. Infinite where a point has no finite answer. words: the solver's own
    of the worst point, with the reason.
    """

    kind: str
    gap: float
    excess: float
    words: str
    answered: int
    asked: int


def fresh(problem: RegressionProblem) -> RegressionProblem:
    """The problem without what it caches; copied, not built: its data were checked before."""
    clone = copy.copy(problem)
    for name in CACHED:
        clone.__dict__.pop(name, None)
    return clone


def solve(task: Task, problem: RegressionProblem) -> tuple[Solution, ...]:
    """The contender's answers, one per penalty; uncertified."""
    backend, tolerance = task.backend, None if math.isnan(task.tolerance) else task.tolerance
    fractions = task.fractions or _own(backend)
    if task.certified:
        checked = RegressionProblem.from_arrays(problem.theta, problem.target, problem.groups)
        fits = certified_path(checked, backend, fractions).fits
        return tuple(Solution(fit.weights, solver_status=fit.status) for fit in fits)
    if isinstance(backend, PenalisedPath):
        return backend.solve_path(problem, fractions, tolerance=tolerance)
    if isinstance(backend, PathBackend):
        return backend.solve_path(problem, fractions)
    if fractions and isinstance(backend, PenalisedBackend):
        points = [_at(backend, fraction) for fraction in fractions]
        return tuple(point.solve(problem) for point in points)
    return (backend.solve(problem),)


def _own(backend: Backend) -> tuple[float, ...]:
    if isinstance(backend, PenalisedBackend):
        return (numeric_fraction(backend.name, backend.alpha_fraction),)
    return ()


def _at(backend: Any, fraction: float) -> Backend:
    placed: Backend = dataclasses.replace(backend, alpha_fraction=fraction)
    return placed


def timed(work: Callable[[], Any]) -> tuple[Any, Timing]:
    """What the work gives, and its time; garbage is collected before and not within."""
    gc.collect()
    gc.disable()
    try:
        cpu, wall = time.process_time(), time.perf_counter()
        result = work()
        return result, Timing(time.process_time() - cpu, time.perf_counter() - wall)
    finally:
        gc.enable()


def keep_what_is_loaded() -> None:
    """Leave what is alive now out of later collections, which then take no time of their own."""
    gc.collect()
    gc.freeze()


class PeakMemory:
    """Megabytes that the process's resident memory grows by, at its highest; NaN without /proc."""

    def __init__(self) -> None:
        with suppress(OSError, AttributeError):  # glibc keeps what was freed, unless told not to
            ctypes.CDLL(None).malloc_trim(0)
        try:
            with Path("/proc/self/clear_refs").open("w", encoding="ascii") as file:
                file.write("5")
        except OSError:
            self._before = math.nan
        else:
            self._before = _resident("VmRSS")

    def megabytes(self) -> float:
        """How much higher the peak since was than where it began."""
        return max(_resident("VmHWM") - self._before, 0.0)


def _resident(name: str) -> float:
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return math.nan
    found = [line.split()[1] for line in lines if line.startswith(name)]
    return float(found[0]) / 1e3 if found else math.nan


def reference_bounds(problem: RegressionProblem, task: Task) -> Array:
    """D_ref (p,): certified lower bounds by sparsefit's exact path; -inf where it has none."""
    backend, fractions = task.backend, task.fractions or _own(task.backend)
    none = np.full(max(len(fractions), 1), -np.inf)
    if not isinstance(backend, PenalisedPath):
        return none
    exact: Any = dataclasses.replace(backend, solver=backend.exact.name)  # type: ignore[type-var]
    fits = certified_path(problem, exact, fractions).fits
    return np.array([fit.certificate.dual if fit.certificate else -np.inf for fit in fits])


def judged(
    problem: RegressionProblem, task: Task, solutions: Sequence[Solution], bounds: Array
) -> Verdict:
    """The verdict on a task's answers; ``bounds`` (p,) are D_ref."""
    backend, asked = task.backend, max(len(task.fractions or _own(task.backend)), 1)
    answered = [i for i, each in enumerate(solutions) if _answers(each)]
    worst = max(solutions, key=lambda each: RANK.get(each.status, 3))
    words = one_line(f"{worst.solver_status} {worst.reason}", 200)
    kind = str(backend.certificate_kind)
    counted = (words, len(answered), asked)
    if len(answered) < asked:
        return Verdict(kind, math.inf, math.inf, *counted)
    if kind != "duality_gap" or not isinstance(backend, PenalisedBackend):
        found = [certificate_of(problem, backend, each, problem) for each in solutions]
        values = [math.nan if each is None else each.value for each in found]
        value = max(math.inf if math.isnan(each) else each for each in values)
        return Verdict(kind, value, value, *counted)
    weights = np.stack([np.asarray(each.weights) for each in solutions])
    gap, excess = _gaps(problem, backend.penalty(problem), weights, task, bounds)
    return Verdict(kind, gap, excess, *counted)


RANK = {"ok": 0, "inaccurate": 1, "unidentifiable": 2}


def _answers(solution: Solution) -> bool:
    """Whether there are finite weights; those of a solver that failed are not an answer."""
    weights = solution.weights
    return solution.status != "error" and weights is not None and bool(np.isfinite(weights).all())


def _gaps(
    problem: RegressionProblem, penalty: Penalty, weights: Array, task: Task, bounds: Array
) -> tuple[float, float]:
    statistics = problem.statistics
    fractions = np.array(task.fractions or _own(task.backend))
    alphas = alpha_max(statistics.cross, penalty) * fractions
    data = (problem.theta, problem.target, statistics.rms, weights, alphas, penalty)
    found = duality_gaps(*data, samples=problem.samples)
    primal, dual = np.array([c.primal for c in found]), np.array([c.dual for c in found])
    excess = np.maximum(primal - np.maximum(dual, bounds), 0.0)
    null = statistics.null_objective or 1.0
    return max(c.value for c in found), float(excess.max()) / null
