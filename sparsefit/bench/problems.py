"""The six named flight problems, and the three penalties that each is solved with."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np

from sparsefit import backends
from sparsefit.arrays import Array
from sparsefit.derivative import Derivative, Samples
from sparsefit.errors import one_of
from sparsefit.flight import simulate_flight
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import Library
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.regression.backend import PathBackend
from sparsefit.regression.objective import Penalty, alpha_max
from sparsefit.regression.problem import RegressionProblem

Kind = Literal["lasso", "group-lasso", "joint-group-lasso"]
Progress: TypeAlias = Callable[[str], None]
KINDS: tuple[Kind, ...] = get_args(Kind)
LOWEST = 1e-3  # of alpha_max: where a path ends
VEHICLE = PointMassVehicle(response_time=0.5, thrust_acceleration=(5.0, 3.0))
SAMPLE_RATE = 100.0  # Hz
WINDOW = 5  # fixed here: a better default derivative must not change the problems


@dataclass(frozen=True)
class NamedFlight:
    """A flight problem: m samples in a flow of one length scale, measured with noise or without.

    noise: standard deviation of the measured velocity [m/s]; a tenth of it, in m, of the position,
    and ten times it, in m/s^2, of the acceleration (gusts that the flow model does not have).
    """

    name: str
    samples: int
    mean_velocity: float
    length_scale: float
    noise: float
    seed: int

    def problem(self, grid: LengthScaleGrid) -> RegressionProblem:
        """Theta (m, 8 g) and the flow velocity along the flight (m, 2)."""
        return Library(grid).build(self.samples_flown(), VEHICLE)

    def samples_flown(self) -> Samples:
        """The flight and its derivatives."""
        derivative = Derivative("savgol", 5, 4)
        flight = simulate_flight(
            CellularFlow(self.mean_velocity, self.length_scale),
            VEHICLE,
            # The derivative drops half a window at either end.
            duration=(self.samples + WINDOW - 2) / SAMPLE_RATE,
            sample_rate=SAMPLE_RATE,
            seed=self.seed,
            velocity_noise=self.noise,
            position_noise=0.1 * self.noise,
            process_noise=10.0 * self.noise,
        )
        return derivative(flight)


NAMED = (
    NamedFlight("short clean", 500, 15.43, 4.2, 0.0, 1),
    NamedFlight("short noisy", 500, 8.0, 3.37, 0.1, 2),
    NamedFlight("medium clean", 2000, 11.0, 2.57, 0.0, 3),
    NamedFlight("medium noisy", 2000, 10.0, 6.0, 0.1, 4),
    NamedFlight("long clean", 10000, 15.43, 4.21, 0.0, 5),
    NamedFlight("long noisy", 10000, 12.0, 9.4, 0.1, 6),
)
QUICK_GRID = LengthScaleGrid(upper=6.0, step=0.5)


@dataclass(frozen=True, eq=False)
class Task:
    """One path: a problem, a penalty and the penalties alpha = fraction * alpha_max."""

    kind: Kind
    name: str
    problem: RegressionProblem
    backend: PathBackend
    penalty: Penalty
    fractions: Array
    unit: float

    @property
    def alphas(self) -> Array:
        """The penalties of the path (p,), descending."""
        return self.unit * self.fractions

    def fresh(self) -> RegressionProblem:
        """The problem without what it caches, so that the Gram matrix is paid for again.

        Copied and not built: validation of the data is no part of a solve, and peers skip it.
        """
        clone = copy.copy(self.problem)
        for name in ("statistics", "spectrum"):
            clone.__dict__.pop(name, None)
        return clone


def chosen(names: tuple[str, ...] | None) -> tuple[NamedFlight, ...]:
    """The named flights, all of them by default. Raises InputError on an unknown name."""
    valid = tuple(flight.name for flight in NAMED)
    for name in names or ():
        one_of("problem", name, valid)
    return tuple(flight for flight in NAMED if names is None or flight.name in names)


def tasks(flight: NamedFlight, *, points: int, grid: LengthScaleGrid) -> tuple[Task, ...]:
    """The three paths of a flight: LASSO and group-LASSO on one target, joint on two."""
    both = flight.problem(grid)
    one = dataclasses.replace(
        both, target=both.target[:, :1].copy(), target_names=both.target_names[:1]
    )
    return tuple(task(kind, flight.name, one if n == 1 else both, points) for kind, n in TARGETS)


TARGETS: tuple[tuple[Kind, int], ...] = (("lasso", 1), ("group-lasso", 1), ("joint-group-lasso", 2))


def task(
    kind: Kind, name: str, problem: RegressionProblem, points: int, *, lowest: float = LOWEST
) -> Task:
    """The path of a penalty on a problem, from alpha_max down to ``lowest`` times it."""
    backend = backends.get("lasso" if kind == "lasso" else "group-lasso")
    assert isinstance(backend, PathBackend)
    penalty = backend.penalty(problem)
    unit = alpha_max(problem.statistics.cross, penalty)
    fractions = np.geomspace(1.0, lowest, points)
    return Task(kind, name, problem, backend, penalty, fractions, unit)
