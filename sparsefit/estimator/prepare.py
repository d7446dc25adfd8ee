"""The shared work of all back-ends on a flight, or on several through one flow."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from time import perf_counter
from typing import Any, TypeVar, cast

import numpy as np
from numpy.linalg import norm

from sparsefit.arrays import Array, Brief
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, told_with
from sparsefit.flight import Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.likelihood.readings import noise_of
from sparsefit.model import Library, Search, flight_weights
from sparsefit.regression.problem import RegressionProblem
from sparsefit.rows import Derivative, Samples
from sparsefit.rows.clean import pieces_of

FEWEST = 20  # rows of each of several flights, to estimate its noise
RESOLVED = 3.0  # least samples per length scale that resolve the flow
EVIDENT = 0.02  # least relative difference of displacements at which a latency is searched for
PARALLEL = 0.98  # least correlation of displacements that differ by a factor alone
MENDED = 0.1  # the largest share of that difference which a latency may leave

Result = TypeVar("Result")


@dataclass(frozen=True, eq=False, repr=False)
class Prepared(Brief):
    """One flight, or several through one flow, with its rows and its regression problem."""

    flights: tuple[Flight, ...]
    parts: tuple[Samples, ...]  # the samples and derivatives of each flight
    weights: tuple[float, ...]  # of the rows of each flight
    library: Library  # that built the problem
    problem: RegressionProblem
    seconds: float  # that the work took
    _answers: dict[Any, Any] = field(default_factory=dict, repr=False)

    @property
    def vehicles(self) -> list[PointMassVehicle]:
        """The vehicles of the flights."""
        return [flight.vehicle for flight in self.flights]

    @cached_property
    def search(self) -> Search:
        """The search off the grid. Raises InputError where nothing can be found."""
        return Search.of(self.parts, self.vehicles, self.library, self.weights)

    @cached_property
    def latencies(self) -> list[float]:
        """The latency [s] of each flight as its log alone shows it; 0: none."""
        return [latency_of(flight) for flight in self.sound]

    @cached_property
    def ways(self) -> dict[int, Ways]:
        """The ways of each flight whose velocity was measured, by its number from 1."""
        sound = enumerate(self.sound, 1)
        return {number: Ways.of(flight) for number, flight in sound if flight.velocity_measured}

    @cached_property
    def sound(self) -> list[Flight]:
        """The flights with outliers of the position replaced, where time steps are even."""
        logs = (pieces_of(flight, repair=True, even=False)[0] for flight in self.flights)
        pairs = zip(self.flights, logs, strict=True)
        return [replace(flight, position=log.state[:, :2]) for flight, log in pairs]

    @cached_property
    def strides(self) -> list[float]:
        """The typical distance [m] between samples of each flight."""
        speeds = [math.sqrt(float(np.mean(np.sum(own.velocity**2, axis=1)))) for own in self.parts]
        steps = [float(np.median(np.diff(own.time))) for own in self.parts]
        return [speed * step for speed, step in zip(speeds, steps, strict=True)]

    def too_fast(self, length: float) -> list[int]:
        """The numbers, from 1, of flights with too few samples to follow a length scale [m]."""
        least, ways = 0.5 * self.library.grid.lower, enumerate(self.strides, 1)
        return [number for number, way in ways if way * RESOLVED > length and way > least]

    def once(self, key: object, work: Callable[[], Result]) -> Result:
        """The result of `work`, computed once for each key."""
        if key not in self._answers:
            self._answers[key] = work()
        return cast(Result, self._answers[key])


@dataclass(frozen=True, eq=False)
class Ways:
    """Displacements (s, 2) [m] over 32nds of a log, which are equal but for noise."""

    placed: Array  # by position
    summed: Array  # by integrated velocity
    noise: float  # the standard deviation [m] of their difference by the noise of the readings

    @classmethod
    def of(cls, flight: Flight, latency: float = 0.0) -> Ways:
        """The ways of a flight; latency: by which positions lag the velocities [s]."""
        steps = np.diff(flight.time)[:, None]
        half = 0.5 * (flight.velocity[1:] + flight.velocity[:-1]) * steps
        integral = np.vstack([np.zeros(2), np.cumsum(half, axis=0)])
        ends = np.unique(np.linspace(0, len(flight.time) - 1, 33).astype(int))
        times = flight.time[ends] - latency
        ends = ends[(times >= flight.time[0]) & (times <= flight.time[-1])]
        summed = [np.interp(flight.time[ends] - latency, flight.time, each) for each in integral.T]
        drawn = float(np.mean(steps)) * math.sqrt(len(flight.time) / len(ends))
        noise = math.hypot(noise_of(flight.position), drawn * noise_of(flight.velocity))
        return cls(np.diff(flight.position[ends], axis=0), np.diff(summed, axis=1).T, noise)

    def apart(self, noises: float = 5.0) -> float:
        """The relative rms difference; noises: standard deviations by which it is reduced."""
        rms = math.sqrt(float(np.mean((self.placed - self.summed) ** 2)))
        size = math.sqrt(max(float(np.mean(self.summed**2)), 1e-300))
        return max(rms - noises * self.noise, 0.0) / size

    @property
    def ratio(self) -> float:
        """The way of the position over that of the velocity."""
        square = max(float(np.sum(self.summed**2)), 1e-300)
        return float(np.sum(self.placed * self.summed)) / square

    @property
    def parallel(self) -> bool:
        """Whether they differ by a factor alone."""
        return bool(self.ratio * norm(self.summed) > PARALLEL * norm(self.placed))

    @property
    def scaled(self) -> bool:
        """Whether the ratio is not 1, whatever noise does to it."""
        doubt = 5.0 * self.noise / (float(norm(self.summed)) + 1e-300)
        return abs(self.ratio - 1.0) > max(EVIDENT, doubt)


def latency_of(flight: Flight) -> float:
    """The time [s] by which positions lag velocities, if it removes their difference; else 0."""
    whole = Ways.of(flight).apart() if flight.velocity_measured else 0.0
    if not whole > EVIDENT:
        return 0.0
    farthest = 0.1 * float(np.ptp(flight.time))
    steps = np.arange(1, 65) * max(float(np.median(np.diff(flight.time))), farthest / 64)
    shifts = [sign * step for step in steps[steps <= farthest].tolist() for sign in (1, -1)]
    best = min(shifts, key=lambda shift: Ways.of(flight, shift).apart(0.0), default=0.0)
    return best if Ways.of(flight, best).apart() < MENDED * whole else 0.0


def prepare(
    flights: Flight | Sequence[Flight],
    derivative: Derivative,
    library: Library,
    *,
    shared: bool = True,
) -> Prepared:
    """Derivatives, flow velocity and regression problem of flights through one flow.

    shared: whether several back-ends will use it, so that common work belongs here. Raises
    InputError where a flight does not suit the settings.
    """
    start, parts, flights = perf_counter(), [], together(flights)
    for number, flight in enumerate(flights, 1):
        with told_with(f"flight {number}" if len(flights) > 1 else ""):
            own = derivative(flight)
            if len(flights) > 1 and len(own.time) <= FEWEST:
                raise InputError(
                    f"{len(own.time)} rows are too few to estimate its noise beside other "
                    f"flights (at least {FEWEST + 1}); leave it out, or sample faster"
                )
            parts.append(own)
    vehicles = [flight.vehicle for flight in flights]
    weights = flight_weights(parts, vehicles, library)
    problem = library.build(parts, vehicles, weights)
    if shared:
        _ = problem.design.gram
    return Prepared(flights, tuple(parts), weights, library, problem, perf_counter() - start)


def together(flights: Flight | Sequence[Flight]) -> tuple[Flight, ...]:
    """One flight or several, as several. Raises InputError where they are none, or no flights."""
    if isinstance(flights, Flight):
        return (flights,)
    if not isinstance(flights, Sequence) or isinstance(flights, str) or not flights:
        empty = isinstance(flights, Sequence) and not flights
        given = "an empty list" if empty else f"a {type(flights).__name__}"
        raise InputError(f"give a Flight, or a list of flights through one flow, not {given}")
    for number, flight in enumerate(flights, 1):
        if not isinstance(flight, Flight):
            kind = f"a {type(flight).__name__}"
            raise InputError(f"flight {number} of the list must be a Flight, not {kind}")
        for first, other in enumerate(flights[: number - 1], 1):
            if np.array_equal(flight.position, other.position):
                raise InputError(f"flights {first} and {number} are one and the same; give it once")
        if flight.frame and flights[0].frame not in ("", flight.frame):
            raise InputError(
                f"flight {number} is in {flight.frame}, and flight 1 in {flights[0].frame}: turn "
                "one of them; several flights need one frame"
            )
    return tuple(flights)
