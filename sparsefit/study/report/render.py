"""One `Table` as Markdown, LaTeX, CSV or terminal text."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence

from sparsefit.study.evidence.table import Column, Table, Value, column_widths, padded
from sparsefit.study.report.escape import escape_markdown
from sparsefit.study.report.latex import to_latex
from sparsefit.study.report.terminal import to_text

CSV_DIGITS = 6

__all__ = ["table_files", "to_csv", "to_latex", "to_markdown", "to_text"]


def table_files(study: str, tables: Mapping[str, Table]) -> dict[str, bytes]:
    """Return every table as NAME.md, .tex and .csv; `study` is in its label."""
    return {
        f"{name}.{suffix}": text.encode()
        for name, table in tables.items()
        for suffix, text in (
            ("md", to_markdown(table)),
            ("tex", to_latex(table, label=f"tab:{study}-{name}")),
            ("csv", to_csv(table)),
        )
    }


def to_markdown(table: Table) -> str:
    """A heading, the table with its columns aligned in the source too, and the notes."""
    headings = [escape_markdown(column.full_heading) for column in table.columns]
    body = [[escape_markdown(text) for text in row] for row in table.texts]
    widths = column_widths([headings, *body])
    rule = "|".join(
        "-" * (width + 1) + ("-" if column.align == "left" else ":")
        for width, column in zip(widths, table.columns, strict=True)
    )
    lines = [_markdown_line(row, widths, table.columns) for row in [headings, *body]]
    notes = [f"\n{escape_markdown(note)}" for note in table.remarks]
    parts = [f"### {escape_markdown(table.title)}", "", lines[0], f"|{rule}|", *lines[1:], *notes]
    return "\n".join(parts) + "\n"


def _markdown_line(row: Sequence[str], widths: Sequence[int], columns: Sequence[Column]) -> str:
    return f"| {' | '.join(padded(row, widths, columns))} |"


def to_csv(table: Table) -> str:
    """Every row, numbers to six digits; an absent or NaN cell is empty.

    An error is no finer than its column's `least`: what is below that is 0, which holds on every
    machine.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([column.full_heading for column in table.columns])
    writer.writerows(
        [_csv_cell(cell, column) for cell, column in zip(row, table.columns, strict=True)]
        for row in table.rows
    )
    return stream.getvalue()


def _csv_cell(cell: Value, column: Column) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    if not isinstance(cell, float):
        return _no_formula(str(cell))
    decimals = round(-math.log10(column.least)) if column.least else 0
    return f"{round(cell, decimals) + 0.0 if decimals else cell:.{CSV_DIGITS}g}"


def _no_formula(text: str) -> str:
    """The text, behind an apostrophe where a spreadsheet would run it."""
    return f"'{text}" if text.startswith(("=", "+", "-", "@", "\t", "\r")) else text
