"""A flight as a file holds it: columns in SI units, and numbers by key.

The numbers are the parameters of the vehicle and, of a flight through the paper's cells whose truth
is known, ``mean_velocity`` and ``length_scale``. The axes are ``frame``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, told_with, unknown
from sparsefit.flight.flow import CellularFlow
from sparsefit.flight.record import FRAMES, Flight
from sparsefit.flight.vehicle import PointMassVehicle

POSITIONS = ("time", "x", "y")  # s, m, m: all that some logs hold
PAIRS = (VELOCITY, PUSH) = (("vx", "vy"), ("ax", "ay"))  # m/s; m/s^2, what the propulsion pushed
COLUMNS = (*POSITIONS, *VELOCITY, *PUSH)
CELLS = ("mean_velocity", "length_scale")
VEHICLE = {  # the keys of a vehicle, and what holds where one is not given
    "response_time": math.inf, "drag": 0.0, "thrust_ax": 0.0, "thrust_ay": 0.0, "thrust_scale": 1.0
}  # fmt: skip
KEYS = (*VEHICLE, *CELLS, "frame")
Settings: TypeAlias = tuple[Mapping[str, float], str]
"""The numbers by key, and the frame."""


@dataclass(frozen=True)
class FlightTable:
    """The columns of a flight, and the settings of its file."""

    columns: dict[str, Array]  # `COLUMNS` by name, (m,) each, in SI units
    settings: Mapping[str, float] = field(default_factory=dict)  # the numbers by key
    frame: str = ""  # the axes, a key of `FRAMES`
    notes: tuple[str, ...] = ()  # how the file was read, in words
    origin: tuple[float, float] | None = None  # of x = y = 0, longitude and latitude [degrees]
    epoch: datetime | None = None  # the time of t = 0, if known

    @classmethod
    def from_flight(cls, flight: Flight) -> FlightTable:
        """Return the table of ``flight``; `flight` gives it back, but for flows of other kinds."""
        names = COLUMNS[:5] if flight.velocity_measured else POSITIONS
        values = (flight.time, *flight.position.T, *flight.velocity.T)
        columns = dict(zip(names, values, strict=False))
        if flight.thrust is not None:
            columns |= dict(zip(PUSH, flight.thrust.T, strict=True))
        given = dict(zip(VEHICLE, flight.vehicle.parameters, strict=True))
        always = ("thrust_ax", "thrust_ay")
        settings = {key: v for key, v in given.items() if key in always or v != VEHICLE[key]}
        if isinstance(flight.flow, CellularFlow):
            settings |= {name: getattr(flight.flow, name) for name in CELLS}
        return cls(columns, settings, flight.frame)

    def flight(self, vehicle: PointMassVehicle | None = None) -> Flight:
        """Return the flight; a ``vehicle`` given here replaces the one in the settings.

        Raises:
            InputError: if there is no vehicle, half a flow, or the flight is not a valid one.
        """
        lacking = [name for name in CELLS if name not in self.settings]
        if len(lacking) == 1:
            raise InputError(f"the flow has no {lacking[0]}; add it, or drop the other")
        flow = None if lacking else CellularFlow(*(self.settings[name] for name in CELLS))
        pairs = {
            names[0]: np.column_stack([self.columns[name] for name in names])
            for names in (("x", "y"), *PAIRS)
            if names[0] in self.columns
        }
        x, v = pairs["x"], pairs.get("vx")
        time, speed, measured = self.columns["time"], x if v is None else v, v is not None
        flown = vehicle_of(self.settings) if vehicle is None else vehicle
        return Flight(time, x, speed, flown, flow, measured, pairs.get("ax"), self.frame)

    def texts(self) -> dict[str, str]:
        """Return the settings and the frame as `settings_of` reads them exactly."""
        texts = {name: repr(float(value)) for name, value in self.settings.items()}
        return texts | ({"frame": self.frame} if self.frame else {})


def settings_of(entries: Iterable[tuple[str, str, str]], *, strict: bool) -> Settings:
    """Return the settings in a file, from entries (place, key, text).

    strict: whether unknown keys are refused, or ignored.

    Raises:
        InputError: naming the place, for a key that is unknown or given twice and for a value that
            is not of its kind.
    """
    settings, frame = dict[str, float](), ""
    for place, key, text in entries:
        if key in settings or (key == "frame" and frame):
            raise InputError(f"{place}: {key} is given twice; keep one")
        if key == "frame":
            frame = text.strip()
            with told_with(place):
                one_of("frame", frame, filter(None, FRAMES))
        elif key in KEYS:
            settings[key] = number(text, f"{place}, {key}")
        elif strict:
            raise InputError(f"{place}: {unknown('key', key, KEYS)}")
    return settings, frame


def vehicle_of(settings: Mapping[str, float]) -> PointMassVehicle:
    """Return the vehicle that settings name; with quadratic drag alone it has no other drag.

    Raises:
        InputError: if they name neither a response time nor drag, or a value is out of its range.
    """
    tau, quadratic, ax, ay, scale = (settings.get(key, least) for key, least in VEHICLE.items())
    if tau == math.inf and not quadratic:
        remedy = "add `# response_time=` to a CSV file, or give it (vehicle=, --response-time, "
        raise InputError(f"no vehicle: no response time; {remedy}--unknown response_time)")
    return PointMassVehicle(tau, (ax, ay), quadratic, scale)


def number(text: str, place: str) -> float:
    """Return the finite number in ``text``; ``1_000`` is refused.

    Raises:
        InputError: naming ``place``, the line and column, if it is not a finite number.
    """
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        cell = ascii(text.strip()[:40])
        raise InputError(f"{place}: {cell} is not a finite number; repair or drop it")
    return value
