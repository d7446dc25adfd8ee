"""The [flights] section: a rule for every quantity of a flight, and the draw of one flight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sparsefit.flight import Flight, simulate_flight
from sparsefit.flow import CellularFlow
from sparsefit.study.document import Place, Table, only, suggestion, text
from sparsefit.study.entry import Entry, read_entry
from sparsefit.vehicle import PointMassVehicle

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
)
FLOWS = ("cellular", "none")  # none: still air, in which any flow found is a false alarm
FLOW_KEYS = ("mean_velocity", "length_scale", "timescale")
NOISE_KEYS = ("process_noise", "position_noise", "velocity_noise")
KEYS = (
    "flow",
    *FLOW_KEYS,
    "response_time",
    "thrust_acceleration",
    "duration",
    "sample_rate",
    *NOISE_KEYS,
    "initial_position",
    "initial_velocity",
)
REQUIRED = ("response_time", "duration", "sample_rate")


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

    flow: CellularFlow | None
    vehicle: PointMassVehicle
    duration: float
    sample_rate: float
    initial_position: tuple[float, float] | None
    initial_velocity: tuple[float, float]
    process_noise: float
    position_noise: float
    velocity_noise: float

    @classmethod
    def from_values(cls, values: dict[str, float]) -> Draw:
        """From one number per stream name; what is not named takes its default."""
        thrust = (values.get("thrust_x", 0.0), values.get("thrust_y", 0.0))
        position = (values["position_x"], values["position_y"]) if "position_x" in values else None
        here = "mean_velocity" in values
        flow = CellularFlow(values["mean_velocity"], values["length_scale"]) if here else None
        return cls(
            flow=flow,
            vehicle=PointMassVehicle(values["response_time"], thrust),
            duration=values["duration"],
            sample_rate=values["sample_rate"],
            initial_position=position,
            initial_velocity=(values.get("velocity_x", 0.0), values.get("velocity_y", 0.0)),
            process_noise=values.get("process_noise", 0.0),
            position_noise=values.get("position_noise", 0.0),
            velocity_noise=values.get("velocity_noise", 0.0),
        )

    def fly(self, seed: np.random.SeedSequence) -> Flight:
        """The simulated flight."""
        return simulate_flight(
            self.flow,
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


def read_flight_rules(section: Table, place: Place) -> FlightRules:
    """The rules from the [flights] table without `count`; `InputError` names the bad key."""
    only(section, KEYS, place)
    calm = _flow_kind(section, place) == "none"
    given = [key for key in FLOW_KEYS if key in section]
    if len(given) != 2 and not calm:
        have = ", ".join(given) or "none"
        raise place.error(f"needs exactly two of {', '.join(FLOW_KEYS)}, has {have}")
    for key in REQUIRED:
        if key not in section:
            raise place.at(key).error("missing: every flight needs it")
    if not calm:
        _check_third(section, place)
    # A protocol without a flow cannot remove the keys of the others': they are left out here.
    kept = [key for key in section if key != "flow" and not (calm and key in FLOW_KEYS)]
    named = {name: entry for key in kept for name, entry in _entries(key, section[key], place)}
    return FlightRules(tuple((name, named[name]) for name in STREAMS if name in named))


def _flow_kind(section: Table, place: Place) -> str:
    kind = text(section.get("flow", "cellular"), place.at("flow"))
    if kind not in FLOWS:
        raise place.at("flow").error(f'has unknown value "{kind}"{suggestion(kind, FLOWS)}')
    return kind


def _check_third(section: Table, place: Place) -> None:
    """U0 = L/tau_w and L = U0 tau_w must be finite and above 0 at all extremes of what is drawn."""
    one, other = (
        read_entry(section[key], place.at(key), least=0.0, open_end=True).values
        for key in FLOW_KEYS
        if key in section
    )
    for first in (min(one), max(one)):
        for second in (min(other), max(other)):
            for third in (first * second, first / second):
                if not 1e-150 < third < 1e150:
                    raise place.error(f"{first:g} and {second:g} give no flow that can be flown")


def _entries(key: str, value: object, place: Place) -> list[tuple[str, Entry]]:
    here = place.at(key)
    if key in ("thrust_acceleration", "initial_position", "initial_velocity"):
        stem = key.removeprefix("initial_").removesuffix("_acceleration")
        return list(zip((f"{stem}_x", f"{stem}_y"), _pair(value, here), strict=True))
    noise = key in NOISE_KEYS
    return [(key, read_entry(value, here, least=0.0, open_end=not noise))]


def _pair(value: object, place: Place) -> list[Entry]:
    if not isinstance(value, list) or len(value) != 2:
        raise place.error("must be a pair [x, y]")
    return [read_entry(item, place, least=None, open_end=False) for item in value]
