"""Directives of the documentation, generated from the package and its results.

`{results} STUDY/TABLE`: rows and columns of a CSV file in results/; `{answers}`: the question
and headline of every study; the role `{measured}`: a number of a table, checked against the claim
of its sentence; `{study-keys} SECTION`: keys of a study file; `{study-names} KIND`: names for
[outputs]; `{backend-settings}` and `{commands}`: back-ends and verbs. READMEs of studies become
pages.
"""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import pandas as pd
from docutils import nodes
from docutils.parsers.rst import directives
from docutils.parsers.rst.states import Inliner
from docutils.statemachine import StringList
from docutils.utils.math import latex2mathml
from sphinx.application import Sphinx
from sphinx.ext.napoleon import GoogleDocstring
from sphinx.util.docutils import SphinxDirective

from sparsefit import backends
from sparsefit.cli import parser
from sparsefit.study import crossing, figures, keys, measures, schema, tables
from sparsefit.study.keys import QUANTITIES, FlightWords
from sparsefit.study.measures import SUMMARY_NAMES

DOCS = Path(__file__).parents[1]
RESULTS = DOCS.parent / "results"
DECIMAL = re.compile(r"-?[0-9]+(\.[0-9]+(e[+-]?[0-9]+)?|e[+-]?[0-9]+)")
README = re.compile(r"\]\(\.\./results/([a-z0-9_-]+)/README\.md\)")


def table(heads: Iterable[str], rows: Iterable[Iterable[object]]) -> list[str]:
    """The lines of a Markdown table."""
    every = ([str(cell).replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows)
    first = list(heads)
    return [f"| {' | '.join(row)} |" for row in (first, ["---"] * len(first), *every)]


# The records whose fields are the keys of a section: "study" is the top of a file of flights,
# "solvers" that of problems, whose [[backends]] are "contenders", [[solvers]] "own-solvers".
RECORDS = {
    "study": (keys.FlightFile,), "flights": (FlightWords,), "logs": (keys.LogRules,),
    "backends": (keys.BackendKeys,), "protocols": (keys.ProtocolKeys,), "split": (keys.Split,),
    "run": (keys.RunRule,), "select": (keys.SelectionRule,), "outputs": (keys.Outputs,),
    "outputs.reference": (keys.Reference,), "solvers": (keys.ProblemFile,),
    "problems": (keys.ProblemKeys, keys.Generator), "contenders": (keys.ContenderKeys,),
    "own-solvers": (keys.SolverKeys,), "path": (keys.PathRule,), "clock": (keys.Clock,),
}  # fmt: skip


def meanings(section: str) -> dict[str, str]:
    """The description of each key of a section, with what its records say."""
    means = schema.shipped("keys.toml")[section]
    words = dict.fromkeys(crossing.SECTION_KEYS.get(section, ()), "")
    for kind in RECORDS.get(section, ()):
        words |= schema.sentences(kind, section)
    if section == "flights":
        rows = QUANTITIES.items()
        words |= {name: schema.described(means[name], row.unit, row.range) for name, row in rows}
    return words | {name: text for name, text in means.items() if not words.get(name)}


def study_keys(section: str, _: Mapping[str, str] | None = None) -> list[str]:
    """A Markdown table of the keys of a section; ValueError for one without a description."""
    words = meanings(section)
    missing = [key for key, text in words.items() if not text]
    if missing or not words:
        raise ValueError(f"keys.toml, [{section}]: no words for {missing}")
    return table(("key", "what it holds"), ((f"`{key}`", text) for key, text in words.items()))


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(";") if part.strip()]


def _selected(name: str, columns: list[str], where: str) -> pd.DataFrame:
    """Rows of results/NAME.csv where columns hold one of `value | value`, and these columns."""
    frame = pd.read_csv(RESULTS / f"{name}.csv", dtype=str, keep_default_na=False)
    wanted = dict(map(str.strip, part.split("=", 1)) for part in _listed(where))
    absent = [column for column in (*columns, *wanted) if column not in frame]
    if absent:
        raise ValueError(f"{name}.csv has no column {absent}; it has {', '.join(frame)}")
    for column, values in wanted.items():
        frame = frame[frame[column].isin([value.strip() for value in values.split("|")])]
    if frame.empty:
        raise ValueError(f"{name}.csv has no row where {where}")
    return frame[columns or list(frame)]


def results(name: str, options: Mapping[str, str]) -> list[str]:
    """Rows and columns of a table that a study wrote."""
    columns, heads = (_listed(options.get(key, "")) for key in ("columns", "names"))
    frame = _selected(name, columns, options.get("where", ""))
    rows = frame.map(lambda cell: f"{float(cell):.3g}" if DECIMAL.fullmatch(cell) else cell)
    return [*table(heads or frame, rows.to_numpy()), "", f"*From results/{name}.csv*"]


def measured(text: str) -> str:
    """The number defined by `STUDY/TABLE; COLUMN; SUMMARY; CLAIM; WHERE`.

    SUMMARY is min, max, median, sum or range of the column, CLAIM `<= 5`, `>= 90` or `-`, WHERE
    `column=value|value; ...`. Raises ValueError if the number contradicts the claim.
    """
    name, column, summary, claim, *where = _listed(text)
    values = pd.to_numeric(_selected(name, [column], "; ".join(where))[column]).dropna()
    low, high = values.min(), values.max()
    figure = (low, high) if summary == "range" else (getattr(values, summary)(),) * 2
    sign, _, limit = claim.partition(" ")
    if (sign == "<=" and figure[1] > float(limit)) or (sign == ">=" and figure[0] < float(limit)):
        raise ValueError(f"{name}: {column} is {figure}, and the page claims {claim}")
    return " to ".join(dict.fromkeys(f"{value:.3g}" for value in figure))


def measured_role(role, rawtext, text, lineno, inliner, options=None, content=None):
    """The role for a number of a study in a sentence."""
    try:
        return [nodes.Text(measured(text))], []
    except (OSError, ValueError) as error:
        message = inliner.reporter.error(str(error), line=lineno)
        return [inliner.problematic(rawtext, rawtext, message)], [message]


def answers(_: str, options: Mapping[str, str]) -> list[str]:
    """The question and the headline of every study."""
    rows = []
    for path in sorted(RESULTS.glob("*/README.md")):
        _, question, answer, *_ = path.read_text("utf-8").split("\n\n")
        link = f"[`{path.parent.name}`](studies/{path.parent.name}.md)"
        rows.append((link, question.strip("*"), answer))
    return table(("study", "question", "answer"), rows)


def study_names(kind: str, options: Mapping[str, str]) -> list[str]:
    """The names for [outputs]: tables, figures, summaries or measures."""
    if kind == "measures":
        rows = [(f"`{name}`", each.words, each.unit, each.kind or "flights, problems")
                for name, each in measures.MEASURES.items()]  # fmt: skip
        return table(("measure", "what it is", "unit", "of"), rows)
    layouts = {"tables": tables.LAYOUTS, "figures": figures.LAYOUTS}
    names = (
        {**schema.shipped("outputs.toml")[kind], **layouts[kind]}
        if kind in layouts
        else SUMMARY_NAMES
    )
    return [", ".join(f"`{name}`" for name in names) + "."]


def backend_settings(_: str, options: Mapping[str, str]) -> list[str]:
    """The docstring and the settings of every back-end."""
    lines: list[str] = []
    for name in backends.known():
        kind = backends.load(name)
        doc = (inspect.getdoc(kind) or "").splitlines()
        lines += [f"### `{name}`", "", "````{eval-rst}", *doc, "````", ""]
        settings = [f"`{item.name} = {item.default!r}`" for item in fields(kind) if item.init]
        lines += [f"Settings: {', '.join(settings) or 'none'}.", ""]
    return lines


def commands(_: str, options: Mapping[str, str]) -> list[str]:
    """Every verb with its help."""

    def verbs(typed: str, declared: argparse.ArgumentParser, level: str) -> Iterator[str]:
        for action in declared._actions:
            if isinstance(action, argparse._SubParsersAction):
                for name, inner in action.choices.items():
                    text = inner.format_help().strip()
                    yield from (f"{level} {typed} {name}", "", "```text", *text.splitlines(), "```")
                    yield from ("", *verbs(f"{typed} {name}", inner, level + "#"))

    return list(verbs("sparsefit", parser(), "##"))


def written(content: Callable[[str, Mapping[str, str]], list[str]]) -> type[SphinxDirective]:
    """A directive whose Markdown lines are computed by `content` from its argument and options."""

    class Written(SphinxDirective):
        option_spec: ClassVar = dict.fromkeys(("columns", "names", "where"), directives.unchanged)
        optional_arguments = 1

        def run(self) -> list[nodes.Node]:
            try:
                lines = content("".join(self.arguments), self.options)
            except (OSError, KeyError, ValueError) as error:
                raise self.error(str(error)) from None
            holder = nodes.section()
            holder.document = self.state.document
            source, _ = self.get_source_info()
            self.state.nested_parse(StringList(lines, source), 0, holder)
            return holder.children

    return Written


def write_pages(app: Sphinx) -> None:
    """Write a page for every study in `results/`, in a folder that git ignores."""
    for path in RESULTS.glob("*/README.md"):
        name = path.parent.name
        text = re.sub(r"^###", "##", path.read_text("utf-8"), flags=re.MULTILINE)
        text = re.sub(r"!\[([^\]]*)\]\(", rf"![\1](../../results/{name}/", text)
        text = re.sub(r"(?<!!)\[([^\]]*)\]\([\w.-]+\)", r"\1", text)  # files beside it are no pages
        text += f"\nThe study is `studies/{name}.toml`, its files `results/{name}/`.\n"
        (DOCS / "studies").mkdir(exist_ok=True)
        (DOCS / "studies" / f"{name}.md").write_text(text, "utf-8")


def read_page(app: Sphinx, name: str, source: list[str]) -> None:
    """Link to pages of studies, not their READMEs; import the lazy public names of modules."""
    if "/" not in name:
        source[0] = README.sub(r"](studies/\1.md)", source[0])
    for module in re.findall(r"automodule:: (\S+)", source[0]):
        room = import_module(module)
        for item in getattr(room, "__all__", ()):
            setattr(room, item, getattr(room, item))


def a_bar(inliner: Inliner, match: re.Match[str], lineno: int):
    """Treat a bar as text: |w| is a norm in docstrings, not a substitution."""
    end = match.end("start")
    return match.string[:end], [], match.string[end:], []


def visit_math(translator: Any, node: nodes.Element) -> None:
    """Write a formula, inline or in a block of its own, as MathML."""
    block = isinstance(node, nodes.math_block)
    formula = latex2mathml.tex2mathml(node.astext(), as_block=block)
    translator.body.append(f'<div class="math-block">{formula}</div>' if block else formula)
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directives and a MathML renderer, which needs no script from the web."""
    for content in (results, study_keys, study_names, backend_settings, answers, commands):
        app.add_directive(content.__name__.replace("_", "-"), written(content))
    app.add_role("measured", measured_role)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math, None))
    app.connect("builder-inited", write_pages)
    app.connect("source-read", read_page)
    Inliner.dispatch = {**Inliner.dispatch, "|": a_bar}
    # Napoleon would take the words before the first colon of a property for its type.
    GoogleDocstring._parse_attribute_docstring = GoogleDocstring._consume_to_end
    return {"parallel_read_safe": False, "parallel_write_safe": True}
