"""How the cost grows with the grid and with the number of samples."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sparsefit.arrays import Array
from sparsefit.backends.homotopy import lasso_path
from sparsefit.bench.problems import LOWEST, NAMED, VEHICLE, Kind, NamedFlight, Progress, task
from sparsefit.flight.flow import CellularFlow
from sparsefit.library.builder import Library
from sparsefit.library.cells import candidate_columns
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.regression.certificate import duality_gaps
from sparsefit.regression.statistics import Statistics, accumulate

BASE = NAMED[3]
ROWS = 8192
GRIDS = (56, 280, 1120)
SAMPLES = (1_000, 10_000, 100_000, 1_000_000)


@dataclass(frozen=True)
class Scaling:
    """One size: CPU seconds to build, to compress and to solve a path; memory [MB] beyond
    that at the start, at its peak.
    """

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
    flight = replace(BASE, samples=samples)
    found = []
    for count in counts:
        progress(f"scaling: {kind}, {count} scales")
        found.append(_grid(kind, flight, LengthScaleGrid(count=count), points))
    return found


def _grid(kind: Kind, flight: NamedFlight, grid: LengthScaleGrid, points: int) -> Scaling:
    samples = flight.samples_flown()
    before = _restart_peak()
    clock = [time.process_time()]
    problem = Library(grid).build(samples, VEHICLE)
    clock.append(time.process_time())
    asked = task(kind, flight.name, problem, points)
    clock.append(time.process_time())
    found = asked.backend.solve_path(problem, tuple(asked.fractions.tolist()))
    clock.append(time.process_time())
    memory = _peak() - before
    weights = np.stack([np.asarray(solution.weights) for solution in found])
    certified = duality_gaps(
        problem.theta,
        problem.target,
        problem.statistics.rms,
        weights,
        asked.alphas,
        asked.penalty,
    )
    gap = max(certificate.value for certificate in certified)
    build, statistics, solve = np.diff(clock).tolist()
    size = (problem.samples, problem.columns)
    return Scaling(f"grid, {kind}", *size, build, statistics, solve, memory, gap)


def _restart_peak() -> float:
    """Resident memory [MB] now, from where its peak is watched; NaN where /proc is missing."""
    try:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    except OSError:
        return float("nan")
    return _peak()


def _peak() -> float:
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return float("nan")
    peaks = [line.split()[1] for line in lines if line.startswith("VmHWM")]
    return float(peaks[0]) / 1e3 if peaks else float("nan")


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
    before = _restart_peak()
    spent = [0.0]
    statistics = accumulate(_blocks(samples, scales, spent))
    compressed = time.process_time()
    _solve(statistics, points)
    done = time.process_time()
    memory = _peak() - before
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
