"""The model of a log: motion, sensors and disturbances, each parameter with a value, free or known.

    x' = v
    v' = [(1 + c |r|) r / tau + s R(rho) m + b] / [(1 + mu t)(1 - l/tau)]
    r  = (1 + gain)(1 + growth t) w(x - l v, t - l) + wind + wind_growth t - v
    z_x = s_x x(t - latency) + b_x + noise,     z_v = s_v R(rho_v) v + b_v + noise

m is the thrust acceleration, t counts from the middle of the log. Every quantity in these lines is
an element: the passes know the derivative by each of them, and the free parameters of a model are
chained to the elements by one Jacobian. An element may also wander about its value, as a state:
turbulence is a wind that does, a swell a gain, a Gauss-Markov error of position a bias.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields, replace
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.cached import cached_property
from sparsefit.errors import InputError, suggestion
from sparsefit.likelihood.pattern import WAVE, StreamPattern

ELEMENTS = (
    *("response_time", "thrust_scale", "thrust_rotation", "thrust_bias_x", "thrust_bias_y"),
    *("quadratic_drag", "wind_x", "wind_y", "wind_growth_x", "wind_growth_y", "mass_rate", "lag"),
    *("gain", "growth", "position_scale", "velocity_scale", "velocity_bias_x", "velocity_bias_y"),
    *("velocity_rotation", "latency", "position_bias_x", "position_bias_y"),
)  # in the order of the passes; the waves follow, five elements each


@dataclass(frozen=True)
class Parameter:
    """A number of the model.

    Args:
        value: what it is, or where the search starts.
        free: whether it is estimated.
        prior: the standard deviation of a Gaussian prior about `value`; infinite: no prior.
    """

    value: float
    free: bool = False
    prior: float = math.inf


Quantity: TypeAlias = float | Parameter


@dataclass(frozen=True)
class Motion:
    """The vehicle and the air around it, beside the pattern of the flow.

    Args:
        response_time: tau [s].
        thrust_scale: s, by which the thrust in the log is multiplied.
        thrust_rotation: rho [rad], by which it is turned counter-clockwise.
        thrust_bias_x: b [m/s^2].
        thrust_bias_y: b [m/s^2].
        quadratic_drag: c [s/m].
        wind_x: [m/s], carries the vehicle and no pattern.
        wind_y: [m/s].
        wind_growth_x: [m/s^2].
        wind_growth_y: [m/s^2].
        mass_rate: mu [1/s], the rate of change of the mass by its value in mid-flight.
        lag: l [s], by which the drag follows the relative wind.
    """

    response_time: Quantity
    thrust_scale: Quantity = 1.0
    thrust_rotation: Quantity = 0.0
    thrust_bias_x: Quantity = 0.0
    thrust_bias_y: Quantity = 0.0
    quadratic_drag: Quantity = 0.0
    wind_x: Quantity = 0.0
    wind_y: Quantity = 0.0
    wind_growth_x: Quantity = 0.0
    wind_growth_y: Quantity = 0.0
    mass_rate: Quantity = 0.0
    lag: Quantity = 0.0


@dataclass(frozen=True)
class Sensor:
    """The instruments, noise apart.

    Args:
        position_scale: s_x.
        velocity_scale: s_v.
        velocity_bias_x: b_v [m/s].
        velocity_bias_y: b_v [m/s].
        velocity_rotation: rho_v [rad], of the frame of the velocity against that of the position.
        latency: [s], by which the position is older than the velocity of its row.
    """

    position_scale: Quantity = 1.0
    velocity_scale: Quantity = 1.0
    velocity_bias_x: Quantity = 0.0
    velocity_bias_y: Quantity = 0.0
    velocity_rotation: Quantity = 0.0
    latency: Quantity = 0.0


@dataclass(frozen=True)
class Process:
    """Elements that wander about their values, each by an independent process of one level.

    Args:
        name: the name of the level.
        elements: the names of the elements.
        level: the stationary rms in the elements' unit; of a random walk, per sqrt(s).
        rate: beta [1/s] of u' = -beta u + level sqrt(2 beta) white; 0: a random walk.
    """

    name: str
    elements: tuple[str, ...]
    level: float
    rate: float = 0.0

    def __post_init__(self) -> None:
        """Check the names, the level and the rate."""
        for name in self.elements:
            if name not in ELEMENTS:
                raise InputError(f"no element {name!r} may wander{suggestion(name, ELEMENTS)}")
        if not (self.level >= 0.0 and 0.0 <= self.rate < math.inf):
            raise InputError(f"process {self.name}: level and rate must be finite and >= 0")


@dataclass(frozen=True)
class Disturbance:
    """Noise of the motion and of the instruments.

    Args:
        acceleration: q [m/s^2/sqrt(Hz)], white.
        position_noise: sigma_x [m], white, of each component.
        velocity_noise: sigma_v [m/s].
        processes: what wanders.
    """

    acceleration: float = 0.0
    position_noise: float = 0.05
    velocity_noise: float = 0.2
    processes: tuple[Process, ...] = ()

    @property
    def levels(self) -> dict[str, float]:
        """The levels by name, in the order of the passes."""
        own = {name: getattr(self, name) for name in LEVELS}
        return own | {process.name: process.level for process in self.processes}

    def at(self, levels: dict[str, float]) -> Disturbance:
        """Return the disturbance with these levels, others as they are."""
        processes = tuple(
            replace(process, level=levels.get(process.name, process.level))
            for process in self.processes
        )
        own = {name: value for name, value in levels.items() if name in LEVELS}
        return replace(self, processes=processes, **own)


LEVELS = ("acceleration", "position_noise", "velocity_noise")


@dataclass(frozen=True)
class Model:
    """A flow, a vehicle, instruments and disturbances.

    Args:
        pattern: the flow; all its parameters are free.
        motion: the vehicle.
        sensor: the instruments.
        disturbance: the noise.
        growth: [1/s], the relative rate at which the flow swells.
        fixed: names of parameters of the pattern that are known.
    """

    pattern: StreamPattern
    motion: Motion
    sensor: Sensor = field(default_factory=Sensor)
    disturbance: Disturbance = field(default_factory=Disturbance)
    growth: Quantity = 0.0
    fixed: tuple[str, ...] = ()

    @cached_property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter by name: those of the pattern first."""
        flow = zip(self.pattern.names, self.pattern.values, strict=True)
        record = {name: Parameter(value, name not in self.fixed) for name, value in flow}
        for part in (self.motion, self.sensor):
            record |= {item.name: _parameter(getattr(part, item.name)) for item in fields(part)}
        return record | {"growth": _parameter(self.growth)}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The names of the free parameters."""
        return tuple(name for name, parameter in self.parameters.items() if parameter.free)

    @cached_property
    def elements(self) -> Array:
        """The values of all elements (22 + 5 j,)."""
        parameters = self.parameters
        own = [parameters[name].value if name in parameters else 0.0 for name in ELEMENTS]
        return np.concatenate([own, self.pattern.waves.ravel()])

    def jacobian(self, names: tuple[str, ...]) -> Array:
        """The derivatives (22 + 5 j, p) of the elements by named parameters.

        A name may also be that of an element of a wave that no parameter of the pattern moves
        alone: "kx_2", "frequency_1".
        """
        first, waves = len(ELEMENTS), 5 * len(self.pattern.waves)
        jacobian = np.zeros((first + waves, len(names)))
        slopes = self.pattern.jacobian
        for column, name in enumerate(names):
            stem, _, number = name.rpartition("_")
            if name in self.pattern.names:
                jacobian[first:, column] = slopes[:, self.pattern.names.index(name)]
            elif name in ELEMENTS:
                jacobian[ELEMENTS.index(name), column] = 1.0
            elif stem in WAVE and number.isdigit() and 0 < int(number) <= waves // 5:
                jacobian[first + 5 * (int(number) - 1) + WAVE.index(stem), column] = 1.0
            else:
                valid = (*self.pattern.names, *ELEMENTS)
                raise InputError(f"no parameter {name!r} in this model{suggestion(name, valid)}")
        return jacobian

    def at(self, values: dict[str, float]) -> Model:
        """Return the model with other values; which are free does not change."""
        flow = zip(self.pattern.names, self.pattern.values, strict=True)
        pattern = replace(
            self.pattern, values=tuple(float(values.get(name, old)) for name, old in flow)
        )
        return self._with(lambda name, old: replace(old, value=float(values.get(name, old.value))),
                          pattern)  # fmt: skip

    def free(self, *names: str, prior: float = math.inf) -> Model:
        """Return the model with these parameters free as well."""
        for name in names:
            if name not in self.parameters:
                near = suggestion(name, self.parameters)
                raise InputError(f"no parameter {name!r} can be freed{near}")
        fixed = tuple(name for name in self.fixed if name not in names)
        freed = self._with(
            lambda name, old: Parameter(old.value, True, prior) if name in names else old,
            self.pattern,
        )
        return replace(freed, fixed=fixed)

    def known(self, *names: str) -> Model:
        """Return the model with these parameters known, at their values."""
        flow = tuple(name for name in self.pattern.names if name in names or name in self.fixed)
        bound = self._with(
            lambda name, old: Parameter(old.value) if name in names else old, self.pattern
        )
        return replace(bound, fixed=flow)

    def _with(self, change: Callable[[str, Parameter], Parameter], pattern: StreamPattern) -> Model:
        """The model with every parameter outside of the pattern changed by a function."""

        def changed(part: Motion | Sensor) -> dict[str, Parameter]:
            names = [item.name for item in fields(part)]
            return {name: change(name, _parameter(getattr(part, name))) for name in names}

        return replace(
            self,
            pattern=pattern,
            motion=Motion(**changed(self.motion)),
            sensor=Sensor(**changed(self.sensor)),
            growth=change("growth", _parameter(self.growth)),
        )


def _parameter(quantity: Quantity) -> Parameter:
    return quantity if isinstance(quantity, Parameter) else Parameter(float(quantity))


@dataclass(frozen=True, eq=False)
class StateSpace:
    """What the passes need of a model, in arrays; n = 4 + w states: x, y, v_x, v_y, the walkers.

    Args:
        elements: the values of the elements (22 + 5 j,).
        walkers: the elements (w,) that wander, states 4 to n.
        rates: their rates beta (w,) [1/s].
        columns: the elements (p,) by which sensitivities are carried.
        kicks: the variance per second that each level gives to each state (l, n).
        spread: the variance that each level gives to each state at the start (l, n).
        noise: the variance that each level gives to each channel (l, 4): position, velocity.
    """

    elements: Array
    walkers: IntArray
    rates: Array
    columns: IntArray
    kicks: Array
    spread: Array
    noise: Array

    @classmethod
    def of(cls, model: Model, columns: Iterable[int] = ()) -> StateSpace:
        """Return the state space of a model, with sensitivities by the elements `columns`."""
        disturbance = model.disturbance
        rows = [
            (ELEMENTS.index(name), process.rate, process.level**2, level)
            for level, process in enumerate(disturbance.processes, len(LEVELS))
            for name in process.elements
        ]
        levels, states = len(disturbance.levels), 4 + len(rows)
        kicks, spread, noise = (np.zeros((levels, width)) for width in (states, states, 4))
        kicks[0, 2:4] = disturbance.acceleration**2
        noise[1, :2] = disturbance.position_noise**2
        noise[2, 2:] = disturbance.velocity_noise**2
        for state, (_, rate, square, level) in enumerate(rows, 4):
            kicks[level, state] = 2.0 * rate * square if rate else square
            spread[level, state] = square if rate else 0.0
        walkers = np.array([row[0] for row in rows], dtype=np.intp)
        rates = np.array([row[1] for row in rows], dtype=np.float64)
        ids = np.array(list(columns), dtype=np.intp)
        return cls(model.elements, walkers, rates, ids, kicks, spread, noise)
