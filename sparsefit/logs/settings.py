"""A vehicle and a true flow as named numbers, as they stand in the head of a file, and back.

A flow alone has plain names (``mean_velocity``, ``length_scale``), superposed ones are numbered
``_1``, ``_2``, ...; the kind of a part follows from its names. A `WaveFlow` has none.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import astuple

from sparsefit.errors import InputError, one_of, told_with
from sparsefit.flight.flow import CellularFlow, Flow, ShapedCells, SuperposedFlow
from sparsefit.flight.record import FRAMES
from sparsefit.flight.turbulence import SPECTRA, Turbulence
from sparsefit.flight.vehicle import PointMassVehicle

CELLS = ("mean_velocity", "length_scale")
KEYS = ("response_time", "thrust_ax", "thrust_ay", "drag", "thrust_scale", *CELLS)
_WIND = ("wind_x", "wind_y")
_SHAPED = (  # the fields of `ShapedCells` in their order, pairs one by one
    *("mean_velocity", "length_scale_x", "length_scale_y", "heading", "angle", "offset_x"),
    *("offset_y", "drift_x", "drift_y", "swell", "swell_period", "swell_phase"),
)
_TURBULENCE = (
    *("turbulence_intensity", "turbulence_length", "turbulence_memory"),
    *("turbulence_spectrum", "turbulence_seed"),
)  # memory 0: frozen; spectrum: its place in `SPECTRA`
_EXACT = 2**53  # integers up to it are exact as floats, which settings are
_NAMES = "|".join(sorted({*CELLS, *_SHAPED, *_TURBULENCE}, key=len, reverse=True))
_KEY = re.compile(rf"(?P<name>{_NAMES})(?P<ending>_[1-9]\d{{0,3}})?")


def is_key(name: str) -> bool:
    """Tell whether ``name`` is a setting that a flight file may hold."""
    return name in KEYS or name in _WIND or _KEY.fullmatch(name) is not None


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
    """Return the frame that ``text`` names; `InputError`, naming ``place``, where it is none."""
    with told_with(place):
        one_of("frame", text.strip(), filter(None, FRAMES))
    return text.strip()


def vehicle_of(settings: Mapping[str, float]) -> PointMassVehicle:
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


def settings_of(vehicle: PointMassVehicle, flow: Flow | None) -> dict[str, float]:
    """Return the settings of a vehicle and a flow.

    A response time is left out where drag is quadratic only; a flow that holds a `WaveFlow`, a
    field of a user's own or a seed above 2^53 has none.
    """
    ax, ay = vehicle.thrust_acceleration
    settings = {"response_time": vehicle.response_time} if vehicle.rate else {}
    settings |= {"thrust_ax": ax, "thrust_ay": ay}
    settings |= {"drag": vehicle.drag} if vehicle.drag else {}
    settings |= {"thrust_scale": vehicle.thrust_scale} if vehicle.thrust_scale != 1.0 else {}
    several = isinstance(flow, SuperposedFlow)
    parts = flow.components if isinstance(flow, SuperposedFlow) else (flow,) if flow else ()
    own: dict[str, float] = {}
    for count, part in enumerate(parts, start=1):
        values = _values(part)
        if not values:
            return settings
        own |= {f"{name}_{count}" if several else name: value for name, value in values.items()}
    wind = dict(zip(_WIND, flow.wind, strict=True)) if flow and any(flow.wind) else {}
    return settings | own | wind


def flow_of(settings: Mapping[str, float]) -> Flow | None:
    """Return the flow that the settings name, None where they name none.

    Raises:
        InputError: where a part lacks one of its numbers, or parts are not numbered 1, 2, ....
    """
    matches = [match for key in settings if (match := _KEY.fullmatch(key))]
    endings = {match["ending"] or "" for match in matches}
    wind = (settings.get(_WIND[0], 0.0), settings.get(_WIND[1], 0.0))
    if not endings:
        return SuperposedFlow((), wind) if any(wind) else None
    if endings == {""}:
        alone = _part(settings, "")
        return SuperposedFlow((alone,), wind) if any(wind) else alone
    numbered = [f"_{count}" for count in range(1, len(endings) + 1)]
    if endings != set(numbered):
        raise InputError(
            "the flow must be one mean_velocity and length_scale, or pairs numbered "
            "_1, _2, ... without a gap; rename them"
        )
    return SuperposedFlow(tuple(_part(settings, ending) for ending in numbered), wind)


def _values(part: Flow) -> dict[str, float]:
    """The numbers of a part by name; none of a kind that has no names."""
    if isinstance(part, CellularFlow):
        return dict(zip(CELLS, astuple(part), strict=True))
    if isinstance(part, ShapedCells):
        pairs = (value if isinstance(value, tuple) else (value,) for value in astuple(part))
        return dict(zip(_SHAPED, (number for pair in pairs for number in pair), strict=True))
    if isinstance(part, Turbulence) and part.seed <= _EXACT:
        spectrum = list(SPECTRA).index(part.spectrum)
        numbers = (part.intensity, part.length, part.memory or 0.0, spectrum, part.seed)
        return dict(zip(_TURBULENCE, map(float, numbers), strict=True))
    return {}


def _part(settings: Mapping[str, float], ending: str) -> Flow:
    """The part with this ending; the first name that only one kind has says which it is."""
    names = next(names for sign, names in ((0, _TURBULENCE), (1, _SHAPED), (None, CELLS))
                 if sign is None or f"{names[sign]}{ending}" in settings)  # fmt: skip
    present = [f"{name}{ending}" for name in names if f"{name}{ending}" in settings]
    for name in names:
        if f"{name}{ending}" not in settings:
            here = present[0] if present else f"part {ending.lstrip('_') or 1} of the flow"
            raise InputError(f"{here} is given without {name}{ending}; add it or drop both")
    values = [settings[f"{name}{ending}"] for name in names]
    if names is CELLS:
        return CellularFlow(*values)
    if names is _SHAPED:
        speed, x, y, heading, angle, left, up, east, north, *swell = values
        return ShapedCells(speed, (x, y), heading, angle, (left, up), (east, north), *swell)
    intensity, length, memory, place, seed = values
    spectra = list(SPECTRA)
    if place not in range(len(spectra)):
        raise InputError(
            f"turbulence_spectrum is 0 ({spectra[0]}) or 1 ({spectra[1]}); got {place:g}"
        )
    whole = int(seed) if seed == int(seed) else seed
    return Turbulence(intensity, length, memory or None, spectra[int(place)], whole)  # type: ignore[arg-type]
