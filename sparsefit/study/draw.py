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

from sparsefit.codec import Place, text
from sparsefit.errors import suggestion
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import Cells, CellularFlow, Flow, ShapedCells, SuperposedFlow
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.flight.turbulence import SPECTRA, Turbulence
from sparsefit.flight.vehicle import PointMassVehicle, ThrustSeries, turning
from sparsefit.study.quantities import (
    COUNTS,
    DRAG_KEYS,
    FAULTS,
    FLOW_KEYS,
    LAW_KEYS,
    NEEDS,
    OF_FLOW,
    QUANTITIES,
    RATIO_KEYS,
    REQUIRED,
    SHAPING,
    STREAMS,
    SUPERPOSED,
    SUPERPOSED_KEYS,
    SYNONYMS,
    TURBULENCE_FIELD,
    TURBULENCE_KEYS,
    Entry,
    read_entry,
)
from sparsefit.study.toml_file import Section

SIMULATION = 0
FAULTY = 100  # the child of a flight's stream that its faults are drawn from
OTHERS = 200  # the first child that other flights through the same flow start from
TOGETHER = 1000  # the first child of the flights that are estimated with it
# none: still air; turbulence: no cells in it. Any flow that is found in these is a false alarm.
FLOWS = ("cellular", "none", "turbulence")
THRUST_LOGS = ("measured", "none")  # none: of a thrust that turns only its constant part is known
WORDS = {"flow": FLOWS, "turbulence_spectrum": tuple(SPECTRA), "thrust_log": THRUST_LOGS}
KEYS = (*WORDS, *QUANTITIES)


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
        if not any(key in values for key in SHAPING):
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
            thrust = self._turning()
        flight = simulate_flight(
            self.flown,
            self.vehicle,
            duration=values["duration"],
            sample_rate=values["sample_rate"],
            seed=seed,
            initial_position=self._pair("position") if "position_x" in values else None,
            initial_velocity=self._pair("velocity"),
            process_noise=values.get("process_noise", 0.0),
            position_noise=values.get("position_noise", 0.0),
            velocity_noise=values.get("velocity_noise", 0.0),
            time_jitter=values.get("time_jitter", 0.0),
            thrust=thrust,
            thrust_noise=values.get("thrust_noise", 0.0),
        )
        if not self.thrust_logged:
            flight = replace(flight, thrust=None)
        given: dict[str, Any] = {
            name: round(values[key]) if key in COUNTS else values[key]
            for key, name in FAULTS.items()
            if key in values
        }
        faults = LogFaults(**given)
        if faults != LogFaults():
            flight = faults.spoil(flight, _child(seed, FAULTY))
        return flight if self.believed is None else replace(flight, vehicle=self.believed)

    def _turning(self) -> ThrustSeries:
        return turning(
            self.values["duration"],
            self.values["sample_rate"],
            constant=self._pair("thrust"),
            size=self.values["thrust_turn"],
            period=self.values["thrust_period"],
            phase=self.values.get("thrust_phase", 0.0),
        )

    def fleet(self, seed: np.random.SeedSequence) -> tuple[Flight, ...]:
        """The flights that are estimated together: this one, and others from other places."""
        elsewhere = self._without("position_x", "position_y")
        together = round(self.values.get("together", 1.0))
        beside = (elsewhere.fly(_child(seed, TOGETHER + n)) for n in range(1, together))
        return (self.fly(seed), *beside)

    def others(self, seed: np.random.SeedSequence, count: int) -> tuple[Flight, ...]:
        """Other flights through the same flow: from other places, without noise or faults."""
        noise = ("process_noise", "position_noise", "velocity_noise", "time_jitter", "thrust_noise")
        content = (*RATIO_KEYS, *LAW_KEYS, *FAULTS, *noise, "position_x", "position_y")
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
    """How the flights of one condition are drawn: (stream name, entry) pairs, in stream order.

    cells: whether there are any; without them, shares of mean_velocity still refer to it.
    """

    entries: tuple[tuple[str, Entry], ...]
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
    for key in section:
        if key not in KEYS:
            raise place.at(key).error(f"unknown{nearest(key)}")
    words = {key: _word(section, key, place) for key in WORDS}
    calm = words["flow"] == "none"
    _check_keys(section, place, calm=calm)
    entries: dict[str, Entry] = {}
    for key, value in section.items():
        if key in WORDS:
            continue
        quantity, here = QUANTITIES[key], place.at(key)
        values = [value]
        if len(quantity.streams) == 2:
            if not isinstance(value, list) or len(value) != 2:
                raise here.error("must be a pair [x, y]")
            values = value
        for name, item in zip(quantity.streams, values, strict=True):
            entries[name] = read_entry(item, quantity, here)
    _check_entries(entries, place, calm=calm)
    # A protocol without a flow cannot remove the keys of the others: they are left out here.
    dropped = OF_FLOW if calm else ()
    named = [name for name in STREAMS if name in entries and name not in dropped]
    return FlightRules(
        tuple((name, entries[name]) for name in named),
        cells=words["flow"] == "cellular",
        spectrum=words["turbulence_spectrum"],
        thrust_log=words["thrust_log"],
    )


def nearest(key: str) -> str:
    """The nearest key of [flights] for a message, and not all of the sixty."""
    if key in SYNONYMS:
        return f': did you mean "{SYNONYMS[key]}"?'
    near = suggestion(key, KEYS)
    return near if "did you mean" in near else ": see `sparsefit study check --help` for the keys"


def _word(section: Section, key: str, place: Place) -> str:
    """The value of a key that is a word, by default the first of those allowed."""
    allowed = WORDS[key]
    word = text(section.get(key, allowed[0]), place.at(key))
    if word not in allowed:
        raise place.at(key).error(f'has unknown value "{word}"{suggestion(word, allowed)}')
    return word


def _check_keys(section: Section, place: Place, *, calm: bool) -> None:
    """Refuse keys that are missing, or exclude each other."""
    given = [key for key in FLOW_KEYS if key in section]
    if len(given) != 2 and not calm:
        have = ", ".join(given) or "none"
        raise place.error(f"needs exactly two of {', '.join(FLOW_KEYS)}, has {have}")
    for key in REQUIRED:
        if key not in section:
            raise place.at(key).error("missing: every flight needs it")
    if not set(DRAG_KEYS) & set(section):
        raise place.at(DRAG_KEYS[0]).error("missing: every flight needs it, or drag")
    if "measurement_noise" in section and {"velocity_noise", "position_noise"} & set(section):
        words = "is [velocity_noise, position_noise]: drop those two"
        raise place.at("measurement_noise").error(words)
    if "wind" in section and "wind_ratio" in section:
        raise place.at("wind_ratio").error("is the wind as a share of U0: drop wind, or this")
    if section.get("flow") == "turbulence" and TURBULENCE_KEYS[0] not in section:
        raise place.at(TURBULENCE_KEYS[0]).error('missing: flow = "turbulence" is made of it')


def _check_entries(entries: Mapping[str, Entry], place: Place, *, calm: bool) -> None:
    """Refuse what no flight can be drawn from: at all extremes, before the first is flown."""
    superposed = [key for key in SUPERPOSED_KEYS if key in entries]
    needed = SUPERPOSED_KEYS if set(superposed) & set(SUPERPOSED[1]) else SUPERPOSED[0]
    for key in needed if superposed else ():
        if key not in entries:
            raise place.at(key).error(f"missing: {superposed[0]} needs it too")
    for key, needs in NEEDS.items():
        if key in entries and needs not in entries:
            raise place.at(needs).error(f"missing: {key} needs it too")
    samples = max(entries["duration"].values) * max(entries["sample_rate"].values)
    if samples > MOST_SAMPLES:
        words = f"at this sample_rate is {samples:.3g} samples: keep it below {MOST_SAMPLES}"
        raise place.at("duration").error(words)
    if calm:
        return
    first, second = (entries[key].values for key in FLOW_KEYS if key in entries)
    for a in (min(first), max(first)):
        for b in (min(second), max(second)):
            if not all(1e-150 < third < 1e150 for third in (a * b, a / b)):
                raise place.error(f"{a:g} and {b:g} give no flow that can be flown")
