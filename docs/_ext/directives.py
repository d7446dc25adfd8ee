"""Directives of the documentation: what the package and its results say of themselves.

`{results} STUDY/TABLE` rows and columns of a CSV file in results/, `{picture} NAME` a drawing of
docs/pictures/, `{study-keys} SECTION` the keys of a study file with the words of study-keys.toml,
`{study-names} KIND` names that [outputs] takes, `{backend-settings}`, `{public-names}` and
`{commands}` what the package offers. The README of a study becomes a page, docs/studies/NAME.md.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import re
import runpy
import tomllib
from collections import defaultdict
from dataclasses import fields
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.statemachine import StringList
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import sparsefit
from sparsefit import backends
from sparsefit.cli import parser
from sparsefit.study import figures, keys, measures, tables
from sparsefit.study.resampling import SUMMARY_NAMES

DOCS = Path(__file__).parents[1]
RESULTS = DOCS.parent / "results"
README = re.compile(r"\]\(\.\./results/([a-z0-9_-]+)/README\.md\)")
BAR = re.compile(r"(``[^`]*``)|\|")
ROOMS = {
    "flight": "Flights and flows", "logs": "Logs", "rows": "Rows", "derivative": "Rows",
    "model": "Library and readout", "library": "Library and readout",
    "modes": "Library and readout", "estimator": "Estimates", "onboard": "On board",
    "online": "On board", "regression": "Regression", "solvers": "Regression",
    "backends": "Regression", "study": "Studies", "score": "Scores", "errors": "Errors",
}  # fmt: skip
STYLE = {
    "font.size": 10.0, "axes.spines.top": False, "axes.spines.right": False,
    "svg.fonttype": "none", "svg.hashsalt": "sparsefit", "font.family": "sans-serif",
    "figure.constrained_layout.use": True, "savefig.facecolor": "white",
}  # fmt: skip


def meanings(section: str) -> dict[str, str]:
    """The words of each key of a section: of its records, or of study-keys.toml."""
    words = keys.keys_of(section) if section in keys.RECORDS else {}
    return words | tomllib.loads((DOCS / "study-keys.toml").read_text("utf-8")).get(section, {})


def key_table(section: str) -> list[str]:
    """A Markdown table of the keys of a section. Raises ValueError where one has no words."""
    words = meanings(section)
    missing = [key for key, text in words.items() if not text]
    if missing or not words:
        raise ValueError(f"study-keys.toml, [{section}]: no words for {missing}")
    cells = ((key, text.replace("|", "\\|")) for key, text in words.items())
    return [
        "| key | what it holds |",
        "|---|---|",
        *(f"| `{key}` | {text} |" for key, text in cells),
    ]


def result_table(name: str, columns: list[str], heads: list[str], where: dict[str, list[str]]):
    """Rows and columns of results/NAME.csv as Markdown. Raises ValueError where none is left."""
    frame = pd.read_csv(RESULTS / f"{name}.csv", dtype=str, keep_default_na=False)
    absent = [column for column in (*columns, *where) if column not in frame]
    if absent:
        raise ValueError(f"{name}.csv has no column {absent}; it has {', '.join(frame)}")
    for column, values in where.items():
        frame = frame[frame[column].isin(values)]
    if frame.empty:
        raise ValueError(f"{name}.csv has no row where {where}")
    frame = frame[columns or list(frame)].map(_rounded)
    lines = [heads or list(frame), ["---"] * frame.shape[1], *frame.to_numpy().tolist()]
    return ["| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |"
            for row in lines]  # fmt: skip


def _rounded(cell: str) -> str:
    try:
        return f"{float(cell):.3g}" if not cell.isdigit() else cell
    except ValueError:
        return cell


class Written(SphinxDirective):
    """A directive whose content is Markdown that `lines` writes."""

    option_spec: ClassVar = dict.fromkeys(
        ("columns", "names", "where", "alone"), directives.unchanged
    )
    optional_arguments = 1

    def lines(self) -> list[str]:
        raise NotImplementedError(type(self).__name__)

    def run(self) -> list[nodes.Node]:
        try:
            lines = self.lines()
        except (OSError, KeyError, ValueError) as error:
            raise self.error(str(error)) from None
        source, _ = self.get_source_info()
        holder = nodes.section()
        holder.document = self.state.document
        self.state.nested_parse(StringList(lines, source), 0, holder)
        return holder.children


class Results(Written):
    """Rows and columns of a table that a study wrote."""

    def lines(self) -> list[str]:
        listed = {key: _listed(self.options.get(key, "")) for key in ("columns", "names")}
        where = {
            name.strip(): [value.strip() for value in values.split("|")]
            for part in _listed(self.options.get("where", ""))
            for name, _, values in [part.partition("=")]
        }
        name = self.arguments[0]
        table = result_table(name, listed["columns"], listed["names"], where)
        return [*table, "", f"*From results/{name}.csv*"]


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(";") if part.strip()]


class Picture(Written):
    """A picture, what it shows, and how it is drawn."""

    def lines(self) -> list[str]:
        source = DOCS / "pictures" / f"{self.arguments[0]}.py"
        text = source.read_text("utf-8")
        title, _, words = (ast.get_docstring(ast.parse(text)) or "").partition("\n")
        image = Path(self.env.app.outdir) / "_drawn" / f"{source.stem}.svg"
        if not image.exists():
            image.parent.mkdir(parents=True, exist_ok=True)
            _draw(source, image)
        shown = [f'<img class="drawn" src="_drawn/{image.name}" alt="{title}">', ""]
        if "alone" in self.options:
            return [*shown, title]
        code = ["````{dropdown} How it is drawn", "```python", text.split('"""', 2)[2].strip()]
        return [*shown, f"**{title}** {' '.join(words.split())}", "", *code, "```", "````"]


def _draw(source: Path, image: Path) -> None:
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    with matplotlib.rc_context(STYLE):
        runpy.run_path(str(source))
        pyplot.savefig(image, bbox_inches="tight")
        pyplot.close("all")


class StudyKeys(Written):
    """The keys of one section of a study file."""

    def lines(self) -> list[str]:
        return key_table(self.arguments[0])


class StudyNames(Written):
    """The names that [outputs] takes: of tables, figures, summaries or measures."""

    def lines(self) -> list[str]:
        kinds = {"tables": tables, "figures": figures}
        if self.arguments[0] in kinds:
            room = kinds[self.arguments[0]]
            names = dict.fromkeys([*room.NAMED, *room.LAYOUTS])
            return [", ".join(f"`{name}`" for name in names) + "."]
        if self.arguments[0] == "summaries":
            return [", ".join(f"`{name}`" for name in SUMMARY_NAMES) + "."]
        rows = [
            f"| `{each.name}` | {each.words.replace('|', chr(92) + '|')} | {each.unit} |"
            for each in measures.MEASURES.values()
        ]
        return ["| measure | what it is | unit |", "|---|---|---|", *rows]


class BackendSettings(Written):
    """Every back-end: what it minimises, in its own words, and its settings."""

    def lines(self) -> list[str]:
        lines: list[str] = []
        for name in backends.known():
            kind = backends.load(name)
            doc = BAR.sub(lambda found: found[1] or r"\|", inspect.getdoc(kind) or "")
            lines += [f"### `{name}`", "", "````{eval-rst}", *doc.splitlines(), "````", ""]
            settings = [f"`{item.name} = {item.default!r}`" for item in fields(kind) if item.init]
            lines += [f"Settings: {', '.join(settings) or 'none'}.", ""]
        return lines


class PublicNames(Written):
    """autodoc of every public name, by room."""

    def lines(self) -> list[str]:
        rooms: dict[str, list[str]] = defaultdict(list)
        for name in sparsefit.__all__:
            home = sparsefit._HOMES.get(name, "").partition(".")[0]
            if home:
                rooms[ROOMS.get(home, home.capitalize())].append(name)
        lines: list[str] = []
        for room in dict.fromkeys([*ROOMS.values(), *rooms]):
            if room in rooms:
                lines += [f"## {room}", "", "````{eval-rst}"]
                for name in rooms[room]:
                    is_class = inspect.isclass(getattr(sparsefit, name))
                    kind = "autoclass" if is_class else "autofunction"
                    members = ["   :members:"] if is_class else []
                    lines += [f".. {kind}:: sparsefit.{name}", *members, ""]
                lines += ["````", ""]
        return lines


class Commands(Written):
    """Every verb with its help."""

    def lines(self) -> list[str]:
        return list(_verbs("sparsefit", parser(), "##"))


def _verbs(typed: str, declared: argparse.ArgumentParser, level: str):
    for action in declared._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, inner in action.choices.items():
                yield from (f"{level} {typed} {name}", "", "```text")
                yield from (*inner.format_help().strip().splitlines(), "```", "")
                yield from _verbs(f"{typed} {name}", inner, level + "#")


def write_pages(app: Sphinx) -> None:
    """Write a page for every study in `results/`, in `docs/studies/`, which git does not keep."""
    folder = Path(app.srcdir) / "studies"
    folder.mkdir(exist_ok=True)
    for old in folder.glob("*.md"):
        old.unlink()
    for path in RESULTS.glob("*/README.md"):
        name = path.parent.name
        text = re.sub(r"^###", "##", path.read_text("utf-8"), flags=re.MULTILINE)
        text = re.sub(r"!\[([^\]]*)\]\(", rf"![\1](../../results/{name}/", text)
        text = re.sub(r"(?<!!)\[([^\]]*)\]\([\w.-]+\)", r"\1", text)  # files beside it are no pages
        closing = f"The study is `studies/{name}.toml`, its files `results/{name}/`."
        (folder / f"{name}.md").write_text(f"{text.rstrip()}\n\n{closing}\n", "utf-8")


def link_pages(app: Sphinx, name: str, source: list[str]) -> None:
    """Let a link to the README of a study lead to its page."""
    if "/" not in name:
        source[0] = README.sub(r"](studies/\1.md)", source[0])


PROPERTIES: dict[str, list[str]] = {}


def set_aside(app: Sphinx, what: str, name: str, value: object, options: object, lines) -> None:
    """Keep properties from napoleon, which takes words before a colon for a type."""
    if what in ("property", "attribute"):
        PROPERTIES[name] = list(lines)
        lines[:] = [""]


def escape_bars(app: Sphinx, what: str, name: str, value: object, options: object, lines) -> None:
    """Escape |w|, a size in docstrings, where reStructuredText sees a substitution."""
    text = "\n".join(PROPERTIES.pop(name, lines))
    lines[:] = BAR.sub(lambda found: found[1] or r"\|", text).split("\n")


def _math(block: bool):
    def visit(translator: Any, node: nodes.Element) -> None:
        formula = latex2mathml.tex2mathml(node.astext(), as_block=block)
        translator.body.append(f'<div class="math-block">{formula}</div>' if block else formula)
        raise nodes.SkipNode

    return visit


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives, and formulas as MathML, for which nothing is fetched."""
    for name, kind in (
        ("results", Results), ("picture", Picture), ("study-keys", StudyKeys),
        ("study-names", StudyNames), ("backend-settings", BackendSettings),
        ("public-names", PublicNames), ("commands", Commands),
    ):  # fmt: skip
        app.add_directive(name, kind)
    app.add_html_math_renderer("mathml", (_math(False), None), (_math(True), None))
    app.connect("builder-inited", write_pages)
    app.connect("source-read", link_pages)
    app.connect("autodoc-process-docstring", set_aside, priority=400)
    app.connect("autodoc-process-docstring", escape_bars, priority=600)
    return {"parallel_read_safe": False, "parallel_write_safe": True}
