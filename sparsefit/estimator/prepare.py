"""What every back-end shares on one flight, and what is worked out once for all of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, TypeVar, cast

import numpy as np

from sparsefit.arrays import Array, Brief
from sparsefit.cached import cached_property
from sparsefit.derivative import Derivative, Samples
from sparsefit.errors import InputError, told_of
from sparsefit.flight import Flight
from sparsefit.flight.flow import FlowField
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.library.builder import Library
from sparsefit.library.nuisance import Nuisance
from sparsefit.library.scan import Bounds, middle
from sparsefit.modes.fitted_rows import Rows
from sparsefit.modes.levels import weighed
from sparsefit.modes.space import SearchSpace
from sparsefit.modes.stack import Part, rows_of
from sparsefit.regression.problem import RegressionProblem
from sparsefit.uncertainty import LAGS

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False, repr=False)
class Prepared(Brief):
    """One flight, or several through one flow, and what is worked out for all back-ends.

    Args:
        parts: the samples and derivatives of each flight, what is unknown of it, and its weight.
        library: that built the problem.
        problem: the regression problem of the flights.
        target: what the columns are regressed on, a row per sample (m, n), where the problem's own
            rows may be compressed, averages or weighted.
        seconds: what all this took.
        lobes: wavenumbers (l,) [1/m] where one mode may be, deepest first, as an earlier scan
            found them; None: the search scans for them.
    """

    parts: tuple[Part, ...]
    library: Library
    problem: RegressionProblem
    target: Array
    seconds: float
    lobes: Array | None = None
    _answers: dict[tuple[Any, ...], Any] = field(default_factory=dict, repr=False)

    @cached_property
    def samples(self) -> Samples:
        """States and derivatives, of several flights one after another."""
        flights = [part.samples for part in self.parts]
        return flights[0] if len(flights) == 1 else Samples.joined(flights)

    @property
    def vehicle(self) -> PointMassVehicle:
        """As it is believed to be; of several flights that of the first."""
        return self.parts[0].nuisance.believed

    @property
    def nuisances(self) -> list[Nuisance]:
        """What is unknown of each flight."""
        return [part.nuisance for part in self.parts]

    @property
    def weak(self) -> bool:
        """Whether rows are averages."""
        return self.parts[0].samples.weak is not None

    @cached_property
    def flow_velocity(self) -> Array:
        """Phi (m, 2) [m/s] at the samples, of the vehicles as they are believed to be."""
        each = [part.samples.flow_velocity(part.nuisance.believed) for part in self.parts]
        return np.concatenate(each)

    @cached_property
    def rows(self) -> Rows:
        """The rows that modes are fitted to."""
        return rows_of(self.parts)

    @property
    def narrow(self) -> bool:
        """Whether the grid's bounds leave nothing to search between them."""
        return not self.library.grid.lower < self.library.grid.upper

    @cached_property
    def space(self) -> SearchSpace:
        """Where modes are searched off the grid. Raises InputError where nothing can be found."""
        space = SearchSpace.of_flights(self.parts, _bounds(self.library))
        return space if self.lobes is None else replace(space, known=self.lobes)

    @property
    def origin(self) -> Array:
        """(x, y, t) from which places [m] and times [s] of the rows count."""
        sources = [part.samples.weak or part.samples for part in self.parts]
        time = self.samples.time
        place = middle(np.concatenate([source.position for source in sources]))
        return np.array([*place, 0.5 * (time.min() + time.max())])

    def once(self, key: tuple[Any, ...], work: Callable[[], Result]) -> Result:
        """What the work gives, done once for all back-ends that come to the same key."""
        if key not in self._answers:
            self._answers[key] = work()
        return cast(Result, self._answers[key])


def prepare(
    flights: Sequence[Flight],
    derivative: Derivative,
    library: Library,
    *,
    shared: bool = True,
    flow: FlowField | None = None,
) -> Prepared:
    """Derivatives, flow velocity and regression problem of flights through one flow.

    shared: whether several back-ends will use it: what they share is worked out here, not in
    whichever of them happens to come first. flow: that is nearly what several flights met, where
    it is known: their weights come from it, and the column of an unknown drag. Raises InputError
    where a flight does not suit the settings.
    """
    if len(flights) > 1 and scaling(library) and flow is None:
        raise InputError(
            f"unknown {scaling(library)!r} of several flights is found in rounds: use "
            "Estimator.estimate, or give it"
        )
    start, samples = perf_counter(), []
    for number, flight in enumerate(flights, 1):
        with told_of("flight", number, len(flights)):
            samples.append(derivative(flight))
            if len(flights) > 1:
                _refuse_short(samples[-1])
    vehicles = [flight.vehicle for flight in flights]
    pairs = zip(samples, vehicles, strict=True)
    parts = [Part(own, Nuisance(library.unknown, vehicle)) for own, vehicle in pairs]
    if flow is not None:
        parts = [replace(part, flow=_along(flow, part.samples)) for part in parts]
    parts = weighed(parts, _bounds(library))
    problem = library.build_flights(samples, vehicles, [part.weight for part in parts])
    responses = zip(samples, vehicles, strict=True)
    target = np.concatenate([library.response(own, vehicle) for own, vehicle in responses])
    if shared:
        _ = problem.statistics.gram
    seconds = perf_counter() - start
    return Prepared(tuple(parts), library, problem, target, seconds)


def scaling(library: Library) -> str:
    """What is unknown that scales the flow velocity of a flight; empty where nothing is."""
    return next((name for name in ("response_time", "drag") if name in library.unknown), "")


def _along(flow: FlowField, samples: Samples) -> Array:
    x, y = samples.position.T
    return flow.velocity(x, y, samples.time)


def together(flights: Flight | Sequence[Flight]) -> tuple[Flight, ...]:
    """One flight or several, as several. Raises InputError where they are none, or no flights."""
    if isinstance(flights, Flight):
        return (flights,)
    if not isinstance(flights, Sequence) or isinstance(flights, str) or not flights:
        raise InputError(
            f"give a Flight, or a list of flights through one flow, not {_named(flights)}"
        )
    for number, flight in enumerate(flights, 1):
        if not isinstance(flight, Flight):
            raise InputError(f"flight {number} of the list must be a Flight, not {_named(flight)}")
        for first, other in enumerate(flights[: number - 1], 1):
            if np.array_equal(flight.position, other.position):
                raise InputError(f"flights {first} and {number} are one and the same; give it once")
        if flight.frame and flights[0].frame not in ("", flight.frame):
            raise InputError(
                f"flight {number} is in {flight.frame}, and flight 1 in {flights[0].frame}: turn "
                "one of them; several flights need one frame"
            )
    return tuple(flights)


def _named(given: object) -> str:
    if isinstance(given, Sequence) and not given:
        return "an empty list"
    return f"a {type(given).__name__}"


def _bounds(library: Library) -> Bounds:
    """Of the wavenumber [1/m]."""
    return math.pi / library.grid.upper, math.pi / library.grid.lower


def _refuse_short(samples: Samples) -> None:
    """InputError where a flight's own noise cannot be told."""
    rows = len((samples.weak or samples).time)
    if rows <= LAGS:
        raise InputError(
            f"{rows} rows are too few to tell its noise beside other flights (at least {LAGS + 1});"
            " leave it out, or sample faster"
        )
