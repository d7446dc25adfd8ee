"""Flight tables as CSV: a header, one row per sample, settings in ``# key=value`` lines."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator

from sparsefit.errors import InputError, unknown
from sparsefit.flight.table import KEYS, FlightTable, columns_of, is_key, number

_SETTING = re.compile(r"#\s*([A-Za-z_]\w*)\s*=(.*)")


def encode(table: FlightTable) -> bytes:
    """Return the file's content, in UTF-8; its numbers read back to the same floats."""
    # The shortest digits that do are those of repr.
    lines = [f"# {key}={value!r}" for key, value in table.settings.items()]
    lines.append(",".join(table.columns))
    rows = zip(*table.columns.values(), strict=True)
    lines.extend(",".join(map(repr, row)) for row in rows)
    return ("\n".join(lines) + "\n").encode()


def decode(content: bytes) -> FlightTable:
    """Return the table in a file's content.

    Raises:
        InputError: naming line and column, if it is no CSV, lacks a column or a value is no number.
    """
    try:
        lines = content.decode("utf-8-sig").splitlines()
        return FlightTable(columns=_columns(lines), settings=_settings(lines))
    except UnicodeDecodeError:
        raise InputError("not a text file; expected CSV with the header time,x,y,vx,vy") from None
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}; check quotes and line ends") from None


def _settings(lines: list[str]) -> dict[str, float]:
    """Read the ``# key=value`` lines; comments of any other form are free text."""
    settings: dict[str, float] = {}
    for count, line in enumerate(lines, start=1):
        match = _SETTING.fullmatch(line.strip())
        if match is None:
            continue
        key, value = match.groups()
        if not is_key(key):
            raise InputError(f"line {count}: {unknown('key', key, KEYS)}")
        if key in settings:
            raise InputError(f"line {count}: {key} is given twice; keep one")
        settings[key] = number(value, f"line {count}, {key}")
    return settings


def _columns(lines: list[str]) -> dict[str, list[float]]:
    rows = _rows(lines)
    _, header = next(rows, (0, []))
    names = [name.strip() for name in header]
    places = [(name, names.index(name)) for name in columns_of(names)]
    columns: dict[str, list[float]] = {name: [] for name, _ in places}
    for line, row in rows:
        if len(row) != len(names):
            raise InputError(
                f"line {line} has {len(row)} cells, the header has {len(names)}; repair that line"
            )
        for name, place in places:
            columns[name].append(number(row[place], f"line {line}, column {name}"))
    return columns


def _rows(lines: list[str]) -> Iterator[tuple[int, list[str]]]:
    """Yield line numbers and cells; comments become empty lines so that the count stays right."""
    reader = csv.reader("" if line.lstrip().startswith("#") else line for line in lines)
    for row in reader:
        if any(cell.strip() for cell in row):
            yield reader.line_num, row
