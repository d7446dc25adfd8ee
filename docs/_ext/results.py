"""Tables and sentences of `results/`, read when the documentation is built.

    ```{results} table2/errors-absolute
    :columns: protocol; backend; n; mean |error| U0 [%]
    :where: protocol=default; backend=lasso, group-lasso
    ```

shows rows and columns of `results/table2/errors-absolute.md`, and says where they come from. The
README of every study becomes a page, `docs/studies/NAME.md`.
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

README = re.compile(r"\]\(\.\./results/([a-z0-9_-]+)/README\.md\)")
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
        columns, names = (_listed(self.options.get(key, ""), ";") for key in ("columns", "names"))
        where = {
            name.strip(): _listed(values, ",")
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


def _listed(text: str, between: str) -> list[str]:
    return [part.strip() for part in text.split(between) if part.strip()]


def study_page(name: str) -> str:
    """The README of a study as a page: its headings one level up, its pictures where they are.

    Links to files beside it are left out, as those are not part of the documentation.
    """
    text = (RESULTS / name / "README.md").read_text("utf-8")
    kept = [part for part in text.split("\n\n") if not part.startswith(BESIDE)]
    text = re.sub(r"^###", "##", "\n\n".join(kept), flags=re.MULTILINE)
    text = re.sub(r"!\[([^\]]*)\]\(", rf"![\1](../../results/{name}/", text)
    return f"{text.rstrip()}\n\nThe study is `studies/{name}.toml`, its files `results/{name}/`.\n"


BESIDE = ("This table: ", "Of the run that made these files: ")


def write_pages(app: Sphinx) -> None:
    """A page for every study in `results/`, in `docs/studies/`, which git does not keep."""
    folder = Path(app.srcdir) / "studies"
    folder.mkdir(exist_ok=True)
    pages = {path.parent.name: study_page(path.parent.name) for path in RESULTS.glob("*/README.md")}
    for old in folder.glob("*.md"):
        if old.stem not in pages:
            old.unlink()
    for name, text in pages.items():
        page = folder / f"{name}.md"
        if not page.exists() or page.read_text("utf-8") != text:
            page.write_text(text, "utf-8")


def link_pages(app: Sphinx, name: str, source: list[str]) -> None:
    """A link to the README of a study, which works where pages are read as files, to its page."""
    if "/" not in name:
        source[0] = README.sub(r"](studies/\1.md)", source[0])


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives."""
    app.add_directive("results", Results)
    app.connect("builder-inited", write_pages)
    app.connect("source-read", link_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
