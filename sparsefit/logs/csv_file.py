"""Flight tables as text: a header, one row per sample, settings in ``# key=value`` lines.

Between cells stand commas, semicolons, tabs or blanks, whichever the header has; where it is no
comma, a comma in a number is its decimal mark.
"""

from __future__ import annotations

import csv
import io
import re
from array import array
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from sparsefit.errors import InputError
from sparsefit.logs.flight_table import FlightTable, Settings, settings_of
from sparsefit.logs.layout import Cells, Layout, check_size

_LONGEST = 1 << 16  # bytes of a line


def encode(table: FlightTable) -> bytes:
    """Return the file's content, in UTF-8; numbers, by repr, read back to the same floats."""
    lines = [f"# {key}={text}" for key, text in table.texts().items()]
    lines.append(",".join(table.columns))
    rows = zip(*(column.tolist() for column in table.columns.values()), strict=True)
    lines.extend(",".join(map(repr, row)) for row in rows)
    return ("\n".join(lines) + "\n").encode()


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the table in a file, read by a layout; memory is that of the columns it needs.

    Raises:
        InputError: naming line and column, if it is no CSV, lacks a column or a value is no number.
    """
    ends, entries, numbers = 0, list[tuple[str, str, str]](), array("q")
    while block := file.read(_LONGEST):  # a bomb costs nothing
        here = max(block.count(b"\n"), block.count(b"\r"))
        if not here and len(block) == _LONGEST:
            words = f"line {ends + 1} is longer than {_LONGEST} bytes: not a CSV file"
            raise InputError(f"{words}; check quotes and line ends")
        ends += here
        check_size(ends - 1)
    file.seek(0)
    text = io.TextIOWrapper(file, "utf-8-sig")

    def lines() -> Iterator[tuple[int, str]]:
        """Yield numbers and lines of header and rows one by one."""
        for number, line in enumerate(text, 1):
            if "#" in line and line.lstrip().startswith("#"):  # others than settings are text
                if match := re.fullmatch(r"#\s*([A-Za-z_]\w*)\s*=(.*)", line.strip()):
                    entries.append((f"line {number}", match[1], match[2]))
            elif line.strip(",;\t\n "):
                yield number, line

    def read(wanted: list[str]) -> tuple[dict[str, Cells], Settings]:
        texts: dict[str, list[str]] = {name: [] for name in wanted}
        pairs = [(column.append, names.index(name)) for name, column in texts.items()]
        for number, line in rows:
            cells = _cells(line, delimiter)
            if len(cells) != len(names):
                words = f"{len(cells)} cells, the header has {len(names)}"
                raise InputError(f"line {number} has {words}; repair that line")
            numbers.append(number)
            for append, place in pairs:
                append(cells[place])
        for name, column in texts.items():  # a comma that parts no cells is a decimal mark
            if delimiter != "," and not any("." in cell for cell in column):
                texts[name] = [cell.replace(",", ".") for cell in column]
        arrays = {name: np.array(column, dtype=object) for name, column in texts.items()}
        return arrays, settings_of(entries, strict=not layout.sources)

    try:
        _, header = next(rows := lines(), (0, ""))
        best = max(",;\t", key=header.count)
        delimiter = best if best in header or " " not in header.strip() else " "
        names = [name.strip() for name in _cells(header, delimiter)] if header else []
        return layout.flight_table(names, read, lambda row: f"line {numbers[row]}")
    except UnicodeError:
        words = "no text in UTF-8; expected CSV with the header time,x,y,vx,vy: save it as UTF-8"
        raise InputError(words) from None
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}; check quotes and line ends") from None
    finally:
        text.detach()


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' in line:
        return next(csv.reader([line.strip("\n")], delimiter=delimiter, skipinitialspace=True))
    return line.split(delimiter)
