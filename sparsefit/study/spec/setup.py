"""What one combination of protocol and sweep levels resolves to: flights, library, readout."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from sparsefit.codec import Place, build, made, only
from sparsefit.derivative import Derivative
from sparsefit.errors import suggestion
from sparsefit.estimator.estimator import Estimator
from sparsefit.library.builder import Library
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.modes.readout import UNNAMED, Readout
from sparsefit.study.spec.document import Section
from sparsefit.study.spec.flights import KEYS as FLIGHT_KEYS
from sparsefit.study.spec.flights import FlightRules, read_flights
from sparsefit.study.spec.logs import Logs

Sections = Mapping[str, Section]


def _names(kind: type[Any]) -> tuple[str, ...]:
    return tuple(field.name for field in fields(kind))


GRID_KEYS = _names(LengthScaleGrid)
LIBRARY_KEYS = tuple(name for name in _names(Library) if name != "grid")
SECTION_KEYS: dict[str, tuple[str, ...]] = {
    "flights": FLIGHT_KEYS,
    "derivative": _names(Derivative),
    "library": GRID_KEYS + LIBRARY_KEYS,
    "readout": _names(Readout),
}


@dataclass(frozen=True)
class Setup:
    """Everything of a case but its flight number and its back-end."""

    flights: FlightRules | Logs
    derivative: Derivative
    library: Library
    readout: Readout


def read_setup(sections: Sections, place: Place) -> Setup:
    """The setup of the four sections; `InputError` names the section and the key."""
    setup = Setup(
        read_flights(sections["flights"], place.within("flights")),
        build(Derivative, sections["derivative"], place.within("derivative")),
        _read_library(sections["library"], place.within("library")),
        build(Readout, {"refine": UNNAMED, **sections["readout"]}, place.within("readout")),
    )
    # What no estimator can combine is refused here, not in the first case.
    parts = {"derivative": setup.derivative, "library": setup.library, "readout": setup.readout}
    made(Estimator, parts, place)
    return setup


def override(sections: Sections, overrides: Mapping[str, object]) -> Sections:
    """The sections with dotted keys (`library.target`) replaced."""
    changed = {name: dict(table) for name, table in sections.items()}
    for dotted, value in overrides.items():
        section, key = dotted.split(".", 1)
        changed[section][key] = value
    return changed


def check_dotted(dotted: str, place: Place) -> None:
    """Refuse a dotted key that names nothing that can be overridden."""
    section, _, key = dotted.partition(".")
    here = place.at(dotted)
    if section not in SECTION_KEYS:
        near = suggestion(section, SECTION_KEYS)
        raise here.error(f'unknown: the part before the dot, "{section}"' + near)
    if key not in SECTION_KEYS[section]:
        near = suggestion(key, SECTION_KEYS[section])
        raise here.error(f'unknown: [{section}] has no "{key}"' + near)


def _read_library(section: Section, place: Place) -> Library:
    only(section, SECTION_KEYS["library"], place)
    grid = {key: value for key, value in section.items() if key in GRID_KEYS}
    library = {key: value for key, value in section.items() if key not in GRID_KEYS}
    # Without a word about the grid, the library keeps the default that is its own.
    parts = {"grid": build(LengthScaleGrid, grid, place)} if grid else {}
    return build(Library, parts | library, place)
