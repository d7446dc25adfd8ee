"""What every back-end shares on one flight, and what is worked out once for all of them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, TypeVar, cast

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.derivative import Derivative, Samples
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import Library
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.space import SearchSpace
from sparsefit.regression.problem import RegressionProblem

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False)
class Prepared:
    """One flight with its derivatives, its regression problem and what is searched for modes.

    Args:
        samples: states and derivatives.
        vehicle: as it is believed to be.
        library: that built the problem.
        problem: the regression problem of the flight.
        target: what the columns are regressed on, a row per sample (m, n), where the problem's own
            rows may be compressed or averages.
        seconds: what all this took.
    """

    samples: Samples
    vehicle: PointMassVehicle
    library: Library
    problem: RegressionProblem
    target: Array
    seconds: float
    _answers: dict[tuple[Any, ...], Any] = field(default_factory=dict, repr=False)

    @cached_property
    def flow_velocity(self) -> Array:
        """Phi (m, 2) [m/s] at the samples, of the vehicle as it is believed to be."""
        return self.samples.flow_velocity(self.vehicle)

    @cached_property
    def rows(self) -> Rows:
        """The rows that modes are fitted to."""
        source = self.samples.weak or self.samples
        return Rows.of(source, self.vehicle, self.library.unknown)

    @property
    def narrow(self) -> bool:
        """Whether the grid's bounds leave nothing to search between them."""
        return not self.library.grid.lower < self.library.grid.upper

    @cached_property
    def space(self) -> SearchSpace:
        """Where modes are searched off the grid. Raises InputError where nothing can be found."""
        bounds = math.pi / self.library.grid.upper, math.pi / self.library.grid.lower
        return SearchSpace.of(self.samples, self.vehicle, bounds, self.library.unknown)

    def once(self, key: tuple[Any, ...], work: Callable[[], Result]) -> Result:
        """What the work gives, done once for all back-ends that come to the same key."""
        if key not in self._answers:
            self._answers[key] = work()
        return cast(Result, self._answers[key])


def prepare(
    flight: Flight, derivative: Derivative, library: Library, *, shared: bool = True
) -> Prepared:
    """Derivatives, flow velocity and regression problem of a flight.

    shared: whether several back-ends will use it: what they share is worked out here, not in
    whichever of them happens to come first. Raises InputError where the flight does not suit the
    settings.
    """
    start = perf_counter()
    samples = derivative(flight)
    problem = library.build(samples, flight.vehicle)
    target = library.response(samples, flight.vehicle)
    if shared:
        _ = problem.statistics.gram
    seconds = perf_counter() - start
    return Prepared(samples, flight.vehicle, library, problem, target, seconds)
