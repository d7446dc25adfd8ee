"""Every contender on every path: CPU time, gap by our formula, and the time to reach a gap.

Time is CPU time of the process with BLAS on one thread: a busy machine does not add to it.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.bench.contender import Contender
from sparsefit.bench.problems import Kind, Progress, Task
from sparsefit.cached import cached_property
from sparsefit.regression.certificate import duality_gaps

LEVELS = (1e-4, 1e-6, 1e-8)
TOO_LONG = 3.0  # s: no tighter setting of a solver is tried after a run that took longer
REPEATED = 1.5  # s: runs longer than this are timed once
BLOCK = 0.05  # s: shorter runs are timed several times in a row


@dataclass(frozen=True, eq=False)
class Run:
    """One contender at one setting on one path.

    seconds: CPU time of the whole path, a value per repeat (extrapolated where only ``timed``
    points of it were solved). gap, sub: worst over the points; sub is (primal - best certified
    lower bound) / (objective at zero). ``last``: no tighter setting was tried though this one
    fell short, because it took too long.
    """

    kind: Kind
    problem: str
    contender: str
    setting: float
    seconds: tuple[float, ...]
    gap: float
    sub: float
    timed: int
    last: bool = False
    error: str = ""

    @cached_property
    def median(self) -> float:
        """Median CPU seconds of the path."""
        return float(np.median(self.seconds)) if self.seconds else float("nan")

    def accuracy(self, measure: str) -> float:
        """The ``gap`` or the ``sub``, infinite where the solver failed."""
        value = self.gap if measure == "gap" else self.sub
        return value if np.isfinite(value) else float("inf")


@dataclass(frozen=True)
class Reach:
    """Seconds of the first setting that reaches a level; None where none does.

    ``best``: the smallest gap (or sub) seen. ``at_least``: a lower bound of the seconds where
    tighter settings were not tried because they take too long.
    """

    seconds: float | None
    best: float
    at_least: float | None = None


def reach(runs: Sequence[Run], level: float, measure: str = "gap") -> Reach:
    """Time to a level of the runs of one contender on one path, loosest setting first."""
    best = min((run.accuracy(measure) for run in runs), default=float("inf"))
    for run in runs:
        if run.accuracy(measure) <= level:
            return Reach(run.median, best)
    capped = [run.median for run in runs if run.last]
    return Reach(None, best, max(capped) if capped else None)


def warm_up(contender: Contender, task: Task) -> None:
    """One run at the loosest setting on two points: imports and compilation are not timed."""
    contender.solve(task, task.fractions[[0, len(task.fractions) // 2]], contender.settings[0])


def explore(contender: Contender, task: Task, bounds: Array) -> list[Run]:
    """The settings of a contender, loosest first, until gap and sub are below the last level.

    bounds (p,): the best certified lower bound of each point, raised in place.
    """
    runs: list[Run] = []
    for setting in contender.settings:
        run = _one(contender, task, setting, bounds)
        runs.append(run)
        if run.error or max(run.accuracy("gap"), run.accuracy("sub")) <= LEVELS[-1]:
            return runs
        if run.median > TOO_LONG and setting != contender.settings[-1]:
            runs[-1] = replace(run, last=True)
            return runs
    return runs


def _one(contender: Contender, task: Task, setting: float, bounds: Array) -> Run:
    name = (task.kind, task.name, contender.name, setting)
    points = _points(contender, len(task.fractions))
    try:
        seconds, weights = timed(contender, task, setting, points)
        gap, sub = _accuracy(task, weights, points, bounds)
    except Exception as error:  # a peer may raise anything: it is reported, not hidden
        words = " ".join(f"{type(error).__name__}: {error}".split())
        return Run(*name, (), np.inf, np.inf, contender.timed, error=words[:200])
    return Run(*name, (seconds,), gap, sub, contender.timed)


def _points(contender: Contender, count: int) -> IntArray:
    """The points that are solved: all, or a few spread over the path, alpha_max left out."""
    if not 0 < contender.timed < count:
        return np.arange(count)
    return np.linspace(0, count - 1, contender.timed + 2).round().astype(np.intp)[1:-1]


def timed(
    contender: Contender, task: Task, setting: float, points: IntArray
) -> tuple[float, Array]:
    """CPU seconds of the whole path and the weights at the points that were solved."""
    fractions, count = task.fractions[points], len(task.fractions)
    seconds, weights = _clocked(contender, task, setting, fractions)
    if len(points) == count:
        return seconds, weights
    if len(points) == 1:
        return seconds * count, weights
    # The first point also pays for what is set up once.
    first, _ = _clocked(contender, task, setting, fractions[len(points) // 2 :][:1])
    each = max(seconds - first, 0.0) / (len(points) - 1)
    return first + (count - 1) * each, weights


def _clocked(
    contender: Contender, task: Task, setting: float, fractions: Array
) -> tuple[float, Array]:
    taken: list[float] = []
    while not taken or (sum(taken) < BLOCK and len(taken) < 5):
        start = time.process_time()
        weights = contender.solve(task, fractions, setting)
        taken.append(time.process_time() - start)
    return float(np.median(taken)), weights


def _accuracy(task: Task, weights: Array, points: IntArray, bounds: Array) -> tuple[float, float]:
    if not np.isfinite(weights).all():
        return float("inf"), float("inf")
    problem = task.problem
    rms = problem.statistics.rms
    found = duality_gaps(
        problem.theta, problem.target, rms, weights, task.alphas[points], task.penalty
    )
    primal, dual = np.array([c.primal for c in found]), np.array([c.dual for c in found])
    bounds[points] = np.maximum(bounds[points], dual)
    excess = np.maximum(primal - bounds[points], 0.0)
    null = problem.statistics.null_objective
    return max(c.value for c in found), float(excess.max()) / (null or 1.0)


def needed(runs: Sequence[Run]) -> list[Run]:
    """The runs that answer a question: the first to reach each level, or the last one."""
    wanted = [
        next((run for run in runs if run.accuracy(measure) <= level), runs[-1])
        for measure in ("gap", "sub")
        for level in LEVELS
    ]
    return [run for run in runs if run in wanted and run.seconds and run.median <= REPEATED]


def repeated(contender: Contender, task: Task, run: Run) -> Run:
    """The run with one more timing."""
    points = _points(contender, len(task.fractions))
    seconds, _ = timed(contender, task, run.setting, points)
    return replace(run, seconds=(*run.seconds, seconds))


def compare(
    contenders: Sequence[Contender], task: Task, repeats: int, progress: Progress
) -> tuple[Run, ...]:
    """All contenders on one path, in alternating order from one repeat to the next."""
    playing = [c for c in contenders if task.kind in c.kinds and c.installed]
    bounds = np.full(len(task.fractions), -np.inf)
    table: dict[str, list[Run]] = {}
    for contender in playing:  # ours first: its lower bounds are the ones sub is measured from
        progress(f"{task.name}: {task.kind}: {contender.name}")
        table[contender.name] = explore(contender, task, bounds)
    for repeat in range(1, repeats):
        progress(f"{task.name}: {task.kind}: repeat {repeat + 1}")
        for contender in playing if repeat % 2 == 0 else reversed(playing):
            runs = table[contender.name]
            for run in needed(runs):
                runs[runs.index(run)] = repeated(contender, task, run)
    return tuple(run for runs in table.values() for run in runs)
