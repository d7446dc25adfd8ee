"""A `Table` as LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from sparsefit.study.evidence.table import Column, Table, Value, column_groups
from sparsefit.study.report.escape import escape_tex

WIDE = 10


def to_latex(table: Table, *, label: str = "") -> str:
    """A float of booktabs rules, numbers right, minus signs as such.

    A wide table lies on its side (package rotating): shrunk to a column it could not be read.
    """
    wide = len(table.columns) > WIDE
    environment, package = ("sidewaystable", ",rotating") if wide else ("table", "")
    lines = [
        rf"% needs \usepackage{{booktabs{package}}}",
        rf"\begin{{{environment}}}[htbp]",
        rf"  \centering{_size(table.columns)}",
        rf"  \caption{{{escape_tex(table.title)}}}",
        *([rf"  \label{{{re.sub(r'[^A-Za-z0-9:-]', '-', label)}}}"] if label else []),
        rf"  \begin{{tabular}}{{{''.join(column.align[0] for column in table.columns)}}}",
        r"    \toprule",
        *_tex_groups(table.columns),
        "    " + " & ".join(_tex_heading(column) for column in table.columns) + r" \\",
        r"    \midrule",
        *("    " + " & ".join(row) + r" \\" for row in _tex_rows(table)),
        r"    \bottomrule",
        r"  \end{tabular}",
        *(rf"  \par\smallskip {escape_tex(note)}" for note in table.remarks),
        rf"\end{{{environment}}}",
    ]
    return "\n".join(lines) + "\n"


def _size(columns: Sequence[Column]) -> str:
    wide = len(columns) > WIDE
    return r"\scriptsize\setlength{\tabcolsep}{2.5pt}" if wide else r"\footnotesize"


def _tex_heading(column: Column) -> str:
    name = column.tex or escape_tex(column.name)
    # The group keeps a line that starts with "[" from being read as the argument of "\\".
    return f"{{{name}}} [{escape_tex(column.unit)}]" if column.unit else f"{{{name}}}"


def _tex_groups(columns: Sequence[Column]) -> list[str]:
    if not any(column.group for column in columns):
        return []
    heads, rules, start = [], [], 1
    for name, span in column_groups(columns):
        if name:
            heads.append(rf"\multicolumn{{{span}}}{{c}}{{{escape_tex(name)}}}")
            rules.append(rf"\cmidrule(lr){{{start}-{start + span - 1}}}")
        else:
            heads.append(" & ".join([""] * span))
        start += span
    return ["    " + " & ".join(heads) + r" \\", "    " + " ".join(rules)]


def _tex_rows(table: Table) -> Iterator[list[str]]:
    for row, texts in zip(table.visible_rows, table.texts, strict=True):
        yield [_tex_cell(cell, text) for cell, text in zip(row, texts, strict=True)]


def _tex_cell(cell: Value, text: str) -> str:
    if isinstance(cell, str):
        return f"{{{escape_tex(text)}}}" if text.startswith(("[", "*")) else escape_tex(text)
    return f"${text}$" if text[:1] in ("+", "-") else escape_tex(text)
