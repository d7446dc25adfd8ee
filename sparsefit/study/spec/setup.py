"""What one combination of protocol and sweep levels resolves to: flights, library, readout."""

from __future__ import annotations

import types
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from sparsefit.derivative import Derivative
from sparsefit.errors import InputError, suggestion
from sparsefit.estimator.estimator import Estimator
from sparsefit.library.builder import Library
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.modes.readout import Readout
from sparsefit.study.spec.document import Place, Section, integer, number, only, shown
from sparsefit.study.spec.flights import KEYS as FLIGHT_KEYS
from sparsefit.study.spec.flights import FlightRules, read_flight_rules

Record = TypeVar("Record")
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

    flights: FlightRules
    derivative: Derivative
    library: Library
    readout: Readout


def read_setup(sections: Sections, place: Place) -> Setup:
    """The setup of the four sections; `InputError` names the section and the key."""
    setup = Setup(
        read_flight_rules(sections["flights"], place.within("flights")),
        read_record(Derivative, sections["derivative"], place.within("derivative")),
        _read_library(sections["library"], place.within("library")),
        read_record(Readout, sections["readout"], place.within("readout")),
    )
    # What no estimator can combine is refused here, not in the first case.
    made = {"derivative": setup.derivative, "library": setup.library, "readout": setup.readout}
    _make(Estimator, made, place)
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
    rest = {key: value for key, value in section.items() if key not in GRID_KEYS}
    # Without a word about the grid, the library keeps the default that is its own.
    made = {"grid": read_record(LengthScaleGrid, grid, place)} if grid else {}
    return _make(Library, made | _typed(Library, rest, place), place)


def read_record(kind: type[Record], section: Section, place: Place) -> Record:
    """A frozen dataclass from a table: unknown keys, wrong types and bad values are refused."""
    only(section, _names(kind), place)
    return _make(kind, _typed(kind, section, place), place)


def _make(kind: type[Record], values: dict[str, Any], place: Place) -> Record:
    try:
        return kind(**values)
    except (InputError, TypeError, ValueError) as error:
        raise place.error(" ".join(str(error).split())) from None


def _typed(kind: type[Any], section: Section, place: Place) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {key: _fit_to(value, hints[key], place.at(key)) for key, value in section.items()}


def _fit_to(value: object, hint: Any, place: Place) -> object:
    """`value` as the annotation asks; TOML has no None, so an optional is its other type."""
    if get_origin(hint) in (Union, types.UnionType):
        (hint, *_) = [option for option in get_args(hint) if option is not type(None)]
    if get_origin(hint) is Literal:
        return _one_of(value, get_args(hint), place)
    if hint is float:
        return number(value, place)
    if hint is int:
        return integer(value, place, least=0)
    if isinstance(hint, type) and not isinstance(value, hint):
        kind = {"str": "text in quotes", "bool": "true or false"}.get(hint.__name__, hint.__name__)
        raise place.error(f"must be {kind}, not {shown(value)}")
    return value


def _one_of(value: object, options: tuple[object, ...], place: Place) -> object:
    if value in options and not isinstance(value, bool):
        return value
    known = [str(option) for option in options]
    near = suggestion(value, known) if isinstance(value, str) else f" (known: {', '.join(known)})"
    raise place.error(f"has unknown value {shown(value)}{near}")
