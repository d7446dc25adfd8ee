"""The `Table` record, and its text for a terminal, CSV, LaTeX, Markdown and JSON."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import pandas as pd

from sparsefit.codec import finite_or_none
from sparsefit.plot.style import wrapped

Value: TypeAlias = str | float | int | bool | None
Row: TypeAlias = tuple[Value, ...]
TEX = str.maketrans({
    "τ": r"$\tau$", "θ": r"$\theta$", "λ": r"$\lambda$", "α": r"$\alpha$", "η": r"$\eta$",
    "²": "$^2$", "°": r"$^\circ$", "×": r"$\times$", "≤": r"$\leq$", "≥": r"$\geq$",
    "∞": r"$\infty$", "±": r"$\pm$", "−": "$-$", "–": "--", "…": r"\ldots{}",
    "“": "``", "”": "''", "’": "'", "<": r"\textless{}", ">": r"\textgreater{}",
    "\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "|": r"\textbar{}", **{sign: f"\\{sign}" for sign in "&%$#_{}"},
})  # fmt: skip
TEX_SYMBOLS = {"U0": "$U_0$", "L_w": "$L_w$", "τ_w": r"$\tau_w$"}
MARKDOWN = str.maketrans({
    "&": "&amp;", "<": "&lt;", ">": "&gt;", **{sign: f"\\{sign}" for sign in "\\|`*~$[]"},
})  # fmt: skip


@dataclass(frozen=True)
class Column:
    """One column of a table.

    group: a heading shared with neighbouring columns; unit: printed in brackets after the name.
    format: a Python format; three significant digits if empty.
    least: smaller numbers are rounding errors; varies: whether values differ between runs.
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
        """The group and the heading in one line."""
        return f"{self.group} {self.heading}".strip()


def sentence(words: str) -> str:
    """Return words with a capital letter and a full stop; empty words unchanged."""
    return f"{words[:1].upper()}{words[1:].rstrip('.')}." if words else ""


def listed(names: Sequence[str], word: str = "or") -> str:
    """Return `a`, `a or b`, `a, b or c`; of more than five names, four and the number of others."""
    names = list(dict.fromkeys(names))
    if len(names) > 5:
        names = [*names[:4], f"{len(names) - 4} more"]
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {word} {names[-1]}"


def significant(value: float, digits: int = 3) -> str:
    """Return a number with three significant digits, without an exponent from 1e-4 to 1e6."""
    if math.isnan(value) or math.isinf(value):
        return "–" if math.isnan(value) else "∞"
    if isinstance(value, int | np.integer):
        return str(value)
    if value != 0 and not 1e-4 <= abs(value) < 1e6:
        return f"{value:.{digits - 1}e}"
    power = int(f"{value:.{digits - 1}e}".partition("e")[2])  # of the rounded number
    decimals = digits - 1 - power if value else 0
    return f"{round(value, decimals) + 0.0:.{max(decimals, 0)}f}"  # no -0


def cell_text(cell: Value, column: Column) -> str:
    """Return a cell as one line of text; `–` for an absent number."""
    if isinstance(cell, bool):
        return "yes" if cell else "no"
    if isinstance(cell, str):
        return "".join(sign if sign.isprintable() else "�" for sign in " ".join(cell.split()))
    if cell is None or not math.isfinite(cell):
        return "-∞" if cell == -math.inf else significant(math.nan if cell is None else cell)
    if column.least and abs(cell) <= column.least * (1.0 + 1e-9):
        return f"< {column.least:.0e}".replace("e-0", "e-")
    text = format(cell, column.format) if column.format else significant(cell)
    return text.lstrip("+-") if text[:1] in "+-" and not text.strip("+-0.") else text


def plain(value: object) -> Value:
    """Return a value of a frame as a cell: a NumPy scalar unwrapped, absence as None."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or value is pd.NA or value is pd.NaT or value != value:
        return None
    return value if isinstance(value, str | float | int) else str(value)


@dataclass(frozen=True, eq=False)
class Table:
    """Columns and rows under a title, with notes below."""

    title: str
    columns: tuple[Column, ...]
    rows: Sequence[Row]
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, frame: pd.DataFrame) -> Table:
        """Return a frame as a table, titled by its `attrs`, its index first where it has a name."""
        title, notes = str(frame.attrs.get("title", "")), tuple(frame.attrs.get("notes", ()))
        if any(frame.index.names):
            frame = frame.reset_index()
        columns = tuple(
            Column(str(name[-1]), group=str(name[0])) if isinstance(name, tuple)
            else Column(str(name)) for name in frame.columns
        )  # fmt: skip
        rows = [tuple(map(plain, row)) for row in frame.itertuples(index=False)]
        return cls(title, columns, rows, notes)

    @classmethod
    def of_cells(
        cls, title: str, rows: Sequence[Mapping[Column, Value]], notes: Sequence[str] = ()
    ) -> Table:
        """Return rows of cells by column as a table; a cell that a row lacks is empty."""
        columns = tuple(dict.fromkeys(column for row in rows for column in row))
        return cls(title, columns, [tuple(map(row.get, columns)) for row in rows], tuple(notes))

    @property
    def varies(self) -> bool:
        """Whether numbers differ between runs of the study."""
        return any(column.varies for column in self.columns)

    @property
    def heads(self) -> list[str]:
        """The full heading of every column."""
        return [column.full for column in self.columns]

    @property
    def frame(self) -> pd.DataFrame:
        """All rows as a data frame, numbers unrounded."""
        return pd.DataFrame(self.rows, columns=self.heads)

    @property
    def is_text(self) -> list[bool]:
        """Whether each column holds words, aligned to the left; grouped columns are quantities."""
        return [
            not place
            or (not column.group and any(isinstance(row[place], str) for row in self.rows))
            for place, column in enumerate(self.columns)
        ]

    @property
    def levels(self) -> pd.Index:
        """The headings as labels of a frame, behind those of groups if there are any."""
        pairs = [(column.group, column.heading) for column in self.columns]
        index = pd.MultiIndex.from_tuples(pairs)
        return index if any(index.get_level_values(0)) else index.get_level_values(1)

    @property
    def groups(self) -> list[tuple[str, int]]:
        """The heading and the width in columns of each group."""
        runs = itertools.groupby(column.group for column in self.columns)
        return [(name, len(list(run))) for name, run in runs]

    def texts(self, most: int) -> list[list[str]]:
        """Return the cells of the first `most` rows as text; whole numbers without decimals."""
        columns = list(self.columns)
        for place, column in enumerate(columns):
            cells = [row[place] for row in self.rows]
            numbers = [cell for cell in cells if isinstance(cell, float) and math.isfinite(cell)]
            is_whole = all(number.is_integer() and abs(number) < 1e6 for number in numbers)
            if is_whole and not (column.format or column.least or column.varies):
                columns[place] = replace(column, format=".0f")
        return [list(map(cell_text, row, columns)) for row in self.rows[:most]]

    def remarks(self, most: int) -> Iterator[str]:
        """Give the notes, and the number of rows after the first `most`, if there are more."""
        yield from self.notes
        if len(self.rows) > most:
            yield f"{len(self.rows) - most} more rows in the CSV file."

    def record(self) -> dict[str, object]:
        """Return title, columns, rows and notes for JSON."""
        rows = finite_or_none(list(self.rows))
        return {"title": self.title, "columns": self.heads, "rows": rows, "notes": list(self.notes)}

    def to_csv(self) -> str:
        """Return all rows with six digits; texts that a spreadsheet would evaluate are quoted."""

        def cell_of(cell: Value, least: float) -> Value:
            if isinstance(cell, float) and cell == cell:
                return f"{round(cell, round(-math.log10(least))) + 0.0 if least else cell:.6g}"
            runs = isinstance(cell, str) and cell.startswith(("=", "+", "-", "@", "\t", "\r"))
            return f"'{cell}" if runs else cell  # absence and NaN: empty

        least = [column.least for column in self.columns]
        rows = [list(map(cell_of, row, least)) for row in self.rows]
        frame = pd.DataFrame(rows, columns=self.heads, dtype=object)
        return frame.to_csv(index=False, lineterminator="\n")

    def to_latex(self, label: str = "", most: int = 40) -> str:
        """Return a float with a booktabs table, which is scaled down to the width of a line."""
        cells = [list(map(_tex, row)) for row in self.texts(most)]
        heads = self.levels.map(
            lambda label: _tex(label) if isinstance(label, str) else tuple(map(_tex, label))
        )
        text = (
            pd.DataFrame(cells, columns=heads)
            .style.hide(axis="index")
            .to_latex(
                column_format="".join("l" if words else "r" for words in self.is_text),
                position="htbp",
                hrules=True,
                multicol_align="c",
                caption=_tex(self.title),
                label=re.sub(r"[^A-Za-z0-9:-]", "-", label) or None,
            )
        )
        fit = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"
        notes = "".join(f"\\par\\smallskip {_tex(note)}\n" for note in self.remarks(most))
        text = text.replace(r"\begin{tabular}", f"\\small\n{fit}\n\\begin{{tabular}}")
        text = text.replace("\\end{tabular}\n", f"\\end{{tabular}}}}\n{notes}")
        return f"% needs \\usepackage{{booktabs,graphicx}}\n{text}"

    def to_markdown(self, most: int = 60, file: str = "") -> str:
        """Return a heading, the first `most` rows as a table, and the notes.

        Args:
            file: the CSV file, to which the number of further rows is linked.
        """
        every = [self.heads, *self.texts(most)]
        lines = [f"| {' | '.join(text.translate(MARKDOWN) for text in row)} |" for row in every]
        lines.insert(1, f"|{'|'.join(':--' if words else '--:' for words in self.is_text)}|")
        remarks = [remark.translate(MARKDOWN) for remark in self.remarks(most)]
        if file and len(self.rows) > most:
            remarks[-1] = remarks[-1].replace("CSV file", f"[CSV file]({file})")
        notes = "".join(f"\n{remark}\n" for remark in remarks)
        return f"### {self.title.translate(MARKDOWN)}\n\n" + "\n".join(lines) + f"\n{notes}"

    def to_text(self, width: int = 100, most: int = 100) -> str:
        """Return the table for a terminal of so many columns.

        Nothing is cut: a long text takes several lines, and columns that do not fit follow in a
        further block behind the names.
        """
        names = min([*self.is_text, False].index(False), len(self.columns) - 1)
        rooms = [max(int(0.6 * width) // names - 2, 12) if at < names else 28
                 for at in range(len(self.columns))]  # fmt: skip
        cells = (map(str.split, map(wrapped, row, rooms), ["\n"] * len(row))
                 for row in self.texts(most))  # fmt: skip
        lines = [line for row in cells for line in itertools.zip_longest(*row, fillvalue="")]
        frame = pd.DataFrame(lines, columns=self.levels)
        if names:
            frame = frame.set_index(list(self.levels[:names])).rename_axis(self.heads[:names])

        # Further blocks of to_string's own lose the heading of their group.
        def block(start: int, end: int) -> list[str]:
            printed = frame.iloc[:, start:end].to_string(index=bool(names))
            return list(map(str.rstrip, printed.split("\n")))

        blocks, start, count = list[str](), 0, len(self.columns) - names if self.rows else 0
        while start < count:
            end = start + 1
            while end < count and max(map(len, block(start, end + 1))) <= width:
                end += 1
            blocks.append("\n".join(block(start, end)))
            start = end
        notes = [wrapped(note, width) for note in self.remarks(most)]
        return "\n\n".join([self.title, *(blocks or ["no rows"]), *notes]) + "\n"

    def __str__(self) -> str:
        return self.to_text()


def _tex(text: str) -> str:
    """Return text as LaTeX prints it, signed numbers and symbols of the flow as formulas."""
    if re.fullmatch(r"[-+][\d.]+", text):
        return f"${text}$"
    if number := re.fullmatch(r"([-+<]? ?[\d.]+)e([-+]\d+)", text):
        return rf"${number[1]} \times 10^{{{int(number[2])}}}$"
    text = re.sub(r'"([^"]*)"', "“\\1”", text).replace('"', "”")
    text = "".join(sign if sign < "\xff" or ord(sign) in TEX else "?" for sign in text)
    parts = re.split(rf"\b({'|'.join(TEX_SYMBOLS)})\b", text)
    text = "".join(TEX_SYMBOLS.get(part) or part.translate(TEX) for part in parts)
    return f"{{}}{text}" if text[:1] in ("[", "*") else text
