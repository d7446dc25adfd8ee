"""The [flights] section: a rule for every quantity of a flight, and the draw of one flight."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from sparsefit.codec import Place, only
from sparsefit.errors import suggestion
from sparsefit.flight import Flight, simulate_flight
from sparsefit.flight.flow import CellularFlow, Flow, SuperposedFlow
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.study.spec.document import Section, text
from sparsefit.study.spec.entry import Entry, read_entry

# Every random quantity has its own stream: adding one at the end changes no other's draws.
SIMULATION = 0
STREAMS = (
    "mean_velocity",
    "length_scale",
    "timescale",
    "response_time",
    "thrust_x",
    "thrust_y",
    "position_x",
    "position_y",
    "velocity_x",
    "velocity_y",
    "duration",
    "sample_rate",
    "process_noise",
    "position_noise",
    "velocity_noise",
    "wind_x",
    "wind_y",
    "second_scale_ratio",
    "second_velocity_ratio",
    "third_scale_ratio",
    "third_velocity_ratio",
    "believed_response_time_ratio",
    "believed_thrust_ratio",
)
FLOWS = ("cellular", "none")  # none: still air, in which any flow found is a false alarm
FLOW_KEYS = ("mean_velocity", "length_scale", "timescale")
# Believed over true: what the estimator is told of the vehicle.
RATIO_KEYS = ("believed_response_time_ratio", "believed_thrust_ratio")
NOISE_KEYS = ("process_noise", "position_noise", "velocity_noise")
SUPERPOSED = (
    ("second_scale_ratio", "second_velocity_ratio"),
    ("third_scale_ratio", "third_velocity_ratio"),
)
SUPERPOSED_KEYS = tuple(key for pair in SUPERPOSED for key in pair)
RATIOS = (0.01, 100.0)
REQUIRED = ("response_time", "duration", "sample_rate")


@dataclass(frozen=True)
class Quantity:
    """A key of [flights]: the streams it fills (two: a pair [x, y]) and the least it may be."""

    streams: tuple[str, ...]
    least: float | None = None
    open_end: bool = False  # the least itself is not allowed


QUANTITIES = {
    **{
        key: Quantity((key,), 0.0, open_end=True)
        for key in (*FLOW_KEYS, *REQUIRED, *SUPERPOSED_KEYS, "believed_response_time_ratio")
    },
    **{key: Quantity((key,), 0.0) for key in (*NOISE_KEYS, "believed_thrust_ratio")},
    "thrust_acceleration": Quantity(("thrust_x", "thrust_y")),
    "initial_position": Quantity(("position_x", "position_y")),
    "initial_velocity": Quantity(("velocity_x", "velocity_y")),
    "wind": Quantity(("wind_x", "wind_y")),
    "measurement_noise": Quantity(("velocity_noise", "position_noise"), 0.0),
}
KEYS = ("flow", *QUANTITIES)


@dataclass(frozen=True)
class FlightRules:
    """How the flights of one variant are drawn: (stream name, entry) pairs, in stream order."""

    entries: tuple[tuple[str, Entry], ...]

    def draw(self, flight: int, count: int, seed: int) -> Draw:
        """Flight `flight` of `count`: depends on the seed, its index and these rules only."""
        values = {
            name: entry.at(flight, count, stream(seed, flight, STREAMS.index(name) + 1))
            for name, entry in self.entries
        }
        return Draw.from_values(_third(values))


def stream(seed: int, flight: int, index: int) -> np.random.SeedSequence:
    """The random stream `index` of one flight."""
    return np.random.SeedSequence(seed, spawn_key=(flight, index))


def _third(values: dict[str, float]) -> dict[str, float]:
    """Two of U0, L and tau_w = L/U0 give the third (paper Eq. 14); in still air there is none."""
    if not values.keys() & set(FLOW_KEYS):
        return values
    if "mean_velocity" not in values:
        return values | {"mean_velocity": values["length_scale"] / values["timescale"]}
    if "length_scale" not in values:
        return values | {"length_scale": values["mean_velocity"] * values["timescale"]}
    return values


@dataclass(frozen=True)
class Draw:
    """One flight to fly: SI units (m/s, m, s, m/s^2, Hz); flow None: still air."""

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

    @classmethod
    def from_values(cls, values: dict[str, float]) -> Draw:
        """From one number per stream name; what is not named takes its default."""
        thrust = (values.get("thrust_x", 0.0), values.get("thrust_y", 0.0))
        position = (values["position_x"], values["position_y"]) if "position_x" in values else None
        return cls(
            flow=_flow(values) if "mean_velocity" in values else None,
            vehicle=PointMassVehicle(values["response_time"], thrust),
            duration=values["duration"],
            sample_rate=values["sample_rate"],
            initial_position=position,
            initial_velocity=(values.get("velocity_x", 0.0), values.get("velocity_y", 0.0)),
            process_noise=values.get("process_noise", 0.0),
            position_noise=values.get("position_noise", 0.0),
            velocity_noise=values.get("velocity_noise", 0.0),
            wind=(values.get("wind_x", 0.0), values.get("wind_y", 0.0)),
            believed=_believed(values, thrust),
        )

    @property
    def flown(self) -> Flow | None:
        """The flow with its wind; `flow` alone is what is sought."""
        parts = self.flow.cells if self.flow else ()
        return SuperposedFlow(parts, self.wind) if any(self.wind) else self.flow

    def fly(self, seed: np.random.SeedSequence) -> Flight:
        """The simulated flight, with the vehicle that its pilot believes in."""
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
        )
        return flight if self.believed is None else replace(flight, vehicle=self.believed)


def _believed(values: dict[str, float], thrust: tuple[float, float]) -> PointMassVehicle | None:
    if not any(key in values for key in RATIO_KEYS):
        return None
    response, push = (values.get(key, 1.0) for key in RATIO_KEYS)
    x, y = thrust
    return PointMassVehicle(response * values["response_time"], (push * x, push * y))


def _flow(values: dict[str, float]) -> Flow:
    """The first cellular flow, (U0, L), and those of its multiples that are asked for."""
    speed, scale = values["mean_velocity"], values["length_scale"]
    first = CellularFlow(speed, scale)
    more = (
        CellularFlow(speed * values[velocity_ratio], scale * values[scale_ratio])
        for scale_ratio, velocity_ratio in SUPERPOSED
        if scale_ratio in values
    )
    parts = (first, *more)
    return SuperposedFlow(parts) if len(parts) > 1 else first


def read_flight_rules(section: Section, place: Place) -> FlightRules:
    """The rules from the [flights] section without `count`; `InputError` names the bad key."""
    only(section, KEYS, place)
    calm = _flow_kind(section, place) == "none"
    _check_keys(section, place, calm=calm)
    entries = {
        name: entry
        for key, value in section.items()
        if key != "flow"
        for name, entry in _entries(QUANTITIES[key], value, place.at(key))
    }
    _check_superposed(entries, place)
    # A protocol without a flow cannot remove the keys of the others': they are left out here.
    left_out = (*FLOW_KEYS, *SUPERPOSED_KEYS) if calm else ()
    if not calm:
        _check_third(entries, place)
    kept = [name for name in STREAMS if name in entries and name not in left_out]
    return FlightRules(tuple((name, entries[name]) for name in kept))


def _flow_kind(section: Section, place: Place) -> str:
    kind = text(section.get("flow", "cellular"), place.at("flow"))
    if kind not in FLOWS:
        raise place.at("flow").error(f'has unknown value "{kind}"{suggestion(kind, FLOWS)}')
    return kind


def _check_keys(section: Section, place: Place, *, calm: bool) -> None:
    given = [key for key in FLOW_KEYS if key in section]
    if len(given) != 2 and not calm:
        have = ", ".join(given) or "none"
        raise place.error(f"needs exactly two of {', '.join(FLOW_KEYS)}, has {have}")
    for key in REQUIRED:
        if key not in section:
            raise place.at(key).error("missing: every flight needs it")
    if "measurement_noise" in section and {"velocity_noise", "position_noise"} & set(section):
        raise place.at("measurement_noise").error(
            "is [velocity_noise, position_noise]: drop those two"
        )


def _entries(quantity: Quantity, value: object, place: Place) -> Iterator[tuple[str, Entry]]:
    values = [value] if len(quantity.streams) == 1 else _pair(value, place)
    for name, item in zip(quantity.streams, values, strict=True):
        yield name, read_entry(item, place, least=quantity.least, open_end=quantity.open_end)


def _pair(value: object, place: Place) -> list[object]:
    if not isinstance(value, list) or len(value) != 2:
        raise place.error("must be a pair [x, y]")
    return value


def _check_third(entries: Mapping[str, Entry], place: Place) -> None:
    """U0 = L/tau_w and L = U0 tau_w must be finite and above 0 at all extremes of what is drawn."""
    one, other = (entries[key].values for key in FLOW_KEYS if key in entries)
    for first in (min(one), max(one)):
        for second in (min(other), max(other)):
            for third in (first * second, first / second):
                if not 1e-150 < third < 1e150:
                    raise place.error(f"{first:g} and {second:g} give no flow that can be flown")


def _check_superposed(entries: Mapping[str, Entry], place: Place) -> None:
    """A flow beside the first needs both its ratios, the third a second; each within RATIOS."""
    given = [key for key in SUPERPOSED_KEYS if key in entries]
    needed = SUPERPOSED_KEYS if set(given) & set(SUPERPOSED[1]) else SUPERPOSED[0]
    low, high = RATIOS
    for key in needed if given else ():
        if key not in entries:
            raise place.at(key).error(f"missing: {given[0]} needs it too")
        if not low <= min(entries[key].values) <= max(entries[key].values) <= high:
            raise place.at(key).error(f"must lie between {low:g} and {high:g}")
