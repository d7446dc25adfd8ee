"""What a path costs besides the solve: certificates, Theta, threads; and STLSQ beside PySINDy."""

from __future__ import annotations

import dataclasses
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.stlsq import STLSQ
from sparsefit.bench.problems import NamedFlight, Task
from sparsefit.library.cells import candidate_columns
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.problem import RegressionProblem


@dataclass(frozen=True)
class CertificateShare:
    """CPU seconds of the certificates of a path beside those of its solve."""

    kind: str
    problem: str
    solve: float
    certificate: float

    @property
    def share(self) -> float:
        """Certificate / solve."""
        return self.certificate / self.solve


@dataclass(frozen=True)
class Ratio:
    """Two times [s] of the same work and their quotient; ``note`` where there is none."""

    name: str
    baseline: float = float("nan")
    ours: float = float("nan")
    difference: float = float("nan")
    note: str = ""

    @property
    def factor(self) -> float:
        """Baseline / ours."""
        return self.baseline / self.ours


def certificate_share(task: Task, repeats: int) -> CertificateShare:
    """Solve and certificate of our path on a task, each timed ``repeats`` times, medians."""
    fractions = tuple(task.fractions.tolist())
    solved = task.backend.solve_path(task.fresh(), fractions)
    weights = np.stack([np.asarray(solution.weights) for solution in solved])
    problem = task.problem
    rms, arguments = problem.statistics.rms, (weights, task.alphas, task.penalty)
    solve, certificate = alternating(
        lambda: task.backend.solve_path(task.fresh(), fractions),
        lambda: duality_gaps(problem.theta, problem.target, rms, *arguments),
        repeats=max(3, repeats),
    )
    return CertificateShare(task.kind, task.name, solve, certificate)


def alternating(
    *work: Callable[[], object],
    repeats: int,
    clock: Callable[[], float] = time.process_time,
    pick: Callable[[Sequence[float]], Any] = np.median,
) -> list[float]:
    """Seconds of each piece of work, by turns after one warm-up each; by default medians."""
    for one in work:
        one()
    taken: list[list[float]] = [[] for _ in work]
    for repeat in range(repeats):
        for place in range(len(work)) if repeat % 2 == 0 else reversed(range(len(work))):
            start = clock()
            work[place]()
            taken[place].append(clock() - start)
    return [float(pick(one)) for one in taken]


def theta(*, samples: int = 3000, scales: int = 56, repeats: int = 7) -> Ratio:
    """Building Theta beside evaluating 4 m K sines and cosines with numpy."""
    position = np.random.default_rng(0).uniform(0.0, 30.0, (samples, 2))
    grid = np.linspace(1.0, 12.0, scales)
    x, y = (position[:, [axis]] * (np.pi / grid) for axis in range(2))
    plain, ours = alternating(
        lambda: (np.sin(x), np.cos(x), np.sin(y), np.cos(y)),
        lambda: candidate_columns(position, grid),
        repeats=repeats,
    )
    return Ratio(f"Theta, {samples} x {scales} scales / 4 m K sines and cosines", ours, plain)


def threads(task: Task, repeats: int = 5) -> Ratio:
    """Two flights one after the other, and in two threads: wall time, the best of each."""
    fractions = tuple(task.fractions.tolist())
    count = 4  # paths per flight: starting a thread is not what is measured

    def flight(_: int) -> int:
        return sum(len(task.backend.solve_path(task.fresh(), fractions)) for _path in range(count))

    with ThreadPoolExecutor(2) as pool:
        one_by_one, together = alternating(
            lambda: [flight(each) for each in range(2)],
            lambda: list(pool.map(flight, range(2))),
            repeats=repeats,
            clock=time.perf_counter,
            pick=min,
        )
    return Ratio(f"two threads, two flights: {task.kind}, {task.name}", one_by_one, together)


def stlsq(*, samples: int = 6000, scales: int = 40, repeats: int = 5) -> tuple[Ratio, ...]:
    """PySINDy's STLSQ beside ours, on columns of noise and on the columns of a flight."""
    if find_spec("pysindy") is None:
        return (Ratio("STLSQ beside PySINDy", note="pysindy is not installed (extra peers)"),)
    columns = 8 * scales
    draw = np.random.default_rng(0)
    design = draw.standard_normal((samples, columns))
    truth = np.where(draw.random((columns, 2)) < 0.05, draw.uniform(1.0, 3.0, (columns, 2)), 0.0)
    target = design @ truth + 0.1 * draw.standard_normal((samples, 2))
    size = f"{samples} x {columns} x 2"
    plain = RegressionProblem.from_arrays(design, target)
    flight = NamedFlight("", samples, 10.0, 6.0, 0.1, 9).problem(LengthScaleGrid(count=scales))
    return (
        _stlsq(f"STLSQ / PySINDy, independent columns, {size}", plain, True, repeats),
        # Without the last least squares, which the nearly dependent columns leave undetermined.
        _stlsq(f"STLSQ / PySINDy, columns of a flight, no unbias, {size}", flight, False, repeats),
    )


def _stlsq(name: str, problem: RegressionProblem, unbias: bool, repeats: int) -> Ratio:
    pysindy: Any = import_module("pysindy")
    ours = STLSQ(mode="pysindy", threshold=0.2, ridge=0.05, unbias=unbias)
    theirs = pysindy.STLSQ(threshold=0.2, alpha=0.05, max_iter=20, unbias=unbias)

    def reference() -> Array:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return np.asarray(theirs.fit(problem.theta, problem.target).coef_).T

    slow, fast = alternating(
        reference, lambda: ours.solve(dataclasses.replace(problem)), repeats=repeats
    )
    expected, found = reference(), ours.solve(problem).weights
    if found is None:
        return Ratio(name, slow, fast, note="ours found an empty support")
    scale = float(np.abs(expected).max()) or 1.0
    return Ratio(name, slow, fast, float(np.abs(found - expected).max()) / scale)
