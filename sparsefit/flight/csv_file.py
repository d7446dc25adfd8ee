"""Flight tables as CSV: a header, one row per sample, settings in ``# key=value`` lines."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import datetime

from sparsefit.errors import InputError, unknown
from sparsefit.flight.anchor import Anchor
from sparsefit.flight.layout import (
    Layout,
    Reader,
    Source,
    check_one_vehicle,
    epoch_of,
    reader_of,
    settled,
    vehicle_columns,
)
from sparsefit.flight.table import KEYS, FlightTable, frame_of, is_key, number

_SETTING = re.compile(r"#\s*([A-Za-z_]\w*)\s*=(.*)")


def encode(table: FlightTable) -> bytes:
    """Return the file's content, in UTF-8; its numbers read back to the same floats."""
    # The shortest digits that do are those of repr.
    lines = [f"# {key}={value!r}" for key, value in table.settings.items()]
    lines += [f"# frame={table.frame}"] if table.frame else []
    lines.append(",".join(table.columns))
    rows = zip(*table.columns.values(), strict=True)
    lines.extend(",".join(map(repr, row)) for row in rows)
    return ("\n".join(lines) + "\n").encode()


def decode(content: bytes, layout: Layout) -> FlightTable:
    """Return the table in a file's content, read by a layout.

    Raises:
        InputError: naming line and column, if it is no CSV, lacks a column or a value is no number.
    """
    try:
        lines = content.decode("utf-8-sig").splitlines()
        settings, frame = _settings(lines, foreign=layout.foreign)
        columns, sources, epoch = _columns(lines, layout)
        table = FlightTable(columns, settings, frame, anchor=Anchor(None, epoch))
        return settled(table, sources, layout) if layout.foreign else table
    except UnicodeDecodeError:
        raise InputError("not a text file; expected CSV with the header time,x,y,vx,vy") from None
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}; check quotes and line ends") from None


def _settings(lines: list[str], *, foreign: bool) -> tuple[dict[str, float], str]:
    """Read the ``# key=value`` lines; comments of any other form are free text.

    So are all others of a ``foreign`` table.
    """
    settings: dict[str, float] = {}
    frame = ""
    for count, line in enumerate(lines, start=1):
        match = _SETTING.fullmatch(line.strip())
        if match is None:
            continue
        key, value = match.groups()
        if key in settings or (key == "frame" and frame):
            raise InputError(f"line {count}: {key} is given twice; keep one")
        if key == "frame":
            frame = frame_of(value, f"line {count}")
        elif is_key(key):
            settings[key] = number(value, f"line {count}, {key}")
        elif not foreign:
            raise InputError(f"line {count}: {unknown('key', key, KEYS)}")
    return settings, frame


def _columns(
    lines: list[str], layout: Layout
) -> tuple[dict[str, list[float]], dict[str, Source], datetime | None]:
    """The columns in SI units, what they were read from, and when the first row was."""
    rows = _rows(lines, layout)
    _, header = next(rows, (0, []))
    names = [name.strip() for name in header]
    sources = layout.chosen(names)
    places = [(name, names.index(source.column)) for name, source in sources.items()]
    columns: dict[str, list[float]] = {name: [] for name, _ in places}
    readers: dict[str, Reader] = {}
    epoch: datetime | None = None
    for line, row in _of_one_vehicle(rows, names, sources, layout):
        if not readers:
            readers = {name: reader_of(name, sources[name], row[p]) for name, p in places}
            epoch = epoch_of(sources["time"], row[dict(places)["time"]])
        for name, place in places:
            where = f"line {line}, column {names[place]}"
            columns[name].append(readers[name](row[place], where))
    return columns, sources, epoch


def _of_one_vehicle(
    rows: Iterator[tuple[int, list[str]]],
    names: list[str],
    sources: Mapping[str, Source],
    layout: Layout,
) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows that the layout takes; InputError at the end where they are of several."""
    counts = {names.index(column): Counter[str]() for column in vehicle_columns(names, sources)}
    place, wanted = layout.filtered(names)
    for line, row in rows:
        if len(row) != len(names):
            raise InputError(
                f"line {line} has {len(row)} cells, the header has {len(names)}; repair that line"
            )
        if place is not None and row[place].strip() != wanted:
            continue
        for column, count in counts.items():
            count[row[column].strip()] += 1
        yield line, row
    for column, count in counts.items():
        check_one_vehicle(names[column], count)


def _rows(lines: list[str], layout: Layout) -> Iterator[tuple[int, list[str]]]:
    """Yield line numbers and cells; comments become empty lines so that the count stays right."""
    plain = ["" if line.lstrip().startswith("#") else line for line in lines]
    header = next(filter(None, map(str.strip, plain)), "")
    reader = csv.reader(plain, delimiter=_delimiter(header) if layout.foreign else ",")
    for row in reader:
        if any(cell.strip() for cell in row):
            yield reader.line_num, row


def _delimiter(header: str) -> str:
    """What stands between the cells of a foreign table: the most frequent of three."""
    return max(",;\t", key=header.count)
