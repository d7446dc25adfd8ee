"""Flight tables as text: a header, one row per sample, settings in ``# key=value`` lines.

Cells are separated by commas, semicolons, tabs or blanks, whichever the header has; where it is no
comma, a comma in a number is its decimal mark. A header may be the comment above the first row, as
numpy.savetxt writes it, and Excel's first line ``sep=;`` is passed over.
"""

from __future__ import annotations

import csv
import io
import re
from array import array
from collections.abc import Iterator
from itertools import chain
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
    """Return the table in a file, read by a layout; only the columns that it needs are kept.

    Raises:
        InputError: naming line and column, if it is no CSV, lacks a column or a value is no number.
    """
    ends, entries, comment, numbers = 0, list[tuple[str, str, str]](), "", array("q")
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
        nonlocal comment
        for number, line in enumerate(text, 1):
            if "#" in line and line.lstrip().startswith("#"):  # others than settings are text
                if match := re.fullmatch(r"#\s*([A-Za-z_]\w*)\s*=(.*)", line.strip()):
                    entries.append((f"line {number}", match[1], match[2]))
                else:
                    comment = line.lstrip("# ")
            elif line.strip(",;\t\n ") and not (number == 1 and re.fullmatch("sep=.\n", line)):
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
        pointed = (cell for column in texts.values() for cell in column if "." in cell)
        if delimiter != "," and all("," in cell or ":" in cell for cell in pointed):
            for name, own in texts.items():  # the decimal mark is a comma
                texts[name] = [cell if "." in cell else cell.replace(",", ".") for cell in own]
        arrays = {name: np.array(column, dtype=object) for name, column in texts.items()}
        return arrays, settings_of(entries, strict=not layout.sources)

    try:
        rows: Iterator[tuple[int, str]] = lines()
        first = _, header = next(rows, (0, ""))
        delimiter, above = _delimiter(header), _cells(comment, _delimiter(comment))
        names = _cells(header, delimiter) if header else []
        if re.match(r"\s*[-+.\d]", header) and len(names) == len(above):
            names, rows = above, chain([first], rows)
        names = [name.strip() for name in names]
        return layout.flight_table(names, read, lambda row: f"line {numbers[row]}")
    except UnicodeError:
        words = "no text in UTF-8; expected CSV with the header time,x,y,vx,vy: save it as UTF-8"
        raise InputError(words) from None
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}; check quotes and line ends") from None
    finally:
        text.detach()


def _delimiter(header: str) -> str:
    best = max(",;\t", key=header.count)
    return best if best in header or " " not in header.strip() else " "


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.replace('"', " ").split()
    if '"' in line:
        return next(csv.reader([line.strip("\n")], delimiter=delimiter, skipinitialspace=True))
    return line.split(delimiter)
