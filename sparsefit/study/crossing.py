"""The cells of a study of flights: protocols x sweep levels x back-ends x settings.

    [[protocols]]                        alternatives, which are not crossed with each other
    name = "weak"
    "derivative.method" = "weak"

    [sweep]                              crossed with everything
    "flights.duration" = [5.0, 20.0]

A `Cell` is one of each, resolved: its `Setup` holds the flights, what is derived, and how it is
read; its back-end and settings say who fits.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

from sparsefit import backends
from sparsefit.codec import Place, build, made, number, only, shown
from sparsefit.errors import SparsefitError, is_real, suggestion
from sparsefit.estimator import Estimator
from sparsefit.model import LengthScaleGrid, Library, Readout
from sparsefit.model.readout import UNNAMED
from sparsefit.onboard import Stream
from sparsefit.regression.backend import PathBackend
from sparsefit.rows import Derivative
from sparsefit.study.draw import KEYS as FLIGHT_KEYS
from sparsefit.study.draw import FlightRules, Logs, read_flight_rules, read_logs
from sparsefit.study.keys import BackendKeys, EstimatorKeys, FlightFile, ProtocolKeys, nearest
from sparsefit.study.schema import Section, canonical_json, distinct, names_of, taken
from sparsefit.study.worker import in_child

MOST_CASES = 2_000_000
ALPHA = "alpha_fraction"
Setting: TypeAlias = float | int | str | bool
Sections: TypeAlias = Mapping[str, Section]
Levels: TypeAlias = Mapping[str, object]  # values by dotted key
Protocols: TypeAlias = Mapping[str, Levels]  # what each named alternative overrides
Grid: TypeAlias = Mapping[str, Sequence[Any]]
Keys = TypeVar("Keys")
RECORDS: dict[str, type[Any]] = {  # of a section whose keys are the fields of one
    "derivative": Derivative, "readout": Readout, "online": Stream, "estimator": EstimatorKeys
}  # fmt: skip
SECTION_KEYS: dict[str, tuple[str, ...]] = {
    "flights": FLIGHT_KEYS,
    "library": (*names_of(LengthScaleGrid), *(n for n in names_of(Library) if n != "grid")),
    **{name: names_of(kind) for name, kind in RECORDS.items()},
}


@dataclass(frozen=True)
class Setup:
    """Everything of a case but the number of its flight and its back-end."""

    flights: FlightRules | Logs
    library: Library
    derivative: Derivative
    readout: Readout
    online: Stream = Stream()
    beside: EstimatorKeys = EstimatorKeys()

    @property
    def estimator(self) -> Estimator:
        """The estimator, but for its back-end and tolerance."""
        return Estimator(self.derivative, self.library, readout=self.readout, **vars(self.beside))


@dataclass(frozen=True, eq=False)
class BackendPoint:
    """A back-end with one combination of the settings of its [[backends]] entry.

    settings: those that the entry gives; canonical_settings: all of them, as canonical JSON;
    own_settings: those that are not at their defaults; fractions: all penalties of the entry, where
    the back-end walks a path over them: a resumed run repeats the path.
    """

    name: str
    label: str
    settings: Mapping[str, Setting]
    canonical_settings: str
    own_settings: str
    fractions: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class Cell:
    """A protocol, sweep levels and a back-end with its settings, resolved."""

    protocol: str
    levels: Levels
    setup: Setup
    backend: BackendPoint


def read_setup(sections: Sections, place: Place, parts: dict[str, Any] | None = None) -> Setup:
    """The setup of the sections; `InputError` names the section and the key.

    parts: what was read before, by content, so that setups share what is equal.
    """
    parts = {} if parts is None else parts
    content = [json.dumps([name, sections.get(name, {})], default=repr) for name in SECTION_KEYS]
    for name, words in zip(SECTION_KEYS, content, strict=True):
        section, here = sections.get(name, {}), place.within(name)
        if words in parts:
            continue
        if name == "flights":
            parts[words] = (read_logs if "files" in section else read_flight_rules)(section, here)
        elif name == "library":
            only(section, SECTION_KEYS[name], here)
            grid, rest = taken(LengthScaleGrid, section, here)
            # Without a word about the grid, the library keeps the default that is its own.
            given = {"grid": grid} if len(rest) < len(section) else {}
            parts[words] = build(Library, given | rest, here)
        else:
            default = {"refine": UNNAMED} if name == "readout" else {}
            parts[words] = build(RECORDS[name], default | dict(section), here)
    setup = Setup(*(parts[words] for words in content))
    combined = "".join(content[1:])
    if combined not in parts:
        # What no estimator can combine is refused here, not in the first case.
        made(Estimator, vars(setup.beside), place.within("estimator"))
        estimator = made(lambda: setup.estimator, {}, place)
        made(setup.online.flying, {"estimator": estimator}, place.within("online"))
        parts[combined] = True
    return setup


def named(name: str, settings: Mapping[str, object]) -> str:
    """A name with settings: `lasso alpha_fraction=0.1`."""
    return " ".join([name, *(f"{key}={value}" for key, value in settings.items())])


def spelled(level: object) -> str:
    """A level in words: `5`, `0.2 / 0.05` of a list, `none` of an empty one."""
    levels = level if isinstance(level, list | tuple) else [level]
    return " / ".join(f"{item:g}" if is_real(item) else str(item) for item in levels) or "none"


def points_of(grid: Grid) -> list[dict[str, Any]]:
    """Every point of a grid, the last key fastest; one empty point where it has no keys."""
    return [dict(zip(grid, chosen, strict=True)) for chosen in itertools.product(*grid.values())]


def read_protocols(file: FlightFile, sweep: Grid, place: Place) -> dict[str, Levels]:
    """The [[protocols]], or one called "default" without overrides."""
    protocols = []
    for entry in file.protocols:
        keys, rest = taken(ProtocolKeys, entry, place)
        protocols.append((keys.name, dotted_keys(rest, place)))
        for dotted in set(sweep) & set(protocols[-1][1]):
            raise place.at(dotted).error(f'is in [sweep] too: "{keys.name}" cannot also set it')
    distinct([name for name, _ in protocols] or ["default"], place.at("name"))
    distinct([levels for _, levels in protocols] or [{}], place)  # else they would be pooled
    return dict(protocols) or {"default": {}}


def dotted_keys(section: Section, place: Place) -> dict[str, object]:
    """Flat dotted keys: `"library.target"` in quotes and bare `library.target` are equal."""
    flat: dict[str, object] = {}
    for name, value in section.items():
        if isinstance(value, dict) and name in SECTION_KEYS:
            flat |= {f"{name}.{inner}": item for inner, item in value.items()}
        else:
            flat[name] = value
    for dotted in flat:
        first, _, name = dotted.partition(".")
        here, keys = place.at(dotted), SECTION_KEYS.get(first)
        if keys is None:
            own = [f"{each}.{name or first}" for each in SECTION_KEYS
                   if (name or first) in SECTION_KEYS[each]]  # fmt: skip
            near = f': did you mean "{own[0]}"?' if own else suggestion(first, SECTION_KEYS)
            raise here.error(f"unknown{near}")
        if dotted == "flights.count":
            raise here.error("is of the whole study: set it in [flights] alone")
        if name not in keys:
            near = nearest(name, keys) if first == "flights" else suggestion(name, keys)
            raise here.error(f'unknown: [{first}] has no "{name}"{near}')
    return flat


def read_backends(file: FlightFile, place: Place) -> list[BackendPoint]:
    """Every point of the [[backends]] of flights, accepted by the back-end itself."""
    fitted: dict[str, BackendPoint] = {}
    listed = points_of_entries(file.backends, BackendKeys, place)
    asked = [(keys.name, settings) for keys, _, settings in listed]
    foreign = any(of_others(name) for name, _ in asked)
    about = facts(about_backends, asked, foreign=foreign, place=place)
    for (keys, grid, settings), (canonical, own, walks) in zip(listed, about, strict=True):
        if (identity := canonical_json([keys.name, settings])) in fitted:
            words = f"with {shown(settings)}" if settings else "without settings"
            raise place.error(f'"{keys.name}" is listed twice {words}')
        # With "auto" a back-end walks a path of its own.
        alphas = [float(alpha) for alpha in grid.get(ALPHA, ()) if alpha != "auto"]
        along = walks and settings.get(ALPHA) != "auto" and len(alphas) > 1
        content = (keys.name, keys.label or keys.name, settings, canonical, own)
        fitted[identity] = BackendPoint(*content, tuple(alphas) if along else ())
    return list(fitted.values())


def facts(work: Callable[..., Any], *asked: object, foreign: bool, place: Place) -> Any:
    """``work(*asked)``, in a process of its own where it loads code of others."""
    try:
        return in_child(work, *asked, seconds=120.0) if foreign else work(*asked)
    except (SparsefitError, TypeError, ValueError) as error:
        raise place.error(str(error)) from None


def points_of_entries(
    entries: Sequence[Section], kind: type[Keys], place: Place
) -> list[tuple[Keys, dict[str, tuple[Setting, ...]], dict[str, Setting]]]:
    """Every combination of the settings of entries: the keys of the entry, its grid, the point.

    A setting, which is any key but those of ``kind``, is a number, a text, true/false, or a list.
    """
    listed = []
    for entry in entries:
        keys, settings = taken(kind, entry, place)
        grid: dict[str, tuple[Any, ...]] = {}
        for name, value in sorted(settings.items()):
            here = place.at(name)
            grid[name] = tuple(distinct(value, here))
            for item in grid[name]:
                if not isinstance(item, bool | str | int | float):
                    words = "must be a number, text or true/false, or a list of them"
                    raise here.error(f"{words}, not {shown(item)}")
                if not isinstance(item, bool | str):
                    number(item, here)
        if (size := math.prod(map(len, grid.values()))) > 100_000:
            raise place.error(f"has a grid of {size} settings: 100000 are the most")
        listed += [(keys, grid, point) for point in points_of(grid)]
    return listed


def of_others(name: str) -> bool:
    """Whether a back-end is code of another package; False of an unknown name."""
    return name not in backends.BACKENDS and name in (*backends.known(), *backends.PUBLIC)


def about_backends(
    asked: Sequence[tuple[str, Mapping[str, Setting]]],
) -> list[tuple[str, str, bool]]:
    """Of each back-end with its settings: all of them, those that are not at their defaults (both
    as canonical JSON), and whether it walks a path of penalties.
    """
    about = []
    for name, settings in asked:
        backend: Any = backends.get(name, **settings)
        canonical = canonical_json(backends.settings_of(backend))
        about.append((canonical, canonical_json(backend), isinstance(backend, PathBackend)))
    return about
