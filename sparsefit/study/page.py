"""The pages of a study: tables and pictures as files, one offline HTML page, and a README.

The page is one file: style and script stand in it, its policy lets no other script run and nothing
be fetched, and whatever comes from a file is escaped.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from sparsefit.plot.style import (
    COLOURS,
    GREY,
    MARKERS,
    encoded,
    labels,
    legend,
    logarithmic,
    panels,
    styled,
    wrapped,
)
from sparsefit.study import figures, solver_times, tables
from sparsefit.study.entries import Script, grouped, read_entry
from sparsefit.study.figures import Picture
from sparsefit.study.measures import STATUSES, measure, numbers
from sparsefit.study.selection import Check, Selection, lines
from sparsefit.study.table import MARKDOWN, Column, Table, cell_text, significant
from sparsefit.whole_file import write_files

LARGEST_VECTOR = 1_000_000  # bytes of an SVG that is written beside its PNG
PAGE, README, EVIDENCE = "report.html", "README.md", "evidence.md"
WORDS = 700  # of a README: what is longer stands in its files and on the page
LEAST_ROWS = 6  # of a table in a README, below which only its file is named
ROWS = 500  # of a table on a page; the CSV file has more
CLIPPED = re.compile(r"^.*?(?=<svg)", re.DOTALL)


@dataclass(frozen=True, eq=False)
class Drawing:
    """A picture of a page: its SVG, with linear axes too where some are logarithmic.

    lines: the id of each line in the SVG and what a legend calls it.
    """

    title: str
    caption: str
    svg: str
    linear: str = ""
    lines: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Code:
    """A text in letters of one width, shown when asked for."""

    title: str
    code: str


@dataclass(frozen=True, eq=False)
class Section:
    """A heading and its parts: texts, lists of texts, tables, drawings and code."""

    title: str
    parts: Sequence[Any]


@cache
def _template() -> tuple[jinja2.Template, str]:
    here = resources.files(__package__)
    environment = jinja2.Environment(autoescape=True, trim_blocks=True)
    template = environment.from_string((here / "page.html").read_text(encoding="utf-8"))
    return template, (here / "page.js").read_text(encoding="utf-8")


def to_html(name: str, question: str, answers: Sequence[str], sections: Sequence[Section],
            progress: str = "") -> str:  # fmt: skip
    """Return one HTML file that opens offline: tables sort and filter, lines hide and show."""
    template, script = _template()
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    shown = [section for section in sections if section.parts]
    return template.render(name=name, question=question, answers=answers, sections=shown,
                           progress=progress, script=script, digest=digest)  # fmt: skip


def drawing(name: str, picture: Picture, svg: bytes = b"") -> Drawing | str:
    """Return a picture, drawn already as `svg` or not, as a part of a page; or its caption."""
    figure = picture.figure
    if figure is None:
        return picture.caption
    lines: dict[str, str] = {}
    for axes in figure.axes:
        for artist in (*axes.lines, *axes.collections):
            if artist.get_gid() and not str(artist.get_label()).startswith("_"):
                lines.setdefault(str(artist.get_gid()), str(artist.get_label()))
    drawn = _inline(svg or encoded(figure, ".svg", name))
    turned = [
        axes for axes in figure.axes if "log" in (axes.get_xscale(), axes.get_yscale())
    ] if lines else []  # fmt: skip
    for axes in turned:
        for axis, low_high in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            if axis.get_scale() == "log":
                set_scale = axes.set_xscale if axis is axes.xaxis else axes.set_yscale
                set_limits = axes.set_xlim if axis is axes.xaxis else axes.set_ylim
                set_scale("linear")
                set_limits(0.0, low_high[1])
    linear = _inline(encoded(figure, ".svg", f"{name}-linear")) if turned else ""
    title = name.replace("-", " ").replace("_", " ").capitalize()
    return Drawing(title, picture.caption, drawn, linear, lines)


def _inline(svg: bytes) -> str:
    """Return the bytes of an SVG file as an element of a page."""
    return CLIPPED.sub("", svg.decode(), 1)


def check_outputs(study: Any) -> None:
    """Refuse, before anything is run, outputs that are not known.

    Raises:
        InputError: with the nearest name that is.
    """
    outputs, script = study.definition.outputs, Script.of(study)
    for entry in outputs.tables:
        if not (isinstance(entry, str) and entry in script.functions):
            read = read_entry(entry, tables.NAMED, tables.LAYOUTS, "table", script)
            if read.contrasts:
                plan = study.plan()
                for pair in read.contrasts:
                    tables.sides_of(plan, *pair)
    for entry in outputs.figures:
        if not (isinstance(entry, str) and entry in script.functions):
            read_entry(entry, figures.NAMED, figures.LAYOUTS, "figure", script)
    if outputs.headline:
        measure(outputs.headline)


def headline(study: Any, cases: pd.DataFrame) -> str:
    """Return the one sentence of a study: the best and the worst candidate by its measure."""
    outputs = study.definition.outputs
    if "objective" in cases and not outputs.headline:
        return " ".join(solver_times.headline(cases))
    truth = np.isfinite(numbers(cases, "true_timescale")).any()
    each = measure(outputs.headline or ("timescale-error" if truth else "called-ok"))
    values = each.values(cases)
    scores = {
        str(title): float(each.reduce(values[places]))
        for (title,), places in grouped(cases, ["title"])
        if not np.isnan(values[places]).all()
    }
    words = f"{each.phrase[:1].upper()}{each.phrase[1:]}"
    if not scores:
        return f"No case has a number for the {each.phrase}."
    size = {name: -value if each.more else abs(value) for name, value in scores.items()}
    best, worst = min(size, key=size.__getitem__), max(size, key=size.__getitem__)
    count = cases["flight"].nunique()
    kind = "problem" if "objective" in cases else "flight"
    several = cases["condition"].nunique()
    where = f"over {count} {kind}{'s' * (count > 1)}"
    where += f" in {several} conditions" if several > 1 else ""
    said = f"{words}, {where}: {_value(each, scores[best])} ({_sharers(scores, best)})"
    if _value(each, scores[worst]) != _value(each, scores[best]):
        said += f" to {_value(each, scores[worst])} ({_sharers(scores, worst)})"
    failing = f"; {each.convention}" if each.miss is not None else ""
    reference = outputs.reference
    printed = None if reference is None else tables.printed_value(reference, each)
    if printed is not None:
        failing += f"; {reference.name}: {_value(each, printed)}"
    return f"{said}{failing}."


def _value(each: Any, value: float) -> str:
    return f"{cell_text(value, tables.column_of(each))} {each.unit}".rstrip()


def _sharers(scores: Mapping[str, float], name: str) -> str:
    """Return a candidate, and how many others have the same value."""
    others = sum(significant(value) == significant(scores[name]) for value in scores.values()) - 1
    return f"{name}{f' and {others} more' if others else ''}"


def progress(study: Any, cases: pd.DataFrame) -> str:
    """Return how many cases there are and how they ended, `3990 of 3990 cases: 3721 ok`."""
    counted, planned = Counter(cases["status"]), len(study.plan())
    ended = ", ".join(f"{counted[name]} {name}" for name in STATUSES if counted[name])
    return f"{len(cases)} of {planned} planned cases: {ended}. Seed {study.seed}."


def show(study: Any, cases: pd.DataFrame, *, width: int) -> str:
    """Return the question, the headline and the first tables for a terminal."""
    made = tables.tables(study, cases)
    head = [f"{study.name}: {study.question}", headline(study, cases), progress(study, cases)]
    return "\n".join([*head, "", *(each.to_text(width) for each in made.values())])


def write(study: Any) -> list[Path]:
    """Write NAME.csv, NAME.tex and NAME.svg, .png of all outputs, report.html and README.md.

    Returns:
        The files written, README.md last.
    """
    cases = study.cases
    made = tables.tables(study, cases)
    pictures = figures.figures(study, cases)
    files = table_files(study.name, made)
    parts: list[Drawing | str] = []
    vectors: dict[str, bytes] = {}
    for name, picture in pictures.items():
        if picture.figure is not None:
            vector = encoded(picture.figure, ".svg", name)
            vectors[name] = vector
            if len(vector) <= LARGEST_VECTOR:  # a repository is no place for a larger one
                files[f"{name}.svg"] = vector
            files[f"{name}.png"] = encoded(picture.figure, ".png")
        parts.append(drawing(name, picture, vectors.get(name, b"")))
    answer, state = headline(study, cases), progress(study, cases)
    lasting = [each for each in made.values() if not each.varies]
    varying = [each for each in made.values() if each.varies]
    sections = [
        Section("Tables", [_shown(each) for each in lasting]),
        Section("Pictures", parts),
        Section("Times", [_shown(each) for each in varying]),
        Section("This run", list(_run(study))),
    ]
    if "objective" in cases:
        sections[0], sections[2] = sections[2], sections[0]
        sections[0] = Section("Solvers", sections[0].parts)
        sections[2] = Section("More tables", sections[2].parts)
    page = to_html(study.name, study.question, [answer], sections, state)
    files[PAGE] = page.encode()
    large = {name for name in vectors if f"{name}.svg" not in files}
    files[README] = _readme(study, answer, state, made, pictures, large).encode()
    return write_files(study.folder, files)


def table_files(study: str, made: Mapping[str, Table]) -> dict[str, bytes]:
    """Return every table as NAME.csv and NAME.tex."""
    return {
        f"{name}.{suffix}": text.encode()
        for name, each in made.items()
        for suffix, text in (
            ("csv", each.to_csv()),
            ("tex", each.to_latex(f"tab:{study}-{name}")),
        )
    }


def _shown(each: Table) -> Table:
    """Return a table with as many rows as a page has."""
    return Table(each.title, each.columns, each.rows, each.notes, ROWS, each.names)


def _run(study: Any) -> Iterator[Any]:
    """Give the study file, and what the manifest says of versions, machine and time."""
    file = Path(study.path)
    if file.is_file():
        yield Code(f"The study file, {file.name}", file.read_text(encoding="utf-8"))
    script = Script.of(study).path
    if script is not None:
        yield Code(f"Its script, {script.name}", script.read_text(encoding="utf-8"))
    manifest = study.folder / "manifest.json"
    if manifest.is_file():
        record = json.loads(manifest.read_text(encoding="utf-8"))
        rows = [(key.replace("_", " "), json.dumps(value)) for key, value in record.items()]
        yield Table("Versions, machine and time", (Column("what"), Column("value")), rows)


def _readme(study: Any, answer: str, state: str, made: Mapping[str, Table],
            pictures: Mapping[str, Picture], large: Collection[str]) -> str:  # fmt: skip
    """Return the README: question, headline, pictures (PNG of the large), and readable rows."""
    escaped = [text.translate(MARKDOWN) for text in (study.name, study.question, answer)]
    parts = [f"# {escaped[0]}", f"**{escaped[1]}**", escaped[2],
             f"{state} Written by `sparsefit study report`; do not edit."]  # fmt: skip
    for name, picture in pictures.items():
        caption = picture.caption.translate(MARKDOWN)
        file = f"{name}.png" if name in large else f"{name}.svg"
        parts.append(f"![{name}]({file})\n\n*{caption}*" if picture.figure else caption)
    room = WORDS - sum(len(part.split()) for part in parts)
    files = []
    for name, each in made.items():
        rows, text = min(len(each.rows), each.shown), ""
        while rows >= min(LEAST_ROWS, len(each.rows)) and rows:
            text = each.to_markdown(rows)
            if len(text.split()) <= room:
                break
            rows, text = rows - max(1, rows // 4), ""
        if text and not each.varies:
            more = len(each.rows) - rows
            parts.append(text + (f"\n{more} more rows: [{name}.csv]({name}.csv)\n" if more else ""))
            room -= len(text.split()) + 5
        else:
            files.append(f"[{name}]({name}.csv)")
    if files:
        parts.append(f"More tables: {', '.join(files)}.")
    return "\n\n".join(part.strip() for part in parts) + "\n"


CAPTION = (
    "The criterion with its 95 % interval against the latency of one estimate, from the median to "
    "the 99th percentile. Ringed: the chosen; hollow: breaks a constraint; line: what nothing "
    "beats in both."
)


def pareto(selection: Selection) -> Picture:
    """Return accuracy against latency of all candidates that were timed, with their front."""
    timed = [
        (each, seen) for each in selection.ranked
        if (seen := selection.latencies.get(each.candidate)) and math.isfinite(seen["median"])
    ]  # fmt: skip
    if not timed:
        return Picture(None, "No candidate was timed.")

    def draw() -> Figure:
        figure, ((axes,),) = panels(1, 1, height=4.2)
        readings = list(dict.fromkeys(selection.parts[each.candidate][0] for each, _ in timed))
        backends = list(dict.fromkeys(selection.parts[each.candidate][1] for each, _ in timed))
        short = labels([each.title for each, _ in timed], 50)
        for each, seen in timed:
            reading, backend = selection.parts[each.candidate]
            ink = COLOURS[backends.index(backend) % len(COLOURS)]
            x, y = 1e3 * seen["median"], each.evaluate
            if each is selection.chosen:
                axes.plot([x], [y], "o", ms=13, mfc="none", mec="black", mew=1.0, zorder=2)
            axes.plot([x, 1e3 * seen["p99"]], [y, y], color=ink, lw=0.7, alpha=0.6)
            axes.plot([x, x], each.between, color=ink, lw=0.7, alpha=0.6)
            axes.plot(
                [x], [y], MARKERS[readings.index(reading) % len(MARKERS)], ms=5, color=ink,
                mfc="white" if each.breaches else ink, label=short[each.title], zorder=4,
            )  # fmt: skip
        front: list[tuple[float, float]] = []
        sign = -1.0 if selection.criterion.measure.more else 1.0
        for seen_, loss in sorted(
            (seen["median"], sign * each.evaluate) for each, seen in timed if not each.breaches
        ):
            if not front or loss < front[-1][1]:
                front.append((1e3 * seen_, loss))
        if len(front) > 1:
            axes.step([x for x, _ in front], [sign * y for _, y in front], where="post",
                      color=GREY, lw=0.9, ls="--", zorder=1)  # fmt: skip
        times, values = [seen["median"] for _, seen in timed], [each.evaluate for each, _ in timed]
        if max(times) > 2.0 * min(times) > 0:
            axes.set_xscale("log")
            logarithmic(axes.xaxis, *axes.get_xlim())
        if max(values) > 8.0 * min(values) > 0:
            axes.set_yscale("log")
            logarithmic(axes.yaxis, *axes.get_ylim())
        axes.set_xlabel("latency of one estimate [ms]")
        unit = selection.criterion.measure.unit
        axes.set_ylabel(wrapped(f"{selection.criterion.words} [{unit}]", 50))
        legend(figure, [axes])
        return figure

    return Picture(styled(draw), CAPTION)


def write_selection(
    study: Any, selection: Selection, folder: Path | None = None, check: Check | None = None
) -> list[Path]:
    """Write the tables and pictures of a selection, evidence.html and evidence.md, the last."""
    said = lines(selection, check)
    made = {"selection": selection.table, "regimes": selection.regimes}
    timed = selection.latency
    files = table_files(study.name, made | ({"latency": timed} if timed else {}))
    picture = pareto(selection)
    if picture.figure is not None:
        files["pareto.svg"] = encoded(picture.figure, ".svg", "pareto")
        files["pareto.png"] = encoded(picture.figure, ".png")
    rule = json.dumps(selection.record()["rule"], indent=1)
    sections = [
        Section("Why", [said]),
        Section("Candidates", [made["selection"]]),
        Section("Accuracy and latency", [drawing("pareto", picture), *([timed] if timed else [])]),
        Section("Regimes", [made["regimes"], Code("The rule", rule)]),
    ]
    title = f"{study.name}: the selection"
    page = to_html(title, study.question, [selection.headline], sections)
    files["evidence.html"] = page.encode()
    text = [f"# {title}", f"**{study.question}**", f"**{selection.headline}**",
            "\n".join(f"- {line}" for line in said),
            *(["![accuracy and latency](pareto.svg)"] if picture.figure is not None else []),
            made["selection"].to_markdown(12),
            "Tables: [selection.csv](selection.csv), [regimes.csv](regimes.csv). Written by "
            "`sparsefit select`; do not edit."]  # fmt: skip
    files[EVIDENCE] = ("\n\n".join(part.strip() for part in text) + "\n").encode()
    return write_files(folder or study.folder, files)
