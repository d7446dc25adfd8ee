"""Flight tables as text: a header, one row per sample, settings in ``# key=value`` lines.

Between cells stand commas, semicolons, tabs or blanks, whichever the header has; where it is no
comma, a comma in a number is its decimal mark. UTF-8, UTF-16 with its mark, or else Windows-1252.
"""

from __future__ import annotations

import csv
import io
import re
from array import array
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Generator, Iterator
from contextlib import closing
from typing import BinaryIO

import numpy as np

from sparsefit.errors import InputError
from sparsefit.logs.flight_table import FlightTable, said
from sparsefit.logs.layout import Layout
from sparsefit.logs.sheet import Cells, Sheet, check_size

_SETTING = re.compile(r"#\s*([A-Za-z_]\w*)\s*=(.*)")
_LONGEST = 1 << 16  # characters of a line
_NO_TEXT = "not a text file; expected CSV with the header time,x,y,vx,vy"


def encode(table: FlightTable) -> bytes:
    """Return the file's content, in UTF-8; its numbers read back to the same floats."""
    # The shortest digits that do are those of repr.
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
    marked, ends = file.read(2) in (BOM_UTF16_LE, BOM_UTF16_BE), 0
    while block := file.read(_LONGEST):
        ends += max(block.count(b"\n"), block.count(b"\r"))
        check_size(ends - 1)
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252"):
        settings: list[tuple[str, str, str]] = []
        try:
            with closing(_lines(file, encoding, settings)) as lines:
                return _sheet(lines, settings, strict=not layout.foreign).flight_table(layout)
        except UnicodeError:
            continue
        except csv.Error as error:
            raise InputError(f"not a CSV file: {error}; check quotes and line ends") from None
    raise InputError(_NO_TEXT)


def _sheet(
    lines: Iterator[tuple[int, str]], settings: list[tuple[str, str, str]], *, strict: bool
) -> Sheet:
    """The table of a file: its header is read, and its rows when they are asked for."""
    _, header = next(lines, (0, ""))
    best = max(",;\t", key=header.count)
    delimiter = best if best in header or " " not in header.strip() else " "
    names = [name.strip() for name in _cells(header, delimiter)] if header else []
    numbers = array("q")

    def read(wanted: list[str]) -> dict[str, Cells]:
        texts: dict[str, list[str]] = {name: [] for name in wanted}
        pairs = [(column.append, names.index(name)) for name, column in texts.items()]
        for number, line in lines:
            cells = _cells(line, delimiter)
            if len(cells) != len(names):
                words = f"line {number} has {len(cells)} cells, the header has {len(names)}"
                raise InputError(f"{words}; repair that line")
            numbers.append(number)
            for append, place in pairs:
                append(cells[place])
        for name, column in texts.items():  # a comma that parts no cells is a decimal mark
            if delimiter != "," and not any("." in cell for cell in column):
                texts[name] = [cell.replace(",", ".") for cell in column]
        return {name: np.array(column, dtype=object) for name, column in texts.items()}

    return Sheet(
        names, read, lambda row: f"line {numbers[row]}", lambda: said(settings, strict=strict)
    )


def _lines(
    file: BinaryIO, encoding: str, settings: list[tuple[str, str, str]]
) -> Generator[tuple[int, str]]:
    """Yield numbers and lines of header and rows; settings are filled on the way.

    A file is read line by line, so that a bomb costs nothing.

    Raises:
        InputError: where it is no text, or has a line that is too long.
    """
    file.seek(0)
    text = io.TextIOWrapper(file, encoding)
    try:
        for number, line in enumerate(iter(lambda: text.readline(_LONGEST + 1), ""), 1):
            if len(line) > _LONGEST:
                raise InputError(
                    f"line {number} is longer than {_LONGEST} characters: not a CSV file; check "
                    "quotes and line ends"
                )
            if "\0" in line:
                raise InputError(_NO_TEXT)
            if "#" in line and line.lstrip().startswith("#"):  # others than settings are text
                if match := _SETTING.fullmatch(line.strip()):
                    settings.append((f"line {number}", match[1], match[2]))
            elif line.strip(",;\t\n "):
                yield number, line
    finally:
        text.detach()


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return line.split()
    if '"' in line:
        return next(csv.reader([line.strip("\n")], delimiter=delimiter, skipinitialspace=True))
    return line.split(delimiter)
