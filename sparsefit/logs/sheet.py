"""From the columns of a table to a flight: rows of one vehicle, SI units, a local plane.

Every format of tables ends here. Times may be ISO 8601: they become seconds since the first, UTC
where they name no zone. Longitude and latitude become metres (`sparsefit.logs.plane`).
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any, TypeAlias

import numpy as np

from sparsefit.arrays import Array
from sparsefit.errors import InputError, suggestion
from sparsefit.flight.record import MOST_SAMPLES
from sparsefit.logs.flight_table import PUSH, VELOCITY, FlightTable, number
from sparsefit.logs.layout import Layout, factor_of, moment_of
from sparsefit.logs.plane import plane_of

Cells: TypeAlias = "np.ndarray[Any, Any]"
"""The cells of a column, (m,): numbers, moments (``datetime64``) or texts (objects)."""
_VEHICLES = {"vehicle", "drifter", "buoy", "platform", "aircraft", "callsign", "flight", "trip",
             "trajectory", "icao24", "tail", "registration", "device", "ship", "mmsi"}  # fmt: skip


_IDENTIFIER = re.compile(r"(^|[^a-z0-9])(id|identifier)$")


@dataclass(frozen=True)
class Sheet:
    """A table as its file holds it, before it is known which of its columns are a flight.

    Args:
        names: of the columns.
        read: the function that reads the cells of columns, by name.
        row: the words for a row, counted from 0, in the file: ``line 7``.
        head: the function that says settings, flow and frame of a `FlightTable`, when all is read.
    """

    names: list[str]
    read: Callable[[list[str]], Mapping[str, Cells]]
    row: Callable[[int], str]
    head: Callable[[], Mapping[str, Any]]

    def flight_table(self, layout: Layout) -> FlightTable:
        """Return the columns that are a flight, read by a layout, in metres and seconds.

        Raises:
            InputError: naming the column, and the row where it is one, if a column is missing, rows
                are of several vehicles, a value is no number, or degrees are none.
            MissingExtra: where there are degrees, without pyproj.
        """
        sources = layout.chosen(self.names)
        used = [source.column for source in sources.values()]
        naming = [
            name
            for name in self.names
            if name not in used
            and (name.casefold() in _VEHICLES or _IDENTIFIER.search(name.casefold()))
        ]
        if layout.only and layout.only[0] not in self.names:
            raise InputError(
                f'no column "{layout.only[0]}"{suggestion(layout.only[0], self.names)}'
            )
        cells = self.read([*dict.fromkeys([*used, *naming, *(layout.only or ())[:1]])])
        rows = np.arange(len(cells[used[0]]))
        if layout.only:
            words = _words(cells[layout.only[0]])
            rows = rows[np.array([word == layout.only[1] for word in words], dtype=bool)]
            if words and not len(rows):
                there = ", ".join(sorted(set(words))[:3])
                raise InputError(f"no row has {'='.join(layout.only)}; there is {there}, ...")
        for name in naming:
            counts = Counter(_words(cells[name][rows]))
            if len(counts) > 1 and len(rows) >= 2 * len(counts):  # else they number the rows
                few = ", ".join(sorted(counts)[:3])
                raise InputError(
                    f"column {name} names {len(counts)} vehicles ({few}): a flight is of one; "
                    f"read the rows of one (--only {name}={min(counts)}, from Python only=...)"
                )
        values: dict[str, Array] = {}
        epoch = None
        for name, (column, unit) in sources.items():
            series = cells[column][rows]

            def at(row: int, column: str = column) -> str:
                return f"{self.row(int(rows[row]))}, column {column}"

            if name == "time" and not unit and _is_moments(series):
                values[name], epoch = _since_first(series, at)
            else:
                values[name] = factor_of(name, unit) * _numbers(series, at)
        read = ", ".join(f"{name} = {source}" for name, source in sources.items())
        plain = not layout.foreign and all(name == str(own) for name, own in sources.items())
        notes, origin, head = () if plain else (read,), None, dict(self.head())
        if sources["x"].degrees:
            head["frame"] = "ENU"
            if len(rows):
                headings = sources["x"].column, sources["y"].column
                plane = plane_of(values["x"], values["y"], headings, layout.origin)
                origin, notes = plane.origin, (*notes, plane.words)
                values["x"], values["y"] = plane.position.T
                for x, y in (VELOCITY, PUSH):
                    if x in values:
                        eastward = np.column_stack([values[x], values[y]])
                        values[x], values[y] = plane.turned(eastward).T
        return FlightTable(values, **head, notes=notes, origin=origin, epoch=epoch)


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


def _words(cells: Cells) -> list[str]:
    """Every cell as text; whole numbers without a point."""
    return [str(cell).strip().removesuffix(".0") for cell in cells.tolist()]


def _is_moments(cells: Cells) -> bool:
    """Whether the first cell is a time of a calendar, or at least no number."""
    if cells.dtype.kind == "O" and len(cells):
        try:
            float(cells[0])
        except ValueError:
            return True
    return bool(cells.dtype.kind == "M")


def _numbers(cells: Cells, at: Callable[[int], str]) -> Array:
    """The numbers (m,). Raises `InputError`, naming the row, where a cell is none."""
    if cells.dtype.kind == "M":
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


def _since_first(cells: Cells, at: Callable[[int], str]) -> tuple[Array, datetime | None]:
    """Seconds since the first moment (m,), and that moment; `InputError` where a cell is none."""
    if cells.dtype.kind == "M":
        empty = np.flatnonzero(np.isnat(cells))
        if len(empty):
            raise InputError(f"{at(int(empty[0]))} is empty; repair or drop it")
        first = cells[:1].astype("datetime64[us]").astype(np.int64)
        return (cells - cells[:1]) / np.timedelta64(1, "s"), moment_at(*first.tolist())
    moments = [moment_of(cell) for cell in cells]
    if None in moments:
        row = moments.index(None)
        cell = ascii(cells[row].strip()[:40])
        kind = "neither a finite number nor an ISO time" if row == 0 else "not an ISO time"
        raise InputError(f"{at(row)}: {cell} is {kind}, 2012-07-22T14:15:00; repair or drop it")
    first_of = moments[0]
    seconds = [(moment - first_of).total_seconds() for moment in moments if moment and first_of]
    return np.array(seconds), first_of
