"""Random and degenerate flights: what is certified, and what needs the referee."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.bench.problems import KINDS, Kind, NamedFlight, Progress, task
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.regression.fit import path
from sparsefit.regression.problem import RegressionProblem

Alter: TypeAlias = Callable[[Array, Array, np.random.Generator], tuple[Array, Array]]
TOLERANCE = 1e-8


@dataclass(frozen=True)
class Robustness:
    """Points of one penalty over all flights: certified to 1e-8, and repaired by the referee."""

    kind: Kind
    flights: int
    points: int
    certified: int
    repaired: int
    worst: float
    failures: tuple[str, ...] = ()


def _as_is(theta: Array, target: Array, _: np.random.Generator) -> tuple[Array, Array]:
    return theta, target


def _duplicated(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """A fifth of the columns replaced by copies, negatives and multiples of others."""
    theta, k = theta.copy(), theta.shape[1]
    count = max(1, k // 5)
    to, source = draw.choice(k, count, replace=False), draw.integers(0, k, count)
    theta[:, to] = theta[:, source] * draw.choice([-2.0, -1.0, 1.0, 3.0], count)
    return theta, target


def _nearly_dependent(
    theta: Array, target: Array, draw: np.random.Generator
) -> tuple[Array, Array]:
    """Columns that differ from others in the ninth digit."""
    theta, k = theta.copy(), theta.shape[1]
    to, source = draw.choice(k, k // 4, replace=False), draw.integers(0, k, k // 4)
    theta[:, to] = theta[:, source] + 1e-9 * draw.standard_normal((len(theta), k // 4))
    return theta, target


def _dead(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Columns that are zero in all samples but one."""
    theta = theta.copy()
    for column in draw.choice(theta.shape[1], theta.shape[1] // 8, replace=False):
        theta[:, column] = 0.0
        theta[draw.integers(len(theta)), column] = 1.0
    return theta, target


def _units(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Tiny and huge units, of each column and of the target."""
    scale = 10.0 ** draw.uniform(-12, 12, theta.shape[1])
    return theta * scale, target * 10.0 ** draw.uniform(-12, 12)


def _few(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """Fewer samples than columns."""
    keep = draw.integers(4, max(5, min(theta.shape) // 2))
    return theta[:keep], target[:keep]


def _one_axis(theta: Array, target: Array, _: np.random.Generator) -> tuple[Array, Array]:
    """One target of zeros."""
    target = target.copy()
    target[:, 1] = 0.0
    return theta, target


def _noise(theta: Array, target: Array, draw: np.random.Generator) -> tuple[Array, Array]:
    """A target that no column explains."""
    return theta, draw.standard_normal(target.shape)


ALTERATIONS: Mapping[str, Alter] = MappingProxyType(
    {
        "random flight": _as_is,
        "duplicated columns": _duplicated,
        "nearly dependent columns": _nearly_dependent,
        "dead columns": _dead,
        "units 1e-12 to 1e12": _units,
        "fewer samples than columns": _few,
        "a target of zeros": _one_axis,
        "a target of noise": _noise,
    }
)


def draw_problem(seed: int) -> tuple[str, RegressionProblem]:
    """A random flight, every second one of them as it is and the others made degenerate."""
    draw = np.random.default_rng([20_240, seed])
    noise = float(draw.choice([0.0, 0.01, 0.1]))
    scales = int(draw.integers(6, 40))
    flight = NamedFlight(
        "", int(draw.integers(60, 500)), draw.uniform(2, 20), draw.uniform(1.5, 9), noise, seed
    )
    problem = flight.problem(LengthScaleGrid(count=scales))
    names = tuple(ALTERATIONS)
    name = names[0] if seed % 2 == 0 else names[1 + (seed // 2) % (len(names) - 1)]
    theta, target = ALTERATIONS[name](problem.theta, problem.target, draw)
    altered = RegressionProblem.from_arrays(theta, target, groups=problem.groups)
    return f"{name}, seed {seed}", altered


def robustness(
    count: int = 100, *, points: int = 30, progress: Progress = lambda _: None
) -> tuple[Robustness, ...]:
    """Paths of ``count`` random and degenerate flights: LASSO, and joint group-LASSO."""
    kinds = (KINDS[0], KINDS[2])
    gaps: dict[Kind, list[tuple[str, Array, int]]] = {kind: [] for kind in kinds}
    for seed in range(count):
        if seed % 50 == 0:
            progress(f"robustness: flight {seed} of {count}")
        name, problem = draw_problem(seed)
        for kind in kinds:
            lowest = 1e-4 if seed % 4 == 1 else 1e-3
            asked = task(kind, name, problem, points, lowest=lowest)
            found = path(problem, asked.backend, asked.fractions, tolerance=TOLERANCE)
            gaps[kind].append((name, found.gaps, found.repaired))
    return tuple(_summary(kind, rows) for kind, rows in gaps.items())


def _summary(kind: Kind, rows: list[tuple[str, Array, int]]) -> Robustness:
    every = np.concatenate([gaps for _, gaps, _ in rows])
    every = np.where(np.isfinite(every), every, np.inf)
    failed = tuple(name for name, gaps, _ in rows if not np.all(gaps <= TOLERANCE))
    return Robustness(
        kind,
        len(rows),
        len(every),
        int(np.sum(every <= TOLERANCE)),
        sum(repaired for _, _, repaired in rows),
        float(every.max()),
        failed,
    )
