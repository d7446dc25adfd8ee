"""Tables and sentences of `results/`, read when the documentation is built.

    ```{results} table2/errors-absolute
    :columns: protocol, backend, n, mean |error| U0 [%]
    :where: protocol=default; backend=lasso, group-lasso
    ```

shows rows and columns of `results/table2/errors-absolute.md`, and says where they come from;
`{answers}` shows the question and the answer of studies.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from written import parsed

RESULTS = Path(__file__).parents[2] / "results"


def read_table(path: Path) -> tuple[list[str], list[str], list[list[str]]]:
    """The header, the rule below it and the rows of the table in a Markdown file."""
    lines = [line for line in path.read_text("utf-8").splitlines() if line.startswith("|")]
    header, rule, *rows = (_cells(line) for line in lines)
    return header, rule, rows


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def chosen(
    path: Path, columns: list[str], where: dict[str, list[str]], names: list[str]
) -> list[str]:
    """The lines of a Markdown table: these columns (empty: all) of the rows that `where` names.

    Raises:
        ValueError: on a column that the table has not, or where no row is left.
    """
    header, rule, rows = read_table(path)
    plain = [name.replace("\\|", "|") for name in header]
    for name in [*columns, *where]:
        if name not in plain:
            raise ValueError(f"{path.name} has no column {name!r}; it has {', '.join(plain)}")
    kept = [plain.index(name) for name in columns or plain]
    left = [
        row
        for row in rows
        if all(row[plain.index(name)] in values for name, values in where.items())
    ]
    if not left:
        raise ValueError(f"{path.name} has no row where {where}")
    heads = names or [header[index] for index in kept]
    rules = [rule[index] for index in kept]
    return [_line(heads), _line(rules), *(_line([row[index] for index in kept]) for row in left)]


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


class Results(SphinxDirective):
    """Rows and columns of a table that a study wrote."""

    required_arguments = 1
    option_spec: ClassVar = {
        "columns": directives.unchanged,
        "names": directives.unchanged,
        "where": directives.unchanged,
    }

    def run(self) -> list[nodes.Node]:
        path = RESULTS / f"{self.arguments[0]}.md"
        self.env.note_dependency(str(path))
        columns, names = (_listed(self.options.get(key, "")) for key in ("columns", "names"))
        where = {
            name.strip(): _listed(values)
            for part in self.options.get("where", "").split(";")
            if part.strip()
            for name, _, values in [part.partition("=")]
        }
        try:
            lines = chosen(path, columns, where, names)
        except (OSError, ValueError) as error:
            raise self.error(str(error)) from None
        table = nodes.container("", *parsed(self, lines), classes=["results-table"])
        source = nodes.caption("", "", nodes.emphasis("", f"From results/{self.arguments[0]}.csv"))
        return [table, nodes.paragraph("", "", *source.children, classes=["source"])]


class Answers(SphinxDirective):
    """The question and the answer of each study named, as its README has them."""

    required_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        lines: list[str] = []
        for name in self.arguments[0].split():
            path = RESULTS / name / "README.md"
            self.env.note_dependency(str(path))
            question, answer = answered(path)
            lines += [f"**`{name}`.** {question}", "", answer, ""]
        return parsed(self, lines)


def answered(path: Path) -> tuple[str, str]:
    """The question and the answer that stand at the head of a study's README."""
    paragraphs = path.read_text("utf-8").split("\n\n")
    return paragraphs[1].strip("*\n "), paragraphs[2]


def _listed(text: str) -> list[str]:
    return [part.strip() for part in re.split(r",(?!\s*\d)", text) if part.strip()]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("results", Results)
    app.add_directive("answers", Answers)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
