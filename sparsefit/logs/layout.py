"""Which columns of a foreign table are a flight, and in which units: ``time=t,x=lon,vx=u[cm/s]``.

A field (``time``, ``x``, ``y``, ``vx``, ``vy``, ``ax``, ``ay``) is read from the column that a map
names, else from the one of its own name, whatever its case; ``ax`` and ``ay``, a measured
acceleration of the propulsion, beside a map only where it says so. The unit is that of the map,
else the one behind the name in the header, ``u [cm/s]`` or ``u (cm/s)``, else the SI unit. Columns
that a map names and that begin with ``lon`` and ``lat`` are degrees.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import NamedTuple, TypeAlias

from sparsefit.errors import InputError, one_of, pair, suggestion, unknown
from sparsefit.logs.flight_table import COLUMNS, POSITIONS, PUSH, VELOCITY

Columns: TypeAlias = "str | Mapping[str, str] | None"
"""A column map as it is typed, or as a mapping of fields to columns."""
DEGREES = "deg"  # of longitude and latitude, which a projection turns into metres
TIMES = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9,
         "min": 60.0, "h": 3600.0, "d": 86400.0}  # fmt: skip
LENGTHS = {"m": 1.0, "metres": 1.0, "meters": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048,
           "mi": 1609.344, "nmi": 1852.0}  # fmt: skip
SPEEDS = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/s": 1e3, "km/h": 1.0 / 3.6, "ft/s": 0.3048,
          "mph": 0.44704, "kn": 1852.0 / 3600.0, "knots": 1852.0 / 3600.0}  # fmt: skip
ACCELERATIONS = {"m/s^2": 1.0, "m/s2": 1.0, "cm/s^2": 1e-2, "ft/s^2": 0.3048, "g": 9.80665}
ANGLES = {DEGREES: 1.0, "°": 1.0, "degrees": 1.0}
UNITS = {"t": TIMES, "x": LENGTHS | ANGLES, "y": LENGTHS | ANGLES, "v": SPEEDS, "a": ACCELERATIONS}
_WITH_UNIT = re.compile(r"(.+?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))")


class Source(NamedTuple):
    """The column that a field is read from, as the header spells it, and its unit, if any."""

    column: str
    unit: str = ""

    def __str__(self) -> str:
        plain = not self.unit or _split(self.column).unit == self.unit
        return self.column if plain else f"{self.column} [{self.unit}]"

    @property
    def degrees(self) -> bool:
        """Return whether the unit is that of an angle on the Earth."""
        return self.unit in ANGLES


@dataclass(frozen=True)
class Layout:
    """The reading of a table.

    Args:
        sources: the fields that a column map names; none where the table is as this package
            writes it.
        only: a column and the text in it of the rows that are read; None for all rows.
        origin: longitude and latitude [degrees] where x = y = 0 shall be, of a log that has places;
            None: its own middle.
        epoch: the time where t = 0 shall be, of a log that has times; None: its first sample.
    """

    sources: Mapping[str, Source] = field(default_factory=dict)
    only: tuple[str, str] | None = None
    origin: tuple[float, float] | None = None
    epoch: datetime | None = None

    @classmethod
    def of(
        cls,
        columns: Columns = None,
        only: str | None = None,
        origin: tuple[float, float] | None = None,
        epoch: str | datetime | None = None,
    ) -> Layout:
        """Return the layout of ``time=t,x=lon[deg],...``, or of a mapping, and ``column=value``.

        Raises:
            InputError: on a field that is none, or is given twice, on an unknown unit, and on an
                origin or epoch that is none.
        """
        pairs = list(columns.items()) if isinstance(columns, Mapping) else []
        if columns and not pairs:
            if not isinstance(columns, str):
                raise InputError(f"columns must be text, time=t,x=lon,y=lat, or a mapping of it; "
                                 f"got {columns!r}")  # fmt: skip
            pairs = [_halves(text, "columns: ", "time=t") for text in columns.split(",")]
        sources: dict[str, Source] = {}
        for name, text in pairs:
            one_of("field", name, (*COLUMNS, *PUSH))
            if name in sources:
                raise InputError(f"columns: {name} is given twice; keep one")
            sources[name] = _split(str(text))
            factor_of(name, sources[name].unit)
        place = None if origin is None else pair("origin", origin, "degrees")
        if place is not None and not (abs(place[0]) <= 360.0 and abs(place[1]) <= 90.0):
            raise InputError(f"origin must be longitude and latitude in degrees; got {place}")
        moment = moment_of(str(epoch)) if isinstance(epoch, str | datetime) else None
        if epoch is not None and moment is None:
            raise InputError(f"epoch must be an ISO time, 2012-07-22T14:15:00, say; got {epoch!r}")
        return cls(sources, _halves(only, "only: ", "id=7") if only else None, place, moment)

    @property
    def foreign(self) -> bool:
        """Whether the table is not one that this package has written."""
        return bool(self.sources)

    def chosen(self, names: list[str]) -> dict[str, Source]:
        """Return the sources of all fields that a table with these columns has.

        Raises:
            InputError: where a column is missing or stands twice.
        """
        chosen: dict[str, Source] = {}
        for name in (*COLUMNS, *PUSH):
            source = self.sources.get(name, Source(name))
            headings = _matching(source.column, names)
            if name not in self.sources and (not headings or (self.foreign and name in PUSH)):
                continue
            if not headings:
                wanted = source.column
                raise InputError(f'no column "{wanted}"{suggestion(wanted, names)}')
            if len(headings) > 1:
                raise InputError(f"column {headings[0]} appears more than once; keep one of each")
            unit = source.unit or _split(headings[0]).unit
            if name in self.sources and source.column.casefold().startswith(("lon", "lat")):
                unit = unit or DEGREES
            factor_of(name, unit)
            chosen[name] = Source(headings[0], unit)
        pairs = [pair for pair in (VELOCITY, PUSH) if set(pair) & set(chosen)]
        needed = (*POSITIONS, *sum(pairs, ())) if chosen else COLUMNS
        missing = [name for name in needed if name not in chosen]
        if missing:
            header = ascii(", ".join(names)[:200])[1:-1] or "nothing"
            remedy = "rename or add it, or say which it is: --columns time=t,x=lon,..."
            raise InputError(f"no column {', '.join(missing)}; found {header}; {remedy}")
        if chosen["x"].degrees != chosen["y"].degrees:
            words = f"x = {chosen['x']}, y = {chosen['y']}"
            raise InputError(f"columns: {words}: both are degrees, or none; say [deg] or [m]")
        return chosen

    def refuse_any(self, kind: str) -> None:
        """Raise `InputError` if anything is asked of a kind of file whose columns are its own."""
        if self.sources or self.only:
            raise InputError(f"{kind} tells its own columns; leave columns and only out")


def factor_of(name: str, unit: str) -> float:
    """Return the SI value of one ``unit`` of a field; 1 for degrees and for no unit.

    Raises:
        InputError: naming the known units, where it is none of them.
    """
    units = UNITS[name[0]]
    if unit and unit not in units:
        raise InputError(f"{name}: {unknown('unit', unit, units)}")
    return units[unit] if unit else 1.0


def moment_of(text: str) -> datetime | None:
    """Return the time that a calendar names, UTC where no zone is named; None of anything else."""
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def _halves(text: str, what: str, example: str) -> tuple[str, str]:
    name, equals, value = str(text).partition("=")
    if not equals or not name.strip() or not value.strip():
        raise InputError(f'{what}"{text}" is not NAME=VALUE, as in {example}')
    return name.strip(), value.strip()


def _split(heading: str) -> Source:
    """The name of a column, and the unit behind it."""
    match = _WITH_UNIT.fullmatch(heading)
    return Source(match[1], (match[2] or match[3] or "").strip()) if match else Source(heading)


def _matching(wanted: str, names: list[str]) -> list[str]:
    """The headings that are a name: exactly, or but for their unit, or their case."""
    for key in (str, lambda name: _split(name).column, lambda name: _split(name).column.casefold()):
        if headings := [name for name in names if key(name) == key(wanted)]:
            return headings
    return []
