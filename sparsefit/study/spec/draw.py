"""One flight to fly: its flow, vehicle, noise and faults, from one number per quantity."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import Cells, CellularFlow, Flow, ShapedCells, SuperposedFlow
from sparsefit.flight.turbulence import Turbulence
from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries, turning
from sparsefit.study.spec.quantities import (
    BESIDE,
    COUNTS,
    FAULTS,
    LAW_KEYS,
    RATIO_KEYS,
    SHAPE_STREAMS,
    SUPERPOSED,
)

SIMULATION = 0
FAULTY = 100  # the child of a flight's stream that its faults are drawn from
OTHERS = 200  # the first of its children that other flights through the same flow start from
TOGETHER = 1000  # the same of those that are estimated with it


def stream(seed: int, flight: int, index: int) -> np.random.SeedSequence:
    """The random stream `index` of one flight."""
    return np.random.SeedSequence(seed, spawn_key=(flight, index))


@dataclass(frozen=True)
class Draw:
    """One flight to fly: SI units (m/s, m, s, m/s^2, Hz).

    flow: the cells that are sought, None where there are none; turbulence and wind are beside
    them. believed: the vehicle that the pilot believes in, where it is not the true one. thrust:
    that turns, of which the constant is a part; thrust_logged: whether the pilot has measured it.
    together: how many flights through this flow are estimated as one.
    """

    flow: Flow | None
    vehicle: PointMassVehicle
    duration: float
    sample_rate: float
    initial_position: tuple[float, float] | None
    initial_velocity: tuple[float, float]
    process_noise: float
    position_noise: float
    velocity_noise: float
    wind: tuple[float, float] = (0.0, 0.0)
    believed: PointMassVehicle | None = None
    turbulence: Turbulence | None = None
    time_jitter: float = 0.0
    faults: LogFaults = field(default_factory=LogFaults)
    thrust: ThrustSeries | None = None
    thrust_noise: float = 0.0
    thrust_logged: bool = True
    together: int = 1

    @classmethod
    def from_values(
        cls,
        values: dict[str, float],
        *,
        cells: bool = True,
        spectrum: str = "dryden",
        turbulence_seed: int = 0,
        thrust_logged: bool = True,
    ) -> Draw:
        """From one number per stream name; what is not named takes its default.

        cells: whether there are any, beside the turbulence; thrust_logged: whether a thrust that
        turns is measured, or only its constant part known.
        """
        thrust = (values.get("thrust_x", 0.0), values.get("thrust_y", 0.0))
        position = (values["position_x"], values["position_y"]) if "position_x" in values else None
        return cls(
            flow=_flow(values) if cells and "mean_velocity" in values else None,
            vehicle=_vehicle(values, (0.0, 0.0) if "thrust_turn" in values else thrust, told=False),
            duration=values["duration"],
            sample_rate=values["sample_rate"],
            initial_position=position,
            initial_velocity=(values.get("velocity_x", 0.0), values.get("velocity_y", 0.0)),
            process_noise=values.get("process_noise", 0.0),
            position_noise=values.get("position_noise", 0.0),
            velocity_noise=values.get("velocity_noise", 0.0),
            wind=_wind(values),
            believed=_believed(values, thrust, logged=thrust_logged),
            turbulence=_turbulence(values, spectrum, turbulence_seed),
            time_jitter=values.get("time_jitter", 0.0),
            faults=_faults(values),
            thrust=_turning(values, thrust),
            thrust_noise=values.get("thrust_noise", 0.0),
            thrust_logged=thrust_logged,
            together=round(values.get("together", 1.0)),
        )

    @property
    def flown(self) -> Flow | None:
        """The flow with its turbulence and wind; `flow` alone is what is sought."""
        if self.turbulence is None and not any(self.wind):
            return self.flow
        gusts = () if self.turbulence is None else (self.turbulence,)
        return SuperposedFlow((*(self.flow.cells if self.flow else ()), *gusts), self.wind)

    def fly(self, seed: np.random.SeedSequence) -> Flight:
        """The simulated flight, with its faults and the vehicle that its pilot believes in."""
        flight = simulate_flight(
            self.flown,
            self.vehicle,
            duration=self.duration,
            sample_rate=self.sample_rate,
            seed=seed,
            initial_position=self.initial_position,
            initial_velocity=self.initial_velocity,
            process_noise=self.process_noise,
            position_noise=self.position_noise,
            velocity_noise=self.velocity_noise,
            time_jitter=self.time_jitter,
            thrust=self.thrust,
            thrust_noise=self.thrust_noise,
        )
        if not self.thrust_logged:
            flight = replace(flight, thrust=None)
        if self.faults != LogFaults():
            flight = self.faults.spoil(flight, _child(seed, FAULTY))
        return flight if self.believed is None else replace(flight, vehicle=self.believed)

    def fleet(self, seed: np.random.SeedSequence) -> tuple[Flight, ...]:
        """The flights that are estimated together: this one, and others from other places."""
        elsewhere = replace(self, initial_position=None)
        beside = (elsewhere.fly(_child(seed, TOGETHER + n)) for n in range(1, self.together))
        return (self.fly(seed), *beside)

    def others(self, seed: np.random.SeedSequence, count: int) -> tuple[Flight, ...]:
        """Other flights through the same flow: from other places, without noise or faults."""
        clean = replace(
            self,
            initial_position=None,
            process_noise=0.0,
            position_noise=0.0,
            velocity_noise=0.0,
            believed=None,
            time_jitter=0.0,
            thrust_noise=0.0,
            faults=LogFaults(),
        )
        return tuple(clean.fly(_child(seed, OTHERS + number)) for number in range(count))


def _child(seed: np.random.SeedSequence, number: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number))


def _vehicle(
    values: dict[str, float], thrust: tuple[float, float], *, told: bool
) -> PointMassVehicle:
    """The true vehicle, or the one that the estimator is told of, with a constant thrust."""
    response, drag = values.get("response_time", math.inf), values.get("drag", 0.0)
    if told:
        by_response, push, by_drag = (values.get(key, 1.0) for key in RATIO_KEYS)
        response, drag = by_response * response, by_drag * drag
        if any(key in values for key in LAW_KEYS):
            response = values.get("believed_response_time", math.inf)
            drag = values.get("believed_drag", 0.0)
        thrust = (push * thrust[0], push * thrust[1])
    return PointMassVehicle(response, thrust, drag)


def _believed(
    values: dict[str, float], thrust: tuple[float, float], *, logged: bool
) -> PointMassVehicle | None:
    turns = "thrust_turn" in values
    if not any(key in values for key in (*RATIO_KEYS, *LAW_KEYS)) and (logged or not turns):
        return None
    believed = _vehicle(values, thrust, told=True)
    if turns and logged:
        scale = values.get("believed_thrust_ratio", 1.0)
        return replace(believed, thrust_acceleration=(0.0, 0.0), thrust_scale=scale)
    return believed


def _turning(values: dict[str, float], constant: tuple[float, float]) -> ThrustSeries | None:
    if "thrust_turn" not in values:
        return None
    return turning(
        values["duration"],
        values["sample_rate"],
        constant=constant,
        size=values["thrust_turn"],
        period=values["thrust_period"],
        phase=values.get("thrust_phase", 0.0),
    )


def _flow(values: dict[str, float]) -> Flow:
    """The first cells, (U0, L), and those of its multiples that are asked for."""
    speed, scale = values["mean_velocity"], values["length_scale"]
    first = _cells(values, speed, scale, values.get("heading", 0.0))
    more = (
        _cells(
            values,
            speed * values[velocity_ratio],
            scale * values[scale_ratio],
            values.get("second_heading" if place == 0 else "heading", values.get("heading", 0.0)),
        )
        for place, (scale_ratio, velocity_ratio) in enumerate(SUPERPOSED)
        if scale_ratio in values
    )
    parts = (first, *more)
    return SuperposedFlow(parts) if len(parts) > 1 else first


def _cells(values: dict[str, float], speed: float, scale: float, heading: float) -> Cells:
    """Cells of side `scale` along x, and `aspect` times it along y; all drift and swell alike."""
    if not any(key in values for key in SHAPE_STREAMS if key not in BESIDE):
        return CellularFlow(speed, scale)
    drift = _polar(values, "drift", values["mean_velocity"])
    return ShapedCells(
        speed,
        (scale, scale * values.get("aspect", 1.0)),
        heading=heading,
        angle=values.get("angle", math.pi / 2.0),
        offset=(values.get("offset_x", 0.0), values.get("offset_y", 0.0)),
        drift=drift,
        swell=values.get("swell", 0.0),
        swell_period=values.get("swell_period", values["duration"]),
        swell_phase=values.get("swell_phase", 0.0),
    )


def _polar(values: dict[str, float], name: str, speed: float) -> tuple[float, float]:
    """What is told as a share of `speed` and a direction [rad], as (x, y)."""
    size = speed * values.get(f"{name}_ratio", 0.0)
    direction = values.get(f"{name}_direction", 0.0)
    return (size * math.cos(direction), size * math.sin(direction)) if size else (0.0, 0.0)


def _wind(values: dict[str, float]) -> tuple[float, float]:
    if "wind_ratio" in values:
        return _polar(values, "wind", values["mean_velocity"])
    return (values.get("wind_x", 0.0), values.get("wind_y", 0.0))


def _turbulence(values: dict[str, float], spectrum: str, seed: int) -> Turbulence | None:
    intensity = values.get("turbulence_ratio", 0.0) * values.get("mean_velocity", 0.0)
    if not intensity:
        return None
    memory = values.get("turbulence_memory")
    return Turbulence(intensity, values["turbulence_length"], memory, spectrum, seed)


def _faults(values: dict[str, float]) -> LogFaults:
    given: dict[str, Any] = {
        name: round(values[key]) if key in COUNTS else values[key]
        for key, name in FAULTS.items()
        if key in values
    }
    return LogFaults(**given)
