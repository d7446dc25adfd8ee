"""Which columns of a foreign table are a flight, and in which units: ``time=t,x=lon,vx=u[cm/s]``.

A field (``time``, ``x``, ``y``, ``vx``, ``vy``, ``ax``, ``ay``) is read from the column that it
names, in the unit in brackets, else in SI units; ``ax`` and ``ay``, a measured thrust, only where
the map says so. Columns whose names begin with ``lon`` and ``lat`` are degrees, and become metres
on a local plane (`sparsefit.flight.plane`). Times may be ISO 8601: they become seconds since the
first, UTC where they name no zone.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any, TypeAlias

import numpy as np

from sparsefit.errors import InputError, one_of, suggestion
from sparsefit.flight.anchor import Anchor, moment_of
from sparsefit.flight.plane import plane_of
from sparsefit.flight.table import COLUMNS, POSITIONS, THRUST, FlightTable, columns_of, number
from sparsefit.flight.units import DEGREES, factor_of

Columns: TypeAlias = "str | Mapping[str, str] | None"
"""A column map as it is typed, or as a mapping of fields to columns."""
FIELDS = (*COLUMNS, *THRUST)
Reader: TypeAlias = Callable[[str, str], float]  # of a cell and its place
_SOURCE = re.compile(r"(?P<name>.*?)\s*\[(?P<unit>[^\[\]]*)\]")
_GEOGRAPHIC = ("lon", "lat")  # how names of columns begin that hold degrees
_VEHICLES = {"vehicle", "drifter", "buoy", "platform", "aircraft", "callsign", "flight", "trip",
             "trajectory", "icao24", "tail", "registration", "device", "ship", "mmsi"}  # fmt: skip
_ENDS = {"id", "identifier"}  # of such a name: drifter_id
_MANY = 2  # samples of each vehicle at least, in the mean: a column of row numbers names none


@dataclass(frozen=True)
class Source:
    """Where a field is read from.

    Args:
        column: the name of the column.
        unit: empty for s, m and m/s.
    """

    column: str
    unit: str = ""

    def __str__(self) -> str:
        return f"{self.column} [{self.unit}]" if self.unit else self.column


@dataclass(frozen=True)
class Layout:
    """How a table is read.

    Args:
        sources: the fields that a column map names; none where the table is as this package
            writes it.
        only: a column and the text in it of the rows that are read; None for all rows.
        anchor: where and when the zeros shall be, of a log that tells places and times; its own
            middle and its first sample where nothing is said.
    """

    sources: Mapping[str, Source] = field(default_factory=dict)
    only: tuple[str, str] | None = None
    anchor: Anchor = Anchor()

    @classmethod
    def of(
        cls, columns: Columns = None, only: str | None = None, anchor: Anchor | None = None
    ) -> Layout:
        """Read ``time=t,x=lon[deg],...``, or a mapping, and ``column=value``.

        Raises:
            InputError: on a field that is none, or is given twice, and on an unknown unit.
        """
        sources: dict[str, Source] = {}
        for name, text in _pairs(columns):
            one_of("field", name, FIELDS)
            if name in sources:
                raise InputError(f"columns: {name} is given twice; keep one")
            sources[name] = _source(name, text)
        return cls(sources, None if only is None else _only(only), anchor or Anchor())

    @property
    def foreign(self) -> bool:
        """Whether the table is not one that this package has written."""
        return bool(self.sources)

    def chosen(self, names: list[str]) -> dict[str, Source]:
        """The sources of all fields that a table with these columns has.

        Raises:
            InputError: where a column is missing or stands twice.
        """
        if not self.foreign:
            return {name: Source(name) for name in columns_of(names)}
        rest = {name: Source(name) for name in COLUMNS if name in names}
        found = rest | {name: _present(source, names) for name, source in self.sources.items()}
        return _complete({name: found[name] for name in FIELDS if name in found}, names)

    def refuse_any(self, what: str) -> None:
        """Raise `InputError` if anything is asked of a file whose columns are its own."""
        if self.sources or self.only:
            raise InputError(f"{what} tells its own columns; leave columns and only out")

    def filtered(self, names: list[str]) -> tuple[int | None, str]:
        """The place of the column that says which rows are read, None for all, and its text there.

        Raises:
            InputError: where there is no such column.
        """
        if self.only is None:
            return None, ""
        column, value = self.only
        if column not in names:
            raise InputError(f'no column "{column}"{suggestion(column, names)}')
        return names.index(column), value


def _pairs(columns: Columns) -> Iterable[tuple[str, str]]:
    if columns is None:
        return []
    if isinstance(columns, Mapping):
        return [(str(name), str(text)) for name, text in columns.items()]
    pairs = [pair.partition("=") for pair in columns.split(",")]
    for name, equals, text in pairs:
        if not equals or not name.strip() or not text.strip():
            told = f"{name}{equals}{text}".strip()
            raise InputError(f'columns: "{told}" is not field=column, as in time=t,x=lon,y=lat')
    return [(name.strip(), text.strip()) for name, _, text in pairs]


def _source(name: str, text: str) -> Source:
    match = _SOURCE.fullmatch(text)
    column, unit = (match["name"], match["unit"].strip()) if match else (text, "")
    factor_of(name, unit)
    if not unit and name in "xy" and column.casefold().startswith(_GEOGRAPHIC):
        unit = DEGREES
    return Source(column, unit)


def _only(text: str) -> tuple[str, str]:
    column, equals, value = text.partition("=")
    if not equals or not column.strip():
        raise InputError(f'"{text}" is not column=value, as in id=7')
    return column.strip(), value.strip()


def _present(source: Source, names: list[str]) -> Source:
    """The source as the header spells it, where units may stand beside the names."""
    for spelled in (source.column, f"{source.column} [{source.unit}]",
                    f"{source.column}[{source.unit}]"):  # fmt: skip
        if spelled in names:
            return Source(spelled, source.unit)
    raise InputError(f'no column "{source.column}"{suggestion(source.column, names)}')


def _complete(found: dict[str, Source], names: list[str]) -> dict[str, Source]:
    missing = [name for name in POSITIONS if name not in found]
    for pair in (("vx", "vy"), THRUST):
        if len(set(pair) & set(found)) == 1:
            missing += set(pair) - set(found)
    if missing:
        lack, header = ", ".join(missing), ", ".join(names)[:200]
        raise InputError(f"columns: nothing says {lack}; the table has {header}")
    twice = [source.column for source in found.values() if names.count(source.column) > 1]
    if twice:
        raise InputError(f"column {', '.join(twice)} appears more than once; keep one of each")
    if len({found[name].unit == DEGREES for name in "xy"}) > 1:
        told = f"x = {found['x']}, y = {found['y']}"
        raise InputError(f"columns: {told}: both are degrees, or none; say [deg] or [m]")
    return found


def reader_of(name: str, source: Source, first: str) -> Reader:
    """What makes numbers of the cells of a column, in SI units or degrees.

    Args:
        name: the field.
        source: its column and unit.
        first: the first cell: times are ISO where it is.
    """
    if name == "time" and not source.unit and not _is_number(first):
        start = moment_of(first)
        return lambda text, place: _since(start, text, place)
    factor = factor_of(name, source.unit)
    return number if factor == 1.0 else lambda text, place: factor * number(text, place)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def epoch_of(source: Source, first: str) -> datetime | None:
    """The time of the first sample, where its cell names one; None of plain numbers."""
    return None if source.unit or _is_number(first) else moment_of(first)


def _since(start: datetime | None, text: str, place: str) -> float:
    moment = moment_of(text)
    if start is None or moment is None:
        shown = ascii(text.strip()[:40])
        kind = "a finite number nor an ISO time" if start is None else "an ISO time as those before"
        word = "is neither" if start is None else "is not"
        raise InputError(f"{place}: {shown} {word} {kind}; repair or drop it")
    return (moment - start).total_seconds()


def vehicle_columns(names: list[str], sources: Mapping[str, Source]) -> list[str]:
    """The columns that name a vehicle, by what they are called: Id, drifter, flight_id, ..."""
    used = {source.column for source in sources.values()}
    return [name for name in dict.fromkeys(names) if name not in used and _names_vehicle(name)]


def _names_vehicle(name: str) -> bool:
    words = re.split(r"[^a-z0-9]+", name.casefold())
    return name.casefold() in _VEHICLES or words[-1] in _ENDS


def check_one_vehicle(column: str, counts: Mapping[Any, int]) -> None:
    """Refuse rows of several vehicles.

    Args:
        column: that names them.
        counts: the number of rows of each value in it.

    Raises:
        InputError: if there are several, unless they only count the rows.
    """
    if len(counts) < 2 or sum(counts.values()) < _MANY * len(counts):
        return
    several = sorted(map(str, counts))
    shown = ", ".join(several[:3]) + (", ..." if len(several) > 3 else "")
    raise InputError(
        f"column {column} names {len(several)} vehicles ({shown}): a flight is of one; "
        f"read the rows of one (only {column}={several[0]})"
    )


def settled(table: FlightTable, sources: Mapping[str, Source], layout: Layout) -> FlightTable:
    """The table in metres, with a note of what it was read from.

    Args:
        table: as it was read, degrees as degrees; its anchor knows the time of its first sample.
        sources: what its columns were read from.
        layout: by which it was read.

    Raises:
        InputError: where degrees are no longitude and latitude.
        MissingExtra: where there are degrees, without pyproj.
    """
    notes = [", ".join(f"{name} = {source}" for name, source in sources.items())]
    if sources["x"].unit != DEGREES:
        return replace(table, notes=tuple(notes))
    columns = dict(table.columns)
    degrees = np.array(columns["x"]), np.array(columns["y"])
    anchor = table.anchor
    if len(degrees[0]):
        named = sources["x"].column, sources["y"].column
        plane = plane_of(*degrees, named, layout.anchor.origin)
        anchor = replace(anchor, origin=plane.origin)
        columns["x"], columns["y"] = plane.position.T.tolist()
        for x, y in (("vx", "vy"), THRUST):
            if x in columns:
                eastward = np.column_stack([columns[x], columns[y]])
                columns[x], columns[y] = plane.turned(eastward).T.tolist()
        notes.append(plane.words)
    return replace(table, columns=columns, frame="ENU", notes=tuple(notes), anchor=anchor)
