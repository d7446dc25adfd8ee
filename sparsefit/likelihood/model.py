"""The model of a log: motion, instruments and disturbances, each parameter with a value.

Equations and elements are in `reference`. The passes differentiate by the elements; a Jacobian maps
a model's free parameters to them. An element may also vary in time about its value, as a state:
gusts are a varying wind, a swell a varying gain, a Gauss-Markov error of position a varying bias.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sparsefit.arrays import Array
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, suggestion
from sparsefit.likelihood.causes import WIND
from sparsefit.likelihood.pattern import WAVE, StreamPattern
from sparsefit.likelihood.reference import ELEMENTS, StateSpace

if TYPE_CHECKING:
    from sparsefit.flight import Flight
    from sparsefit.flight.vehicle import PointMassVehicle

Pair = tuple[float, float]
SLOWEST = 1e6  # [s], of a vehicle whose response is quadratic alone
LEVELS = {
    "acceleration": 0.0,  # q [m/s^2/sqrt(Hz)], of the motion
    "position_noise": 0.05,  # sigma_x [m], of each component
    "velocity_noise": 0.2,  # sigma_v [m/s]
}
"""The levels of white noise in the order of the passes, with their defaults."""


@dataclass(frozen=True)
class Process:
    """Elements that vary in time about their values, by processes of one level and one rate.

    u' = -beta u + level sqrt(2 beta) white, or a random walk. For a wind, beta is the rate at the
    rms speed: gusts vary along the path (`Model.space`).
    """

    name: str  # of the level
    elements: tuple[str, ...]  # their names
    level: float  # the stationary rms in the elements' unit; of a random walk, per sqrt(s)
    rate: float = 0.0  # beta [1/s]; 0: a random walk
    course: tuple[float, ...] = ()  # factors of the level's variance at equal parts of the log
    mixing: tuple[tuple[float, ...], ...] = ()  # A (e, e) of the elements' covariance A A' level^2

    @property
    def isotropy(self) -> float:
        """The variance in the weakest direction over that in the strongest."""
        return float(np.linalg.cond(self.mixing)) ** -2 if self.mixing else 1.0


@dataclass(frozen=True)
class Model:
    """A flow, a vehicle, instruments and disturbances.

    Raises InputError for an unknown name of an element or a level.
    """

    pattern: StreamPattern  # the flow; its parameters are free but for those in `fixed`
    #: the values of elements and of `LEVELS` by name, where they differ from the defaults; the
    #: response time must be among them
    own: Mapping[str, float]
    processes: tuple[Process, ...] = ()  # of the elements that vary with time
    freed: tuple[str, ...] = ()  # the names of the elements that are free
    fixed: tuple[str, ...] = ()  # the names of parameters of the pattern that are known

    def __post_init__(self) -> None:
        """Check the names of the elements."""
        for name in (*self.own, *self.freed):
            if name not in ELEMENTS and name not in LEVELS:
                raise InputError(f"no parameter {name!r}{suggestion(name, self.values)}")

    @classmethod
    def of_flight(
        cls, pattern: StreamPattern, flight: Flight, vehicle: PointMassVehicle, wind: Pair
    ) -> Model:
        """The model of a flight of a vehicle; a constant thrust is in the log, not in the model."""
        _, c, *_ = vehicle.parameters
        tau = min(vehicle.response_time, SLOWEST)
        x, y = (0.0, 0.0) if flight.thrust is None else vehicle.thrust_acceleration
        scale = 1.0 if flight.thrust is None else vehicle.thrust_scale
        own = {"response_time": tau, "thrust_scale": scale, "thrust_bias_x": x, "thrust_bias_y": y}
        own |= {"quadratic_drag": c * tau, "wind_x": wind[0], "wind_y": wind[1]}
        return cls(pattern, own)

    @cached_property
    def values(self) -> dict[str, float]:
        """Every parameter and level of white noise by name: those of the pattern first."""
        flow = dict(zip(self.pattern.names, self.pattern.values, strict=True))
        return flow | ELEMENTS | LEVELS | dict(self.own)

    @property
    def levels(self) -> dict[str, float]:
        """The levels of all noise by name, in the order of the passes."""
        white = {name: self.values[name] for name in LEVELS}
        return white | {process.name: process.level for process in self.processes}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the free parameters."""
        flow = tuple(name for name in self.pattern.names if name not in self.fixed)
        return flow + tuple(name for name in ELEMENTS if name in self.freed)

    @property
    def elements(self) -> Array:
        """The values of all elements (e + 5 j,)."""
        own = [self.values[name] for name in ELEMENTS]
        return np.concatenate([own, self.pattern.waves.ravel()])

    def jacobian(self, names: Iterable[str]) -> Array:
        """The derivatives (e + 5 j, p) of the elements by named parameters.

        A name may also be that of a single quantity of a wave: "kx_2", "frequency_1".
        """
        order, waves, names = list(ELEMENTS), len(self.pattern.waves), tuple(names)
        columns = np.zeros((len(names), len(order) + 5 * waves))
        for name, column in zip(names, columns, strict=True):
            stem, _, number = name.rpartition("_")
            if name in self.pattern.names:
                place = self.pattern.names.index(name)
                column[len(order) :] = self.pattern.jacobian[:, place]
            elif name in ELEMENTS:
                column[order.index(name)] = 1.0
            else:
                column[len(order) + 5 * (int(number) - 1) + WAVE.index(stem)] = 1.0
        return columns.T

    def at(self, values: Mapping[str, float]) -> Model:
        """Return the model with other values and levels, and the same free parameters."""
        flow = zip(self.pattern.names, self.pattern.values, strict=True)
        moved = tuple(float(values.get(name, old)) for name, old in flow)
        names = ELEMENTS | LEVELS
        other = {name: float(value) for name, value in values.items() if name in names}
        pattern = replace(self.pattern, values=moved)
        walks = (replace(own, level=values.get(own.name, own.level)) for own in self.processes)
        return replace(self, pattern=pattern, own={**self.own, **other}, processes=tuple(walks))

    def free(self, *names: str) -> Model:
        """Return the model with these elements free as well."""
        return replace(self, freed=tuple(dict.fromkeys((*self.freed, *names))))

    def space(self, names: Iterable[str] = (), track: Array | None = None) -> StateSpace:
        """Return the state space, with sensitivities by named parameters.

        Gusts are a field in space: a varying wind has the rate beta sqrt(|v - c|^2 + level^2) over
        its rms along the track (m, n), with c the velocity of the pattern.
        """
        order, sizes = list(ELEMENTS), list(self.levels.values())
        walkers = [name for process in self.processes for name in process.elements]
        states = 4 + len(walkers)
        kicks, spread, noise = (np.zeros((len(sizes), width)) for width in (states, states, 4))
        kicks[0, 2:4], noise[1, :2], noise[2, 2:] = np.square(sizes[: len(LEVELS)])
        length, end = 0 if track is None else len(track), 4
        pace, turning = np.ones((2, length, states))
        mixing, rates = np.eye(states), np.zeros(states)
        for level, process in enumerate(self.processes, len(LEVELS)):
            own, end = slice(end, end + len(process.elements)), end + len(process.elements)
            rate, variance, course = process.rate, process.level**2, process.course or (1.0,)
            parts = (np.arange(len(course)) + 0.5) * length / len(course)
            pace[:, own] = np.interp(np.arange(length) + 0.5, parts, course)[:, None]
            mixing[own, own], rates[own] = process.mixing or mixing[own, own], rate
            kicks[level, own] = 2.0 * rate * variance if rate else variance
            spread[level, own] = course[0] * variance if rate else 0.0
            if track is not None and rate and process.elements[0] in WIND:
                speeds = self.pattern.speed_through(track[:, 2:4])
                speeds[:-1] = 0.5 * (speeds[:-1] + speeds[1:])
                squares = speeds**2 + variance + 1e-300
                turning[:, own] = np.sqrt(squares / squares.mean())[:, None]
                pace[:, own] *= turning[:, own]
        places = np.array([order.index(name) for name in walkers], dtype=np.intp)
        paces, jacobian = np.hstack([pace, turning[:, 4:]]), self.jacobian(names)
        return StateSpace(
            self.elements, places, mixing[4:, 4:], rates[4:], jacobian, kicks, spread, noise, paces
        )
