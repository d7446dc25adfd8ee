"""Flight tables as text: a header, one row per sample, settings in ``# key=value`` lines.

Between cells stand commas, semicolons, tabs or blanks, whichever the header has; where it is no
comma, a comma in a number is its decimal mark. UTF-8, UTF-16 with its mark, or else Windows-1252.
"""

from __future__ import annotations

import csv
import io
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO

import numpy as np

from sparsefit.errors import InputError
from sparsefit.logs.flight_table import FlightTable, said
from sparsefit.logs.layout import Layout
from sparsefit.logs.sheet import Cells, Sheet, check_size

_SETTING = re.compile(r"#\s*([A-Za-z_]\w*)\s*=(.*)")
_LONGEST = 1 << 16  # characters of a line
_BLANKS = r"\s+"
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
    marked, lines = file.read(2) in (BOM_UTF16_LE, BOM_UTF16_BE), 0
    while block := file.read(_LONGEST):
        lines += max(block.count(b"\n"), block.count(b"\r"))
        check_size(lines - 1)
    for encoding in ("utf-16",) if marked else ("utf-8-sig", "cp1252"):
        try:
            text = _Text(file, encoding)
        except UnicodeError:
            continue
        head = said(text.settings, strict=not layout.foreign)
        return Sheet(text.names, text.read, text.row, head).flight_table(layout)
    raise InputError(_NO_TEXT)


class _Text:
    """The text of a file, decoded anew by every reader: a long one is never held as text."""

    def __init__(self, file: BinaryIO, encoding: str) -> None:
        """Look through a file line by line, so that a bomb costs nothing.

        Raises:
            InputError: where it is no text, has a line that is too long, or a row of more or fewer
                cells than the header.
            UnicodeError: where it is of another encoding.
        """
        self.file, self.encoding, self.delimiter, self.rows = file, encoding, ",", 0
        self.names: list[str] = []
        self.settings: list[tuple[str, str, str]] = []
        self.skipped: list[int] = []  # lines, from 0, that are no row
        with self.lines() as text:
            for place, line in enumerate(iter(lambda: text.readline(_LONGEST + 1), "")):
                if len(line) > _LONGEST:
                    raise InputError(
                        f"line {place + 1} is longer than {_LONGEST} characters: not a CSV file; "
                        "check quotes and line ends"
                    )
                if "\0" in line:
                    raise InputError(_NO_TEXT)
                if "#" in line and line.lstrip().startswith("#"):  # others than settings are text
                    if match := _SETTING.fullmatch(line.strip()):
                        self.settings.append((f"line {place + 1}", match[1], match[2]))
                    self.skipped.append(place)
                elif not line.strip(",;\t\n "):
                    self.skipped.append(place)
                elif not self.names:
                    best = max(",;\t", key=line.count)
                    self.delimiter = best if best in line or " " not in line.strip() else _BLANKS
                    self.names = self.cells(line)
                    self.skipped.append(place)
                else:
                    self.rows += 1
                    plain = '"' not in line and self.delimiter != _BLANKS
                    count = line.count(self.delimiter) + 1 if plain else len(self.cells(line))
                    if count != len(self.names):
                        words = f"line {place + 1} has {count} cells, the header has"
                        raise InputError(f"{words} {len(self.names)}; repair that line")

    @contextmanager
    def lines(self) -> Iterator[io.TextIOWrapper]:
        """The file from its begin, line ends of any kind."""
        self.file.seek(0)
        text = io.TextIOWrapper(self.file, self.encoding)
        try:
            yield text
        finally:
            text.detach()

    def cells(self, line: str) -> list[str]:
        """The cells of a line."""
        if self.delimiter == _BLANKS:
            return line.split()
        cells = next(
            csv.reader([line.rstrip("\n")], delimiter=self.delimiter, skipinitialspace=True)
        )
        return [cell.strip() for cell in cells]

    def row(self, place: int) -> str:
        """The words for a row, counted from 0."""
        for line in self.skipped:
            place += line <= place
        return f"line {place + 1}"

    def read(self, wanted: list[str]) -> dict[str, Cells]:
        """The texts of columns, a comma in a number as a point where it does not part cells."""
        import pandas as pd

        places = [self.names.index(name) for name in wanted]
        columns: dict[str, Cells] = {name: np.empty(0, object) for name in wanted}
        if not self.rows:
            return columns
        with self.lines() as text:
            frame = pd.read_csv(
                text, sep=self.delimiter, header=None, names=range(len(self.names)),
                usecols=places, skiprows=self.skipped, dtype=str, keep_default_na=False,
                skip_blank_lines=False, skipinitialspace=True, index_col=False,
            )  # fmt: skip
        for name, place in zip(wanted, places, strict=True):
            cells = frame.pop(place)  # type: ignore[arg-type]
            if self.delimiter != "," and not cells.str.contains(".", regex=False).any():
                cells = cells.str.replace(",", ".", regex=False)
            columns[name] = cells.to_numpy(object)
        return columns
