"""The flights of a study: a rule for every quantity and the draw of one, or pieces of logs.

    length_scale = 4.21                       every flight
    length_scale = { uniform = [2.0, 10.0] }  each flight its own; or loguniform, linspace

    rules = read_flight_rules(section, place)
    draw = rules.draw(flight=7, count=60, seed=1)    # one number per quantity
    fleet = draw.fleet(stream(1, 7, SIMULATION))     # simulated; equal for equal numbers

Two of U0, L and tau_w = L/U0 give the third (paper Eq. 14). A study that reads its flights says

    files = ["logs/*.csv"]            # relative to the study file, in order of name
    windows = [432000, 864000]        # [s] each log in pieces of so long; without, the whole of it

The flow of a log is unknown: its cases have a status and an estimate, and no error.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from sparsefit.codec import Place, build, number, only, shown
from sparsefit.errors import positive
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.faults import LogFaults
from sparsefit.flight.flow import Cells, CellularFlow, ShapedCells, SuperposedFlow
from sparsefit.flight.record import MINIMUM_SAMPLES, MOST_SAMPLES
from sparsefit.flight.vehicle import PointMassVehicle, turning
from sparsefit.flight.waves import Flow, Turbulence
from sparsefit.logs import read_flight
from sparsefit.logs.files import LARGEST
from sparsefit.study import keys
from sparsefit.study.keys import QUANTITIES, STREAMS, FlightWords, LogRules, Quantity, nearest
from sparsefit.study.schema import POSITIVE, Section, items, names_of, taken
from sparsefit.whole_file import read_whole

MOST_FILES = 1000
SIMULATION = 0
NOISES = ("process_noise", "position_noise", "velocity_noise", "time_jitter", "thrust_noise")
BELIEFS = tuple(name for name in QUANTITIES if name.startswith("believed_"))
KEYS = (*names_of(FlightWords), *QUANTITIES)
RULES = ("uniform", "loguniform", "linspace")


def stream(seed: int, flight: int, index: int) -> np.random.SeedSequence:
    """The random stream number `index` of a flight.

    0 is the simulation's, whose child 100 the faults are drawn from; other flights through its flow
    have those from 200 on, flights that are estimated with it those from 1000 on. Quantities have
    1, 2 ... in their order; alterations of a problem 300, problems that are drawn 301.
    """
    return np.random.SeedSequence(seed, spawn_key=(flight, index))


def _child(seed: np.random.SeedSequence, number: int) -> np.random.SeedSequence:
    return np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, number))


@dataclass(frozen=True, eq=False)
class Draw:
    """One flight to fly: a number per stream name, in SI units (m/s, m, s, m/s², Hz)."""

    values: Mapping[str, float]
    words: FlightWords = FlightWords()
    turbulence_seed: int = 0

    @cached_property
    def flow(self) -> Flow | None:
        """The cells that are sought, without turbulence and wind; None where there are none."""
        values = self.values
        if self.words.flow != "cellular" or "mean_velocity" not in values:
            return None
        speed, scale = values["mean_velocity"], values["length_scale"]
        heading = values.get("heading", 0.0)
        first = self._cells(speed, scale, heading)
        if "second_scale_ratio" not in values:
            return first
        sizes = (speed * values["second_velocity_ratio"], scale * values["second_scale_ratio"])
        return SuperposedFlow((first, self._cells(*sizes, values.get("second_heading", heading))))

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
            size = (self.values["turbulence_length"], self.values.get("turbulence_memory"))
            spectrum = self.words.turbulence_spectrum
            gusts = (Turbulence(intensity, *size, spectrum, self.turbulence_seed),)
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
    def believed(self) -> PointMassVehicle:
        """The vehicle that the estimator is given; the true one, but for what is believed of it."""
        values, vehicle = self.values, self.vehicle
        response = vehicle.response_time * values.get("believed_response_time_ratio", 1.0)
        drag = vehicle.drag * values.get("believed_drag_ratio", 1.0)
        if "believed_response_time" in values:
            response, drag = values["believed_response_time"], 0.0
        push, (x, y) = values.get("believed_thrust_ratio", 1.0), self._pair("thrust")
        if "thrust_turn" in values and self.words.thrust_log == "measured":
            return PointMassVehicle(response, (0.0, 0.0), drag, thrust_scale=push)
        return PointMassVehicle(response, (push * x, push * y), drag)

    def fly(self, seed: np.random.SeedSequence) -> Flight:
        """The simulated flight, with its faults and the vehicle that its pilot believes in."""
        values, thrust = self.values, None
        if "thrust_turn" in values:
            samples = round(values["duration"] * values["sample_rate"]) + 2  # one after the end
            thrust = turning(
                np.arange(samples) / values["sample_rate"],
                self._pair("thrust"),
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
        if self.words.thrust_log == "none":
            flight = replace(flight, thrust=None)
        given: dict[str, Any] = {
            row.fault: round(values[key]) if key in ("jumps", "gaps") else values[key]
            for key, row in QUANTITIES.items()
            if row.fault and key in values
        }
        faults = LogFaults(**given)
        if faults != LogFaults():
            flight = faults.spoil(flight, _child(seed, 100))
        return replace(flight, vehicle=self.believed)

    def fleet(self, seed: np.random.SeedSequence) -> tuple[Flight, ...]:
        """The flights that are estimated together: this one, and others from other places."""
        elsewhere = self._without("position_x", "position_y")
        together = round(self.values.get("together", 1.0))
        beside = (elsewhere.fly(_child(seed, 1000 + n)) for n in range(1, together))
        return (self.fly(seed), *beside)

    def others(self, seed: np.random.SeedSequence, count: int) -> tuple[Flight, ...]:
        """Other flights through the same flow: from other places, without noise or faults."""
        faults = (key for key, row in QUANTITIES.items() if row.fault)
        clean = self._without(*BELIEFS, *faults, *NOISES, "position_x", "position_y")
        flights = (clean.fly(_child(seed, 200 + number)) for number in range(count))
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
class DrawRule:
    """The rule by which a quantity is drawn, "constant" or one of `RULES`, and its numbers."""

    rule: str
    values: tuple[float, ...]

    @classmethod
    def of(cls, value: object, quantity: Quantity, place: Place) -> DrawRule:
        """The rule of a TOML value, with every number in the range of the quantity."""
        rule, listed = "constant", items([value], place)
        if isinstance(value, Mapping):
            only(value, RULES, place)
            if len(value) != 1:
                raise place.error(f"must hold exactly one of {', '.join(RULES)}, not {value}")
            ((rule, pair),) = value.items()
            listed = items(pair, place)
            if len(listed) != 2:
                raise place.error(f"{rule} takes two numbers [a, b], not {len(listed)}")
        elif isinstance(value, list):
            words = "must be a number, or a rule as { uniform = [2.0, 10.0] }"
            raise place.error(f"{words}, not {shown(value)}")
        values = tuple(number(item, place) for item in listed)
        for item in values:
            quantity.range.check(item, place, quantity.unit)
        low, high = values[0], values[-1]
        if rule != "linspace" and low > high:
            raise place.error(f"{rule} range [{low:g}, {high:g}] is empty: write the smaller first")
        if rule == "loguniform":
            POSITIVE.check(low, place, quantity.unit)
        return cls(rule, values)

    def at(self, flight: int, count: int, stream: np.random.SeedSequence) -> float:
        """The value of flight number `flight` of `count`; `stream` decides a random one.

        One uniform number u in [0, 1) is drawn under every rule, so levels of a sweep that
        differ in their range only share it (common random numbers).
        """
        low, high = self.values[0], self.values[-1]
        if self.rule == "constant":
            return low
        if self.rule == "linspace":
            return low + (high - low) * flight / max(count - 1, 1)
        share = float(np.random.default_rng(stream).random())
        if self.rule == "loguniform":
            return math.exp(math.log(low) + share * (math.log(high) - math.log(low)))
        return low + share * (high - low)


@dataclass(frozen=True)
class FlightRules:
    """Rules that draw the flights of a condition: (stream name, rule) pairs, in stream order.

    Where ``words`` name no cells, shares of mean_velocity still refer to it.
    """

    entries: tuple[tuple[str, DrawRule], ...]
    words: FlightWords = FlightWords()

    def draw(self, flight: int, count: int, seed: int) -> Draw:
        """Flight `flight` of `count`: it depends on the seed, its number and these rules only."""
        values = {
            name: entry.at(flight, count, stream(seed, flight, STREAMS.index(name) + 1))
            for name, entry in self.entries
        }
        if values.keys() & set(keys.FLOW_KEYS):  # in still air there is no third
            if "mean_velocity" not in values:
                speed = values["length_scale"] / values["timescale"]
                values["mean_velocity"] = positive("length_scale/timescale", speed, "m/s")
            elif "length_scale" not in values:
                size = values["mean_velocity"] * values["timescale"]
                values["length_scale"] = positive("mean_velocity*timescale", size, "m")
        field = stream(seed, flight, STREAMS.index(keys.TURBULENCE_FIELD) + 1)
        return Draw(values, self.words, int(field.generate_state(1)[0]))


def read_flight_rules(section: Section, place: Place) -> FlightRules:
    """The rules from the [flights] section without `count`; `InputError` names the bad key."""
    for name in section:
        if name not in KEYS:
            raise place.at(name).error(f"unknown{nearest(name, KEYS)}")
    words, given = taken(FlightWords, section, place)
    calm, flow = words.flow == "none", [name for name in keys.FLOW_KEYS if name in given]
    if len(flow) != 2 and not calm:
        have = ", ".join(flow) or "none"
        raise place.error(f"needs exactly two of {', '.join(keys.FLOW_KEYS)}, has {have}")
    needed = {"duration": "every flight", "sample_rate": "every flight"}
    if "drag" not in given:
        needed["response_time"] = "a flight without drag"
    if words.flow == "turbulence":
        needed["turbulence_ratio"] = 'flow = "turbulence"'
    needed |= {other: name for name in given for other in QUANTITIES[name].needs}
    for name, by in needed.items():
        if name not in given:
            raise place.at(name).error(f"missing: {by} needs it")
    noise = "measurement_noise"
    twice = (("wind", "wind_ratio"), (noise, "velocity_noise"), (noise, "position_noise"))
    for name, other in twice:
        if name in given and other in given:
            raise place.at(name).error(f"and {other} say one thing: drop one of them")
    rules: dict[str, DrawRule] = {}
    for name, value in given.items():
        quantity, here = QUANTITIES[name], place.at(name)
        pair = value if len(quantity.streams) == 2 else [value]
        if not isinstance(pair, list) or len(pair) != len(quantity.streams):
            raise here.error("must be a pair [x, y]")
        for stream_name, item in zip(quantity.streams, pair, strict=True):
            rules[stream_name] = DrawRule.of(item, quantity, here)
    samples = max(rules["duration"].values) * max(rules["sample_rate"].values)
    if samples > MOST_SAMPLES:
        many = f"at this sample_rate is {samples:.3g} samples: keep it below {MOST_SAMPLES}"
        raise place.at("duration").error(many)
    # A protocol without a flow cannot remove the keys of the others: they are left out here.
    dropped = {name for row in QUANTITIES.values() if row.of_flow and calm for name in row.streams}
    named = [name for name in STREAMS if name in rules and name not in dropped]
    return FlightRules(tuple((name, rules[name]) for name in named), words)


@dataclass(frozen=True)
class Logged:
    """A piece of a log, in the place of a draw to fly; its flow is not known.

    digest: of the file; start, end: from when to when [s] of its own time; vehicle: in place of the
    one in the file.
    """

    file: str = field(repr=False)  # its digest identifies the content
    digest: str
    start: float
    end: float
    vehicle: PointMassVehicle | None
    flow: ClassVar[None] = None

    @property
    def label(self) -> str:
        """The file's name and the seconds, as a reader would look it up."""
        return f"{Path(self.file).name} {self.start:g}-{self.end:g} s"

    def fleet(self, seed: np.random.SeedSequence) -> tuple[Flight]:
        """The flight as it was logged, alone, its time from 0 on: nothing of it is random."""
        whole = _parsed(self.file, self.digest, self.vehicle)
        piece = whole.rows((whole.time >= self.start) & (whole.time <= self.end))
        return (replace(piece, time=piece.time - self.start),)


@dataclass(frozen=True)
class Logs:
    """The flights of a study that come from files."""

    pieces: tuple[Logged, ...]

    def draw(self, flight: int, count: int, seed: int) -> Logged:
        """Flight number `flight`, of the pieces in order."""
        return self.pieces[flight]


@lru_cache(maxsize=4)  # logs that are kept while their pieces are flown
def _parsed(file: str, digest: str, vehicle: PointMassVehicle | None) -> Flight:
    """The flight of a file of this digest, parsed once for all its pieces."""
    return read_flight(file, vehicle=vehicle)


def read_logs(section: Section, place: Place) -> Logs:
    """The logs of [flights]; `InputError` names the key, the file or the line of a fault."""
    rules, here = build(LogRules, section, place), place.at("files")
    folder, files, vehicle = Path(place.file).parent, list[str](), None
    for pattern in rules.files:
        named = [folder / pattern]
        if set(pattern) & set("*?["):
            named = [] if Path(pattern).is_absolute() else sorted(folder.glob(pattern))
        if not named:
            raise here.error(f'"{pattern}" matches no file beside {Path(place.file).name}')
        files += map(str, named)
    if not 0 < len(files) <= MOST_FILES or len(set(files)) < len(files):
        raise here.error(f"must name 1 to {MOST_FILES} files, each of them once")
    if rules.response_time or rules.drag:
        vehicle = PointMassVehicle(rules.response_time or math.inf, drag=rules.drag or 0.0)
    pieces = tuple(piece for file in files for piece in _pieces(file, vehicle, rules.windows))
    if not pieces:
        raise place.at("windows").error("leaves no flight: each piece is longer than every log")
    return Logs(pieces)


def _pieces(
    file: str, vehicle: PointMassVehicle | None, windows: tuple[float, ...]
) -> Iterator[Logged]:
    """The log whole, or cut into pieces of each length; the rest at its end is not flown."""
    digest = hashlib.sha256(read_whole(file, most=LARGEST)).hexdigest()
    flight = _parsed(file, digest, vehicle)
    first, last = float(flight.time[0]), float(flight.time[-1])
    step = float(np.median(np.diff(flight.time)))
    for window in windows or (last - first,):
        for place in range(int((last - first + step) / window + 1e-9) if windows else 1):
            start = first + place * window
            end = min(start + window - 0.5 * step, last) if windows else last
            inside = (flight.time >= start) & (flight.time <= end)
            if np.count_nonzero(inside) >= MINIMUM_SAMPLES:
                yield Logged(file, digest, start, end, vehicle)
