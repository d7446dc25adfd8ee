"""One self-contained HTML file from sections of text, tables and pictures.

It opens offline and survives being mailed: style and script stand in it, and its policy lets no
other script run and nothing be fetched. Whatever comes from a file is escaped.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from typing import TypeAlias

from sparsefit.study.evidence.table import Column, Table, column_groups

ROWS = 500  # of a table; the CSV file has more
FILTERED = 8  # rows from which on a table can be filtered


@dataclass(frozen=True)
class Picture:
    """A figure of a page.

    svg: an element `<svg>`, of `drawing.to_inline` for one of Matplotlib; put in as it is. Links
    in it to `#NAME` are points that a reader can hover and reach by keyboard (`Points`).
    title, caption: plain text.
    """

    svg: str
    title: str
    caption: str = ""


@dataclass(frozen=True)
class Code:
    """A command or a hash, in letters of one width, with words before it."""

    text: str
    words: str = ""


Part: TypeAlias = str | Code | Table | Picture  # a text is a paragraph


@dataclass(frozen=True)
class Section:
    """A heading and what stands under it; `folded`: shown when asked for."""

    title: str
    parts: Sequence[Part]
    folded: bool = False


@dataclass(frozen=True)
class Points:
    """What the points of the pictures stand for: lines of text by name, and what shows one.

    command: to be followed by the name, `sparsefit study show STUDY --case`.
    """

    lines: Mapping[str, Sequence[str]] = field(default_factory=dict)
    command: str = ""


@dataclass(frozen=True)
class Page:
    """A question, its answers, a line on where they come from, and sections."""

    name: str
    question: str
    answers: Sequence[str]
    sections: Sequence[Section]
    progress: str = ""
    points: Points = field(default_factory=Points)


def to_html(page: Page) -> str:
    """Return the page as one HTML file: tables that sort and filter, points that tell their case.

    The same page gives the same bytes.
    """
    style, script = _asset("page.css"), _asset("page.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = (
        f"default-src 'none'; script-src 'sha256-{digest}'; style-src 'unsafe-inline'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    anchors = {section.title: _anchor(section.title) for section in page.sections}
    links = [f'<a href="#{anchor}">{escaped(title)}</a>' for title, anchor in anchors.items()]
    parts = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        f"<title>{escaped(page.name)}: {escaped(page.question)}</title>",
        f"<style>\n{style}</style>\n</head>\n<body>\n<header>",
        f'<p class="soft">{escaped(page.name)}</p>\n<h1>{escaped(page.question)}</h1>',
        *(f"<p>{escaped(answer)}</p>" for answer in page.answers),
        *([f'<p class="soft">{escaped(page.progress)}</p>'] if page.progress else []),
        f"<nav>{' '.join(links)}</nav>\n</header>\n<main>",
        *(_section(section, anchors[section.title]) for section in page.sections),
        '</main>\n<div id="tip" role="status" hidden></div>',
        f'<script type="application/json" id="points">{_points(page.points)}</script>',
        f"<script>{script}</script>\n</body>\n</html>\n",
    ]
    return "\n".join(parts)


def escaped(text: str) -> str:
    """Return text as HTML shows it letter for letter, in an element or an attribute."""
    return html.escape(text, quote=True)


def _asset(name: str) -> str:
    return (resources.files(__package__) / name).read_text(encoding="utf-8")


def _anchor(title: str) -> str:
    return "section-" + re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _section(section: Section, anchor: str) -> str:
    parts = [
        _part(part, f"{anchor}-{place}", section.title)
        for place, part in enumerate(section.parts, 1)
    ]
    if section.folded:
        parts = ["<details><summary>Show</summary>", *parts, "</details>"]
    body = "\n".join(parts)
    return f'<section id="{anchor}">\n<h2>{escaped(section.title)}</h2>\n{body}\n</section>'


def _part(part: Part, name: str, title: str) -> str:
    if isinstance(part, str):
        return f"<p>{escaped(part)}</p>"
    if isinstance(part, Code):
        return f"<p>{escaped(part.words)} <code>{escaped(part.text)}</code></p>"
    if isinstance(part, Picture):
        head = "" if part.title == title else f"<h3>{escaped(part.title)}</h3>\n"
        text = f"<figcaption>{escaped(part.caption)}</figcaption>"
        return f'{head}<figure>\n<div class="wide">{part.svg}</div>\n{text}\n</figure>'
    return _table(part, name, title)


def _table(table: Table, name: str, title: str) -> str:
    shown = replace(table, shown=ROWS)
    rows, head = shown.texts, "" if table.title == title else f"<h3>{escaped(table.title)}</h3>\n"
    search = (
        f'<p class="filter scripted"><label>Filter <input type="search" aria-controls="{name}" '
        'placeholder="words of a row"></label><output></output></p>\n'
        if len(rows) >= FILTERED
        else ""
    )
    body = "\n".join(f"<tr>{''.join(_cells(row, table.columns))}</tr>" for row in rows)
    notes = "".join(f'\n<p class="soft">{escaped(note)}</p>' for note in shown.remarks)
    # A region that scrolls is reached by keyboard.
    frame = f'<div class="table" tabindex="0" role="region" aria-label="{escaped(table.title)}">'
    return (
        f'{head}{search}{frame}<table class="sorts" id="{name}">\n<thead>'
        f"{''.join(_heads(table.columns))}</thead>\n<tbody>\n{body}\n</tbody></table></div>{notes}"
    )


def _cells(texts: Sequence[str], columns: Sequence[Column]) -> Iterator[str]:
    for text, column in zip(texts, columns, strict=True):
        yield f"<td{_aligned(column)}>{escaped(text)}</td>"


def _aligned(column: Column) -> str:
    return ' class="n"' if column.align == "right" else ""


def _heads(columns: Sequence[Column]) -> Iterator[str]:
    if any(column.group for column in columns):
        cells = (
            f'<th colspan="{span}" scope="colgroup">{escaped(name)}</th>'
            for name, span in column_groups(columns)
        )
        yield f"<tr>{''.join(cells)}</tr>"
    heads = (
        f'<th scope="col"{_aligned(column)}><button type="button">{escaped(column.heading)}'
        "</button></th>"
        for column in columns
    )
    yield f"<tr>{''.join(heads)}</tr>"


def _points(points: Points) -> str:
    """As JSON in which nothing ends a script: each text once, the lines by number."""
    words = {text: 0 for lines in points.lines.values() for text in lines}
    words = {text: place for place, text in enumerate(words)}
    numbered = {name: [words[text] for text in lines] for name, lines in points.lines.items()}
    content = {"command": points.command, "words": list(words), "points": numbered}
    text = json.dumps(content, separators=(",", ":"))
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
