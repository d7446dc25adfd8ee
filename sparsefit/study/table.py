"""The `Table` record, and its text for a terminal, CSV, LaTeX, Markdown and JSON."""

from __future__ import annotations

import itertools
import math
import re
import textwrap
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import pandas as pd

Value: TypeAlias = str | float | int | bool | None
NOTHING = "–"
LEAST_NAME = 12  # screen columns to which a name is shortened at most
SHORTENED = 0.6  # of a terminal's width, from which on names are shortened
WIDE = 10  # columns from which on a table of LaTeX lies on its side
TEX = str.maketrans({
    "τ": r"$\tau$", "θ": r"$\theta$", "λ": r"$\lambda$", "α": r"$\alpha$", "η": r"$\eta$",
    "²": "$^2$", "°": r"$^\circ$", "×": r"$\times$", "≤": r"$\leq$", "≥": r"$\geq$",
    "∞": r"$\infty$", "±": r"$\pm$", "−": "$-$", "–": "--", "…": r"\ldots{}",
    "“": "``", "”": "''", "’": "'", "<": r"\textless{}", ">": r"\textgreater{}",
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "|": r"\textbar{}", **{sign: f"\\{sign}" for sign in "&%$#_{}"},
})  # fmt: skip
MARKDOWN = str.maketrans({
    "&": "&amp;", "<": "&lt;", ">": "&gt;", **{sign: f"\\{sign}" for sign in "\\|`*~$[]"},
})  # fmt: skip


@dataclass(frozen=True)
class Column:
    """One column of a table.

    group: a heading that it shares with its neighbours; unit: in brackets behind the name.
    format: a Python format, three significant digits where it is empty.
    least: a smaller number is rounding; varies: whether it is of one run on one machine.
    """

    name: str
    unit: str = ""
    format: str = ""
    group: str = ""
    least: float = 0.0
    varies: bool = False

    @property
    def heading(self) -> str:
        """The name and the unit, `U0 [m/s]`."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def full(self) -> str:
        """The heading behind its group, for what has one line of headings."""
        return f"{self.group} {self.heading}".strip()


def cell_text(cell: Value, column: Column) -> str:
    """Return a cell as one line of text; `–` for nothing and NaN."""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str):
        return "".join(sign if sign.isprintable() else "�" for sign in " ".join(cell.split()))
    if cell is None or math.isnan(cell):
        return NOTHING
    if math.isinf(cell):
        return "∞" if cell > 0 else "-∞"
    if column.least and abs(cell) <= column.least * (1.0 + 1e-9):
        return f"< {column.least:.0e}".replace("e-0", "e-")
    text = format(cell, column.format) if column.format else significant(cell)
    return text.lstrip("+-") if text[:1] in "+-" and not text.strip("+-0.") else text


def significant(value: float, digits: int = 3) -> str:
    """Return a number with three significant digits, without an exponent from 1e-4 to 1e6."""
    if math.isnan(value) or math.isinf(value):
        return NOTHING if math.isnan(value) else "∞"
    if isinstance(value, int | np.integer):
        return str(value)
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    power = int(f"{value:.{digits - 1}e}".partition("e")[2])  # of the rounded number
    decimals = digits - 1 - power if value else 0
    return f"{round(value, decimals):.{max(decimals, 0)}f}"


def plain(value: object) -> Value:
    """Return a value of a frame as a cell: a NumPy scalar unwrapped, absence as None."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or value is pd.NA or value is pd.NaT or value != value:
        return None
    return value if isinstance(value, str | float | int) else str(value)


@dataclass(frozen=True, eq=False)
class Table:
    """Columns and rows with a title; `shown` rows of it stand in everything but CSV."""

    title: str
    columns: tuple[Column, ...]
    rows: Sequence[tuple[Value, ...]]
    notes: tuple[str, ...] = ()
    shown: int = 60
    names: int = field(default=1)  # leading columns that say what a row is

    @classmethod
    def of(cls, frame: pd.DataFrame, title: str, notes: Sequence[str] = ()) -> Table:
        """Return a frame as a table: its index first where it has a name."""
        if any(frame.index.names):
            frame = frame.reset_index()
        grouped = [
            (str(name[0]), str(name[-1])) if isinstance(name, tuple) else ("", str(name))
            for name in frame.columns
        ]
        columns = tuple(Column(name, group=group) for group, name in grouped)
        rows = [tuple(map(plain, row)) for row in frame.itertuples(index=False)]
        words = [isinstance(value, str) for value in rows[0]] if rows else []
        return cls(title, columns, rows, tuple(notes), names=max(sum(
            1 for _ in itertools.takewhile(bool, words)), 1))  # fmt: skip

    @property
    def varies(self) -> bool:
        """Whether another run of the study prints other numbers."""
        return any(column.varies for column in self.columns)

    @property
    def frame(self) -> pd.DataFrame:
        """All rows as a data frame, numbers unrounded."""
        return pd.DataFrame(self.rows, columns=[column.full for column in self.columns])

    @property
    def texts(self) -> list[list[str]]:
        """The cells that are shown, as text."""
        return [
            [cell_text(cell, column) for cell, column in zip(row, self.columns, strict=True)]
            for row in self.rows[: self.shown]
        ]

    @property
    def is_text(self) -> list[bool]:
        """Whether each column holds words, which stand on the left."""
        return [
            place < self.names or any(isinstance(row[place], str) for row in self.rows)
            for place in range(len(self.columns))
        ]

    @property
    def remarks(self) -> tuple[str, ...]:
        """The notes, and the number of rows that are not shown."""
        hidden = len(self.rows) - self.shown
        return (*self.notes, *([f"{hidden} more rows in the CSV file."] if hidden > 0 else []))

    @property
    def groups(self) -> list[tuple[str, int]]:
        """The heading and the number of columns of each run that shares a group."""
        runs = itertools.groupby(column.group for column in self.columns)
        return [(name, len(list(run))) for name, run in runs]

    def record(self) -> dict[str, object]:
        """Return the table as JSON has it: title, columns, rows, notes."""
        rows = [
            [None if isinstance(cell, float) and not math.isfinite(cell) else cell for cell in row]
            for row in self.rows
        ]
        heads = [column.full for column in self.columns]
        return {"title": self.title, "columns": heads, "rows": rows, "notes": list(self.notes)}

    def to_csv(self) -> str:
        """Return all rows, numbers to six digits; words that a spreadsheet would run are quoted."""
        frame = self.frame
        for place, column in enumerate(self.columns):
            cells = [_csv_cell(row[place], column.least) for row in self.rows]
            frame.isetitem(place, np.array(cells, dtype=object))
        return frame.to_csv(index=False, lineterminator="\n")

    def to_latex(self, label: str = "") -> str:
        """Return a float of booktabs rules, the cells escaped and the quotes typeset."""
        heads: pd.Index = pd.MultiIndex.from_tuples(
            [(_tex(column.group), _tex(column.heading)) for column in self.columns]
        )
        if not any(column.group for column in self.columns):
            heads = heads.get_level_values(1)
        cells = [[_tex(text) for text in row] for row in self.texts]
        style = pd.DataFrame(cells, columns=heads).style.hide(axis="index")
        wide = len(self.columns) > WIDE
        text = style.to_latex(
            column_format="".join("l" if words else "r" for words in self.is_text),
            position="htbp", hrules=True, multicol_align="c",
            caption=_tex(self.title), label=re.sub(r"[^A-Za-z0-9:-]", "-", label) or None,
            environment="sidewaystable" if wide else "table",
        )  # fmt: skip
        notes = "".join(f"\\par\\smallskip {_tex(note)}\n" for note in self.remarks)
        end = r"\end{sidewaystable}" if wide else r"\end{table}"
        packages = "booktabs,multirow,rotating" if wide else "booktabs,multirow"
        return f"% needs \\usepackage{{{packages}}}\n{text.replace(end, notes + end)}"

    def to_markdown(self, rows: int | None = None) -> str:
        """Return a heading, the first `rows` rows as a table, and the notes."""
        every = [[column.full for column in self.columns], *self.texts[:rows]]
        lines = [f"| {' | '.join(text.translate(MARKDOWN) for text in row)} |" for row in every]
        lines.insert(1, f"|{'|'.join(':--' if words else '--:' for words in self.is_text)}|")
        notes = "".join(f"\n{note.translate(MARKDOWN)}\n" for note in self.notes)
        body = "\n".join(lines)
        return f"### {self.title.translate(MARKDOWN)}\n\n{body}\n{notes}"

    def to_text(self, width: int = 100) -> str:
        """Return the table for a terminal of so many columns.

        Numbers are never cut: columns that do not fit follow in a further block behind the names.
        """
        heads = [column.full for column in self.columns]
        widths = [max(map(_width, texts)) for texts in zip(heads, *self.texts, strict=True)]
        names = list(range(self.names))
        while sum(widths[at] + 2 for at in names) > SHORTENED * width:
            widest = max(names, key=lambda at: widths[at])
            if widths[widest] <= LEAST_NAME:
                break
            widths[widest] -= 1
        room, blocks = width - sum(widths[at] + 2 for at in names), [list[int]()]
        for place in range(self.names, len(heads)):
            widths[place] = min(widths[place], max(room, LEAST_NAME))
            if blocks[-1] and sum(widths[at] + 2 for at in [*blocks[-1], place]) > room + 2:
                blocks.append([])
            blocks[-1].append(place)
        words, parts = self.is_text, []
        for block in blocks:
            chosen = [*names, *block]
            rule = ["-" * widths[at] for at in range(len(heads))]
            lines = (
                "  ".join(_padded(row[at], widths[at], left=words[at]) for at in chosen).rstrip()
                for row in (heads, rule, *self.texts)
            )
            parts.append("\n".join(lines))
        notes = [textwrap.fill(note, width) for note in self.remarks]
        return "\n\n".join([self.title, *parts, *notes]) + "\n"

    def _repr_html_(self) -> str:
        texts = [column.full for column in self.columns]
        return pd.DataFrame(self.texts, columns=texts).style.hide(axis="index").to_html()


def _csv_cell(cell: Value, least: float) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    if isinstance(cell, float):
        return f"{round(cell, round(-math.log10(least))) + 0.0 if least else cell:.6g}"
    text = str(cell)
    is_formula = isinstance(cell, str) and text.startswith(("=", "+", "-", "@", "\t", "\r"))
    return f"'{text}" if is_formula else text


def _tex(text: str) -> str:
    """Return text as LaTeX prints it letter for letter, quotes opening and closing."""
    text = re.sub(r'"([^"]*)"', "“\\1”", text).replace('"', "”")
    text = "".join(sign if sign < "\xff" or ord(sign) in TEX else "?" for sign in text)
    text = text.translate(TEX)
    return f"{{}}{text}" if text[:1] in ("[", "*") else text


def _width(text: str) -> int:
    """Return the columns of a monospaced screen that text takes."""
    return sum(
        0 if unicodedata.combining(sign) else 1 + (unicodedata.east_asian_width(sign) in "WF")
        for sign in text
    )


def _padded(text: str, width: int, *, left: bool) -> str:
    """Return text of this width; the middle of a longer one is left out, names differ at ends."""
    if _width(text) > width:
        half = (width - 1) // 2
        text = f"{text[: width - 1 - half]}…{text[len(text) - half :]}"
    blanks = " " * max(0, width - _width(text))
    return text + blanks if left else blanks + text
