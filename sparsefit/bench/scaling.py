"""How the cost grows with the grid and with the number of samples."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sparsefit.backends.homotopy import lasso_path
from sparsefit.bench.problems import LOWEST, NAMED, Kind, NamedFlight, Progress, task
from sparsefit.flow import CellularFlow
from sparsefit.library import LengthScaleGrid, candidate_columns
from sparsefit.objective import Statistics, accumulate

Array: TypeAlias = NDArray[np.float64]
BASE = NAMED[3]
ROWS = 8192
GRIDS = (56, 280, 1120)
SAMPLES = (1_000, 10_000, 100_000, 1_000_000)


@dataclass(frozen=True)
class Scaling:
    """One size: CPU seconds to build, to compress and to solve a path; peak memory [MB]."""

    sweep: str
    samples: int
    columns: int
    build: float
    statistics: float
    solve: float
    memory: float
    gap: float = float("nan")

    @property
    def total(self) -> float:
        """Everything, from positions to weights."""
        return self.build + self.statistics + self.solve


def exponent(sizes: Sequence[float], seconds: Sequence[float]) -> float:
    """The slope of log(seconds) against log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(seconds), 1)[0])


def with_grid(
    kind: Kind, counts: Sequence[int], *, samples: int, points: int, progress: Progress
) -> list[Scaling]:
    """Paths on finer and finer grids over the same flight, uniform in length scale."""
    flight = NamedFlight(
        BASE.name, samples, BASE.mean_velocity, BASE.length_scale, BASE.noise, BASE.seed
    )
    found = []
    for count in counts:
        progress(f"scaling: {kind}, {count} scales")
        found.append(_grid(kind, flight, LengthScaleGrid(count=count), points))
    return found


def _grid(kind: Kind, flight: NamedFlight, grid: LengthScaleGrid, points: int) -> Scaling:
    from sparsefit.fit import path

    tracemalloc.start()
    clock = [time.process_time()]
    problem = flight.problem(grid)
    clock.append(time.process_time())
    asked = task(kind, flight.name, problem, points)
    clock.append(time.process_time())
    gap = float(np.nanmax(path(problem, asked.backend, asked.fractions).gaps))
    clock.append(time.process_time())
    memory = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    spent = np.diff(clock).tolist()
    return Scaling(f"grid, {kind}", problem.samples, problem.columns, *spent, memory, gap)


def with_samples(
    counts: Sequence[int], *, scales: int, points: int, progress: Progress
) -> list[Scaling]:
    """LASSO paths on longer and longer flights, compressed block by block as Theta is built."""
    found = []
    for count in counts:
        progress(f"scaling: {count} samples")
        found.append(_streamed(count, LengthScaleGrid(count=scales).scales, points))
    return found


def _streamed(samples: int, scales: Array, points: int) -> Scaling:
    tracemalloc.start()
    spent = [0.0]
    statistics = accumulate(_blocks(samples, scales, spent))
    compressed = time.process_time()
    solve = _solve(statistics, points)
    done = time.process_time()
    memory = tracemalloc.get_traced_memory()[1] / 1e6
    tracemalloc.stop()
    del solve
    size = (samples, len(statistics.gram))
    reduce = max(compressed - spent[-1] - spent[0], 0.0)
    return Scaling("samples, lasso", *size, spent[0], reduce, done - compressed, memory)


def _blocks(samples: int, scales: Array, spent: list[float]) -> Iterator[tuple[Array, Array]]:
    """Rows of Theta and the flow velocity along random walks; spent[0] sums their CPU seconds.

    The last entry of ``spent`` is when the first block was begun.
    """
    flow, draw = CellularFlow(BASE.mean_velocity, BASE.length_scale), np.random.default_rng(0)
    spent.append(time.process_time())
    for start in range(0, samples, ROWS):
        begun = time.process_time()
        steps = draw.standard_normal((min(ROWS, samples - start), 2))
        position = draw.uniform(0.0, 100.0, 2) + 0.1 * np.cumsum(steps, axis=0)
        target = flow.velocity(position[:, 0], position[:, 1])[:, :1]
        target = target + draw.standard_normal(target.shape)
        theta = candidate_columns(position, scales)
        spent[0] += time.process_time() - begun
        yield theta, target


def _solve(statistics: Statistics, points: int) -> Array:
    cross = statistics.cross[:, 0]
    alphas = float(np.abs(cross).max()) * np.geomspace(1.0, LOWEST, points)
    return lasso_path(statistics.gram, cross, alphas).weights
