"""The [flights] of a study: a rule for every quantity, and the draw of one flight from them.

    rules = read_flight_rules(section, place)
    draw = rules.draw(flight=7, count=60, seed=1)    # one number per quantity
    fleet = draw.fleet(stream(1, 7, SIMULATION))     # simulated; equal for equal numbers

Two of U0, L and tau_w = L/U0 give the third (paper Eq. 14).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sparsefit.codec import Place
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import Cells, CellularFlow, Flow, ShapedCells, SuperposedFlow
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.flight.vehicle import PointMassVehicle, turning
from sparsefit.flight.waves import Turbulence
from sparsefit.study.quantities import (
    FLOW_KEYS,
    LAW_KEYS,
    QUANTITIES,
    RATIO_KEYS,
    STREAMS,
    SUPERPOSED,
    TURBULENCE_FIELD,
    DrawRule,
    FlightWords,
    nearest,
    read_entry,
)
from sparsefit.study.schema import names_of, taken
from sparsefit.study.toml_file import Section

SIMULATION = 0
FAULTY = 100  # the child of a flight's stream that its faults are drawn from
OTHERS = 200  # the first child that other flights through the same flow start from
TOGETHER = 1000  # the first child of the flights that are estimated with it
NOISES = ("process_noise", "position_noise", "velocity_noise", "time_jitter", "thrust_noise")
KEYS = (*names_of(FlightWords), *QUANTITIES)


def stream(seed: int, flight: int, index: int) -> np.random.SeedSequence:
    """The random stream number `index` of a flight."""
    return np.random.SeedSequence(seed, spawn_key=(flight, index))


def _child(seed: np.random.SeedSequence, number: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number))


@dataclass(frozen=True, eq=False)
class Draw:
    """One flight to fly: a number per stream name, in SI units (m/s, m, s, m/s², Hz).

    cells: whether there are cells beside the turbulence; thrust_logged: whether a thrust that
    turns is measured, or only its constant part known.
    """

    values: Mapping[str, float]
    cells: bool = True
    spectrum: str = "dryden"
    turbulence_seed: int = 0
    thrust_logged: bool = True

    @cached_property
    def flow(self) -> Flow | None:
        """The cells that are sought, without turbulence and wind; None where there are none."""
        values = self.values
        if not self.cells or "mean_velocity" not in values:
            return None
        speed, scale = values["mean_velocity"], values["length_scale"]
        heading = values.get("heading", 0.0)
        parts = [self._cells(speed, scale, heading)]
        for place, (scale_ratio, velocity_ratio) in enumerate(SUPERPOSED):
            if scale_ratio in values:
                turned = values.get("second_heading", heading) if place == 0 else heading
                sizes = (speed * values[velocity_ratio], scale * values[scale_ratio])
                parts.append(self._cells(*sizes, turned))
        return SuperposedFlow(tuple(parts)) if len(parts) > 1 else parts[0]

    def _cells(self, speed: float, scale: float, heading: float) -> Cells:
        """Cells of side `scale` along x and `aspect` times it along y; all drift alike."""
        values = self.values
        if not any(row.shapes and row.streams[0] in values for row in QUANTITIES.values()):
            return CellularFlow(speed, scale)
        return ShapedCells(
            speed,
            (scale, scale * values.get("aspect", 1.0)),
            heading=heading,
            angle=values.get("angle", math.pi / 2.0),
            offset=self._pair("offset"),
            drift=self._polar("drift"),
            swell=values.get("swell", 0.0),
            swell_period=values.get("swell_period", values["duration"]),
            swell_phase=values.get("swell_phase", 0.0),
        )

    @property
    def wind(self) -> tuple[float, float]:
        """The uniform wind (x, y) [m/s]."""
        return self._polar("wind") if "wind_ratio" in self.values else self._pair("wind")

    @property
    def flown(self) -> Flow | None:
        """The flow with its turbulence and wind; `flow` alone is sought."""
        intensity = self.values.get("turbulence_ratio", 0.0) * self.values.get("mean_velocity", 0.0)
        gusts: tuple[Turbulence, ...] = ()
        if intensity:
            length, memory = self.values["turbulence_length"], self.values.get("turbulence_memory")
            gusts = (Turbulence(intensity, length, memory, self.spectrum, self.turbulence_seed),)
        if not gusts and not any(self.wind):
            return self.flow
        return SuperposedFlow((*(self.flow.cells if self.flow else ()), *gusts), self.wind)

    @property
    def vehicle(self) -> PointMassVehicle:
        """The true vehicle; the thrust of one that turns is a series of its own."""
        thrust = (0.0, 0.0) if "thrust_turn" in self.values else self._pair("thrust")
        response = self.values.get("response_time", math.inf)
        return PointMassVehicle(response, thrust, self.values.get("drag", 0.0))

    @property
    def believed(self) -> PointMassVehicle | None:
        """The vehicle that the estimator is given, where it is not the true one."""
        values, turns = self.values, "thrust_turn" in self.values
        content = any(key in values for key in (*RATIO_KEYS, *LAW_KEYS))
        if not content and (self.thrust_logged or not turns):
            return None
        by_response, push, by_drag = (values.get(key, 1.0) for key in RATIO_KEYS)
        response = by_response * values.get("response_time", math.inf)
        drag = by_drag * values.get("drag", 0.0)
        if any(key in values for key in LAW_KEYS):
            response, drag = (values.get(LAW_KEYS[0], math.inf), values.get(LAW_KEYS[1], 0.0))
        if turns and self.thrust_logged:
            return PointMassVehicle(response, (0.0, 0.0), drag, thrust_scale=push)
        x, y = self._pair("thrust")
        return PointMassVehicle(response, (push * x, push * y), drag)

    def fly(self, seed: np.random.SeedSequence) -> Flight:
        """The simulated flight, with its faults and the vehicle that its pilot believes in."""
        values, thrust = self.values, None
        if "thrust_turn" in values:
            thrust = turning(
                values["duration"],
                values["sample_rate"],
                constant=self._pair("thrust"),
                size=values["thrust_turn"],
                period=values["thrust_period"],
                phase=values.get("thrust_phase", 0.0),
            )
        noises: Any = {name: values.get(name, 0.0) for name in NOISES}
        flight = simulate_flight(
            self.flown,
            self.vehicle,
            duration=values["duration"],
            sample_rate=values["sample_rate"],
            seed=seed,
            initial_position=self._pair("position") if "position_x" in values else None,
            initial_velocity=self._pair("velocity"),
            thrust=thrust,
            **noises,
        )
        if not self.thrust_logged:
            flight = replace(flight, thrust=None)
        given: dict[str, Any] = {
            row.fault: round(values[key]) if key in ("jumps", "gaps") else values[key]
            for key, row in QUANTITIES.items()
            if row.fault and key in values
        }
        faults = LogFaults(**given)
        if faults != LogFaults():
            flight = faults.spoil(flight, _child(seed, FAULTY))
        return flight if self.believed is None else replace(flight, vehicle=self.believed)

    def fleet(self, seed: np.random.SeedSequence) -> tuple[Flight, ...]:
        """The flights that are estimated together: this one, and others from other places."""
        elsewhere = self._without("position_x", "position_y")
        together = round(self.values.get("together", 1.0))
        beside = (elsewhere.fly(_child(seed, TOGETHER + n)) for n in range(1, together))
        return (self.fly(seed), *beside)

    def others(self, seed: np.random.SeedSequence, count: int) -> tuple[Flight, ...]:
        """Other flights through the same flow: from other places, without noise or faults."""
        faults = (key for key, row in QUANTITIES.items() if row.fault)
        content = (*RATIO_KEYS, *LAW_KEYS, *faults, *NOISES, "position_x", "position_y")
        clean = self._without(*content)
        flights = (clean.fly(_child(seed, OTHERS + number)) for number in range(count))
        return tuple(replace(flight, vehicle=clean.vehicle) for flight in flights)

    def _without(self, *names: str) -> Draw:
        stored = {name: value for name, value in self.values.items() if name not in names}
        return replace(self, values=stored)

    def _pair(self, name: str) -> tuple[float, float]:
        return (self.values.get(f"{name}_x", 0.0), self.values.get(f"{name}_y", 0.0))

    def _polar(self, name: str) -> tuple[float, float]:
        """A share of U0 in a direction [rad], as (x, y) [m/s]."""
        size = self.values["mean_velocity"] * self.values.get(f"{name}_ratio", 0.0)
        direction = self.values.get(f"{name}_direction", 0.0)
        return (size * math.cos(direction), size * math.sin(direction)) if size else (0.0, 0.0)


@dataclass(frozen=True)
class FlightRules:
    """Rules that draw the flights of a condition: (stream name, entry) pairs, in stream order.

    cells: whether there are any; without them, shares of mean_velocity still refer to it.
    """

    entries: tuple[tuple[str, DrawRule], ...]
    cells: bool = True
    spectrum: str = "dryden"
    thrust_log: str = "measured"

    def draw(self, flight: int, count: int, seed: int) -> Draw:
        """Flight `flight` of `count`: it depends on the seed, its number and these rules only."""
        values = {
            name: entry.at(flight, count, stream(seed, flight, STREAMS.index(name) + 1))
            for name, entry in self.entries
        }
        if values.keys() & set(FLOW_KEYS):  # in still air there is no third
            if "mean_velocity" not in values:
                values["mean_velocity"] = values["length_scale"] / values["timescale"]
            elif "length_scale" not in values:
                values["length_scale"] = values["mean_velocity"] * values["timescale"]
        field = stream(seed, flight, STREAMS.index(TURBULENCE_FIELD) + 1)
        logged = self.thrust_log == "measured"
        return Draw(values, self.cells, self.spectrum, int(field.generate_state(1)[0]), logged)


def read_flight_rules(section: Section, place: Place) -> FlightRules:
    """The rules from the [flights] section without `count`; `InputError` names the bad key."""
    for name in section:
        if name not in KEYS:
            raise place.at(name).error(f"unknown{nearest(name, KEYS)}")
    words, given = taken(FlightWords, section, place)
    calm = words.flow == "none"
    _check_keys(section, place, calm=calm)
    entries: dict[str, DrawRule] = {}
    for name, value in given.items():
        quantity, here = QUANTITIES[name], place.at(name)
        pair = value if len(quantity.streams) == 2 else [value]
        if not isinstance(pair, list) or len(pair) != len(quantity.streams):
            raise here.error("must be a pair [x, y]")
        for stream_name, item in zip(quantity.streams, pair, strict=True):
            entries[stream_name] = read_entry(item, quantity, here)
    samples = max(entries["duration"].values) * max(entries["sample_rate"].values)
    if samples > MOST_SAMPLES:
        many = f"at this sample_rate is {samples:.3g} samples: keep it below {MOST_SAMPLES}"
        raise place.at("duration").error(many)
    if not calm:  # at all extremes, before the first is flown
        first, second = (entries[name].values for name in FLOW_KEYS if name in entries)
        for a in (min(first), max(first)):
            for b in (min(second), max(second)):
                if not all(1e-150 < third < 1e150 for third in (a * b, a / b)):
                    raise place.error(f"{a:g} and {b:g} give no flow that can be flown")
    # A protocol without a flow cannot remove the keys of the others: they are left out here.
    rows = QUANTITIES.values()
    dropped = [name for row in rows if row.of_flow for name in row.streams] if calm else []
    named = [name for name in STREAMS if name in entries and name not in dropped]
    return FlightRules(
        tuple((name, entries[name]) for name in named),
        cells=words.flow == "cellular",
        spectrum=words.turbulence_spectrum,
        thrust_log=words.thrust_log,
    )


def _check_keys(section: Section, place: Place, *, calm: bool) -> None:
    """Refuse keys that are missing, or exclude each other."""
    given = [name for name in FLOW_KEYS if name in section]
    if len(given) != 2 and not calm:
        have = ", ".join(given) or "none"
        raise place.error(f"needs exactly two of {', '.join(FLOW_KEYS)}, has {have}")
    for name in ("duration", "sample_rate"):
        if name not in section:
            raise place.at(name).error("missing: every flight needs it")
    if not {"response_time", "drag"} & set(section):
        raise place.at("response_time").error("missing: every flight needs it, or drag")
    if "measurement_noise" in section and {"velocity_noise", "position_noise"} & set(section):
        words = "is [velocity_noise, position_noise]: drop those two"
        raise place.at("measurement_noise").error(words)
    if "wind" in section and "wind_ratio" in section:
        raise place.at("wind_ratio").error("is the wind as a share of U0: drop wind, or this")
    if section.get("flow") == "turbulence" and "turbulence_ratio" not in section:
        raise place.at("turbulence_ratio").error('missing: flow = "turbulence" is made of it')
    for name in section:
        for needed in QUANTITIES[name].needs if name in QUANTITIES else ():
            if needed not in section:
                raise place.at(needed).error(f"missing: {name} needs it too")
