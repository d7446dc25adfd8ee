"""From the columns of a table to a flight: ``time=t,x=lon,vx=u[cm/s]``, SI units, a local plane.

A field is read from the column that a map names, else from the one of its own name, whatever its
case; with a map, ``ax`` and ``ay`` only if it names them. The unit is that of the map, else the one
behind the name in the header, ``u [cm/s]`` or ``u (cm/s)``, else the SI unit. Columns in a map
whose names begin with ``lon`` and ``lat`` are degrees. ISO 8601 times become seconds since the
first, in UTC if they name no zone.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, pair, suggestion
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.logs.flight_table import COLUMNS, PAIRS, POSITIONS, FlightTable, Settings, number
from sparsefit.logs.plane import plane_of

Cells: TypeAlias = "np.ndarray[Any, Any]"
"""The cells of a column, (m,): numbers, moments (``datetime64``) or texts (objects)."""
ANGLES = {"deg": 1.0, "rad": math.degrees(1.0), "degE7": 1e-7}
LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048, "mi": 1609.344,
           "nmi": 1852.0, **ANGLES}  # fmt: skip
UNITS = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0},
    "x": LENGTHS,
    "y": LENGTHS,
    "v": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/s": 1e3, "km/h": 1.0 / 3.6, "ft/s": 0.3048,
          "mph": 0.44704, "kn": 1852.0 / 3600.0},
    "a": {"m/s^2": 1.0, "cm/s^2": 1e-2, "ft/s^2": 0.3048, "g": 9.80665},
}  # fmt: skip
SPELLINGS = {"sec": "s", "µs": "us", "μs": "us", "°": "deg", "kt": "kn", "kts": "kn",
             "knots": "kn", "m s-1": "m/s", "m/s2": "m/s^2", "m/s²": "m/s^2",
             "m s-2": "m/s^2"}  # fmt: skip


class Source(NamedTuple):
    """The column that a field is read from, as the header spells it, and its unit, if any."""

    column: str
    unit: str = ""

    @classmethod
    def of(cls, heading: str) -> Source:
        """Return the name of a column and the unit behind it, ``u [cm/s]`` or ``u (cm/s)``."""
        match = re.fullmatch(r"(.+?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))", heading)
        return cls(match[1], (match[2] or match[3] or "").strip()) if match else cls(heading)

    def __str__(self) -> str:
        plain = not self.unit or Source.of(self.column).unit == self.unit
        return self.column if plain else f"{self.column} [{self.unit}]"


@dataclass(frozen=True)
class Layout:
    """The assignment of a table's columns to the fields of a flight."""

    sources: Mapping[str, Source] = field(default_factory=dict)  # the fields that a map names
    origin: tuple[float, float] | None = None  # longitude, latitude [degrees] of x = y = 0
    epoch: datetime | None = None  # the time of t = 0; None: the first sample

    @classmethod
    def of(
        cls,
        columns: str | None = None,
        origin: tuple[float, float] | None = None,
        epoch: str | datetime | None = None,
    ) -> Layout:
        """Return the layout of ``time=t,x=lon[deg],...``; `InputError` where a part is none."""
        sources: dict[str, Source] = {}
        for text in str(columns).split(",") if columns else ():
            name, _, column = (part.strip() for part in text.partition("="))
            if not name or not column:
                raise InputError(f'columns: "{text}" is not NAME=VALUE, as in time=t')
            one_of("field", name, COLUMNS)
            if name in sources:
                raise InputError(f"columns: {name} is given twice; keep one")
            sources[name] = Source.of(column)
        if origin is not None:
            origin = pair("origin", origin, "degrees")
            if not (abs(origin[0]) <= 360.0 and abs(origin[1]) <= 90.0):
                raise InputError(f"origin must be longitude and latitude in degrees; got {origin}")
        if epoch is not None:
            _, epoch = _since_first(np.array([str(epoch)], dtype=object), lambda _: "epoch")
        return cls(sources, origin, epoch)

    def chosen(self, names: list[str]) -> dict[str, Source]:
        """Return the sources of all fields that a table with these columns has.

        Raises:
            InputError: if a column is missing or appears twice, or its unit is unknown.
        """
        chosen: dict[str, Source] = {}
        bare = [(heading, Source.of(heading).column) for heading in names]
        for name in COLUMNS:
            source, mapped = self.sources.get(name, Source(name)), name in self.sources
            folded = source.column.casefold()
            headings = [own for own, column in bare if column == source.column]
            headings = headings or [own for own, column in bare if column.casefold() == folded]
            if not mapped and (not headings or (self.sources and name in ("ax", "ay"))):
                continue
            if not headings:
                raise InputError(f'no column "{source.column}"{suggestion(source.column, names)}')
            if len(headings) > 1:
                raise InputError(f"column {headings[0]} appears more than once; keep one of each")
            degrees = mapped and folded.startswith(("lon", "lat"))
            unit = source.unit or Source.of(headings[0]).unit or "deg" * degrees
            unit = SPELLINGS.get(unit, unit)
            if unit:
                one_of(f"unit of {name}", unit, UNITS[name[0]])
            chosen[name] = Source(headings[0], unit)
        needed = [*POSITIONS, *sum((own for own in PAIRS if set(own) & set(chosen)), ())]
        if missing := [name for name in needed if name not in chosen]:
            header = ascii(", ".join(names)[:200])[1:-1] or "nothing"
            remedy = "rename or add it, or say which it is: --columns time=t,x=lon,..."
            raise InputError(f"no column {', '.join(missing)}; found {header}; {remedy}")
        if (chosen["x"].unit in ANGLES) != (chosen["y"].unit in ANGLES):
            words = f"x = {chosen['x']}, y = {chosen['y']}"
            raise InputError(f"columns: {words}: both are degrees, or none; say [deg] or [m]")
        return chosen

    def flight_table(
        self,
        names: list[str],
        read: Callable[[list[str]], tuple[Mapping[str, Cells], Settings]],
        row: Callable[[int], str],
    ) -> FlightTable:
        """Return the columns of a table that are a flight, in metres and seconds.

        Args:
            names: of the columns.
            read: returns the cells of columns, by name, and the settings of the file.
            row: the words for a row, counted from 0, in the file: ``line 7``.

        Raises:
            InputError: naming the column, and the row where it is one, if a column is missing, a
                value is no number, or degrees are none.
            MissingExtra: where there are degrees, without pyproj.
        """
        sources = self.chosen(names)
        used = dict.fromkeys(source.column for source in sources.values())
        cells, (settings, frame) = read([*used])
        if not len(cells[sources["time"].column]):
            raise InputError("there are no rows below the header; give the log of a flight")
        values: dict[str, Array] = {}
        epoch = origin = None
        for name, source in sources.items():
            own = cells[source.column]

            def at(place: int, column: str = source.column) -> str:
                return f"{row(place)}, column {column}"

            if name == "time" and not source.unit and _calendar(own):
                values[name], epoch = _since_first(own, at)
            else:
                values[name] = UNITS[name[0]].get(source.unit, 1.0) * _numbers(own, at)
        words = ", ".join(f"{name} = {source}" for name, source in sources.items())
        plain = not self.sources and all(name == str(own) for name, own in sources.items())
        notes = () if plain else (words,)
        if sources["x"].unit in ANGLES:
            headings = sources["x"].column, sources["y"].column
            plane = plane_of(values["x"], values["y"], headings, self.origin)
            frame, origin, notes = "ENU", plane.origin, (*notes, plane.words)
            values["x"], values["y"] = plane.position.T
            for x, y in PAIRS:
                if x in values:
                    values[x], values[y] = plane.turned(np.stack([values[x], values[y]], axis=1)).T
        return FlightTable(values, settings, frame, notes, origin, epoch)


def check_size(rows: int) -> None:
    """Raise `InputError` where a table has more rows than a flight may have samples."""
    if rows > MOST_SAMPLES:
        raise InputError(f"{rows} rows are more than the {MOST_SAMPLES} of a flight; cut the log")


def _numbers(cells: Cells, at: Callable[[int], str]) -> Array:
    """The numbers (m,). Raises `InputError`, naming the row, where a cell is none."""
    if cells.dtype.kind in "Mb":
        raise InputError(f"{at(0)} is of type {cells.dtype}; it must be a number")
    try:
        values: Array = cells.astype(np.float64)
    except (TypeError, ValueError):
        values = np.full(1, np.nan)
    texts = cells.dtype.kind == "O"
    if not np.isfinite(values).all() or (texts and any("_" in str(cell) for cell in cells)):
        for row, cell in enumerate(cells):
            number(str(cell), at(row))
    return values


def _calendar(cells: Cells) -> bool:
    """Whether cells are moments of a calendar: by their type, or as the first is no number."""
    if cells.dtype.kind != "O":
        return bool(cells.dtype.kind == "M")
    try:
        float(cells[0])
    except (TypeError, ValueError):
        return True
    return False


def _since_first(cells: Cells, at: Callable[[int], str]) -> tuple[Array, datetime]:
    """Seconds since the first moment (m,), and that moment.

    Raises InputError, naming the row, where a cell is no moment.
    """
    from pandas import Series, to_datetime

    moments = to_datetime(Series(cells), format="ISO8601", utc=True, errors="coerce")
    for row in np.flatnonzero(moments.isna() | (moments.dt.year > 9999))[:1]:
        cell = ascii(str(cells[row]).strip()[:40])
        raise InputError(
            f"{at(row)}: {cell} is no ISO time, 2012-07-22T14:15:00; repair or drop it"
        )
    seconds = np.asarray((moments - moments[0]).dt.total_seconds(), np.float64)
    return seconds, moments[0].to_pydatetime()
