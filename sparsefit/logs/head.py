"""The head of a flight's file: vehicle, true flow and axes as texts by key, and back.

The parameters of the vehicle are numbers. The paper's cells are ``mean_velocity`` and
``length_scale``, as a person types them; any other flow is one ``flow`` entry, a JSON object of its
``kind`` and the fields of its record. The axes are ``frame``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from sparsefit.codec import Place, build, finite_or_none, made, mapping, shown
from sparsefit.errors import InputError, one_of, suggestion, told_with, unknown
from sparsefit.flight.flow import CellularFlow, Flow, ShapedCells, SuperposedFlow
from sparsefit.flight.record import FRAMES, Flight
from sparsefit.flight.turbulence import Turbulence
from sparsefit.flight.vehicle import PointMassVehicle
from sparsefit.flight.waves import WaveFlow

CELLS = ("mean_velocity", "length_scale")
NUMBERS = ("response_time", "thrust_ax", "thrust_ay", "drag", "thrust_scale", *CELLS)
KEYS = (*NUMBERS, "flow", "frame")
KINDS: dict[str, type[Flow]] = {
    "cells": CellularFlow,
    "shaped-cells": ShapedCells,
    "turbulence": Turbulence,
    "waves": WaveFlow,
}
SUM = "sum"  # the kind of a `SuperposedFlow`, whose components are such objects
LONGEST = 60_000  # characters of a flow: a line of CSV is no longer than 65,536 bytes


@dataclass(frozen=True)
class Head:
    """The vehicle, the flow and the axes that a file says beside its columns.

    Args:
        settings: the parameters of the vehicle by name.
        flow: the true flow, where it is known.
        frame: the axes, a key of `FRAMES`.
    """

    settings: Mapping[str, float] = field(default_factory=dict)
    flow: Flow | None = None
    frame: str = ""

    @classmethod
    def of(cls, flight: Flight) -> Head:
        """Return the head of a flight; drag that is quadratic only has no response time."""
        vehicle = flight.vehicle
        settings = {"response_time": vehicle.response_time} if vehicle.rate else {}
        settings |= dict(zip(NUMBERS[1:3], vehicle.thrust_acceleration, strict=True))
        settings |= {"drag": vehicle.drag} if vehicle.drag else {}
        settings |= {"thrust_scale": vehicle.thrust_scale} if vehicle.thrust_scale != 1.0 else {}
        return cls(settings, flight.flow, flight.frame)

    @classmethod
    def parsed(cls, entries: Iterable[tuple[str, str, str]], *, strict: bool) -> Head:
        """Return the head that a file's entries (place, key, text) say.

        strict: unknown keys are refused, and not passed over.

        Raises:
            InputError: naming the place, on a key that is unknown or stands twice and on a value
                that is none of its kind.
        """
        texts: dict[str, str] = {}
        numbers: dict[str, float] = {}
        flow: Flow | None = None
        for place, key, text in entries:
            if key not in KEYS:
                if strict:
                    raise InputError(f"{place}: {unknown('key', key, KEYS)}")
                continue
            if key in texts:
                raise InputError(f"{place}: {key} is given twice; keep one")
            texts[key] = text.strip()
            if key in NUMBERS:
                numbers[key] = number(text, f"{place}, {key}")
            elif key == "flow":
                flow = _parsed_flow(text, place)
            else:
                with told_with(place):
                    one_of("frame", texts[key], filter(None, FRAMES))
        cells = [numbers.pop(name) for name in CELLS if name in numbers]
        if len(cells) == 1:
            alone, other = sorted(CELLS, key=lambda name: name not in texts)
            raise InputError(f"{alone} is given without {other}; add it or drop both")
        if cells and flow is not None:
            raise InputError("mean_velocity and flow both say what the flow is; drop one")
        return cls(numbers, CellularFlow(*cells) if cells else flow, texts.get("frame", ""))

    def texts(self) -> dict[str, str]:
        """Return the entries, which `parsed` reads exactly; a flow of a user's own has none."""
        texts = {name: repr(value) for name, value in self.settings.items()}
        if isinstance(self.flow, CellularFlow):
            texts |= {name: repr(getattr(self.flow, name)) for name in CELLS}
        elif record := self.flow and _record(self.flow):
            line = json.dumps(finite_or_none(record))
            texts |= {"flow": line} if len(line) <= LONGEST else {}
        return texts | ({"frame": self.frame} if self.frame else {})


def vehicle_of(settings: Mapping[str, float]) -> PointMassVehicle:
    """Return the vehicle that the settings name; what they do not say is 0, its scale 1.

    With quadratic drag and no response time it has no other drag.

    Raises:
        InputError: if they name neither a response time nor drag, or a value is out of its range.
    """
    drag = settings.get("drag", 0.0)
    if "response_time" not in settings and not drag:
        raise InputError(
            "no vehicle: the file has no `# response_time=` line; add it or pass vehicle="
        )
    response, scale = settings.get("response_time", math.inf), settings.get("thrust_scale", 1.0)
    constant = (settings.get("thrust_ax", 0.0), settings.get("thrust_ay", 0.0))
    return PointMassVehicle(response, constant, drag, scale)


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
        cell = ascii(text.strip()[:40])
        raise InputError(f"{place}: {cell} is not a finite number; repair or drop it{more}")
    return value


def _record(flow: Flow) -> dict[str, Any] | None:
    """The kind and the fields of a flow; None where it, or a component, is of a user's own."""
    if isinstance(flow, SuperposedFlow):
        parts = [_record(part) for part in flow.components]
        return {"kind": SUM, "components": parts, "wind": flow.wind} if None not in parts else None
    for kind, home in KINDS.items():
        if type(flow) is home:
            return {"kind": kind} | {item.name: getattr(flow, item.name) for item in fields(home)}  # type: ignore[arg-type]
    return None


def _parsed_flow(text: str, place: str) -> Flow:
    """The flow of a JSON object. Raises `InputError`, naming the place, where it is none."""

    def flow_of(record: object) -> Flow:
        values = dict(mapping(record, where))
        kind = values.pop("kind", None)
        if kind == SUM:
            parts = values.get("components")
            values["components"] = tuple(map(flow_of, parts if isinstance(parts, list) else ()))
            return made(SuperposedFlow, values, where)
        if kind not in KINDS:
            hint = suggestion(str(kind), (*KINDS, SUM))
            raise where.error(f"is of unknown kind {shown(kind)}{hint}")
        return build(KINDS[str(kind)], values, where)

    where = Place(place, "", "flow")
    try:
        return flow_of(json.loads(text))
    except (json.JSONDecodeError, RecursionError):
        raise where.error("is no JSON object of a flow; repair or drop it") from None
