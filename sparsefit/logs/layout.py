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
from itertools import chain
from typing import TypeAlias

from sparsefit.errors import InputError, one_of, suggestion, unknown
from sparsefit.logs.flight_table import COLUMNS, POSITIONS, THRUST, VELOCITY, Anchor

Columns: TypeAlias = "str | Mapping[str, str] | None"
"""A column map as it is typed, or as a mapping of fields to columns."""
FIELDS = (*COLUMNS, *THRUST)
DEGREES = "deg"  # of longitude and latitude, which a projection turns into metres
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0,
         "d": 86400.0}  # fmt: skip
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "mi": 1609.344, "nmi": 1852.0}
SPEEDS = {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/s": 1e3, "km/h": 1.0 / 3.6, "ft/s": 0.3048,
          "mph": 0.44704, "kn": 1852.0 / 3600.0}  # fmt: skip
ACCELERATIONS = {"m/s^2": 1.0, "m/s2": 1.0, "cm/s^2": 1e-2, "ft/s^2": 0.3048, "g": 9.80665}
_UNITS = {"t": TIMES, "x": LENGTHS | {DEGREES: 1.0}, "v": SPEEDS, "a": ACCELERATIONS}
_SPELLED = {  # in headers
    **{"sec": "s", "seconds": "s", "msec": "ms", "usec": "us", "hr": "h", "hours": "h"},
    **{"meters": "m", "metres": "m", "°": DEGREES, "degrees": DEGREES},
    **{"m s-1": "m/s", "cm s-1": "cm/s", "kmh": "km/h", "kph": "km/h", "kt": "kn", "knots": "kn"},
}
_TYPED = re.compile(r"(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]")
_HEADING = re.compile(r"(?P<name>.+?)\s*(?:\[(?P<unit>[^\[\]]*)\]|\((?P<other>[^()]*)\))")
_GEOGRAPHIC = ("lon", "lat")  # how names of columns begin that hold degrees


def factor_of(name: str, unit: str) -> float:
    """Return the SI value of one ``unit`` of a field; 1 for degrees and for no unit.

    Args:
        name: of the field: ``time``, ``x``, ``y``, ``vx``, ``vy``, ``ax`` or ``ay``.
        unit: as written in the log; empty for the SI unit.

    Raises:
        InputError: naming the known units, where it is none of them.
    """
    units, unit = _UNITS["x" if name == "y" else name[0]], _SPELLED.get(unit, unit)
    if unit and unit not in units:
        raise InputError(f"{name}: {unknown('unit', unit, units)}")
    return units[unit] if unit else 1.0


def named(ratio: float, units: Mapping[str, float], within: float = 0.02) -> str:
    """Return the unit that is ``ratio`` of the first of ``units``, to a share; else nothing."""
    near = (unit for unit, one in list(units.items())[1:] if abs(ratio / one - 1.0) < within)
    return next(near, "")


@dataclass(frozen=True)
class Source:
    """Where a field is read from.

    Args:
        column: the name of the column, as the header spells it.
        unit: empty for s, m and m/s.
    """

    column: str
    unit: str = ""

    def __str__(self) -> str:
        plain = not self.unit or _heading(self.column)[1] == self.unit
        return self.column if plain else f"{self.column} [{self.unit}]"


@dataclass(frozen=True)
class Layout:
    """The reading of a table.

    Args:
        sources: the fields that a column map names; none where the table is as this package
            writes it.
        only: a column and the text in it of the rows that are read; None for all rows.
        anchor: where and when the zeros shall be, of a log that has places and times; its own
            middle and its first sample where nothing is said.
    """

    sources: Mapping[str, Source] = field(default_factory=dict)
    only: tuple[str, str] | None = None
    anchor: Anchor = Anchor()

    @classmethod
    def of(
        cls, columns: Columns = None, only: str | None = None, anchor: Anchor | None = None
    ) -> Layout:
        """Return the layout of ``time=t,x=lon[deg],...``, or of a mapping, and ``column=value``.

        Raises:
            InputError: on a field that is none, or is given twice, and on an unknown unit.
        """
        sources: dict[str, Source] = {}
        for name, text in _pairs(columns):
            one_of("field", name, FIELDS)
            if name in sources:
                raise InputError(f"columns: {name} is given twice; keep one")
            match = _TYPED.fullmatch(text)
            column, unit = (match["name"], match["unit"].strip()) if match else (text, "")
            factor_of(name, unit)
            sources[name] = Source(column, _SPELLED.get(unit, unit))
        if only is None:
            return cls(sources, None, anchor or Anchor())
        column, equals, value = str(only).partition("=")
        if not equals or not column.strip():
            raise InputError(f'"{only}" is not column=value, as in id=7')
        return cls(sources, (column.strip(), value.strip()), anchor or Anchor())

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
        for name in FIELDS:
            source = self.sources.get(name)
            if source is not None:
                wanted = source.column
                exact = _named(f"{wanted} [{source.unit}]", names) if source.unit else []
                columns = exact or _named(wanted, names)
                if not columns:
                    raise InputError(f'no column "{wanted}"{suggestion(wanted, names)}')
                geographic = name in "xy" and wanted.casefold().startswith(_GEOGRAPHIC)
            else:
                columns, geographic = _named(name, names), False
                if not columns or (self.foreign and name in THRUST):
                    continue
                source = Source(name)
            if len(columns) > 1:
                raise InputError(f"column {columns[0]} appears more than once; keep one of each")
            unit = source.unit or _heading(columns[0])[1] or (DEGREES if geographic else "")
            factor_of(name, unit)
            chosen[name] = Source(columns[0], unit)
        pairs = [pair for pair in (VELOCITY, THRUST) if set(pair) & set(chosen)]
        wanted_fields = (*POSITIONS, *chain.from_iterable(pairs)) if chosen else COLUMNS
        missing = [name for name in wanted_fields if name not in chosen]
        if missing:
            raise InputError(_lacks(missing, names))
        if len({chosen[name].unit == DEGREES for name in "xy"}) > 1:
            words = f"x = {chosen['x']}, y = {chosen['y']}"
            raise InputError(f"columns: {words}: both are degrees, or none; say [deg] or [m]")
        return chosen

    def refuse_any(self, kind: str) -> None:
        """Raise `InputError` if anything is asked of a kind of file whose columns are its own."""
        if self.sources or self.only:
            raise InputError(f"{kind} tells its own columns; leave columns and only out")


def is_number(text: str) -> bool:
    """Whether a cell is a number, infinite or NaN too, with a decimal point or comma."""
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _pairs(columns: Columns) -> list[tuple[str, str]]:
    """The fields and columns of a column map."""
    if columns is None:
        return []
    if isinstance(columns, Mapping):
        return [(str(name), str(text)) for name, text in columns.items()]
    if not isinstance(columns, str):
        raise InputError(
            f"columns must be text or a mapping, as time=t,x=lon,y=lat; got {columns!r}"
        )
    pairs = [pair.partition("=") for pair in columns.split(",")]
    for name, equals, text in pairs:
        if not equals or not name.strip() or not text.strip():
            words = f"{name}{equals}{text}".strip()
            raise InputError(f'columns: "{words}" is not field=column, as in time=t,x=lon,y=lat')
    return [(name.strip(), text.strip()) for name, _, text in pairs]


def _heading(text: str) -> tuple[str, str]:
    """The name of a column, and the unit behind it as this module spells it."""
    match = _HEADING.fullmatch(text)
    unit = (match["unit"] or match["other"] or "").strip() if match else ""
    return (match["name"] if match else text), _SPELLED.get(unit, unit)


def _named(wanted: str, names: list[str]) -> list[str]:
    """The headings that are a name: exactly, or but for their unit, or their case."""
    for key in (
        lambda heading: heading,
        lambda heading: _heading(heading)[0],
        lambda heading: _heading(heading)[0].casefold(),
    ):
        headings = [name for name in names if key(name) == key(wanted)]
        if headings:
            return headings
    return []


def _lacks(missing: list[str], names: list[str]) -> str:
    lack, header = ", ".join(missing), ascii(", ".join(names)[:200])[1:-1] or "nothing"
    if names and all(is_number(name) for name in names):
        return f"no column {lack}: the first line holds numbers; put the names of columns above it"
    remedy = "rename or add it, or say which it is: --columns time=t,x=lon,..."
    return f"no column {lack}; found {header}; {remedy}"
