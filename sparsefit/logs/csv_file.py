"""Flight tables as text: a header, one row per sample, settings in ``# key=value`` lines.

Between cells stand commas, semicolons, tabs or blanks, whichever the header has; where it is no
comma, a comma in a number is its decimal mark. UTF-8, UTF-16 with its mark, or else Windows-1252.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice

from sparsefit.errors import InputError, unknown
from sparsefit.logs.column import Cells
from sparsefit.logs.layout import Layout
from sparsefit.logs.sheet import Sheet, check_size
from sparsefit.logs.table import KEYS, FlightTable, frame_of, is_key, number

_SETTING = re.compile(r"#\s*([A-Za-z_]\w*)\s*=(.*)")
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1f]")  # in no text
_LOOKED_AT = 1 << 16  # bytes
_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def encode(table: FlightTable) -> bytes:
    """Return the file's content, in UTF-8; its numbers read back to the same floats."""
    # The shortest digits that do are those of repr.
    lines = [f"# {key}={value!r}" for key, value in table.settings.items()]
    lines += [f"# frame={table.frame}"] if table.frame else []
    lines.append(",".join(table.columns))
    rows = zip(*(column.tolist() for column in table.columns.values()), strict=True)
    lines.extend(",".join(map(repr, row)) for row in rows)
    return ("\n".join(lines) + "\n").encode()


def decode(content: bytes, layout: Layout) -> FlightTable:
    """Return the table in a file's content, read by a layout.

    Raises:
        InputError: naming line and column, if it is no CSV, lacks a column or a value is no number.
    """
    check_size(content.count(b"\n") - 1)
    text = _Text(content, _encoding(content))
    settings, frame = _settings(text.lines(), foreign=layout.foreign)
    delimiter = _delimiter(next(filter(None, map(str.strip, text.plain())), ""))
    try:
        _, header = next(text.rows(delimiter), (0, []))
        names = [name.strip() for name in header]

        def row(place: int) -> str:
            line, _ = next(islice(text.rows(delimiter), place + 1, None))
            return f"line {line}"

        def read(wanted: list[str]) -> dict[str, Cells]:
            return _read(text.rows(delimiter), names, wanted)

        sheet = Sheet(names, read, row, settings, frame, commas=delimiter != ",")
        return sheet.flight_table(layout)
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}; check quotes and line ends") from None


@dataclass(frozen=True)
class _Text:
    """A file's text, decoded anew by whoever reads it: a long one is never held as text."""

    content: bytes
    encoding: str

    def lines(self) -> Iterator[str]:
        """Every line."""
        return io.TextIOWrapper(io.BytesIO(self.content), self.encoding, errors="replace")

    def plain(self) -> Iterator[str]:
        """The same, comments as empty lines so that the count stays right."""
        for line in self.lines():
            yield "" if line.lstrip().startswith("#") else line.strip(" \n")

    def rows(self, delimiter: str) -> Iterator[tuple[int, list[str]]]:
        """Line numbers and cells of the header and of every row; empty lines are none."""
        reader = csv.reader(self.plain(), delimiter=delimiter, skipinitialspace=delimiter == " ")
        for row in reader:
            if any(cell.strip() for cell in row):
                yield reader.line_num, row


def _encoding(content: bytes) -> str:
    """How the text of a file is encoded. Raises InputError where it is none."""
    head = content[:_LOOKED_AT]
    if head.startswith(_MARKS):
        return "utf-16"
    # Numbers are the same in all encodings of a spreadsheet but the first.
    for encoding in () if _BINARY.search(head) else ("utf-8-sig", "cp1252"):
        with suppress(UnicodeDecodeError):
            content.decode(encoding)
            return encoding
    raise InputError("not a text file; expected CSV with the header time,x,y,vx,vy")


def _settings(lines: Iterable[str], *, foreign: bool) -> tuple[dict[str, float], str]:
    """Read the ``# key=value`` lines; comments of any other form are free text.

    So are all others of a ``foreign`` table.
    """
    settings: dict[str, float] = {}
    frame = ""
    for count, line in enumerate(lines, start=1):
        match = _SETTING.fullmatch(line.strip()) if "#" in line else None
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


def _read(
    rows: Iterator[tuple[int, list[str]]], names: list[str], wanted: list[str]
) -> dict[str, Cells]:
    """The cells of the wanted columns."""
    cells: dict[str, list[str]] = {name: [] for name in wanted}
    pairs = [(one.append, names.index(name)) for name, one in cells.items()]
    for line, row in islice(rows, 1, None):
        if len(row) != len(names):
            raise InputError(
                f"line {line} has {len(row)} cells, the header has {len(names)}; repair that line"
            )
        for append, place in pairs:
            append(row[place])
    return dict(cells)


def _delimiter(header: str) -> str:
    """What stands between the cells: the most frequent of three, or blanks."""
    best = max(",;\t", key=header.count)
    return best if best in header or " " not in header else " "
