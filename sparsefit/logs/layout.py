"""From the columns of a table to a flight: ``time=t,x=lon,vx=u[cm/s]``, SI units, a local plane.

A field (``time``, ``x``, ``y``, ``vx``, ``vy``, ``ax``, ``ay``) is read from the column that a map
names, else from the one of its own name, whatever its case; ``ax`` and ``ay``, a measured
acceleration of the propulsion, beside a map only where it says so. The unit is that of the map,
else the one behind the name in the header, ``u [cm/s]`` or ``u (cm/s)``, else the SI unit. Columns
that a map names and that begin with ``lon`` and ``lat`` are degrees, and become metres
(`sparsefit.logs.plane`). Times may be ISO 8601: they become seconds since the first, UTC where they
name no zone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, one_of, pair, suggestion, unknown
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.logs.flight_table import COLUMNS, POSITIONS, PUSH, VELOCITY, FlightTable, number
from sparsefit.logs.plane import plane_of

Cells: TypeAlias = "np.ndarray[Any, Any]"
"""The cells of a column, (m,): numbers, moments (``datetime64``) or texts (objects)."""
ANGLES = {"deg": 1.0, "°": 1.0, "degrees": 1.0}
LENGTHS = {"m": 1.0, "metres": 1.0, "meters": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3, "ft": 0.3048,
           "mi": 1609.344, "nmi": 1852.0} | ANGLES  # fmt: skip
UNITS = {
    "t": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9,
          "min": 60.0, "h": 3600.0, "d": 86400.0},
    "x": LENGTHS,
    "y": LENGTHS,
    "v": {"m/s": 1.0, "mm/s": 1e-3, "cm/s": 1e-2, "km/s": 1e3, "km/h": 1.0 / 3.6, "ft/s": 0.3048,
          "mph": 0.44704, "kn": 1852.0 / 3600.0, "knots": 1852.0 / 3600.0},
    "a": {"m/s^2": 1.0, "m/s2": 1.0, "cm/s^2": 1e-2, "ft/s^2": 0.3048, "g": 9.80665},
}  # fmt: skip


class Source(NamedTuple):
    """The column that a field is read from, as the header spells it, and its unit, if any."""

    column: str
    unit: str = ""

    @classmethod
    def of(cls, heading: str) -> Source:
        """Return the name of a column and the unit behind it, ``u [cm/s]`` or ``u (cm/s)``."""
        match = re.fullmatch(r"(.+?)\s*(?:\[([^\[\]]*)\]|\(([^()]*)\))", heading)
        return cls(match[1], (match[2] or match[3] or "").strip()) if match else cls(heading)

    def factor(self, name: str) -> float:
        """Return the SI value of a unit of a field, 1 for degrees; `InputError` on a wrong unit."""
        units = UNITS[name[0]]
        if self.unit and self.unit not in units:
            raise InputError(f"{name}: {unknown('unit', self.unit, units)}")
        return units[self.unit] if self.unit else 1.0

    def headings(self, names: list[str]) -> list[str]:
        """Return the names that are the column: exactly, but for their unit, or their case."""
        for key in (str, lambda name: Source.of(name).column,
                    lambda name: Source.of(name).column.casefold()):  # fmt: skip
            if same := [name for name in names if key(name) == key(self.column)]:
                return same
        return []

    def __str__(self) -> str:
        plain = not self.unit or Source.of(self.column).unit == self.unit
        return self.column if plain else f"{self.column} [{self.unit}]"


@dataclass(frozen=True)
class Layout:
    """The reading of a table.

    Args:
        sources: the fields that a column map names; none where the table is as this package
            writes it.
        origin: longitude and latitude [degrees] where x = y = 0 shall be, of a log that has places;
            None: its own middle.
        epoch: the time where t = 0 shall be, of a log that has times; None: its first sample.
    """

    sources: Mapping[str, Source] = field(default_factory=dict)
    origin: tuple[float, float] | None = None
    epoch: datetime | None = None

    @classmethod
    def of(
        cls,
        columns: str | None = None,
        origin: tuple[float, float] | None = None,
        epoch: str | datetime | None = None,
    ) -> Layout:
        """Return the layout of ``time=t,x=lon[deg],...``.

        Raises:
            InputError: on a field that is none, or is given twice, on an unknown unit, and on an
                origin or epoch that is none.
        """
        if columns is not None and not isinstance(columns, str):
            raise InputError(f"columns must be text, time=t,x=lon,y=lat; got {columns!r}")
        sources: dict[str, Source] = {}
        for text in columns.split(",") if columns else ():
            name, _, column = (part.strip() for part in text.partition("="))
            if not name or not column:
                raise InputError(f'columns: "{text}" is not NAME=VALUE, as in time=t')
            one_of("field", name, (*COLUMNS, *PUSH))
            if name in sources:
                raise InputError(f"columns: {name} is given twice; keep one")
            sources[name] = Source.of(column)
            sources[name].factor(name)
        place = None if origin is None else pair("origin", origin, "degrees")
        if place is not None and not (abs(place[0]) <= 360.0 and abs(place[1]) <= 90.0):
            raise InputError(f"origin must be longitude and latitude in degrees; got {place}")
        moment = _moment(str(epoch)) if isinstance(epoch, str | datetime) else None
        if epoch is not None and moment is None:
            raise InputError(f"epoch must be an ISO time, 2012-07-22T14:15:00, say; got {epoch!r}")
        return cls(sources, place, moment)

    def chosen(self, names: list[str]) -> dict[str, Source]:
        """Return the sources of all fields that a table with these columns has.

        Raises:
            InputError: where a column is missing or stands twice.
        """
        chosen: dict[str, Source] = {}
        for name in (*COLUMNS, *PUSH):
            source, mapped = self.sources.get(name, Source(name)), name in self.sources
            headings = source.headings(names)
            if not mapped and (not headings or (self.sources and name in PUSH)):
                continue
            if not headings:
                raise InputError(f'no column "{source.column}"{suggestion(source.column, names)}')
            if len(headings) > 1:
                raise InputError(f"column {headings[0]} appears more than once; keep one of each")
            degrees = mapped and source.column.casefold().startswith(("lon", "lat"))
            unit = source.unit or Source.of(headings[0]).unit or "deg" * degrees
            chosen[name] = Source(headings[0], unit)
        pairs = [pair for pair in (VELOCITY, PUSH) if set(pair) & set(chosen)]
        needed = (*POSITIONS, *sum(pairs, ())) if chosen else COLUMNS
        if missing := [name for name in needed if name not in chosen]:
            header = ascii(", ".join(names)[:200])[1:-1] or "nothing"
            remedy = "rename or add it, or say which it is: --columns time=t,x=lon,..."
            raise InputError(f"no column {', '.join(missing)}; found {header}; {remedy}")
        if (chosen["x"].unit in ANGLES) != (chosen["y"].unit in ANGLES):
            words = f"x = {chosen['x']}, y = {chosen['y']}"
            raise InputError(f"columns: {words}: both are degrees, or none; say [deg] or [m]")
        return chosen

    def refuse_any(self, kind: str) -> None:
        """Raise `InputError` if a map is given of a kind of file whose columns are its own."""
        if self.sources:
            raise InputError(f"{kind} tells its own columns; leave columns out")

    def flight_table(
        self,
        names: list[str],
        read: Callable[[list[str]], Mapping[str, Cells]],
        row: Callable[[int], str],
        head: Callable[[], Mapping[str, Any]],
    ) -> FlightTable:
        """Return the columns of a table that are a flight, in metres and seconds.

        Args:
            names: of the columns.
            read: reads the cells of columns, by name.
            row: the words for a row, counted from 0, in the file: ``line 7``.
            head: says settings, flow and frame of a `FlightTable`, when all is read.

        Raises:
            InputError: naming the column, and the row where it is one, if a column is missing, a
                value is no number, or degrees are none.
            MissingExtra: where there are degrees, without pyproj.
        """
        sources = self.chosen(names)
        used = [*dict.fromkeys(source.column for source in sources.values())]
        cells = read(used)
        values: dict[str, Array] = {}
        epoch = origin = None
        for name, source in sources.items():

            def at(place: int, column: str = source.column) -> str:
                return f"{row(place)}, column {column}"

            own, timed = cells[source.column], name == "time" and not source.unit
            if moments := _since_first(own, at) if timed else None:
                values[name], epoch = moments
            else:
                values[name] = source.factor(name) * _numbers(own, at)
        words = ", ".join(f"{name} = {source}" for name, source in sources.items())
        plain = not self.sources and all(name == str(own) for name, own in sources.items())
        notes, said = () if plain else (words,), dict(head())
        if sources["x"].unit in ANGLES:
            said["frame"] = "ENU"
            if len(values["x"]):
                headings = sources["x"].column, sources["y"].column
                plane = plane_of(values["x"], values["y"], headings, self.origin)
                origin, notes = plane.origin, (*notes, plane.words)
                values["x"], values["y"] = plane.position.T
                for x, y in (VELOCITY, PUSH):
                    if x in values:
                        eastward = np.column_stack([values[x], values[y]])
                        values[x], values[y] = plane.turned(eastward).T
        return FlightTable(values, **said, notes=notes, origin=origin, epoch=epoch)


def check_size(rows: int) -> None:
    """Raise `InputError` where a table has more rows than a flight may have samples."""
    if rows > MOST_SAMPLES:
        words = f"{rows} rows are more than the {MOST_SAMPLES} that a flight may have"
        raise InputError(f"{words}; cut it into pieces")


def moment_at(microseconds: int) -> datetime | None:
    """Return the time so many microseconds after 1970 began; None beyond all calendars."""
    try:
        return datetime.fromtimestamp(0, UTC) + timedelta(microseconds=microseconds)
    except OverflowError:
        return None


def _moment(text: str) -> datetime | None:
    """The time that a calendar names, UTC where no zone is named; None of anything else."""
    try:
        moment = datetime.fromisoformat(text.strip())
    except ValueError:
        return None
    return moment if moment.tzinfo else moment.replace(tzinfo=UTC)


def _numbers(cells: Cells, at: Callable[[int], str]) -> Array:
    """The numbers (m,). Raises `InputError`, naming the row, where a cell is none."""
    if cells.dtype.kind == "M" and len(cells):
        raise InputError(f"{at(0)} is a time; it must be a number")
    try:
        values: Array = cells.astype(np.float64)
    except ValueError:
        values = np.full(1, np.nan)
    texts = cells.dtype.kind == "O"
    if not np.isfinite(values).all() or (texts and any("_" in cell for cell in cells)):
        for row, cell in enumerate(cells):
            number(str(cell), at(row))
    return values


def _since_first(cells: Cells, at: Callable[[int], str]) -> tuple[Array, datetime | None] | None:
    """Seconds since the first moment (m,), and that moment; None where the first is a number.

    Raises InputError, naming the row, where a cell is no moment.
    """
    if cells.dtype.kind == "M" and len(cells):
        empty = np.flatnonzero(np.isnat(cells))
        if len(empty):
            raise InputError(f"{at(int(empty[0]))} is empty; repair or drop it")
        first = cells[:1].astype("datetime64[us]").astype(np.int64)
        return (cells - cells[:1]) / np.timedelta64(1, "s"), moment_at(*first.tolist())
    if cells.dtype.kind != "O" or not len(cells):
        return None
    with suppress(ValueError):
        float(cells[0])
        return None
    moments: list[datetime] = []
    for row, cell in enumerate(cells):
        if (moment := _moment(cell)) is None:
            kind = "not an ISO time" if row else "neither a finite number nor an ISO time"
            words = f"{at(row)}: {cell.strip()[:40]!a} is {kind}, 2012-07-22T14:15:00"
            raise InputError(f"{words}; repair or drop it")
        moments.append(moment)
    return np.array([(own - moments[0]).total_seconds() for own in moments]), moments[0]
