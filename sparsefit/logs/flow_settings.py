"""The true flow of a flight as named numbers, for its file, and back.

A flow alone has plain names (``mean_velocity``, ``length_scale``), superposed ones are numbered
``_1``, ``_2``, ...; what kind a part is, its names say. A `WaveFlow` has none.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from sparsefit.errors import InputError
from sparsefit.flight.flow import CellularFlow, Flow, ShapedCells, SuperposedFlow
from sparsefit.flight.turbulence import SPECTRA, Turbulence

WIND = ("wind_x", "wind_y")
CELLS = ("mean_velocity", "length_scale")
SHAPED = (
    *("mean_velocity", "length_scale_x", "length_scale_y", "heading", "angle", "offset_x"),
    *("offset_y", "drift_x", "drift_y", "swell", "swell_period", "swell_phase"),
)
TURBULENCE = (
    *("turbulence_intensity", "turbulence_length", "turbulence_memory"),
    *("turbulence_spectrum", "turbulence_seed"),
)  # memory 0: frozen; spectrum: its place in `SPECTRA`

EXACT = 2**53  # integers up to it are exact as floats, which settings are

_NAMES = "|".join(sorted({*CELLS, *SHAPED, *TURBULENCE}, key=len, reverse=True))
_KEY = re.compile(rf"(?P<name>{_NAMES})(?P<ending>_[1-9]\d{{0,3}})?")


def is_flow_key(name: str) -> bool:
    """Tell whether ``name`` is a setting of a flow."""
    return name in WIND or _KEY.fullmatch(name) is not None


def settings_of_flow(flow: Flow | None) -> dict[str, float]:
    """Return the settings of a flow; none of one that holds a `WaveFlow` or a seed
    above 2^53, or of still air."""
    parts = flow.components if isinstance(flow, SuperposedFlow) else (flow,) if flow else ()
    settings: dict[str, float] = {}
    for count, part in enumerate(parts, start=1):
        values = _values(part)
        if not values:
            return {}
        ending = f"_{count}" if isinstance(flow, SuperposedFlow) else ""
        settings |= {f"{name}{ending}": value for name, value in values.items()}
    if isinstance(flow, SuperposedFlow) and any(flow.wind):
        settings |= dict(zip(WIND, flow.wind, strict=True))
    return settings


def flow_of_settings(settings: Mapping[str, float]) -> Flow | None:
    """Return the flow that the settings name, None where they name none.

    Raises:
        InputError: where a part lacks one of its numbers, or parts are not numbered 1, 2, ....
    """
    matches = [match for key in settings if (match := _KEY.fullmatch(key))]
    endings = {match["ending"] or "" for match in matches}
    wind = (settings.get(WIND[0], 0.0), settings.get(WIND[1], 0.0))
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
    if isinstance(part, CellularFlow):
        return dict(zip(CELLS, (part.mean_velocity, part.length_scale), strict=True))
    if isinstance(part, ShapedCells):
        pairs = (*part.offset, *part.drift)
        swell = (part.swell, part.swell_period, part.swell_phase)
        first = (part.mean_velocity, *part.length_scales, part.heading, part.angle)
        return dict(zip(SHAPED, (*first, *pairs, *swell), strict=True))
    if isinstance(part, Turbulence) and part.seed <= EXACT:
        spectrum = list(SPECTRA).index(part.spectrum)
        numbers = (part.intensity, part.length, part.memory or 0.0, spectrum, part.seed)
        return dict(zip(TURBULENCE, map(float, numbers), strict=True))
    return {}


def _part(settings: Mapping[str, float], ending: str) -> Flow:
    """The part with this ending: its kind is the first with a name that no other has."""
    kinds: tuple[tuple[str, tuple[str, ...], Callable[..., Flow]], ...] = (
        (TURBULENCE[0], TURBULENCE, _turbulence),
        (SHAPED[1], SHAPED, _shaped),
        ("", CELLS, CellularFlow),
    )
    names, made = next((names, made) for sign, names, made in kinds
                       if not sign or f"{sign}{ending}" in settings)  # fmt: skip
    present = [f"{name}{ending}" for name in names if f"{name}{ending}" in settings]
    for name in names:
        if f"{name}{ending}" not in settings:
            here = present[0] if present else f"part {ending.lstrip('_') or 1} of the flow"
            raise InputError(f"{here} is given without {name}{ending}; add it or drop both")
    return made(*(settings[f"{name}{ending}"] for name in names))


def _shaped(
    speed: float, length_x: float, length_y: float, heading: float, angle: float,
    offset_x: float, offset_y: float, drift_x: float, drift_y: float, *swell: float,
) -> ShapedCells:  # fmt: skip
    offset, drift = (offset_x, offset_y), (drift_x, drift_y)
    return ShapedCells(speed, (length_x, length_y), heading, angle, offset, drift, *swell)


def _turbulence(
    intensity: float, length: float, memory: float, spectrum: float, seed: float
) -> Turbulence:
    names = list(SPECTRA)
    if spectrum not in range(len(names)):
        raise InputError(
            f"turbulence_spectrum is 0 ({names[0]}) or 1 ({names[1]}); got {spectrum:g}"
        )
    whole = int(seed) if seed == int(seed) else seed
    return Turbulence(intensity, length, memory or None, names[int(spectrum)], whole)  # type: ignore[arg-type]
