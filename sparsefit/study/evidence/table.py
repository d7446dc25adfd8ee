"""The `Table` record: what every renderer reads, and how one of its values becomes text."""

from __future__ import annotations

import itertools
import math
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd

Value: TypeAlias = str | float | int | bool | None
SIGNIFICANT = "significant"
NOTHING = "–"


@dataclass(frozen=True)
class Column:
    """One column: `group` is a heading shared with its neighbours, `tex` its name as TeX source.

    `format` is a Python format specification, or `SIGNIFICANT` for three significant digits
    without an exponent. `tex` is printed verbatim: nothing read from a file may stand there.
    `least`: a smaller size is rounding, which no two machines share. `varies`: whether the column
    is of one run on one machine: times, and certificates as small as rounding.
    """

    name: str
    unit: str = ""
    format: str = ""
    align: Literal["left", "right"] = "right"
    group: str = ""
    tex: str = ""
    least: float = 0.0
    varies: bool = False

    @property
    def heading(self) -> str:
        """Name and unit, `U0 [m/s]`."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def full_heading(self) -> str:
        """The heading with its group in front, for renderers of one heading line."""
        return f"{self.group} {self.heading}" if self.group else self.heading


@dataclass(frozen=True)
class Table:
    """A table to print: `shown` limits the rows of every renderer but CSV, which has them all."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    notes: tuple[str, ...] = ()
    shown: int | None = None

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"{len(row)} cells in a row of {len(self.columns)} columns")

    @property
    def varies(self) -> bool:
        """Whether another run of the same study prints other numbers."""
        return any(column.varies for column in self.columns)

    @property
    def visible_rows(self) -> tuple[tuple[Value, ...], ...]:
        """The rows that renderers other than CSV print."""
        return self.rows[: self.shown]

    @property
    def texts(self) -> list[list[str]]:
        """The visible cells as plain text."""
        return [
            [cell_text(cell, column) for cell, column in zip(row, self.columns, strict=True)]
            for row in self.visible_rows
        ]

    @property
    def remarks(self) -> tuple[str, ...]:
        """The notes, and what `shown` left out."""
        hidden = len(self.rows) - len(self.visible_rows)
        if not hidden:
            return self.notes
        return (*self.notes, f"Rows that only the CSV file of this table has: {hidden}.")


def cell_text(cell: Value, column: Column) -> str:
    """One cell as plain text: `–` for nothing or NaN, control characters made visible."""
    if cell is None:
        return NOTHING
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str):
        return printable(cell)
    return _number(cell, column)


def _number(value: float, column: Column) -> str:
    if math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    if column.format != SIGNIFICANT:
        return _signless_zero(format(value, column.format))
    return sized(value, column.least)


def sized(value: float, least: float) -> str:
    """Three significant digits, or that it is no larger than what is rounding."""
    return below(least) if abs(value) <= least * (1.0 + 1e-9) and least else significant(value)


def below(least: float) -> str:
    """`< 1e-6`."""
    return f"< {least:.0e}".replace("e-0", "e-")


def _signless_zero(text: str) -> str:
    """`-0.00` reads as a sign that is not there."""
    return text.lstrip("+-") if text[:1] in "+-" and not text.strip("+-0.") else text


def significant(value: float, digits: int = 3) -> str:
    """`value` with three significant digits, never an exponent between 1e-4 and 1e6."""
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    # From the rounded number: 99.97 is 100, not 100.0.
    power = int(f"{value:.{digits - 1}e}".partition("e")[2])
    decimals = digits - 1 - power if value else 0
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def printable(text: str) -> str:
    """`text` on one line; what a terminal would obey instead of print becomes a `�`."""
    return "".join(one if one.isprintable() else "�" for one in " ".join(text.split()))


def display_width(text: str) -> int:
    """Columns of a monospaced screen that `text` takes."""
    return sum(_width(one) for one in text)


def _width(one: str) -> int:
    if unicodedata.combining(one):
        return 0
    return 2 if unicodedata.east_asian_width(one) in "WF" else 1


def pad(text: str, width: int, align: str) -> str:
    """`text` filled with blanks to `width` screen columns."""
    blanks = " " * max(0, width - display_width(text))
    return text + blanks if align == "left" else blanks + text


def column_groups(columns: Sequence[Column]) -> list[tuple[str, int]]:
    """(heading, number of columns) of each run of columns that share a group."""
    runs = itertools.groupby(columns, key=lambda column: column.group)
    return [(name, len(list(run))) for name, run in runs]


def column_widths(rows: Sequence[Sequence[str]]) -> list[int]:
    """Screen columns that the widest text of each column takes."""
    return [max(map(display_width, column)) for column in zip(*rows, strict=True)]


def padded(row: Sequence[str], widths: Sequence[int], columns: Sequence[Column]) -> list[str]:
    """One row of texts, each aligned as its column is."""
    return [
        pad(text, width, column.align)
        for text, width, column in zip(row, widths, columns, strict=True)
    ]


def plain(value: object) -> Value:
    """Return a value of a data frame as a cell: a NumPy scalar unwrapped, absence as None."""
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and math.isnan(value):
        return None
    if isinstance(value, str | float | int):
        return value
    return None if value is None or value is pd.NA or value is pd.NaT else str(value)
