"""What one combination of protocol and sweep levels resolves to: flights, library, readout."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any

from sparsefit.codec import Place, build, made, only
from sparsefit.derivative import Derivative
from sparsefit.errors import suggestion, told_with
from sparsefit.estimator.estimator import Estimator
from sparsefit.library.builder import Library
from sparsefit.library.grid import LengthScaleGrid
from sparsefit.modes.readout import UNNAMED, Readout
from sparsefit.onboard import Stream
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
    "online": _names(Stream),
}
NO_SECTION: Section = {}


@dataclass(frozen=True)
class Setup:
    """Everything of a case but its flight number and its back-end."""

    flights: FlightRules | Logs
    derivative: Derivative
    library: Library
    readout: Readout
    online: Stream = Stream()


def read_setup(sections: Sections, place: Place) -> Setup:
    """The setup of the sections; `InputError` names the section and the key."""
    return SetupReader(sections).read(sections, place)


class SetupReader:
    """Reads setups that differ from ``sections`` in some: what they share is read once."""

    def __init__(self, sections: Sections) -> None:
        self._shared = sections
        self._read: dict[str, Any] = {}
        self._combined = False

    def read(self, sections: Sections, place: Place) -> Setup:
        """The setup of these sections; `InputError` names the section and the key."""
        setup = Setup(*(self._part(name, _section(sections, name), place) for name in READERS))
        shared = all(
            _section(sections, name) is _section(self._shared, name)
            for name in (*COMBINED, "online")
        )
        if not (shared and self._combined):
            # What no estimator can combine is refused here, not in the first case.
            estimator = made(Estimator, {name: getattr(setup, name) for name in COMBINED}, place)
            with told_with(place.within("online")):
                setup.online.refuse_unfit(estimator)
            self._combined = self._combined or shared
        return setup

    def _part(self, name: str, section: Section, place: Place) -> Any:
        if section is not _section(self._shared, name):
            return READERS[name](section, place.within(name))
        if name not in self._read:
            self._read[name] = READERS[name](section, place.within(name))
        return self._read[name]


def _section(sections: Sections, name: str) -> Section:
    """A section by its name; one that is not there is empty."""
    return sections.get(name, NO_SECTION)


def override(sections: Sections, overrides: Mapping[str, object]) -> Sections:
    """The sections with dotted keys (`library.target`) replaced; the others are the same ones."""
    changed: dict[str, dict[str, object]] = {}
    for dotted, value in overrides.items():
        section, key = dotted.split(".", 1)
        changed.setdefault(section, dict(_section(sections, section)))[key] = value
    return {**sections, **changed}


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


def _read_derivative(section: Section, place: Place) -> Derivative:
    return build(Derivative, section, place)


def _read_readout(section: Section, place: Place) -> Readout:
    return build(Readout, {"refine": UNNAMED, **section}, place)


def _read_online(section: Section, place: Place) -> Stream:
    return build(Stream, section, place)


READERS: dict[str, Callable[[Section, Place], Any]] = {  # in the order of the fields of `Setup`
    "flights": read_flights,
    "derivative": _read_derivative,
    "library": _read_library,
    "readout": _read_readout,
    "online": _read_online,
}
COMBINED = ("derivative", "library", "readout")
