"""A flight as a file holds it: three to seven named columns and a few named numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, told_with
from sparsefit.flight.record import FRAMES, Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.logs.anchor import Anchor
from sparsefit.logs.flow_settings import flow_of_settings, is_flow_key, settings_of_flow

POSITIONS = ("time", "x", "y")  # s, m, m: all that some logs hold
VELOCITY = ("vx", "vy")  # m/s
COLUMNS = (*POSITIONS, *VELOCITY)
THRUST = ("ax", "ay")  # m/s^2, measured; in some logs
KEYS = (
    *("response_time", "thrust_ax", "thrust_ay", "drag", "thrust_scale"),
    *("mean_velocity", "length_scale"),
)


@dataclass(frozen=True)
class FlightTable:
    """The columns (m,) of a flight by name, and its vehicle and flow as ``settings`` (see `KEYS`).

    The parameters of superposed flows are numbered: ``mean_velocity_1``, ``length_scale_1``, ...;
    a steady wind is ``wind_x``, ``wind_y``.

    frame: what the axes are, a key of `FRAMES`; notes: how a foreign log was read, in words;
    anchor: where and when its zeros are, as far as it tells.
    """

    columns: dict[str, Array]
    settings: dict[str, float]
    frame: str = ""
    notes: tuple[str, ...] = ()
    anchor: Anchor = Anchor()

    @classmethod
    def from_flight(cls, flight: Flight) -> FlightTable:
        """Return the table of ``flight``; `flight` gives it back exactly."""
        values = np.column_stack([flight.time, flight.position, flight.velocity])
        names = COLUMNS if flight.velocity_measured else POSITIONS
        columns = {name: values[:, place] for place, name in enumerate(names)}
        if flight.thrust is not None:
            columns |= dict(zip(THRUST, flight.thrust.T, strict=True))
        settings = _settings_of(flight.vehicle) | settings_of_flow(flight.flow)
        return cls(columns, settings, flight.frame)

    def flight(self, vehicle: PointMassVehicle | None = None) -> Flight:
        """Return the flight; a ``vehicle`` given here replaces the one in the settings.

        Raises:
            InputError: if there is no vehicle, or the flight is not a valid one.
        """
        time = self.columns["time"]
        position = np.column_stack([self.columns["x"], self.columns["y"]])
        flown = vehicle_of(self.settings) if vehicle is None else vehicle
        flow = flow_of_settings(self.settings)
        measured = THRUST[0] in self.columns
        thrust = np.column_stack([self.columns[name] for name in THRUST]) if measured else None
        if "vx" not in self.columns:
            return Flight.from_positions(time, position, flown, flow, thrust, self.frame)
        velocity = np.column_stack([self.columns["vx"], self.columns["vy"]])
        return Flight(time, position, velocity, flown, flow, True, thrust, self.frame)

    def since(self, epoch: datetime | None) -> FlightTable:
        """Return the same rows by a clock that is 0 at ``epoch``, where the log tells its own."""
        own = self.anchor.epoch
        if epoch is None or own is None or epoch == own:
            return self
        late = (own - epoch).total_seconds()
        columns = self.columns | {"time": late + self.columns["time"]}
        return replace(self, columns=columns, anchor=replace(self.anchor, epoch=epoch))

    def between(self, start: float | None, end: float | None) -> FlightTable:
        """Return the rows from one time of the log to another [s]; None is its own end.

        Raises:
            InputError: where no row is between them.
        """
        if start is None and end is None:
            return self
        time = self.columns["time"]
        low, high = -math.inf if start is None else start, math.inf if end is None else end
        kept = np.flatnonzero((time >= low) & (time <= high))
        if not len(kept):
            ends = f"{time.min():g} … {time.max():g} s" if len(time) else "nothing"
            raise InputError(f"no sample from {low:g} s to {high:g} s; the log has {ends}")
        columns = {name: values[kept] for name, values in self.columns.items()}
        return replace(self, columns=columns)


def is_key(name: str) -> bool:
    """Tell whether ``name`` is a setting a flight file may hold."""
    return name in KEYS or is_flow_key(name)


def finite_in(text: str) -> float:
    """Return the finite number that ``text`` is, else NaN; ``1_000`` is none in a log."""
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan
    return value if math.isfinite(value) else math.nan


def number(text: str, place: str, more: str = "") -> float:
    """Return the finite number that ``text`` is, as `finite_in`.

    Raises:
        InputError: naming ``place``, the line and column, and what is ``more`` to mend, where it is
            no number.
    """
    value = finite_in(text)
    if math.isnan(value):
        shown = ascii(text.strip()[:40])
        raise InputError(f"{place}: {shown} is not a finite number; repair or drop it{more}")
    return value


def frame_of(text: str, place: str) -> str:
    """Return the frame that ``text`` names.

    Raises:
        InputError: naming ``place``, where it is none.
    """
    with told_with(place):
        one_of("frame", text.strip(), filter(None, FRAMES))
    return text.strip()


def vehicle_of(settings: dict[str, float]) -> PointMassVehicle:
    """Return the vehicle that the settings name; its thrust is 0 where they do not say.

    With quadratic drag and no response time it has no other drag.

    Raises:
        InputError: if they name neither a response time nor drag, or a value is out of its range.
    """
    drag = settings.get("drag", 0.0)
    if "response_time" not in settings and not drag:
        raise InputError(
            "no vehicle: the file has no `# response_time=` line; add it or pass vehicle="
        )
    thrust = (settings.get("thrust_ax", 0.0), settings.get("thrust_ay", 0.0))
    response = settings.get("response_time", math.inf)
    return PointMassVehicle(response, thrust, drag, settings.get("thrust_scale", 1.0))


def _settings_of(vehicle: PointMassVehicle) -> dict[str, float]:
    """The settings of a vehicle; without a response time where its drag is quadratic only."""
    ax, ay = vehicle.thrust_acceleration
    linear = {"response_time": vehicle.response_time} if vehicle.rate else {}
    settings = linear | {"thrust_ax": ax, "thrust_ay": ay}
    if vehicle.drag:
        settings["drag"] = vehicle.drag
    if vehicle.thrust_scale != 1.0:
        settings["thrust_scale"] = vehicle.thrust_scale
    return settings
