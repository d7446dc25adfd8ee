"""A flight as a file holds it: five named columns and a few named numbers."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

import numpy as np

from sparsefit.errors import InputError
from sparsefit.flight.flow import CellularFlow, Flow, SuperposedFlow
from sparsefit.flight.record import Flight
from sparsefit.flight.vehicle import PointMassVehicle

COLUMNS = ("time", "x", "y", "vx", "vy")  # s, m, m, m/s, m/s
KEYS = ("response_time", "thrust_ax", "thrust_ay", "mean_velocity", "length_scale")
WIND = ("wind_x", "wind_y")

_FLOW_KEY = re.compile(r"(?:mean_velocity|length_scale)(_[1-9]\d{0,3})?")


@dataclass(frozen=True)
class FlightTable:
    """The columns of a flight by name, and its vehicle and flow as ``settings`` (see `KEYS`).

    The parameters of superposed flows are numbered: ``mean_velocity_1``, ``length_scale_1``, ...;
    a steady wind is ``wind_x``, ``wind_y``.
    """

    columns: dict[str, list[float]]
    settings: dict[str, float]

    @classmethod
    def from_flight(cls, flight: Flight) -> FlightTable:
        """Return the table of ``flight``; `flight` gives it back exactly."""
        values = np.column_stack([flight.time, flight.position, flight.velocity])
        columns = {name: values[:, place].tolist() for place, name in enumerate(COLUMNS)}
        ax, ay = flight.vehicle.thrust_acceleration
        vehicle = {"response_time": flight.vehicle.response_time, "thrust_ax": ax, "thrust_ay": ay}
        return cls(columns, vehicle | _flow_settings(flight.flow))

    def flight(self, vehicle: PointMassVehicle | None = None) -> Flight:
        """Return the flight; a ``vehicle`` given here replaces the one in the settings.

        Raises:
            InputError: if there is no vehicle, or the flight is not a valid one.
        """
        return Flight(
            time=np.array(self.columns["time"]),
            position=np.column_stack([self.columns["x"], self.columns["y"]]),
            velocity=np.column_stack([self.columns["vx"], self.columns["vy"]]),
            vehicle=vehicle_of(self.settings) if vehicle is None else vehicle,
            flow=_flow(self.settings),
        )


def is_key(name: str) -> bool:
    """Tell whether ``name`` is a setting a flight file may hold."""
    return name in (*KEYS, *WIND) or _FLOW_KEY.fullmatch(name) is not None


def check_header(names: list[str]) -> None:
    """Raise `InputError` where one of `COLUMNS` is missing or stands twice.

    Other columns are welcome.
    """
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        present = ascii(", ".join(names)[:200])[1:-1] or "nothing"
        raise InputError(f"no column {', '.join(missing)}; found {present}; rename or add it")
    twice = [name for name in COLUMNS if names.count(name) > 1]
    if twice:
        raise InputError(f"column {', '.join(twice)} appears more than once; keep one of each")


def number(text: str, place: str) -> float:
    """Return the finite number that ``text`` is; ``1_000`` and ``nan`` are none in a log.

    Raises:
        InputError: naming ``place``, the line and column, where it is no number.
    """
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        shown = ascii(text.strip()[:40])
        raise InputError(f"{place}: {shown} is not a finite number; repair or drop it")
    return value


def _flow_settings(flow: Flow | None) -> dict[str, float]:
    """A flow of cells along the axes, with a wind or none; no other flow has a place in a file."""
    settings: dict[str, float] = {}
    parts = flow.components if isinstance(flow, SuperposedFlow) else (flow,)
    for count, part in enumerate(parts, start=1):
        if not isinstance(part, CellularFlow):
            return {}
        ending = f"_{count}" if isinstance(flow, SuperposedFlow) else ""
        settings[f"mean_velocity{ending}"] = part.mean_velocity
        settings[f"length_scale{ending}"] = part.length_scale
    if isinstance(flow, SuperposedFlow) and any(flow.wind):
        settings |= dict(zip(WIND, flow.wind, strict=True))
    return settings


def vehicle_of(settings: dict[str, float]) -> PointMassVehicle:
    """Return the vehicle that the settings name; its thrust is 0 where they do not say.

    Raises:
        InputError: if they name no response time, or a value is out of its range.
    """
    if "response_time" not in settings:
        raise InputError(
            "no vehicle: the file has no `# response_time=` line; add it or pass vehicle="
        )
    thrust = (settings.get("thrust_ax", 0.0), settings.get("thrust_ay", 0.0))
    return PointMassVehicle(settings["response_time"], thrust)


def _flow(settings: dict[str, float]) -> Flow | None:
    matches = (_FLOW_KEY.fullmatch(key) for key in settings)
    endings = {match.group(1) or "" for match in matches if match}
    wind = (settings.get(WIND[0], 0.0), settings.get(WIND[1], 0.0))
    if not endings:
        return SuperposedFlow((), wind) if any(wind) else None
    if endings == {""} and any(wind):
        return SuperposedFlow((_component(settings, ""),), wind)
    if endings == {""}:
        return _component(settings, "")
    numbered = [f"_{count}" for count in range(1, len(endings) + 1)]
    if endings != set(numbered):
        raise InputError(
            "the flow must be one mean_velocity and length_scale, or pairs numbered "
            "_1, _2, ... without a gap; rename them"
        )
    return SuperposedFlow(tuple(_component(settings, ending) for ending in numbered), wind)


def _component(settings: dict[str, float], ending: str) -> CellularFlow:
    speed, scale = f"mean_velocity{ending}", f"length_scale{ending}"
    for needed, present in ((speed, scale), (scale, speed)):
        if needed not in settings:
            raise InputError(f"{present} is given without {needed}; add it or drop both")
    return CellularFlow(settings[speed], settings[scale])
