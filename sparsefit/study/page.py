"""The report of a study: tables and figures as files, one offline HTML page, and a README.

The page is one file with its style and script; its content security policy forbids other scripts
and all requests, and texts are escaped.
"""

from __future__ import annotations

import base64
import hashlib
import itertools
import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

import pandas as pd

from sparsefit.errors import InputError, told_with
from sparsefit.plot.style import encoded, wrapped
from sparsefit.study import figures, solver_times, tables
from sparsefit.study.columns import STATUSES
from sparsefit.study.figures import Picture
from sparsefit.study.measures import in_flow, measure, stated
from sparsefit.study.store import MANIFEST, read_record
from sparsefit.study.table import MARKDOWN, Column, Table, cell_text, sentence, significant
from sparsefit.study.tables import asked, is_predicted, script_of
from sparsefit.study.trials import unit_of
from sparsefit.whole_file import write_files

Files: TypeAlias = dict[str, bytes]  # by name
Part: TypeAlias = dict[str, Any]  # of a page, a figure or a text to unfold, as in page.html


def to_html(name: str, question: str, answer: str,
            sections: Mapping[str, Sequence[Any]], progress: str = "") -> str:  # fmt: skip
    """Return the HTML of a page with sortable tables and figures whose lines can be hidden.

    Args:
        sections: parts by heading: texts, lists of texts, tables, drawings and, with `title` and
            `code`, preformatted texts that can be unfolded.
    """
    import jinja2

    here = resources.files(__package__)
    environment = jinja2.Environment(autoescape=True, trim_blocks=True)
    template = environment.from_string((here / "page.html").read_text(encoding="utf-8"))
    script = (here / "page.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    shown = {title: parts for title, parts in sections.items() if parts}
    return template.render(name=name, question=question, answer=answer, sections=shown,
                           progress=progress, script=script, digest=digest, most=500)  # fmt: skip


def drawing(name: str, picture: Picture, svg: bytes = b"") -> Part | str:
    """Return a figure as a part of a page, or its caption; `svg`: the figure if already encoded.

    The part has the `svg`, a `linear` one if some axes are logarithmic, and the legend of each line
    by its id in the SVG.
    """
    figure = picture.figure
    if figure is None or not (svg := svg or encoded(figure, ".svg", name)):
        return picture.caption

    def inline(vector: bytes) -> str:  # a figure of 7 in is 62 rem wide
        svg = re.sub(r"^.*?(?=<svg)", "", vector.decode(), count=1, flags=re.DOTALL)
        return svg.replace(
            "<svg ", f'<svg style="width: {62 / 7 * figure.get_figwidth():g}rem" ', 1
        )

    drawn = (line for axes in figure.axes for line in axes.lines if line.get_gid())
    lines = {str(line.get_gid()): str(line.get_label()) for line in drawn if line.get_label()}
    order = sorted(lines, key=lambda gid: (len(gid), gid))
    part = {"title": name.replace("-", " ").replace("_", " ").capitalize(),
            "caption": picture.caption, "svg": inline(svg),
            "lines": {gid: lines[gid] for gid in order}}  # fmt: skip
    for axes, axis in itertools.product(figure.axes if lines else (), "xy"):
        if getattr(axes, f"get_{axis}scale")() == "log":
            end = getattr(axes, f"get_{axis}lim")()[1]
            axes.set(**{f"{axis}scale": "linear", f"{axis}lim": (0.0, end)})
            part["linear"] = ""
    if "linear" in part:
        part["linear"] = inline(encoded(figure, ".svg", f"{name}-linear"))
    return part


def check_outputs(study: Any) -> None:
    """Refuse unknown outputs, and figures along nothing, before anything is run.

    Raises:
        InputError: with the nearest known name.
    """
    plan = study.plan()
    for kind, room in (("table", tables), ("figure", figures)):
        for name, entry in asked(study, kind, room.LAYOUTS):
            if not isinstance(entry, tables.Entry):
                continue
            if entry.along.startswith("flights.") and entry.along not in plan:
                raise InputError(f"{kind} {name}: along {entry.along}, which is not swept")
            if room.LAYOUTS[entry.compare or "settings"] is figures.lines:
                with told_with(f"{kind} {name}"):
                    figures.axes_of(entry, plan)
    headline = study.definition.outputs.headline
    if headline and measure(headline).kind not in ("", study.kind):
        raise InputError(f'[outputs] headline: "{headline}" is no measure of {study.kind}')


def headline(study: Any, cases: pd.DataFrame) -> str:
    """Return the summary sentence of a study: the best and the worst candidate by its measure."""
    outputs = study.definition.outputs
    default = "timescale-error" if in_flow(cases).any() else "called-ok"
    if study.kind == "problems":
        default = "holdout-error" if is_predicted(cases) else ""
    if not (name := outputs.headline or default):
        return solver_times.headline(cases)
    each = measure(name)
    values, column = each.values(cases), tables.column_of(each)
    groups = pd.Series(values).groupby(cases["title"].to_numpy(), sort=False)
    scores = groups.agg(each.summary_of).dropna()
    if scores.empty:
        return f"No case has a number for the {each.phrase}."

    def text(value: float) -> str:
        number = f"{cell_text(value, column)} {each.unit}".rstrip()
        return "no answer" if value == math.inf else number

    size, said = -scores if each.more else scores.abs(), list[str]()
    for name in map(str, dict.fromkeys((size.idxmin(), size.idxmax()))):
        others = int((scores.map(significant) == significant(scores[name])).sum()) - 1
        sharers = f" and {others} more" if others else ""
        said.append(f"{text(scores[name])} ({name}{sharers})")
    count, several = cases["flight"].nunique(), cases["condition"].nunique()
    where = f"over {count} {unit_of(cases)}{'s' * (count > 1)}"
    where += f" in {several} conditions" if several > 1 else ""
    failing = ", failures included" if each.miss is not None else ""
    printed = stated(outputs.reference).get(each.name)
    if printed is not None:
        failing += f"; {outputs.reference.name}: {text(printed)}"
    return sentence(f"{each.phrase}, {where}: {' to '.join(said)}{failing}")


def progress(study: Any, cases: pd.DataFrame) -> str:
    """Return the numbers of cases by status, `3990 of 3990 planned cases: 3721 ok`."""
    counted, planned = Counter(cases["status"]), len(study.plan())
    ended = ", ".join(f"{counted[name]} {name}" for name in STATUSES if counted[name])
    return f"{len(cases)} of {planned} planned cases: {ended}. Seed {study.seed}."


def show(study: Any, cases: pd.DataFrame, *, width: int, tables_shown: int = 99) -> str:
    """Return the question, the headline and the first tables for a terminal."""
    made = list(tables.tables(study, cases).values())[:tables_shown]
    head = (f"{study.name}: {study.question}", headline(study, cases), progress(study, cases))
    return "\n".join(
        [*(wrapped(text, width) for text in head), "", *(each.to_text(width) for each in made)]
    )


def files_of(study: str, made: Mapping[str, Table], pictures: Mapping[str, Picture]) -> Files:
    """Return tables as NAME.csv and .tex, figures as NAME.svg, or .png above 1 MB."""
    files: Files = {}
    for name, each in made.items():
        files[f"{name}.csv"] = each.to_csv().encode()
        files[f"{name}.tex"] = each.to_latex(f"tab:{study}-{name}").encode()
    for name, picture in pictures.items():
        if picture.figure is not None:
            vector = encoded(picture.figure, ".svg", name)
            is_large = len(vector) > 1_000_000  # for a repository
            files |= (
                {f"{name}.png": encoded(picture.figure, ".png")} if is_large
                else {f"{name}.svg": vector}
            )  # fmt: skip
    return files


def joined(parts: Sequence[str]) -> bytes:
    """Return the paragraphs of a Markdown file."""
    return ("\n\n".join(part.strip() for part in parts if part) + "\n").encode()


def linked(names: Iterable[str]) -> str:
    """Return links in Markdown to the CSV files of tables; empty without tables."""
    links = ", ".join(f"[{name}]({name}.csv)" for name in names)
    return f"Tables: {links}." if links else ""


def write(study: Any) -> list[Path]:
    """Write NAME.csv, NAME.tex and NAME.svg, .png of all outputs, report.html and README.md.

    Returns:
        The files written, README.md last.
    """
    cases = study.cases
    made, pictures = tables.tables(study, cases), figures.figures(study, cases)
    files = files_of(study.name, made, pictures)
    answer, state = headline(study, cases), progress(study, cases)
    steady = [each for each in made.values() if "objective" in cases or not each.varies]
    run: list[Part | Table] = [
        {"title": f"The {words}, {file.name}", "code": file.read_text(encoding="utf-8")}
        for words, file in (("study file", Path(study.path)), ("script", script_of(study)))
        if file is not None and file.is_file()
    ]
    if record := read_record(study.folder / MANIFEST):
        rows = [(key.replace("_", " "), json.dumps(value)) for key, value in record.items()]
        run.append(Table("Versions, machine and time", (Column("what"), Column("value")), rows))
    sections: dict[str, Sequence[Any]] = {
        "Tables": steady,
        "Figures": [drawing(name, each, files.get(f"{name}.svg", b""))
                    for name, each in pictures.items()],
        "Times": [each for each in made.values() if each not in steady],
        "This run": run,
    }  # fmt: skip
    page = to_html(study.name, study.question, answer, sections, state)
    files |= {"report.html": page.encode()}
    texts = [text.translate(MARKDOWN) for text in (study.name, study.question, answer)]
    written = f"{state} Written by `sparsefit study report`; do not edit."
    parts, shown = ["# {}\n\n**{}**\n\n{}".format(*texts), written], list[str]()
    for name, picture in pictures.items():
        caption = picture.caption.translate(MARKDOWN)
        file = f"{name}.svg" if f"{name}.svg" in files else f"{name}.png"
        shown.append(f"![{name}]({file})\n\n*{caption}*" if picture.figure else caption)
    room, fitting = 700 - sum(len(part.split()) for part in (*parts, *shown)), list[str]()
    for name, each in made.items():  # as far as 700 words go
        lengths = (each.to_markdown(rows, f"{name}.csv") for rows in (60, 30, 15, 8))
        text = next((text for text in lengths if len(text.split()) <= room), "")
        if text and not each.varies:
            fitting.append(text)
            room -= len(text.split())
    parts += [*fitting, *shown] if "prediction" in made else [*shown, *fitting]
    files["README.md"] = joined([*parts, linked(made)])
    return write_files(study.folder, files)
