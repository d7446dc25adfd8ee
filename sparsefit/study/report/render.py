"""One `Table` as Markdown, LaTeX, CSV or terminal text."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence

from sparsefit.study.evidence.table import Column, Table, Value, column_widths, padded
from sparsefit.study.report.escape import escape_markdown
from sparsefit.study.report.latex import to_latex
from sparsefit.study.report.terminal import to_text

__all__ = ["to_csv", "to_latex", "to_markdown", "to_text"]


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
    """Every row in full precision; an absent or NaN cell is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([column.full_heading for column in table.columns])
    writer.writerows([_csv_cell(cell) for cell in row] for row in table.rows)
    return stream.getvalue()


def _csv_cell(cell: Value) -> str:
    if cell is None or (isinstance(cell, float) and math.isnan(cell)):
        return ""
    return repr(cell) if isinstance(cell, float) else str(cell)
