"""From the columns of a table to a flight: rows of one vehicle, SI units, a local plane.

Every format of tables ends here. Times may be ISO 8601: they become seconds since the first, UTC
where they name no zone. Longitude and latitude become metres (`sparsefit.logs.plane`).
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from shlex import quote
from typing import Any, TypeAlias

import numpy as np

from sparsefit.arrays import Array, IntArray
from sparsefit.errors import InputError, suggestion
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.logs.flight_table import THRUST, VELOCITY, Anchor, FlightTable, moment_at, moment_of
from sparsefit.logs.head import Head, finite_in, number
from sparsefit.logs.layout import DEGREES, Layout, factor_of, is_number
from sparsefit.logs.plane import plane_of

Cells: TypeAlias = "list[str] | np.ndarray[Any, Any]"
"""Texts, or an array of numbers or of moments (``datetime64``)."""
_NEITHER = "neither a finite number nor an ISO time, 2012-07-22T14:15:00"
_VEHICLES = {"vehicle", "drifter", "buoy", "platform", "aircraft", "callsign", "flight", "trip",
             "trajectory", "icao24", "tail", "registration", "device", "ship", "mmsi"}  # fmt: skip
_ENDS = {"id", "identifier"}  # of such a name: drifter_id
_MANY = 2  # samples of each vehicle at least, in the mean: a column of row numbers names none
_SHOWN = 3  # vehicles that a refusal lists


@dataclass(frozen=True, eq=False)
class SheetColumn:
    """The cells of one column.

    Args:
        name: of the column, as the header spells it.
        cells: its values, a row each.
        row: the words for a row, counted from 0, in the file: ``line 7``.
        commas: whether a comma in a number is a decimal mark.
    """

    name: str
    cells: Cells
    row: Callable[[int], str]
    commas: bool = False

    def taken(self, rows: IntArray) -> SheetColumn:
        """Return the column of some of the rows."""
        if isinstance(self.cells, np.ndarray):
            cells: Cells = self.cells[rows]
        else:
            cells = [self.cells[row] for row in rows]
        return SheetColumn(self.name, cells, lambda row: self.row(int(rows[row])), self.commas)

    def words(self) -> list[str]:
        """Return every cell as text; whole numbers without a point."""
        if isinstance(self.cells, np.ndarray):
            return [str(cell).removesuffix(".0") for cell in self.cells.tolist()]
        return [cell.strip() for cell in self.cells]

    @property
    def has_moments(self) -> bool:
        """Whether the first cell is a time of a calendar, or at least no number."""
        if isinstance(self.cells, np.ndarray):
            return bool(self.cells.dtype.kind == "M")
        return bool(self.cells) and not is_number(self.cells[0])

    def numbers(self) -> Array:
        """Return the numbers (m,). Raises `InputError`, naming the row, where a cell is none."""
        if isinstance(self.cells, np.ndarray):
            if self.has_moments:
                raise InputError(f"column {self.name} holds times; it must hold numbers")
            texts, values = [], self.cells.astype(np.float64)
        else:
            texts = self.cells
            if self.commas and any("," in text for text in texts):
                if any("." in text for text in texts):
                    words = f"column {self.name} has numbers with commas and with points"
                    raise InputError(f"{words}; write them without marks between thousands")
                texts = [text.replace(",", ".") for text in texts]
            try:
                values = np.fromiter(map(float, texts), np.float64, len(texts))
            except ValueError:
                values = np.full(1, np.nan)
        if not np.isfinite(values).all() or any("_" in text for text in texts):
            texts = texts or list(map(str, values.tolist()))
            row, *others = (row for row, text in enumerate(texts) if math.isnan(finite_in(text)))
            more = f" and {len(others)} more such rows (a gap is mended)" if others else ""
            number(texts[row], f"{self.row(row)}, column {self.name}", more)
        return values

    def since_first(self) -> tuple[Array, datetime | None]:
        """Return seconds since the first moment (m,), and that moment.

        Raises:
            InputError: naming the row, where a cell is no ISO time.
        """
        if isinstance(self.cells, np.ndarray):
            empty = np.flatnonzero(np.isnat(self.cells))
            if len(empty):
                place = f"{self.row(int(empty[0]))}, column {self.name}"
                raise InputError(f"{place} is empty; repair or drop it")
            if not len(self.cells):
                return np.zeros(0), None
            epoch = moment_at(int(self.cells[0].astype("datetime64[us]").astype(np.int64)))
            return (self.cells - self.cells[0]) / np.timedelta64(1, "s"), epoch
        moments: list[datetime] = []
        for row, text in enumerate(self.cells):
            moment = moment_of(text)
            if moment is None:
                kind = "not an ISO time as those before" if row else _NEITHER
                place = f"{self.row(row)}, column {self.name}"
                raise InputError(f"{place}: {text.strip()[:40]!a} is {kind}; repair or drop it")
            moments.append(moment)
        seconds = [(moment - moments[0]).total_seconds() for moment in moments]
        return np.array(seconds), moments[0]


@dataclass(frozen=True)
class Sheet:
    """A table as its file holds it, before it is known which of its columns are a flight.

    Args:
        names: of the columns.
        read: the function that reads the cells of columns, by name.
        row: the words for a row, counted from 0, in the file: ``line 7``.
        head: as of `FlightTable`.
        commas: whether a comma in a number is a decimal mark, as between semicolons.
    """

    names: list[str]
    read: Callable[[list[str]], Mapping[str, Cells]]
    row: Callable[[int], str]
    head: Head = Head()
    commas: bool = False

    def flight_table(self, layout: Layout) -> FlightTable:
        """Return the columns that are a flight, read by a layout, in metres and seconds.

        Raises:
            InputError: naming the column, and the row where it is one, if a column is missing, rows
                are of several vehicles, a value is no number, or degrees are none.
            MissingExtra: where there are degrees, without pyproj.
        """
        sources = layout.chosen(self.names)
        if layout.only is not None and layout.only[0] not in self.names:
            only = layout.only[0]
            raise InputError(f'no column "{only}"{suggestion(only, self.names)}')
        used = [source.column for source in sources.values()]
        naming = [name for name in self.names if name not in used and _names_vehicle(name)]
        wanted = dict.fromkeys([*used, *naming, *(layout.only or ())[:1]])
        columns = {
            name: SheetColumn(name, cells, self.row, self.commas)
            for name, cells in self.read(list(wanted)).items()
        }
        if layout.only is not None:
            words = np.array(columns[layout.only[0]].words(), dtype=object)
            rows = np.flatnonzero(words == layout.only[1])
            if len(words) and not len(rows):
                there = _listed(Counter(words))
                raise InputError(f"no row has {'='.join(layout.only)}; there is {there}")
            columns = {name: column.taken(rows) for name, column in columns.items()}
        for name in naming:
            _check_one_vehicle(name, Counter(columns[name].words()))
        values: dict[str, Array] = {}
        epoch, origin, head = None, None, self.head
        for name, source in sources.items():
            column = columns[source.column]
            if name == "time" and not source.unit and column.has_moments:
                values[name], epoch = column.since_first()
            else:
                values[name] = factor_of(name, source.unit) * column.numbers()
        plain = all(name == str(source) for name, source in sources.items())
        reading = ", ".join(f"{name} = {source}" for name, source in sources.items())
        notes = () if plain and not layout.foreign else (reading,)
        if sources["x"].unit == DEGREES:
            head = replace(head, frame="ENU")
            if len(values["x"]):
                headings = sources["x"].column, sources["y"].column
                plane = plane_of(values["x"], values["y"], headings, layout.anchor.origin)
                origin, notes = plane.origin, (*notes, plane.words)
                values["x"], values["y"] = plane.position.T
                for x, y in (VELOCITY, THRUST):
                    if x in values:
                        eastward = np.column_stack([values[x], values[y]])
                        values[x], values[y] = plane.turned(eastward).T
        return FlightTable(values, head, notes, Anchor(origin, epoch))


def check_size(rows: int) -> None:
    """Raise `InputError` where a table has more rows than a flight may have samples."""
    if rows > MOST_SAMPLES:
        words = f"{rows} rows are more than the {MOST_SAMPLES} that a flight may have"
        raise InputError(f"{words}; cut it into pieces")


def _names_vehicle(name: str) -> bool:
    """Whether a column is called as one that names a vehicle: Id, drifter, flight_id, ..."""
    words = re.split(r"[^a-z0-9]+", name.casefold())
    return name.casefold() in _VEHICLES or words[-1] in _ENDS


def _check_one_vehicle(column: str, counts: Mapping[str, int]) -> None:
    """Refuse rows of several vehicles, by their numbers, unless they only count the rows."""
    if len(counts) < 2 or sum(counts.values()) < _MANY * len(counts):
        return
    raise InputError(
        f"column {column} names {len(counts)} vehicles ({_listed(counts)}): a flight is of one; "
        f"read the rows of one (--only {quote(f'{column}={min(counts)}')}, from Python only=...)"
    )


def _listed(counts: Mapping[str, int]) -> str:
    words = sorted(counts)
    return ", ".join(words[:_SHOWN]) + (", ..." if len(words) > _SHOWN else "")
