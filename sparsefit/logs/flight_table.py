"""A flight as a file holds it: columns in SI units, settings as texts by key, and its zeros.

The parameters of the vehicle are numbers. The paper's cells are ``mean_velocity`` and
``length_scale``, as a person types them; any other flow is one ``flow`` entry, a JSON object of its
``kind`` and the fields of its record. The axes are ``frame``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Any

import numpy as np

from sparsefit.arrays import Array
from sparsefit.codec import Place, build, finite_or_none, mapping, shown
from sparsefit.errors import InputError, one_of, suggestion, told_with, unknown
from sparsefit.flight.flow import CellularFlow, ShapedCells, SuperposedFlow
from sparsefit.flight.record import FRAMES, Flight
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import Flow, Turbulence, WaveFlow

POSITIONS = ("time", "x", "y")  # s, m, m: all that some logs hold
VELOCITY = ("vx", "vy")  # m/s
COLUMNS = (*POSITIONS, *VELOCITY)
PUSH = ("ax", "ay")  # m/s^2, of the propulsion, measured; in some logs
CELLS = ("mean_velocity", "length_scale")
VEHICLE = {  # the keys of a vehicle, and what holds where one is not given
    "response_time": math.inf, "thrust_ax": 0.0, "thrust_ay": 0.0, "drag": 0.0, "thrust_scale": 1.0
}  # fmt: skip
KEYS = (*VEHICLE, *CELLS, "flow", "frame")
KINDS: dict[str, type[Any]] = {
    "cells": CellularFlow,
    "shaped-cells": ShapedCells,
    Turbulence.__name__.lower(): Turbulence,
    "waves": WaveFlow,
    "sum": SuperposedFlow,
}


@dataclass(frozen=True)
class FlightTable:
    """The columns of a flight, and what its file says beside them.

    Args:
        columns: `COLUMNS` and `PUSH` by name, (m,) each, in SI units.
        settings: the parameters of the vehicle by name, which may be missing.
        flow: the true flow, where it is known.
        frame: the axes, a key of `FRAMES`.
        notes: how a foreign log was read, in words.
        origin: longitude and latitude of x = y = 0 [degrees], as far as the log says.
        epoch: the time of t = 0, likewise.
    """

    columns: dict[str, Array]
    settings: Mapping[str, float] = field(default_factory=dict)
    flow: Flow | None = None
    frame: str = ""
    notes: tuple[str, ...] = ()
    origin: tuple[float, float] | None = None
    epoch: datetime | None = None

    @classmethod
    def from_flight(cls, flight: Flight) -> FlightTable:
        """Return the table of ``flight``; `flight` gives it back exactly."""
        values = np.column_stack([flight.time, flight.position, flight.velocity])
        names = COLUMNS if flight.velocity_measured else POSITIONS
        columns = {name: values[:, place] for place, name in enumerate(names)}
        if flight.thrust is not None:
            columns |= dict(zip(PUSH, flight.thrust.T, strict=True))
        tau, quadratic, ax, ay, scale = flight.vehicle.parameters
        given = dict(zip(VEHICLE, (tau, ax, ay, quadratic, scale), strict=True))
        always = ("thrust_ax", "thrust_ay")
        settings = {key: v for key, v in given.items() if key in always or v != VEHICLE[key]}
        flow = flight.flow if isinstance(flight.flow, Flow) else None
        return cls(columns, settings, flow, flight.frame)

    def flight(self, vehicle: PointMassVehicle | None = None) -> Flight:
        """Return the flight; a ``vehicle`` given here replaces the one in the settings.

        Raises:
            InputError: if there is no vehicle, or the flight is not a valid one.
        """
        position, velocity, push = (
            np.column_stack([self.columns[name] for name in names])
            if names[0] in self.columns
            else None
            for names in (("x", "y"), VELOCITY, PUSH)
        )
        assert position is not None
        flown = vehicle_of(self.settings) if vehicle is None else vehicle
        speed, measured = (position, False) if velocity is None else (velocity, True)
        time = self.columns["time"]
        return Flight(time, position, speed, flown, self.flow, measured, push, self.frame)

    def texts(self) -> dict[str, str]:
        """Return the settings as `said` reads them exactly; a flow of a user's own has none."""
        texts = {name: repr(value) for name, value in self.settings.items()}
        if isinstance(self.flow, CellularFlow):
            texts |= {name: repr(getattr(self.flow, name)) for name in CELLS}
        elif record := self.flow and _record(self.flow):
            line = json.dumps(finite_or_none(record))
            texts |= {"flow": line} if len(line) <= 60_000 else {}  # a line of CSV is 65,536 bytes
        return texts | ({"frame": self.frame} if self.frame else {})


def said(entries: Iterable[tuple[str, str, str]], *, strict: bool) -> dict[str, Any]:
    """Return the settings, flow and frame of a `FlightTable` by a file's (place, key, text).

    strict: unknown keys are refused, and not passed over.

    Raises:
        InputError: naming the place, on a key that is unknown or stands twice and on a value
            that is none of its kind.
    """
    texts: dict[str, tuple[str, str]] = {}
    for place, key, text in entries:
        if key in texts:
            raise InputError(f"{place}: {key} is given twice; keep one")
        if key in KEYS:
            texts[key] = place, text.strip()
        elif strict:
            raise InputError(f"{place}: {unknown('key', key, KEYS)}")
    numbers = {
        key: number(text, f"{place}, {key}")
        for key, (place, text) in texts.items()
        if key in VEHICLE or key in CELLS
    }
    flow: Flow | None = None
    if "flow" in texts:
        where = Place(texts["flow"][0], "", "flow")
        try:
            flow = _flow_of(json.loads(texts["flow"][1]), where)
        except (json.JSONDecodeError, RecursionError):
            raise where.error("is no JSON object of a flow; repair or drop it") from None
    place, frame = texts.get("frame", ("", ""))
    with told_with(place):
        one_of("frame", frame, FRAMES if not place else filter(None, FRAMES))
    cells = [numbers.pop(name) for name in CELLS if name in numbers]
    if len(cells) == 1:
        alone, other = sorted(CELLS, key=lambda name: name not in texts)
        raise InputError(f"{alone} is given without {other}; add it or drop both")
    if cells and flow is not None:
        raise InputError("mean_velocity and flow both say what the flow is; drop one")
    flow = CellularFlow(*cells) if cells else flow
    return {"settings": numbers, "flow": flow, "frame": frame}


def vehicle_of(settings: Mapping[str, float]) -> PointMassVehicle:
    """Return the vehicle that settings name; with quadratic drag alone it has no other drag.

    Raises:
        InputError: if they name neither a response time nor drag, or a value is out of its range.
    """
    tau, ax, ay, quadratic, scale = (settings.get(key, least) for key, least in VEHICLE.items())
    if tau == math.inf and not quadratic:
        raise InputError(
            "no vehicle: the file has no `# response_time=` line; add it or pass vehicle="
        )
    return PointMassVehicle(tau, (ax, ay), quadratic, scale)


def number(text: str, place: str) -> float:
    """Return the finite number that ``text`` is; ``1_000`` is none in a log.

    Raises:
        InputError: naming ``place``, the line and column, where it is no number.
    """
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        cell = ascii(text.strip()[:40])
        raise InputError(f"{place}: {cell} is not a finite number; repair or drop it")
    return value


def _record(flow: Flow) -> dict[str, Any] | None:
    """The kind and the fields of a flow; None where it, or a component, is of a user's own."""
    kind = next((kind for kind, home in KINDS.items() if type(flow) is home), None)
    values = {item.name: getattr(flow, item.name) for item in fields(KINDS[kind])} if kind else {}
    if isinstance(flow, SuperposedFlow):
        values["components"] = [_record(part) for part in flow.components]
    return {"kind": kind, **values} if kind and None not in values.get("components", ()) else None


def _flow_of(record: object, where: Place) -> Flow:
    """The flow of a JSON object. Raises `InputError`, naming the place, where it is none."""
    values = dict(mapping(record, where))
    kind = values.pop("kind", None)
    if str(kind) not in KINDS:
        raise where.error(f"is of unknown kind {shown(kind)}{suggestion(str(kind), KINDS)}")
    if isinstance(parts := values.get("components"), list):
        values["components"] = [_flow_of(part, where) for part in parts]
    flow: Flow = build(KINDS[str(kind)], values, where)
    return flow
