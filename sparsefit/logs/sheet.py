"""From a table as its file holds it to a flight: rows of one vehicle, SI units, a local plane.

Every format of tables ends here. Times may be ISO 8601: they become seconds since the first, UTC
where they name no zone. Longitude and latitude become metres (`sparsefit.logs.plane`).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from shlex import quote

import numpy as np

from sparsefit.arrays import IntArray
from sparsefit.errors import InputError, suggestion
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.logs.anchor import Anchor
from sparsefit.logs.column import Cells, Column
from sparsefit.logs.layout import Layout, Source
from sparsefit.logs.plane import plane_of
from sparsefit.logs.table import THRUST, FlightTable
from sparsefit.logs.units import DEGREES, factor_of

_VEHICLES = {"vehicle", "drifter", "buoy", "platform", "aircraft", "callsign", "flight", "trip",
             "trajectory", "icao24", "tail", "registration", "device", "ship", "mmsi"}  # fmt: skip
_ENDS = {"id", "identifier"}  # of such a name: drifter_id
_MANY = 2  # samples of each vehicle at least, in the mean: a column of row numbers names none
_SHOWN = 3  # vehicles that a refusal lists


@dataclass(frozen=True)
class Sheet:
    """A table as its file holds it, before it is known which of its columns are a flight.

    Args:
        names: of the columns.
        read: the cells of columns, by name.
        row: what a row, counted from 0, is called in the file: ``line 7``.
        settings: as of `FlightTable`.
        frame: likewise.
        commas: whether a comma in a number is a decimal mark, as between semicolons.
    """

    names: list[str]
    read: Callable[[list[str]], Mapping[str, Cells]]
    row: Callable[[int], str]
    settings: dict[str, float] = field(default_factory=dict)
    frame: str = ""
    commas: bool = False

    def flight_table(self, layout: Layout) -> FlightTable:
        """The columns that are a flight, read by a layout.

        Raises:
            InputError: naming the column, and the row where it is one, if a column is missing, rows
                are of several vehicles, a value is no number, or degrees are none.
            MissingExtra: where there are degrees, without pyproj.
        """
        sources = layout.chosen(self.names)
        used = {source.column for source in sources.values()}
        naming = [name for name in self.names if name not in used and _names_vehicle(name)]
        read = self._columns([*used, *naming, *_filtered(layout, self.names)])
        if layout.only is not None:
            kept = _said(read[layout.only[0]], layout.only[1])
            read = {name: column.taken(kept) for name, column in read.items()}
        for name in naming:
            _check_one_vehicle(name, Counter(read[name].words()))
        columns, epoch = {}, None
        for name, source in sources.items():
            column = read[source.column]
            if name == "time" and not source.unit and column.tells_moments:
                columns[name], epoch = column.since_first()
            else:
                columns[name] = factor_of(name, source.unit) * column.numbers()
        table = FlightTable(columns, self.settings, self.frame, anchor=Anchor(None, epoch))
        return _settled(table, sources, layout)

    def _columns(self, names: list[str]) -> dict[str, Column]:
        cells = self.read(list(dict.fromkeys(names)))
        return {name: Column(name, one, self.row, self.commas) for name, one in cells.items()}


def check_size(rows: int) -> None:
    """Raise `InputError` where a table has more rows than a flight may have samples."""
    if rows > MOST_SAMPLES:
        words = f"{rows} rows are more than the {MOST_SAMPLES} that a flight may have"
        raise InputError(f"{words}; cut it into pieces")


def _filtered(layout: Layout, names: list[str]) -> list[str]:
    """The column that says which rows are read, where one does."""
    if layout.only is None:
        return []
    column, _ = layout.only
    if column not in names:
        raise InputError(f'no column "{column}"{suggestion(column, names)}')
    return [column]


def _said(column: Column, wanted: str) -> IntArray:
    """The rows in which a column says what is wanted."""
    words = np.array(column.words(), dtype=object)
    kept = np.flatnonzero(words == wanted)
    if len(words) and not len(kept):
        raise InputError(f"no row has {column.name}={wanted}; there is {_listed(Counter(words))}")
    return kept


def _names_vehicle(name: str) -> bool:
    """Whether a column is called as one that names a vehicle: Id, drifter, flight_id, ..."""
    words = re.split(r"[^a-z0-9]+", name.casefold())
    return name.casefold() in _VEHICLES or words[-1] in _ENDS


def _check_one_vehicle(column: str, counts: Mapping[str, int]) -> None:
    """Refuse rows of several vehicles, by their numbers, unless they only count the rows."""
    if len(counts) < 2 or sum(counts.values()) < _MANY * len(counts):
        return
    first = min(counts)
    raise InputError(
        f"column {column} names {len(counts)} vehicles ({_listed(counts)}): a flight is of one; "
        f"read the rows of one (--only {quote(f'{column}={first}')}, from Python only=...)"
    )


def _listed(counts: Mapping[str, int]) -> str:
    words = sorted(counts)
    return ", ".join(words[:_SHOWN]) + (", ..." if len(words) > _SHOWN else "")


def _settled(table: FlightTable, sources: Mapping[str, Source], layout: Layout) -> FlightTable:
    """The table in metres, with a note of what it was read from where that is not plain."""
    told = ", ".join(f"{name} = {source}" for name, source in sources.items())
    plain = all(name == str(source) for name, source in sources.items())
    notes = () if plain and not layout.foreign else (told,)
    if sources["x"].unit != DEGREES:
        return replace(table, notes=notes)
    columns, anchor = dict(table.columns), table.anchor
    if len(columns["x"]):
        named = sources["x"].column, sources["y"].column
        plane = plane_of(columns["x"], columns["y"], named, layout.anchor.origin)
        anchor = replace(anchor, origin=plane.origin)
        columns["x"], columns["y"] = plane.position.T
        for x, y in (("vx", "vy"), THRUST):
            if x in columns:
                eastward = np.column_stack([columns[x], columns[y]])
                columns[x], columns[y] = plane.turned(eastward).T
        notes = (*notes, plane.words)
    return replace(table, columns=columns, frame="ENU", notes=notes, anchor=anchor)
