"""The benchmark: our solvers and public peers on six flight problems, by one referee's formula."""

from __future__ import annotations

import time
from collections.abc import Sequence

from threadpoolctl import threadpool_limits

from sparsefit.bench import contenders as registry
from sparsefit.bench import problems as flights
from sparsefit.bench import scaling, side
from sparsefit.bench.contender import Contender
from sparsefit.bench.files import FOLDER, write
from sparsefit.bench.measure import compare, warm_up
from sparsefit.bench.problems import NAMED, QUICK_GRID, Progress, Task
from sparsefit.bench.result import BenchResult, ProblemSize
from sparsefit.bench.robustness import Robustness, robustness
from sparsefit.library.grid import LengthScaleGrid

__all__ = ["FOLDER", "BenchResult", "Robustness", "robustness", "run", "write"]

POINTS, QUICK_POINTS = 30, 6
FLIGHTS, QUICK_FLIGHTS = 1000, 4


def _silent(_: str) -> None:
    pass


def run(
    *,
    problems: Sequence[str] | None = None,
    contenders: Sequence[str] | None = None,
    repeats: int = 3,
    quick: bool = False,
    beside: bool = True,
    progress: Progress | None = None,
) -> BenchResult:
    """Measure the named contenders (all by default) on the named problems (all six by default).

    ``quick``: small grids and short paths on the first problem, to see that everything works.
    ``beside``: also certificates, Theta, threads, STLSQ, scaling and robustness.
    Raises InputError on unknown names.
    """
    say, start = progress or _silent, time.perf_counter()
    named = flights.chosen(tuple(problems) if problems is not None else None)
    if quick and problems is None:
        named = named[:1]
    playing = registry.chosen(contenders, quick=quick)
    grid = QUICK_GRID if quick else LengthScaleGrid()
    points = QUICK_POINTS if quick else POINTS
    with threadpool_limits(limits=1):
        paths = [flights.tasks(flight, points=points, grid=grid) for flight in named]
        _warm(playing, points, say)
        every = [task for tasks in paths for task in tasks]
        runs = [found for task in every for found in compare(playing, task, repeats, say)]
        shares = [side.certificate_share(task, repeats) for task in every] if beside else []
        ratios = _ratios(paths[-1], quick, say) if beside else []
        scalings = _scalings(quick, points, say) if beside else []
        count = QUICK_FLIGHTS if quick else FLIGHTS
        sturdy = robustness(count, points=points, progress=say) if beside else ()
    return BenchResult(
        tuple(_size(tasks[0]) for tasks in paths),
        playing,
        registry.absent(playing),
        tuple(runs),
        tuple(shares),
        tuple(ratios),
        tuple(scalings),
        sturdy,
        repeats,
        points,
        quick,
        time.perf_counter() - start,
    )


def _size(task: Task) -> ProblemSize:
    problem = task.problem
    return ProblemSize(task.name, problem.samples, problem.columns, problem.statistics.rank)


def _warm(playing: Sequence[Contender], points: int, say: Progress) -> None:
    for task in flights.tasks(NAMED[0], points=points, grid=QUICK_GRID):
        for contender in playing:
            if contender.installed and task.kind in contender.kinds:
                say(f"warm-up: {task.kind}: {contender.name}")
                try:
                    warm_up(contender, task)
                except Exception as error:  # it will fail again, and be reported, where it counts
                    say(f"warm-up: {contender.name}: {type(error).__name__}")


def _ratios(tasks: Sequence[Task], quick: bool, say: Progress) -> list[side.Ratio]:
    say("Theta, threads, STLSQ")
    found = [side.theta(samples=300 if quick else 3000)]
    found += [side.threads(task, repeats=2 if quick else 5) for task in tasks]
    found += side.stlsq(samples=400, scales=4, repeats=1) if quick else side.stlsq()
    return found


def _scalings(quick: bool, points: int, say: Progress) -> list[scaling.Scaling]:
    grids = (4, 8) if quick else scaling.GRIDS
    samples = (200, 400) if quick else scaling.SAMPLES
    found: list[scaling.Scaling] = []
    for kind in ("lasso", "joint-group-lasso"):
        found += scaling.with_grid(
            kind, grids, samples=300 if quick else 2000, points=points, progress=say
        )
    scales = 4 if quick else 56
    return found + scaling.with_samples(samples, scales=scales, points=points, progress=say)
