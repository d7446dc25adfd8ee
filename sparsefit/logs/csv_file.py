"""Flight tables as text: a header, one row per sample, settings in ``# key=value`` lines.

Between cells stand commas, semicolons, tabs or blanks, whichever the header has; where it is no
comma, a comma in a number is its decimal mark. UTF-8, UTF-16 with its mark, or else Windows-1252.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from typing import BinaryIO

from sparsefit.errors import InputError
from sparsefit.logs.flight_table import FlightTable
from sparsefit.logs.head import Head
from sparsefit.logs.layout import Layout
from sparsefit.logs.sheet import Cells, Sheet, check_size

_SETTING = re.compile(r"#\s*([A-Za-z_]\w*)\s*=(.*)")
_BINARY = re.compile(rb"[\x00-\x08\x0e-\x1f]")  # in no text
_LONGEST = 1 << 16  # bytes of a line
_MARKS = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)


def encode(table: FlightTable) -> bytes:
    """Return the file's content, in UTF-8; its numbers read back to the same floats."""
    # The shortest digits that do are those of repr.
    lines = [f"# {key}={text}" for key, text in table.head.texts().items()]
    lines.append(",".join(table.columns))
    rows = zip(*(column.tolist() for column in table.columns.values()), strict=True)
    lines.extend(",".join(map(repr, row)) for row in rows)
    return ("\n".join(lines) + "\n").encode()


def decode(file: BinaryIO, layout: Layout) -> FlightTable:
    """Return the table in a file, read by a layout; memory is that of the columns it needs.

    Raises:
        InputError: naming line and column, if it is no CSV, lacks a column or a value is no number.
    """
    text = _Text(file, _encoding(file))
    matches = (
        (f"line {count}", match)
        for count, line in enumerate(text.lines(), start=1)
        if "#" in line and (match := _SETTING.fullmatch(line.strip()))
    )  # other comments, and a foreign table's, are text
    head = Head.parsed(
        ((at, match[1], match[2]) for at, match in matches), strict=not layout.foreign
    )
    header = next(filter(None, map(str.strip, text.plain())), "")
    best = max(",;\t", key=header.count)
    delimiter = best if best in header or " " not in header else " "
    try:
        names = [name.strip() for name in next(text.rows(delimiter), (0, []))[1]]

        def row(place: int) -> str:
            line, _ = next(islice(text.rows(delimiter), place + 1, None))
            return f"line {line}"

        def read(wanted: list[str]) -> dict[str, Cells]:
            cells: dict[str, list[str]] = {name: [] for name in wanted}
            pairs = [(column.append, names.index(name)) for name, column in cells.items()]
            for line, items in islice(text.rows(delimiter), 1, None):
                if len(items) != len(names):
                    words = f"line {line} has {len(items)} cells, the header has {len(names)}"
                    raise InputError(f"{words}; repair that line")
                for append, place in pairs:
                    append(items[place])
            return dict(cells)

        sheet = Sheet(names, read, row, head, commas=delimiter != ",")
        return sheet.flight_table(layout)
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}; check quotes and line ends") from None


@dataclass(frozen=True)
class _Text:
    """The text of a file, decoded anew by every reader: a long one is never held as text."""

    file: BinaryIO
    encoding: str

    def lines(self) -> Iterator[str]:
        """Yield every line, without its end, whatever that is."""
        decoder = io.IncrementalNewlineDecoder(
            codecs.getincrementaldecoder(self.encoding)(errors="replace"), translate=True
        )
        place, rest = 0, ""
        while block := (self.file.seek(place), self.file.read(_LONGEST))[1]:
            place += len(block)
            *lines, rest = (rest + decoder.decode(block)).split("\n")
            yield from lines
        yield rest

    def plain(self) -> Iterator[str]:
        """Yield every line, comments as empty ones so that the count stays right."""
        for line in self.lines():
            yield "" if line.lstrip().startswith("#") else line.strip(" ")

    def rows(self, delimiter: str) -> Iterator[tuple[int, list[str]]]:
        """Yield line numbers and cells of the header and of every row; empty lines are none."""
        reader = csv.reader(self.plain(), delimiter=delimiter, skipinitialspace=delimiter == " ")
        for row in reader:
            if any(cell.strip() for cell in row):
                yield reader.line_num, row


def _encoding(file: BinaryIO) -> str:
    """The encoding of a file's text; blocks of it are read, so that a bomb costs nothing.

    Raises:
        InputError: where it is no text, has too many lines or one that is too long.
    """
    file.seek(0)
    head, lines, utf8 = b"", 0, True
    decoder = codecs.getincrementaldecoder("utf-8")()
    while block := file.read(_LONGEST):
        ends = max(block.count(b"\n"), block.count(b"\r"))
        if not ends and len(block) == _LONGEST:
            raise InputError(
                f"line {lines + 1} is longer than {_LONGEST} bytes: not a CSV file; check quotes "
                "and line ends"
            )
        head, lines = head or block, lines + ends
        check_size(lines - 1)
        try:
            utf8 and decoder.decode(block)
        except UnicodeDecodeError:
            utf8 = False
    if head.startswith(_MARKS):
        return "utf-16"
    # Numbers are the same in all encodings of a spreadsheet but the first.
    encoding = "utf-8-sig" if utf8 else "cp1252"
    if _BINARY.search(head) or (not utf8 and "\ufffd" in head.decode(encoding, "replace")):
        raise InputError("not a text file; expected CSV with the header time,x,y,vx,vy")
    return encoding
